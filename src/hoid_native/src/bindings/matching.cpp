#include "matching/matching.hpp"

#include "bindings/arrays.hpp"

namespace hoid::bindings {

namespace {

using matching::kDescriptorBytes;
using matching::MatchThreshold;
using Descriptors = Array<uint8_t, -1, kDescriptorBytes>;
using KeyBits = Array<uint8_t, -1, -1>;

HOID_RESULT(Pairs);

struct QueryConstraints
{
  Vector<int8_t> min_octave, max_octave;
  Descriptors descriptors;

  QueryConstraints(
    const Vector<int8_t>& min_octave, const Vector<int8_t>& max_octave,
    const Descriptors& descriptors)
  : min_octave(min_octave), max_octave(max_octave), descriptors(descriptors)
  {
    require_lengths(count(), "min_octave", min_octave, "max_octave", max_octave);
  }

  int count() const { return descriptors.size(); }
  operator matching::QueryConstraints() const
  {
    return {min_octave, max_octave, descriptors, count()};
  }
};

struct Candidates
{
  Array<float, -1, 3> measurement_px;
  Vector<uint8_t> octave;
  Descriptors descriptors;
  std::optional<Vector<bool>> free;

  Candidates(
    const Array<float, -1, 3>& measurement_px, const Vector<uint8_t>& octave,
    const Descriptors& descriptors, const std::optional<Vector<bool>>& free)
  : measurement_px(measurement_px), octave(octave), descriptors(descriptors), free(free)
  {
    require_lengths(
      octave.size(), "measurement_px", measurement_px, "descriptors", descriptors);
    if (free) {
      require_lengths(octave.size(), "free", *free);
    }
  }

  operator matching::Candidates() const
  {
    return {measurement_px, octave, descriptors, free ? free->begin() : nullptr, octave.size()};
  }
};

Pairs give_pairs(matching::Pairs&& pairs)
{
  return make<Pairs>(std::move(pairs.q), std::move(pairs.k), std::move(pairs.distance));
}

void require_bits(const KeyBits& bits)
{
  require_range("bits", bits, 0, 8 * kDescriptorBytes);
  require(bits.size(1) <= 32, "bits: a key has at most 32 bits");
}

void bind_candidates(nb::module_& module)
{
  nb::class_<QueryConstraints>(module, "QueryConstraints", R"(
Octave limits and descriptors of Q queries, for which matching features are searched.

Args:
    min_octave: (Q,) int8 least octave of a matching feature.
    max_octave: (Q,) int8 greatest octave of a matching feature.
    descriptors: (Q, 32) uint8 ORB descriptors.)")
    .def(
      nb::init<const Vector<int8_t>&, const Vector<int8_t>&, const Descriptors&>(),
      "min_octave"_a, "max_octave"_a, "descriptors"_a);
  nb::class_<Candidates>(module, "Candidates", R"(
N features of an image among which matches are searched.

Args:
    measurement_px: (N, 3) float32 stereo observations u, v, u_right; NaN u_right: no depth. A
        feature whose position is NaN or beyond 16384 px is not matched.
    octave: (N,) uint8 octaves.
    descriptors: (N, 32) uint8 ORB descriptors.
    free: (N,) bool, whether each feature may be matched; None: all may be matched.)")
    .def(
      nb::init<
        const Array<float, -1, 3>&, const Vector<uint8_t>&, const Descriptors&,
        const std::optional<Vector<bool>>&>(),
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
}

}  // namespace

void bind_matching(nb::module_& module)
{
  bind_candidates(module);
  module.def(
    "match_by_projection",
    [](
      const RealArray<3, -1>& projection_px, const RealArray<-1>& radius_px,
      const QueryConstraints& queries, const Candidates& candidates,
      const MatchThreshold& threshold) {
      const int count = queries.count();
      require_lengths(count, "radius_px", radius_px);
      require(projection_px.size(1) == count, "projection_px: expected a column for each query");
      const double *u = projection_px, *v = u + count, *u_right = v + count;
      return give_pairs(unlocked([&] {
        return matching::match_by_projection(
          {u, v, u_right, radius_px}, queries, candidates, threshold);
      }));
    },
    "projection_px"_a, "radius_px"_a, "queries"_a, "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features within windows around expected positions.

Args:
    projection_px: (3, Q) expected u, v, u_right of each query; NaN u_right: unknown.
    radius_px: (Q,) half sides of the square windows around u, v.
    queries: octave limits and descriptors of the queries.
    candidates: features of the image. If expected and measured u_right are known, they must also
        agree within the radius.
    threshold: limits of the descriptor distances.)");
  module.def(
    "match_along_segments",
    [](
      const RealArray<-1, 4>& segments_px, const RealArray<-1>& octave_radius_px,
      const QueryConstraints& queries, const Candidates& candidates,
      const MatchThreshold& threshold) {
      require_lengths(queries.count(), "segments_px", segments_px);
      require_range("max_octave", queries.max_octave, 0, octave_radius_px.size());
      require_range("octave", candidates.octave, 0, octave_radius_px.size());
      return give_pairs(unlocked([&] {
        return matching::match_along_segments(
          {segments_px, octave_radius_px}, queries, candidates, threshold);
      }));
    },
    "segments_px"_a, "octave_radius_px"_a, "queries"_a, "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features near image segments (of epipolar lines).

Args:
    segments_px: (Q, 4) u, v of both ends of each query's segment; NaN: no segment.
    octave_radius_px: (L,) largest distance between a segment and a feature, by the octave of the
        feature. It must not decrease with the octave. All octaves are less than L.
    queries: octave limits and descriptors of the queries.
    candidates: features of the image, of which u_right is not used.
    threshold: limits of the descriptor distances.)");
  module.def(
    "hash_keys",
    [](const Descriptors& descriptors, const KeyBits& bits) {
      require_bits(bits);
      const int count = descriptors.size(), num_tables = bits.size();
      auto keys = unlocked(
        [&] { return matching::hash_keys(descriptors, count, bits, num_tables, bits.size(1)); });
      return give<uint64_t>(std::move(keys), {num_tables, count});
    },
    "descriptors"_a, "bits"_a, R"(
Return the (T, N) uint64 keys of descriptors in T hash tables, in the 32 upper bits.

The lower bits are 0. Each key consists of some bits of the descriptor (locality-sensitive hashing,
Indyk and Motwani, STOC 1998).

Args:
    descriptors: (N, 32) uint8 ORB descriptors.
    bits: (T, B) uint8 bits of the descriptor, at most 32, that are bits 0, 1, ... of the keys of
        each table. They are numbered as `numpy.unpackbits` orders them.)");
  module.def(
    "sorted_hash_keys",
    [](const Descriptors& descriptors, const KeyBits& bits, int64_t first) {
      require_bits(bits);
      const int count = descriptors.size(), num_tables = bits.size();
      require(
        first >= 0 && first + count <= std::numeric_limits<uint32_t>::max(),
        "first: a row must fit into 32 bits");
      auto keys = unlocked([&] {
        auto found = matching::hash_keys(descriptors, count, bits, num_tables, bits.size(1));
        for (std::size_t n = 0; n < found.size(); ++n) {
          found[n] |= static_cast<uint64_t>(first) + n % count;
        }
        matching::sort_hash_keys(found.data(), count, num_tables, bits.size(1));
        return found;
      });
      return give<uint64_t>(std::move(keys), {num_tables, count});
    },
    "descriptors"_a, "bits"_a, "first"_a, R"(
Return the keys of `hash_keys`, sorted in each table, with row numbers in the 32 lower bits.

Args:
    descriptors: (N, 32) uint8 ORB descriptors.
    bits: as in `hash_keys`.
    first: row number of the first descriptor; the others have the next ones, of at most 32 bits.)");
}

}  // namespace hoid::bindings
