// Matching: each query searches a region of the image, an octave range and the available features.

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

// The search region of one query: a square window around a pixel ...
struct Window
{
  double u, v, u_right, radius;

  ALWAYS_INLINE Window(const Windows& windows, const Problem&, int q)
  : u(windows.u[q]),
    v(windows.v[q]),
    u_right(windows.u_right[q]),
    radius(windows.radius_px[q])
  {
  }

  Rectangle extent() const { return {u - radius, v - radius, u + radius, v + radius}; }

  ALWAYS_INLINE bool contains(const Problem& problem, int q, int k) const
  {
    const float* at = problem.candidates.measurement_px + 3 * static_cast<std::size_t>(k);
    const bool inside = std::abs(at[0] - u) < radius && std::abs(at[1] - v) < radius;
    // A missing right coordinate is NaN and passes.
    return inside && problem.may_match(q, k) && !(std::abs(at[2] - u_right) > radius);
  }
};

// ... or the surroundings of a segment.
struct Segment
{
  const double *at, *octave_radius_px;
  double du, dv, reach;

  ALWAYS_INLINE Segment(const Segments& segments, const Problem& problem, int q)
  : at(segments.ends_px + 4 * static_cast<std::size_t>(q)),
    octave_radius_px(segments.octave_radius_px),
    du(at[2] - at[0]),
    dv(at[3] - at[1]),
    reach(octave_radius_px[problem.queries.max_octave[q]])
  {
  }

  Rectangle extent() const
  {
    return {
      std::min(at[0], at[2]) - reach, std::min(at[1], at[3]) - reach,
      std::max(at[0], at[2]) + reach, std::max(at[1], at[3]) + reach};
  }

  ALWAYS_INLINE bool contains(const Problem& problem, int q, int k) const
  {
    if (!problem.may_match(q, k)) {
      return false;
    }
    const float* pixel = problem.candidates.measurement_px + 3 * static_cast<std::size_t>(k);
    const double radius = octave_radius_px[problem.candidates.octave[k]];
    return square_from_segment(pixel[0] - at[0], pixel[1] - at[1], du, dv) <= radius * radius;
  }
};

// Return the best candidate of each query if it passes the threshold. If it is the best candidate of
// several queries, the query with the smallest distance gets it.
template <typename Region, typename Regions>
ALWAYS_INLINE Pairs match(const Regions& regions, const Problem& problem)
{
  const Grid grid(problem.candidates.measurement_px, problem.candidates.count);
  Assignment assignment(problem.candidates.count);
  for (int q = 0; q < problem.queries.count; ++q) {
    Best best;
    const Region region(regions, problem, q);
    const Rectangle box = region.extent();
    grid.visit(
      box.u_min, box.v_min, box.u_max, box.v_max, [&](int k) __attribute__((always_inline)) {
        if (region.contains(problem, q, k)) {
          best.update(k, problem.distance(q, k));
        }
      });
    if (problem.is_match(best)) {
      assignment.offer(q, best);
    }
  }
  return assignment.pairs(problem.queries.count);
}

}  // namespace

MULTIVERSION("popcnt")
Pairs match_by_projection(
  const Windows& windows, const QueryConstraints& queries, const Candidates& candidates,
  const MatchThreshold& threshold)
{
  return match<Window>(windows, Problem{queries, candidates, threshold});
}

MULTIVERSION("popcnt")
Pairs match_along_segments(
  const Segments& segments, const QueryConstraints& queries, const Candidates& candidates,
  const MatchThreshold& threshold)
{
  return match<Segment>(segments, Problem{queries, candidates, threshold});
}

}  // namespace hoid::matching
