#include "graph/observation_graph.hpp"
#include "graph/moved_points.hpp"
#include "graph/point_statistics.hpp"

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <array>
#include <limits>
#include <optional>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"
#include "matching/matching.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;
using graph::ObservationGraph;

HOID_RESULT(Observations);
HOID_RESULT(Neighbors);
HOID_RESULT(Edges);
HOID_RESULT(PointStatistics);

using Rows = Vector<int64_t>;

void require_rows(const char* name, const Rows& rows)
{
  require_range(name, rows, 0, std::numeric_limits<int32_t>::max());
}

void require_observations(const Rows& i, const Rows& k, const Rows& j)
{
  require_length("k", k, i.size());
  require_length("j", j, i.size());
  require_rows("i", i);
  require_rows("k", k);
  require_rows("j", j);
}

void observe(ObservationGraph& self, const Rows& i, const Rows& k, const Rows& j)
{
  require_observations(i, k, j);
  self.observe(i.data(), k.data(), j.data(), i.size());
}

void unobserve(ObservationGraph& self, const Rows& i, const Rows& k, const Rows& j)
{
  require_observations(i, k, j);
  self.unobserve(i.data(), k.data(), j.data(), i.size());
}

Observations as_result(graph::Observations&& found)
{
  return make<Observations>(
    give(std::move(found.i)), give(std::move(found.k)), give(std::move(found.j)));
}

Observations observations(
  const ObservationGraph& self, const Rows& j, const std::optional<Rows>& keyframes)
{
  require_rows("j", j);
  if (keyframes) {
    require_rows("keyframes", *keyframes);
  }
  return as_result(unlocked([&] {
    return keyframes ? self.observations_by(
                         j.data(), j.size(), keyframes->data(), keyframes->size())
                     : self.observations(j.data(), j.size());
  }));
}

Observations observations_by_point(const ObservationGraph& self, const Rows& j)
{
  require_rows("j", j);
  return as_result(
    unlocked([&] { return self.observations_by_point(j.data(), j.size()); }));
}

void connect(ObservationGraph& self, int64_t i, const Rows& j)
{
  require(i >= 0, "i: must not be negative");
  require_rows("j", j);
  self.connect(i, j.data(), j.size());
}

void set_neighbors(ObservationGraph& self, int64_t i, const Rows& rows, const Rows& shared)
{
  require(i >= 0, "i: must not be negative");
  require_rows("rows", rows);
  require_length("shared", shared, rows.size());
  require(
    std::is_sorted(rows.data(), rows.data() + rows.size()), "rows: must ascend");
  self.set_neighbors(i, rows.data(), shared.data(), rows.size());
}

Neighbors neighbors(const ObservationGraph& self, int64_t i, int64_t min_shared)
{
  require(i >= 0, "i: must not be negative");
  auto found = self.neighbors(i, min_shared);
  return make<Neighbors>(give(std::move(found.rows)), give(std::move(found.shared)));
}

Edges edges(const ObservationGraph& self, int64_t min_shared)
{
  auto found = self.edges(min_shared);
  return make<Edges>(
    give(std::move(found.first)), give(std::move(found.second)), give(std::move(found.shared)));
}

double path_length_m(
  const ObservationGraph& self, const RealArray<-1, 4, 4>& T_map_camera, const Rows& parents,
  int64_t start, int64_t goal, int64_t min_shared, double m_per_rad)
{
  const int count = T_map_camera.size();
  require_length("parents", parents, count);
  require_range("parents", parents, -1, count);
  require(start >= 0 && start < count, "start: no row of T_map_camera");
  require(goal >= 0 && goal < count, "goal: no row of T_map_camera");
  const graph::Poses poses{T_map_camera.data(), parents.data(), count};
  return unlocked([&] { return self.path_length_m(poses, start, goal, min_shared, m_per_rad); });
}

auto count_observed(const ObservationGraph& self, const Rows& j, const Rows& keyframes)
{
  require_rows("j", j);
  require_rows("keyframes", keyframes);
  return give(self.count_observed(j.data(), j.size(), keyframes.data(), keyframes.size()));
}

auto points_of(
  ObservationGraph& self, const Array<int32_t, -1, -1>& point_of_feature, const Rows& keyframes)
{
  require_range("keyframes", keyframes, 0, point_of_feature.size());
  const graph::PointTable table{
    point_of_feature.data(), point_of_feature.size(), point_of_feature.size(1)};
  return give(self.points_of(table, keyframes.data(), keyframes.size()));
}

template <typename T>
using Changed = nb::ndarray<T, Shape<-1, 3>, nb::c_contig, nb::device::cpu>;

void move_points(
  const RealArray<-1, 4, 4>& motions, const Rows& which, const Changed<double>& position_m,
  const Changed<float>& view_direction)
{
  require_range("which", which, -1, motions.size());
  require(position_m.shape(0) == which.array.shape(0), "position_m: another length than which");
  require(
    view_direction.shape(0) == which.array.shape(0), "view_direction: another length than which");
  unlocked([&] {
    graph::move_points(
      motions.data(), which.data(), which.size(), position_m.data(), view_direction.data());
    return 0;
  });
}

PointStatistics point_statistics(
  const RealArray<-1, 4, 4>& T_map_camera, const Rows& keyframe_uid,
  const Array<uint8_t, -1, -1>& octave,
  const Array<uint8_t, -1, -1, matching::kDescriptorBytes>& descriptors,
  const RealArray<-1, 3>& position_m, const Rows& reference_uid, const Rows& i, const Rows& k,
  const Rows& j, const RealArray<-1>& octave_scale)
{
  const int num_keyframes = T_map_camera.size(), num_points = position_m.size();
  require_length("keyframe_uid", keyframe_uid, num_keyframes);
  require_length("octave", octave, num_keyframes);
  require_length("descriptors", descriptors, num_keyframes);
  require(descriptors.size(1) == octave.size(1), "descriptors: not as many features as octave");
  require_length("reference_uid", reference_uid, num_points);
  require_length("k", k, i.size());
  require_length("j", j, i.size());
  require_range("i", i, 0, num_keyframes);
  require_range("k", k, 0, octave.size(1));
  require_range("j", j, 0, num_points);
  require(std::is_sorted(j.data(), j.data() + j.size()), "j: must ascend");
  require(octave_scale.size() > 0, "octave_scale: must not be empty");
  auto found = unlocked([&] {
    return graph::point_statistics(
      {T_map_camera.data(), keyframe_uid.data(), octave.data(), descriptors.data(),
       octave.size(1)},
      {position_m.data(), reference_uid.data()}, {i.data(), k.data(), j.data(), i.size()},
      octave_scale.data(), octave_scale.size());
  });
  const std::size_t count = found.rows.size();
  return make<PointStatistics>(
    give(std::move(found.rows)),
    give(std::move(found.view_direction), std::array<std::size_t, 2>{count, 3}),
    give(std::move(found.reference)), give(std::move(found.max_distance_m)),
    give(
      std::move(found.descriptors),
      std::array<std::size_t, 2>{count, static_cast<std::size_t>(matching::kDescriptorBytes)}));
}

}  // namespace

void bind_graph(nb::module_& module)
{
  nb::class_<ObservationGraph>(module, "ObservationGraph", R"(
Stores which keyframes observe which map points, and how many points two keyframes share.

Keyframes, features and points are int64 row numbers from 0 to 2^31 - 2. The cost of most calls
depends on the observations concerned and not on the size of the map. Except in the table of
`points_of`, a number in an array that is out of range raises a ValueError.)")
    .def(nb::init<>())
    .def(
      "observe", &observe, "i"_a, "k"_a, "j"_a, R"(
Add N observations: keyframe i observes point j in its feature k.

They must not have been added before, which is not checked.

Args:
    i: (N,) rows of keyframes.
    k: (N,) features of the keyframes.
    j: (N,) rows of points.

Raises:
    ValueError: Lengths differ, or a row is out of range.)")
    .def(
      "unobserve", &unobserve, "i"_a, "k"_a, "j"_a, R"(
Remove N observations.

Args:
    i: (N,) rows of keyframes.
    k: (N,) features of the keyframes.
    j: (N,) rows of points.

Raises:
    ValueError: Lengths differ, a row is out of range, or one of the observations does not exist;
        those before it are removed nevertheless.)")
    .def("clear", &ObservationGraph::clear, "Remove all observations and connections.")
    .def(
      "observations", &observations, "j"_a, "keyframes"_a = nb::none(), R"(
Return the observations of some points, sorted by keyframe and feature.

Args:
    j: (P,) rows of points.
    keyframes: (K,) rows of the keyframes whose observations are returned; the observations are
        sorted by the order of the keyframes in this list. None: all keyframes, sorted by row.)")
    .def(
      "observations_by_point", &observations_by_point, "j"_a, R"(
Return the observations of some points, sorted by point, keyframe and feature.

Args:
    j: (P,) rows of points.)")
    .def(
      "connect", &connect, "i"_a, "j"_a, R"(
Count again how many points a keyframe shares with each other keyframe, and store the numbers.

Args:
    i: row of the keyframe.
    j: (P,) rows of all points that the keyframe observes.)")
    .def(
      "set_neighbors", &set_neighbors, "i"_a, "rows"_a, "shared"_a, R"(
Replace the stored numbers of points that a keyframe shares with other keyframes, both ways.

Args:
    i: row of the keyframe.
    rows: (N,) rows of all keyframes that share points with it, ascending, each once.
    shared: (N,) numbers of shared points, at least 1.

Raises:
    ValueError: Lengths differ, a row is out of range, or the rows are not sorted.)")
    .def(
      "neighbors", &neighbors, "i"_a, "min_shared"_a = 1, R"(
Return the keyframes that share points with a keyframe, by the numbers stored last.

Those that share most points come first; those that share equally many are sorted by row.

Args:
    i: row of the keyframe.
    min_shared: least number of shared points.)")
    .def(
      "edges", &edges, "min_shared"_a = 1, R"(
Return the pairs of keyframes that share points, by the numbers stored last.

They are sorted by first and second row.

Args:
    min_shared: least number of shared points.)")
    .def(
      "path_length_m", &path_length_m, "T_map_camera"_a, "parents"_a, "start"_a, "goal"_a,
      "min_shared"_a, "m_per_rad"_a, R"(
Return the length [m] of the shortest path between two keyframes (Dijkstra's algorithm).

Each step of a path joins two keyframes that share points, or a keyframe and its parent in the
spanning tree. The length is infinite if there is no path.

Args:
    T_map_camera: (K, 4, 4) poses of all keyframes.
    parents: (K,) row of each keyframe's parent in the spanning tree; -1: none.
    start: row of the first keyframe.
    goal: row of the last keyframe.
    min_shared: least number of points that two keyframes of a step share.
    m_per_rad: length [m] that is added to a step for each radian of its rotation.

Raises:
    ValueError: Lengths differ, or a row is out of range.)")
    .def(
      "count_observed", &count_observed, "j"_a, "keyframes"_a, R"(
Return the (K,) numbers of points, out of some given points, that keyframes observe.

Args:
    j: (P,) rows of points, without repetitions.
    keyframes: (K,) rows of keyframes.)")
    .def(
      "points_of", &points_of, "point_of_feature"_a, "keyframes"_a, R"(
Return the (P,) ascending rows of the points that at least one of some keyframes observes.

What they observe is read from a table, not from the stored observations.

Args:
    point_of_feature: (K, F) int32 row of the point that each feature of each keyframe observes, or
        -1. The values are not checked.
    keyframes: (N,) rows of keyframes in `point_of_feature`.)");
  module.def(
    "point_statistics", &point_statistics, "T_map_camera"_a, "keyframe_uid"_a, "octave"_a,
    "descriptors"_a, "position_m"_a, "reference_uid"_a, "i"_a, "k"_a, "j"_a, "octave_scale"_a, R"(
Return viewing direction, scale range and descriptor of points, nearly as ORB-SLAM's MapPoint.

The largest distance is that at which some octave can detect the point: its distance in the
reference keyframe times the scale of the octave in which it was observed there. If the reference
keyframe does not observe the point, the keyframe of its first observation becomes the reference.
The descriptor is one of the point's last eight observations: the one with the least median
distance to them (ComputeDistinctiveDescriptors of ORB-SLAM); of two, it is the second one.

Args:
    T_map_camera: (K, 4, 4) poses of the keyframes.
    keyframe_uid: (K,) int64 uids of the keyframes.
    octave: (K, F) uint8 octaves of their features.
    descriptors: (K, F, 32) uint8 descriptors of their features.
    position_m: (P, 3) positions of all points.
    reference_uid: (P,) int64 uids of their reference keyframes.
    i: (N,) int64 rows of keyframes, which observe
    k: (N,) int64 in these features
    j: (N,) int64 these points; ascending.
    octave_scale: (L,) scales of the octaves; octaves from L on have the last one.

Raises:
    ValueError: Lengths differ, a row or a feature is out of range, or `j` does not ascend.)");
  module.def(
    "move_points", &move_points, "motions"_a, "which"_a, "position_m"_a.noconvert(),
    "view_direction"_a.noconvert(), R"(
Apply rigid motions to points and their viewing directions, in place.

Args:
    motions: (G, 4, 4) rigid transforms.
    which: (N,) int64 index of the motion of each point; -1: the point stays.
    position_m: (N, 3) float64 positions of the points, which are changed.
    view_direction: (N, 3) float32 viewing directions, which are changed.

Raises:
    ValueError: Lengths differ, or an index is out of range.)");
}

}  // namespace hoid::bindings
