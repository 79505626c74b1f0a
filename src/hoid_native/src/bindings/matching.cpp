#include "matching/matching.hpp"

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <functional>
#include <optional>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;
using matching::kDescriptorBytes;
using matching::MatchThreshold;

HOID_RESULT(Pairs);

class QueryConstraints
{
public:
  QueryConstraints(
    Vector<int8_t> min_octave, Vector<int8_t> max_octave,
    Array<uint8_t, -1, kDescriptorBytes> descriptors)
  : min_octave_(std::move(min_octave)),
    max_octave_(std::move(max_octave)),
    descriptors_(std::move(descriptors))
  {
    require_length("min_octave", min_octave_, count());
    require_length("max_octave", max_octave_, count());
  }

  int count() const { return descriptors_.size(); }
  const Vector<int8_t>& max_octave() const { return max_octave_; }
  matching::QueryConstraints view() const
  {
    return {min_octave_.data(), max_octave_.data(), descriptors_.data(), count()};
  }

private:
  Vector<int8_t> min_octave_, max_octave_;
  Array<uint8_t, -1, kDescriptorBytes> descriptors_;
};

class Candidates
{
public:
  Candidates(
    Array<float, -1, 3> measurement_px, Vector<uint8_t> octave,
    Array<uint8_t, -1, kDescriptorBytes> descriptors, std::optional<Vector<bool>> free)
  : measurement_px_(std::move(measurement_px)),
    octave_(std::move(octave)),
    descriptors_(std::move(descriptors)),
    free_(std::move(free))
  {
    require_length("measurement_px", measurement_px_, octave_.size());
    require_length("descriptors", descriptors_, octave_.size());
    if (free_) {
      require_length("free", *free_, octave_.size());
    }
  }

  const Vector<uint8_t>& octave() const { return octave_; }
  matching::Candidates view() const
  {
    const auto* free = free_ ? reinterpret_cast<const uint8_t*>(free_->data()) : nullptr;
    return {measurement_px_.data(), octave_.data(), descriptors_.data(), free, octave_.size()};
  }

private:
  Array<float, -1, 3> measurement_px_;
  Vector<uint8_t> octave_;
  Array<uint8_t, -1, kDescriptorBytes> descriptors_;
  std::optional<Vector<bool>> free_;
};

Pairs given(matching::Pairs&& pairs)
{
  return make<Pairs>(
    give(std::move(pairs.q)), give(std::move(pairs.k)), give(std::move(pairs.distance)));
}

Pairs match_by_projection(
  const RealArray<3, -1>& projection_px, const RealArray<-1>& radius_px,
  const QueryConstraints& wanted, const Candidates& candidates, const MatchThreshold& threshold)
{
  const int count = wanted.count();
  require_length("radius_px", radius_px, count);
  require(projection_px.size(1) == count, "projection_px: expected a column for each query");
  const double* u = projection_px.data();
  const matching::Windows windows{
    u, u + count, u + 2 * static_cast<std::ptrdiff_t>(count), radius_px.data()};
  return given(unlocked([&] {
    return matching::match_by_projection(windows, wanted.view(), candidates.view(), threshold);
  }));
}

Pairs match_along_segments(
  const RealArray<-1, 4>& segments_px, const RealArray<-1>& octave_radius_px,
  const QueryConstraints& wanted, const Candidates& candidates, const MatchThreshold& threshold)
{
  require_length("segments_px", segments_px, wanted.count());
  require_range("max_octave", wanted.max_octave(), 0, octave_radius_px.size());
  require_range("octave", candidates.octave(), 0, octave_radius_px.size());
  const matching::Segments segments{segments_px.data(), octave_radius_px.data()};
  return given(unlocked([&] {
    return matching::match_along_segments(segments, wanted.view(), candidates.view(), threshold);
  }));
}

nb::ndarray<nb::numpy, int64_t, nb::ndim<1>> typical_descriptors(
  const Array<uint8_t, -1, kDescriptorBytes>& descriptors, const Vector<int64_t>& starts)
{
  require_range("starts", starts, 0, descriptors.size());
  const int64_t *first = starts.data(), *last = first + starts.size();
  require(
    std::adjacent_find(first, last, std::greater_equal<>()) == last, "starts: must ascend");
  return give(unlocked([&] {
    return matching::typical_descriptors(
      descriptors.data(), descriptors.size(), first, starts.size());
  }));
}

}  // namespace

void bind_matching(nb::module_& module)
{
  nb::class_<QueryConstraints>(module, "QueryConstraints", R"(
What Q queries ask of a feature, wherever it lies.

Args:
    min_octave: (Q,) int8, inclusive.
    max_octave: (Q,) int8, inclusive.
    descriptors: (Q, 32) uint8.

Raises:
    ValueError: Lengths differ.)")
    .def(
      nb::init<Vector<int8_t>, Vector<int8_t>, Array<uint8_t, -1, kDescriptorBytes>>(),
      "min_octave"_a, "max_octave"_a, "descriptors"_a);
  nb::class_<Candidates>(module, "Candidates", R"(
N features among which queries look for theirs.

Args:
    measurement_px: (N, 3) float32 u, v, u_right; NaN u_right: no depth. Features without a
        position (NaN), or further out than any image is large, match nothing.
    octave: (N,) uint8.
    descriptors: (N, 32) uint8.
    free: (N,) bool, those that may be matched; None: all.

Raises:
    ValueError: Lengths differ.)")
    .def(
      nb::init<
        Array<float, -1, 3>, Vector<uint8_t>, Array<uint8_t, -1, kDescriptorBytes>,
        std::optional<Vector<bool>>>(),
      "measurement_px"_a, "octave"_a, "descriptors"_a, "free"_a = nb::none());
  nb::class_<MatchThreshold>(module, "MatchThreshold", R"(
How good a match must be.

Args:
    max_distance: Hamming.
    ratio: by which the best must beat a second best of its octave; 1.0: no test.)")
    .def(nb::init<int, double>(), "max_distance"_a, "ratio"_a)
    .def_ro("max_distance", &MatchThreshold::max_distance, "Hamming.")
    .def_ro(
      "ratio", &MatchThreshold::ratio, "Of the best distance to the second best; 1.0: no test.");
  module.def(
    "match_by_projection", &match_by_projection, "projection_px"_a, "radius_px"_a, "wanted"_a,
    "candidates"_a, "threshold"_a, R"(
Return the best feature of each query near its expected pixel, one to one.

Args:
    projection_px: (3, Q) u, v, u_right where each query is expected; NaN u_right: unknown.
    radius_px: (Q,) half sides of the square windows.
    wanted: by each query.
    candidates: which agree in u_right too where both know it.
    threshold: of a match.

Raises:
    ValueError: Lengths differ.)");
  module.def(
    "match_along_segments", &match_along_segments, "segments_px"_a, "octave_radius_px"_a,
    "wanted"_a, "candidates"_a, "threshold"_a, R"(
Return the best feature of each query along the segment where it may be, one to one.

Args:
    segments_px: (Q, 4) u, v of both ends; NaN: nowhere.
    octave_radius_px: (L,) how far from the segment a feature of each octave may lie.
    wanted: by each query.
    candidates: whose u_right is not looked at.
    threshold: of a match.

Raises:
    ValueError: Lengths differ, or an octave is not below L.)");
  module.def(
    "typical_descriptors", &typical_descriptors, "descriptors"_a, "starts"_a, R"(
Return the (G,) row of each group's descriptor with the least median distance to the others.

Args:
    descriptors: (M, 32), grouped; only the last eight of a larger group are compared.
    starts: (G,) int64 first row of each group, ascending.

Raises:
    ValueError: A group starts beyond the descriptors, or where another one does.)");
}

}  // namespace hoid::bindings
