#include "matching/matching.hpp"

#include "bindings/arrays.hpp"

namespace hoid::bindings {

namespace {

using matching::MatchThreshold;
using DescriptorArray = Array<uint8_t, -1, kDescriptorBytes>;

HOID_RESULT(Pairs);

struct QueryConstraints
{
  Vector<int8_t> min_octave, max_octave;
  DescriptorArray descriptors;
};

struct Candidates
{
  Array<float, -1, 3> measurement_px;
  Vector<uint8_t> octave;
  DescriptorArray descriptors;
  std::optional<Vector<bool>> free;
};

// Match the features of `candidates` to `queries` in the regions that the kernel takes.
template <typename Regions, typename Kernel>
Pairs match(
  const QueryConstraints& queries, const Candidates& candidates, const MatchThreshold& threshold,
  const Regions& regions, Kernel kernel)
{
  const auto& [min_octave, max_octave, descriptors] = queries;
  require_lengths(descriptors.size(), "min_octave", min_octave, "max_octave", max_octave);
  const auto& [measurement_px, octave, features, free] = candidates;
  require_lengths(octave.size(), "measurement_px", measurement_px, "descriptors", features);
  if (free) {
    require_lengths(octave.size(), "free", *free);
  }
  auto pairs = unlocked([&] {
    return kernel(
      regions, {min_octave, max_octave, descriptors},
      {measurement_px, octave, features, free ? free->begin() : nullptr}, threshold);
  });
  return make<Pairs>(std::move(pairs.q), std::move(pairs.k), std::move(pairs.distance));
}

}  // namespace

HOID_PARAMETERS(MatchThreshold, "MatchThreshold", int, double);
HOID_PARAMETERS(
  QueryConstraints, "QueryConstraints", Vector<int8_t>, Vector<int8_t>, DescriptorArray);
HOID_PARAMETERS(
  Candidates, "Candidates", Array<float, -1, 3>, Vector<uint8_t>, DescriptorArray,
  std::optional<Vector<bool>>);

void bind_matching(nb::module_& module)
{
  module.def(
    "match_by_projection",
    [](
      const RealArray<3, -1>& projection_px, const RealArray<-1>& radius_px,
      const QueryConstraints& queries, const Candidates& candidates,
      const MatchThreshold& threshold) {
      const int count = queries.descriptors.size();
      require_lengths(count, "radius_px", radius_px);
      require(projection_px.size(1) == count, "projection_px: expected a column for each query");
      const matching::Windows windows{projection_px, radius_px};
      return match(queries, candidates, threshold, windows, &matching::match_by_projection);
    },
    "projection_px"_a, "radius_px"_a, "queries"_a, "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features within windows around expected positions.

Args:
    projection_px: (3, Q) expected u, v, u_right of each query; NaN u_right: unknown.
    radius_px: (Q,) half sides of the square windows around u, v. If expected and measured u_right
        are known, they must also agree within the radius.)");
  module.def(
    "match_along_segments",
    [](
      const RealArray<-1, 4>& segments_px, const RealArray<-1>& octave_radius_px,
      const QueryConstraints& queries, const Candidates& candidates,
      const MatchThreshold& threshold) {
      require_lengths(queries.descriptors.size(), "segments_px", segments_px);
      require_range("max_octave", queries.max_octave, 0, octave_radius_px.size());
      require_range("octave", candidates.octave, 0, octave_radius_px.size());
      const matching::Segments segments{segments_px, octave_radius_px};
      return match(queries, candidates, threshold, segments, &matching::match_along_segments);
    },
    "segments_px"_a, "octave_radius_px"_a, "queries"_a, "candidates"_a, "threshold"_a, R"(
Return one-to-one matches of queries and features near image segments (of epipolar lines).

Args:
    segments_px: (Q, 4) u, v of both ends of each query's segment; NaN: no segment.
    octave_radius_px: (L,) largest distance between a segment and a feature, by the octave of the
        feature. It must not decrease with the octave. All octaves are less than L.)");
  module.def(
    "hash_keys",
    [](const DescriptorArray& descriptors, const ImageArray<uint8_t>& bits) {
      require_range("bits", bits, 0, 8 * kDescriptorBytes);
      require(bits.size(1) <= 32, "bits: a key has at most 32 bits");
      auto keys = unlocked([&] { return matching::hash_keys(descriptors, bits); });
      return give<uint64_t>(std::move(keys), {bits.size(), descriptors.size()});
    },
    "descriptors"_a, "bits"_a, R"(
Return the (T, N) uint64 keys of descriptors (N, 32) in T hash tables, in the 32 upper bits.

The lower bits are 0. Each key consists of some bits of the descriptor (locality-sensitive hashing,
Indyk and Motwani, STOC 1998).

Args:
    bits: (T, B) uint8 bits of the descriptor, at most 32, that are bits 0, 1, ... of the keys of
        each table. They are numbered as `numpy.unpackbits` orders them.)");
}

}  // namespace hoid::bindings
