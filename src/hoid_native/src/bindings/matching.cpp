#include "matching/matching.hpp"

#include <nanobind/stl/optional.h>

#include <array>
#include <limits>
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

Pairs give_pairs(matching::Pairs&& pairs)
{
  return make<Pairs>(
    give(std::move(pairs.q)), give(std::move(pairs.k)), give(std::move(pairs.distance)));
}

Pairs match_by_projection(
  const RealArray<3, -1>& projection_px, const RealArray<-1>& radius_px,
  const QueryConstraints& queries, const Candidates& candidates, const MatchThreshold& threshold)
{
  const int count = queries.count();
  require_length("radius_px", radius_px, count);
  require(projection_px.size(1) == count, "projection_px: expected a column for each query");
  const double* u = projection_px.data();
  const matching::Windows windows{
    u, u + count, u + 2 * static_cast<std::ptrdiff_t>(count), radius_px.data()};
  return give_pairs(unlocked([&] {
    return matching::match_by_projection(windows, queries.view(), candidates.view(), threshold);
  }));
}

Pairs match_along_segments(
  const RealArray<-1, 4>& segments_px, const RealArray<-1>& octave_radius_px,
  const QueryConstraints& queries, const Candidates& candidates, const MatchThreshold& threshold)
{
  require_length("segments_px", segments_px, queries.count());
  require_range("max_octave", queries.max_octave(), 0, octave_radius_px.size());
  require_range("octave", candidates.octave(), 0, octave_radius_px.size());
  const matching::Segments segments{segments_px.data(), octave_radius_px.data()};
  return give_pairs(unlocked([&] {
    return matching::match_along_segments(segments, queries.view(), candidates.view(), threshold);
  }));
}

void require_bits(const Array<uint8_t, -1, -1>& bits)
{
  require_range("bits", bits, 0, 8 * kDescriptorBytes);
  require(bits.size(1) <= 32, "bits: a key has at most 32 bits");
}

nb::ndarray<nb::numpy, uint64_t, nb::ndim<2>> hash_keys(
  const Array<uint8_t, -1, kDescriptorBytes>& descriptors, const Array<uint8_t, -1, -1>& bits)
{
  require_bits(bits);
  const int count = descriptors.size(), num_tables = bits.size();
  auto keys = unlocked([&] {
    return matching::hash_keys(descriptors.data(), count, bits.data(), num_tables, bits.size(1));
  });
  return give<uint64_t>(
    std::move(keys),
    std::array{static_cast<std::size_t>(num_tables), static_cast<std::size_t>(count)});
}

nb::ndarray<nb::numpy, uint64_t, nb::ndim<2>> sorted_hash_keys(
  const Array<uint8_t, -1, kDescriptorBytes>& descriptors, const Array<uint8_t, -1, -1>& bits,
  int64_t first)
{
  require_bits(bits);
  const int count = descriptors.size(), num_tables = bits.size();
  require(
    first >= 0 && first + count <= std::numeric_limits<uint32_t>::max(),
    "first: a row must fit into 32 bits");
  auto keys = unlocked([&] {
    auto found =
      matching::hash_keys(descriptors.data(), count, bits.data(), num_tables, bits.size(1));
    for (std::size_t n = 0; n < found.size(); ++n) {
      found[n] |= static_cast<uint64_t>(first) + n % count;
    }
    matching::sort_hash_keys(found.data(), count, num_tables, bits.size(1));
    return found;
  });
  return give<uint64_t>(
    std::move(keys),
    std::array{static_cast<std::size_t>(num_tables), static_cast<std::size_t>(count)});
}

}  // namespace

void bind_matching(nb::module_& module)
{
  nb::class_<QueryConstraints>(module, "QueryConstraints", R"(
Octave limits and descriptors of Q queries, for which matching features are searched.

Args:
    min_octave: (Q,) int8 least octave of a matching feature.
    max_octave: (Q,) int8 greatest octave of a matching feature.
    descriptors: (Q, 32) uint8 ORB descriptors.

Raises:
    ValueError: Lengths differ.)")
    .def(
      nb::init<Vector<int8_t>, Vector<int8_t>, Array<uint8_t, -1, kDescriptorBytes>>(),
      "min_octave"_a, "max_octave"_a, "descriptors"_a);
  nb::class_<Candidates>(module, "Candidates", R"(
N features of an image among which matches are searched.

Args:
    measurement_px: (N, 3) float32 stereo observations u, v, u_right; NaN u_right: no depth. A
        feature whose position is NaN or beyond 16384 px is not matched.
    octave: (N,) uint8 octaves.
    descriptors: (N, 32) uint8 ORB descriptors.
    free: (N,) bool, whether each feature may be matched; None: all may be matched.

Raises:
    ValueError: Lengths differ.)")
    .def(
      nb::init<
        Array<float, -1, 3>, Vector<uint8_t>, Array<uint8_t, -1, kDescriptorBytes>,
        std::optional<Vector<bool>>>(),
      "measurement_px"_a, "octave"_a, "descriptors"_a, "free"_a = nb::none());
  nb::class_<MatchThreshold>(module, "MatchThreshold", R"(
Limits of the descriptor distances of a match.

Args:
    max_distance: largest Hamming distance.
    ratio: largest ratio of the best distance to the second best distance. The ratio is tested only
        if both features have the same octave; 1.0: no test.)")
    .def(nb::init<int, double>(), "max_distance"_a, "ratio"_a)
    .def_ro("max_distance", &MatchThreshold::max_distance, "Largest Hamming distance.")
    .def_ro(
      "ratio", &MatchThreshold::ratio,
      "Largest ratio of best to second best distance; 1.0: no test.");
  module.def(
    "match_by_projection", &match_by_projection, "projection_px"_a, "radius_px"_a, "queries"_a,
    "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features within windows around expected positions.

Args:
    projection_px: (3, Q) expected u, v, u_right of each query; NaN u_right: unknown.
    radius_px: (Q,) half sides of the square windows around u, v.
    queries: octave limits and descriptors of the queries.
    candidates: features of the image. If expected and measured u_right are known, they must also
        agree within the radius.
    threshold: limits of the descriptor distances.

Raises:
    ValueError: Lengths differ.)");
  module.def(
    "match_along_segments", &match_along_segments, "segments_px"_a, "octave_radius_px"_a,
    "queries"_a, "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features near image segments (of epipolar lines).

Args:
    segments_px: (Q, 4) u, v of both ends of each query's segment; NaN: no segment.
    octave_radius_px: (L,) largest distance between a segment and a feature, by the octave of the
        feature. It must not decrease with the octave.
    queries: octave limits and descriptors of the queries.
    candidates: features of the image, of which u_right is not used.
    threshold: limits of the descriptor distances.

Raises:
    ValueError: Lengths differ, or an octave is not below L.)");
  module.def(
    "hash_keys", &hash_keys, "descriptors"_a, "bits"_a, R"(
Return the (T, N) uint64 keys of descriptors in T hash tables, in the 32 upper bits.

The lower bits are 0. Each key consists of some bits of the descriptor (locality-sensitive hashing,
Indyk and Motwani, STOC 1998).

Args:
    descriptors: (N, 32) uint8 ORB descriptors.
    bits: (T, B) uint8 bits of the descriptor, at most 32, that are bits 0, 1, ... of the keys of
        each table. They are numbered as `numpy.unpackbits` orders them.

Raises:
    ValueError: There are more than 32 bits.)");
  module.def(
    "sorted_hash_keys", &sorted_hash_keys, "descriptors"_a, "bits"_a, "first"_a, R"(
Return the keys of `hash_keys`, sorted in each table, with row numbers in the 32 lower bits.

Args:
    descriptors: (N, 32) uint8 ORB descriptors.
    bits: as in `hash_keys`.
    first: row number of the first descriptor; the others have the next ones.

Raises:
    ValueError: There are more than 32 bits, or a row number has more than 32 bits.)");
}

}  // namespace hoid::bindings
