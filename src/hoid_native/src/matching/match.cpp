// Matching: each query looks in a region, in an octave range and among what is free.

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "matching/candidates.hpp"
#include "matching/grid.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

struct Rectangle
{
  double u_min, v_min, u_max, v_max;
};

// Squared distance of a pixel from a segment that starts at the origin and runs along (du, dv).
ALWAYS_INLINE double square_from_segment(double u, double v, double du, double dv)
{
  const double length2 = du * du + dv * dv;
  const double share = length2 > 0 ? std::clamp((u * du + v * dv) / length2, 0.0, 1.0) : 0.0;
  const double apart_u = u - share * du, apart_v = v - share * dv;
  return apart_u * apart_u + apart_v * apart_v;
}

ALWAYS_INLINE Rectangle around(const Windows& windows, const Problem&, int q)
{
  const double u = windows.u[q], v = windows.v[q], radius = windows.radius_px[q];
  return {u - radius, v - radius, u + radius, v + radius};
}

ALWAYS_INLINE bool is_candidate(const Windows& windows, const Problem& problem, int q, int k)
{
  const float* at = problem.candidates.measurement_px + 3 * static_cast<std::size_t>(k);
  const double radius = windows.radius_px[q];
  const bool inside =
    std::abs(at[0] - windows.u[q]) < radius && std::abs(at[1] - windows.v[q]) < radius;
  // A missing right coordinate is NaN, and agrees.
  return inside && problem.may_match(q, k) && !(std::abs(at[2] - windows.u_right[q]) > radius);
}

ALWAYS_INLINE Rectangle around(const Segments& segments, const Problem& problem, int q)
{
  const double* at = segments.ends_px + 4 * static_cast<std::size_t>(q);
  const double reach = segments.octave_radius_px[problem.wanted.max_octave[q]];
  return {
    std::min(at[0], at[2]) - reach, std::min(at[1], at[3]) - reach,
    std::max(at[0], at[2]) + reach, std::max(at[1], at[3]) + reach};
}

ALWAYS_INLINE bool is_candidate(const Segments& segments, const Problem& problem, int q, int k)
{
  const double* at = segments.ends_px + 4 * static_cast<std::size_t>(q);
  const float* pixel = problem.candidates.measurement_px + 3 * static_cast<std::size_t>(k);
  const double radius = segments.octave_radius_px[problem.candidates.octave[k]];
  return problem.may_match(q, k) &&
         square_from_segment(pixel[0] - at[0], pixel[1] - at[1], at[2] - at[0], at[3] - at[1]) <=
           radius * radius;
}

// The best candidate of each query within `max_distance` that, when the second best is of the same
// octave, beats it by `ratio`. A feature goes to the nearest of the queries that want it.
template <typename Regions>
ALWAYS_INLINE Pairs match(const Regions& regions, const Problem& problem)
{
  const Grid grid(problem.candidates.measurement_px, problem.candidates.count);
  Assignment assignment(problem.candidates.count);
  for (int q = 0; q < problem.wanted.count; ++q) {
    Best best;
    const Rectangle box = around(regions, problem, q);
    grid.visit(box.u_min, box.v_min, box.u_max, box.v_max, [&](int k) __attribute__((always_inline)) {
      if (is_candidate(regions, problem, q, k)) {
        best.consider(k, problem.distance(q, k));
      }
    });
    if (problem.is_clear(best)) {
      assignment.offer(q, best);
    }
  }
  return assignment.pairs(problem.wanted.count);
}

}  // namespace

MULTIVERSION("popcnt")
Pairs match_by_projection(
  const Windows& windows, const QueryConstraints& wanted, const Candidates& candidates,
  const MatchThreshold& threshold)
{
  return match(windows, Problem{wanted, candidates, threshold});
}

MULTIVERSION("popcnt")
Pairs match_along_segments(
  const Segments& segments, const QueryConstraints& wanted, const Candidates& candidates,
  const MatchThreshold& threshold)
{
  return match(segments, Problem{wanted, candidates, threshold});
}

}  // namespace hoid::matching
