// Matching: each query searches a region of the image, an octave range and the available features.

#include <algorithm>
#include <cmath>

#include "matching/grid.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

constexpr int kMaxDistance = 257;  // more than the largest Hamming distance of 256 bits

struct Best
{
  int feature = -1;
  int distance = kMaxDistance;
  int second_feature = -1;
  int second_distance = kMaxDistance;

  void update(int k, int new_distance)
  {
    if (new_distance < distance) {
      *this = {k, new_distance, feature, distance};
    } else if (new_distance < second_distance) {
      second_feature = k;
      second_distance = new_distance;
    }
  }
};

// Queries, candidates and the threshold of a match.
struct Problem
{
  QueryConstraints queries;
  Candidates candidates;
  MatchThreshold threshold;

  ALWAYS_INLINE bool may_match(int q, int k) const
  {
    return candidates.octave[k] >= queries.min_octave[q] &&
           candidates.octave[k] <= queries.max_octave[q] &&
           (candidates.free == nullptr || candidates.free[k] != 0);
  }

  ALWAYS_INLINE int distance(int q, int k) const
  {
    return hamming(queries.descriptors[q], candidates.descriptors[k]);
  }

  // Whether the best candidate passes the threshold. Lowe's ratio test (IJCV 2004) applies if the
  // second best has the same octave, as in ORB-SLAM.
  bool is_match(const Best& best) const
  {
    if (best.feature < 0 || best.distance > threshold.max_distance) {
      return false;
    }
    const bool needs_ratio_test =
      best.second_feature >= 0 &&
      candidates.octave[best.second_feature] == candidates.octave[best.feature];
    return !(needs_ratio_test && best.distance > threshold.ratio * best.second_distance);
  }
};

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

// A search region of a query: a square window around a pixel.
struct Window
{
  double u, v, u_right, radius;

  ALWAYS_INLINE Window(const Windows& windows, const Problem&, int q)
  : u(windows.projection_px.row(0)[q]),
    v(windows.projection_px.row(1)[q]),
    u_right(windows.projection_px.row(2)[q]),
    radius(windows.radius_px[q])
  {
  }

  Rectangle extent() const { return {u - radius, v - radius, u + radius, v + radius}; }

  ALWAYS_INLINE bool contains(const Problem& problem, int q, int k) const
  {
    const float* at = problem.candidates.measurement_px[k];
    const bool inside = std::abs(at[0] - u) < radius && std::abs(at[1] - v) < radius;
    // A missing right coordinate is NaN and passes.
    return inside && problem.may_match(q, k) && !(std::abs(at[2] - u_right) > radius);
  }
};

// A search region of a query: the pixels near a line segment.
struct Segment
{
  const double *at, *octave_radius_px;
  double du, dv, reach;

  ALWAYS_INLINE Segment(const Segments& segments, const Problem& problem, int q)
  : at(segments.ends_px[q]),
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
    const float* pixel = problem.candidates.measurement_px[k];
    const double radius = octave_radius_px[problem.candidates.octave[k]];
    return square_from_segment(pixel[0] - at[0], pixel[1] - at[1], du, dv) <= radius * radius;
  }
};

// Return the best candidate of each query if it passes the threshold. If it is the best candidate of
// several queries, the query with the smallest distance gets it.
template <typename Region, typename Regions>
ALWAYS_INLINE Pairs match(const Regions& regions, const Problem& problem)
{
  const int num_queries = problem.queries.descriptors.count;
  const Grid grid(problem.candidates.measurement_px);
  std::vector<Best> found(num_queries);
  std::vector<int> query_of(problem.candidates.descriptors.count, -1);  // of each feature
  for (int q = 0; q < num_queries; ++q) {
    Best best;
    const Region region(regions, problem, q);
    const Rectangle box = region.extent();
    grid.visit(
      box.u_min, box.v_min, box.u_max, box.v_max, [&](int k) __attribute__((always_inline)) {
        if (region.contains(problem, q, k)) {
          best.update(k, problem.distance(q, k));
        }
      });
    found[q] = best;
    if (problem.is_match(best)) {
      int& query = query_of[best.feature];
      query = query < 0 || best.distance < found[query].distance ? q : query;
    }
  }
  Pairs out;
  for (int q = 0; q < num_queries; ++q) {
    const int k = found[q].feature;
    if (k >= 0 && query_of[k] == q) {
      out.q.push_back(q);
      out.k.push_back(k);
      out.distance.push_back(found[q].distance);
    }
  }
  return out;
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
