#include "bindings/arrays.hpp"
#include "graph/moved_points.hpp"
#include "graph/observation_graph.hpp"
#include "graph/point_statistics.hpp"
#include "matching/matching.hpp"

namespace hoid::bindings {

namespace {

using graph::ObservationGraph;
using Rows = Vector<int64_t>;
using Poses = RealArray<-1, 4, 4>;

// An array that is changed in place.
template <typename T>
using Changed = nb::ndarray<T, Shape<-1, 3>, nb::c_contig, nb::device::cpu>;

HOID_RESULT(Observations);
HOID_RESULT(Neighbors);
HOID_RESULT(Edges);
HOID_RESULT(PointStatistics);

// Require that the named arrays hold row numbers: require_rows("k", k, "j", j).
template <typename... Others>
void require_rows(const char* name, const Rows& rows, const Others&... others)
{
  require_range(name, rows, 0, std::numeric_limits<int32_t>::max());
  if constexpr (sizeof...(others) > 0) {
    require_rows(others...);
  }
}

void require_row(int64_t i)
{
  require(i >= 0, "i: must not be negative");
}

void require_ascending(const char* reason, const Rows& rows)
{
  require(std::is_sorted(rows.begin(), rows.end()), reason);
}

Observations give_observations(graph::Observations&& found)
{
  return make<Observations>(std::move(found.i), std::move(found.k), std::move(found.j));
}

// Bind a method that changes N observations.
using Change = void (ObservationGraph::*)(const int64_t*, const int64_t*, const int64_t*, int);
auto changing(Change change)
{
  return [change](ObservationGraph& self, const Rows& i, const Rows& k, const Rows& j) {
    require_lengths(i.size(), "k", k, "j", j);
    require_rows("i", i, "k", k, "j", j);
    (self.*change)(i, k, j, i.size());
  };
}

void bind_observation_graph(nb::module_& module)
{
  nb::class_<ObservationGraph>(module, "ObservationGraph", R"(
Stores which keyframes observe which map points, and how many points two keyframes share.

Keyframes, features and points are int64 row numbers from 0 to 2^31 - 2. The cost of most calls
depends on the observations concerned and not on the size of the map. Except in the table of
`points_of`, a number in an array that is out of range raises a ValueError.)")
    .def(nb::init<>())
    .def("observe", changing(&ObservationGraph::observe), "i"_a, "k"_a, "j"_a, R"(
Add N observations: keyframe i observes point j in its feature k.

They must not have been added before, which is not checked.

Args:
    i: (N,) rows of keyframes.
    k: (N,) features of the keyframes.
    j: (N,) rows of points.)")
    .def("unobserve", changing(&ObservationGraph::unobserve), "i"_a, "k"_a, "j"_a, R"(
Remove N observations.

Args:
    i: (N,) rows of keyframes.
    k: (N,) features of the keyframes.
    j: (N,) rows of points.

Raises:
    ValueError: One of the observations does not exist; those before it are removed nevertheless.)")
    .def("clear", &ObservationGraph::clear, "Remove all observations and connections.")
    .def(
      "observations",
      [](const ObservationGraph& self, const Rows& j, const std::optional<Rows>& keyframes) {
        require_rows("j", j);
        if (!keyframes) {
          return give_observations(unlocked([&] { return self.observations(j, j.size()); }));
        }
        require_rows("keyframes", *keyframes);
        return give_observations(unlocked(
          [&] { return self.observations_by(j, j.size(), *keyframes, keyframes->size()); }));
      },
      "j"_a, "keyframes"_a = nb::none(), R"(
Return the observations of some points, sorted by keyframe and feature.

Args:
    j: (P,) rows of points.
    keyframes: (K,) rows of the keyframes whose observations are returned; the observations are
        sorted by the order of the keyframes in this list. None: all keyframes, sorted by row.)")
    .def(
      "observations_by_point",
      [](const ObservationGraph& self, const Rows& j) {
        require_rows("j", j);
        return give_observations(
          unlocked([&] { return self.observations_by_point(j, j.size()); }));
      },
      "j"_a, R"(
Return the observations of some points, sorted by point, keyframe and feature.

Args:
    j: (P,) rows of points.)")
    .def(
      "connect",
      [](ObservationGraph& self, int64_t i, const Rows& j) {
        require_row(i);
        require_rows("j", j);
        self.connect(i, j, j.size());
      },
      "i"_a, "j"_a, R"(
Count again how many points a keyframe shares with each other keyframe, and store the numbers.

Args:
    i: row of the keyframe.
    j: (P,) rows of all points that the keyframe observes.)")
    .def(
      "set_neighbors",
      [](ObservationGraph& self, int64_t i, const Rows& rows, const Rows& shared) {
        require_row(i);
        require_rows("rows", rows);
        require_lengths(rows.size(), "shared", shared);
        require_ascending("rows: must ascend", rows);
        self.set_neighbors(i, rows, shared, rows.size());
      },
      "i"_a, "rows"_a, "shared"_a, R"(
Replace the stored numbers of points that a keyframe shares with other keyframes, both ways.

Args:
    i: row of the keyframe.
    rows: (N,) rows of all keyframes that share points with it, ascending, each once.
    shared: (N,) numbers of shared points, at least 1.)")
    .def(
      "neighbors",
      [](const ObservationGraph& self, int64_t i, int64_t min_shared) {
        require_row(i);
        auto found = self.neighbors(i, min_shared);
        return make<Neighbors>(std::move(found.rows), std::move(found.shared));
      },
      "i"_a, "min_shared"_a = 1, R"(
Return the keyframes that share points with a keyframe, by the numbers stored last.

Those that share most points come first; those that share equally many are sorted by row.

Args:
    i: row of the keyframe.
    min_shared: least number of shared points.)")
    .def(
      "edges",
      [](const ObservationGraph& self, int64_t min_shared) {
        auto found = self.edges(min_shared);
        return make<Edges>(
          std::move(found.first), std::move(found.second), std::move(found.shared));
      },
      "min_shared"_a = 1, R"(
Return the pairs of keyframes that share points, by the numbers stored last.

They are sorted by first and second row.

Args:
    min_shared: least number of shared points.)")
    .def(
      "path_length_m",
      [](
        const ObservationGraph& self, const Poses& T_map_camera, const Rows& parents,
        int64_t start, int64_t goal, int64_t min_shared, double m_per_rad) {
        const int count = T_map_camera.size();
        require_lengths(count, "parents", parents);
        require_range("parents", parents, -1, count);
        require(start >= 0 && start < count, "start: no row of T_map_camera");
        require(goal >= 0 && goal < count, "goal: no row of T_map_camera");
        return unlocked([&] {
          return self.path_length_m(
            {T_map_camera, parents, count}, start, goal, min_shared, m_per_rad);
        });
      },
      "T_map_camera"_a, "parents"_a, "start"_a, "goal"_a, "min_shared"_a, "m_per_rad"_a, R"(
Return the length [m] of the shortest path between two keyframes (Dijkstra's algorithm).

Each step of a path joins two keyframes that share points, or a keyframe and its parent in the
spanning tree. The length is infinite if there is no path.

Args:
    T_map_camera: (K, 4, 4) poses of all keyframes.
    parents: (K,) row of each keyframe's parent in the spanning tree; -1: none.
    start: row of the first keyframe.
    goal: row of the last keyframe.
    min_shared: least number of points that two keyframes of a step share.
    m_per_rad: length [m] that is added to a step for each radian of its rotation.)")
    .def(
      "count_observed",
      [](const ObservationGraph& self, const Rows& j, const Rows& keyframes) {
        require_rows("j", j, "keyframes", keyframes);
        return give_rows(self.count_observed(j, j.size(), keyframes, keyframes.size()));
      },
      "j"_a, "keyframes"_a, R"(
Return the (K,) numbers of points, out of some given points, that keyframes observe.

Args:
    j: (P,) rows of points, without repetitions.
    keyframes: (K,) rows of keyframes.)")
    .def(
      "points_of",
      [](ObservationGraph& self, const ImageArray<int32_t>& table, const Rows& keyframes) {
        require_range("keyframes", keyframes, 0, table.size());
        return give_rows(
          self.points_of({table, table.size(), table.size(1)}, keyframes, keyframes.size()));
      },
      "point_of_feature"_a, "keyframes"_a, R"(
Return the (P,) ascending rows of the points that at least one of some keyframes observes.

What they observe is read from a table, not from the stored observations.

Args:
    point_of_feature: (K, F) int32 row of the point that each feature of each keyframe observes, or
        -1. The values are not checked.
    keyframes: (N,) rows of keyframes in `point_of_feature`.)");
}

}  // namespace

void bind_graph(nb::module_& module)
{
  bind_observation_graph(module);
  module.def(
    "point_statistics",
    [](
      const Poses& T_map_camera, const Rows& keyframe_uid, const ImageArray<uint8_t>& octave,
      const Array<uint8_t, -1, -1, matching::kDescriptorBytes>& descriptors,
      const RealArray<-1, 3>& position_m, const Rows& reference_uid, const Rows& i,
      const Rows& k, const Rows& j, const RealArray<-1>& octave_scale) {
      const int num_keyframes = T_map_camera.size(), num_features = octave.size(1);
      require_lengths(
        num_keyframes, "keyframe_uid", keyframe_uid, "octave", octave, "descriptors",
        descriptors);
      require(
        descriptors.size(1) == num_features, "descriptors: not as many features as octave");
      require_lengths(position_m.size(), "reference_uid", reference_uid);
      require_lengths(i.size(), "k", k, "j", j);
      require_range("i", i, 0, num_keyframes);
      require_range("k", k, 0, num_features);
      require_range("j", j, 0, position_m.size());
      require_ascending("j: must ascend", j);
      require(octave_scale.size() > 0, "octave_scale: must not be empty");
      auto found = unlocked([&] {
        return graph::point_statistics(
          {T_map_camera, keyframe_uid, octave, descriptors, num_features},
          {position_m, reference_uid}, {i, k, j, i.size()}, octave_scale, octave_scale.size());
      });
      return make<PointStatistics>(
        std::move(found.rows), give_rows<3>(std::move(found.view_direction)),
        std::move(found.reference), std::move(found.max_distance_m),
        give_rows<matching::kDescriptorBytes>(std::move(found.descriptors)));
    },
    "T_map_camera"_a, "keyframe_uid"_a, "octave"_a, "descriptors"_a, "position_m"_a,
    "reference_uid"_a, "i"_a, "k"_a, "j"_a, "octave_scale"_a, R"(
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
    octave_scale: (L,) scales of the octaves, at least one; octaves from L on have the last one.)");
  module.def(
    "move_points",
    [](
      const Poses& motions, const Rows& which, const Changed<double>& position_m,
      const Changed<float>& view_direction) {
      require_range("which", which, -1, motions.size());
      const auto count = static_cast<std::size_t>(which.size());
      require(position_m.shape(0) == count, "position_m: another length than which");
      require(view_direction.shape(0) == count, "view_direction: another length than which");
      const nb::gil_scoped_release release;
      graph::move_points(
        motions, which, which.size(), position_m.data(), view_direction.data());
    },
    "motions"_a, "which"_a, "position_m"_a.noconvert(), "view_direction"_a.noconvert(), R"(
Apply rigid motions to points and their viewing directions, in place.

Args:
    motions: (G, 4, 4) rigid transforms.
    which: (N,) int64 index of the motion of each point; -1: the point stays.
    position_m: (N, 3) float64 positions of the points, which are changed.
    view_direction: (N, 3) float32 viewing directions, which are changed.)");
}

}  // namespace hoid::bindings
