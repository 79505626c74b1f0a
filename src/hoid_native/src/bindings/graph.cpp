#include "bindings/arrays.hpp"
#include "graph/map_points.hpp"
#include "graph/observation_graph.hpp"

namespace hoid::bindings {

namespace {

using graph::ObservationGraph;
using Numbers = Vector<int64_t>;

// An array that is changed in place.
template <typename T>
using Changed = nb::ndarray<T, Shape<-1, 3>, nb::c_contig, nb::device::cpu>;

HOID_RESULT(Observations);
HOID_RESULT(Neighbors);
HOID_RESULT(Edges);
HOID_RESULT(PointStatistics);

// Require that the named arrays hold row numbers: require_rows("k", k, "j", j).
template <typename... Others>
void require_rows(const char* name, const Numbers& rows, const Others&... others)
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

void require_ascending(const char* reason, const Numbers& rows)
{
  require(std::is_sorted(rows.begin(), rows.end()), reason);
}

Observations give_observations(graph::Observations&& found)
{
  return make<Observations>(std::move(found.i), std::move(found.k), std::move(found.j));
}

// Wrap a method that changes N observations as a function that Python can call.
using Change = void (ObservationGraph::*)(
  const graph::Numbers&, const graph::Numbers&, const graph::Numbers&);
auto changing(Change change)
{
  return [change](ObservationGraph& self, const Numbers& i, const Numbers& k, const Numbers& j) {
    require_lengths(i.size(), "k", k, "j", j);
    require_rows("i", i, "k", k, "j", j);
    (self.*change)(i, k, j);
  };
}

void bind_observation_graph(nb::module_& module)
{
  nb::class_<ObservationGraph>(module, "ObservationGraph", R"(
Stores which keyframes observe which map points, and how many points two keyframes share.

Keyframes (`i`), their features (`k`) and points (`j`) are int64 row numbers from 0 to 2^31 - 2. The
cost of most calls depends on the observations concerned and not on the size of the map. Except in
the table of `points_of`, a number in an array that is out of range raises a ValueError.)")
    .def(nb::init<>())
    .def("observe", changing(&ObservationGraph::observe), "i"_a, "k"_a, "j"_a, R"(
Add N observations: keyframe i (N,) observes point j (N,) in its feature k (N,).

They must not have been added before, which is not checked.)")
    .def("unobserve", changing(&ObservationGraph::unobserve), "i"_a, "k"_a, "j"_a, R"(
Remove N observations of points j (N,) by keyframes i (N,) in their features k (N,).

Raises:
    ValueError: One of the observations does not exist; those before it are removed nevertheless.)")
    .def("clear", &ObservationGraph::clear, "Remove all observations and connections.")
    .def(
      "observations",
      [](const ObservationGraph& self, const Numbers& j, const std::optional<Numbers>& keyframes) {
        require_rows("j", j);
        graph::Numbers only{};
        if (keyframes) {
          require_rows("keyframes", *keyframes);
          only = *keyframes;
        }
        return give_observations(
          unlocked([&] { return self.observations(j, keyframes ? &only : nullptr); }));
      },
      "j"_a, "keyframes"_a = nb::none(), R"(
Return the observations of points j (P,), sorted by keyframe and feature.

Args:
    keyframes: (K,) rows of the keyframes whose observations are returned; the observations are
        sorted by the order of the keyframes in this list. None: all keyframes, sorted by row.)")
    .def(
      "observations_by_point",
      [](const ObservationGraph& self, const Numbers& j) {
        require_rows("j", j);
        return give_observations(unlocked([&] { return self.observations_by_point(j); }));
      },
      "j"_a, "Return the observations of points j (P,), sorted by point, keyframe and feature.")
    .def(
      "connect",
      [](ObservationGraph& self, int64_t i, const Numbers& j) {
        require_row(i);
        require_rows("j", j);
        self.connect(i, j);
      },
      "i"_a, "j"_a, R"(
Count again how many points keyframe i shares with each other keyframe, and store the numbers.

Args:
    j: (P,) rows of all points that the keyframe observes.)")
    .def(
      "set_neighbors",
      [](ObservationGraph& self, int64_t i, const Numbers& rows, const Numbers& shared) {
        require_row(i);
        require_rows("rows", rows);
        require_lengths(rows.size(), "shared", shared);
        require_ascending("rows: must ascend", rows);
        self.set_neighbors(i, rows, shared);
      },
      "i"_a, "rows"_a, "shared"_a, R"(
Replace the stored numbers of points that keyframe i shares with other keyframes, both ways.

Args:
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
Return the keyframes that share at least `min_shared` points with keyframe i, as stored last.

Those that share most points come first; those that share equally many are sorted by row.)")
    .def(
      "edges",
      [](const ObservationGraph& self, int64_t min_shared) {
        auto found = self.edges(min_shared);
        return make<Edges>(
          std::move(found.first), std::move(found.second), std::move(found.shared));
      },
      "min_shared"_a = 1, R"(
Return the pairs of keyframes that share at least `min_shared` points, as stored last.

They are sorted by first and second row.)")
    .def(
      "path_length_m",
      [](
        const ObservationGraph& self, const Matrices& T_map_camera, const Numbers& parents,
        int64_t start, int64_t goal, int64_t min_shared, double m_per_rad) {
        const int count = T_map_camera.size();
        require_lengths(count, "parents", parents);
        require_range("parents", parents, -1, count);
        require(start >= 0 && start < count, "start: no row of T_map_camera");
        require(goal >= 0 && goal < count, "goal: no row of T_map_camera");
        return unlocked([&] {
          return self.path_length_m({T_map_camera, parents}, start, goal, min_shared, m_per_rad);
        });
      },
      "T_map_camera"_a, "parents"_a, "start"_a, "goal"_a, "min_shared"_a, "m_per_rad"_a, R"(
Return the length [m] of the shortest path between two keyframes (Dijkstra's algorithm).

Each step of a path joins two keyframes that share at least `min_shared` points, or a keyframe and
its parent in the spanning tree. The length is infinite if there is no path.

Args:
    T_map_camera: (K, 4, 4) poses of all keyframes.
    parents: (K,) row of each keyframe's parent in the spanning tree; -1: none.
    start, goal: rows of the first and the last keyframe.
    m_per_rad: length [m] that is added to a step for each radian of its rotation.)")
    .def(
      "count_observed",
      [](const ObservationGraph& self, const Numbers& j, const Numbers& keyframes) {
        require_rows("j", j, "keyframes", keyframes);
        return give_rows(self.count_observed(j, keyframes));
      },
      "j"_a, "keyframes"_a,
      "Return how many of the distinct points j (P,) each of the keyframes (K,) observes, (K,).")
    .def(
      "points_of",
      [](ObservationGraph& self, const ImageArray<int32_t>& table, const Numbers& keyframes) {
        require_range("keyframes", keyframes, 0, table.size());
        return give_rows(self.points_of(table, keyframes));
      },
      "point_of_feature"_a, "keyframes"_a, R"(
Return the (P,) ascending rows of the points that at least one of some keyframes (N,) observes.

What they observe is read from a table, not from the stored observations.

Args:
    point_of_feature: (K, F) int32 row of the point that each feature of each keyframe observes, or
        -1. The values are not checked.)");
}

}  // namespace

void bind_graph(nb::module_& module)
{
  bind_observation_graph(module);
  module.def(
    "point_statistics",
    [](
      const Matrices& T_map_camera, const Numbers& keyframe_uid,
      const ImageArray<uint8_t>& octave, const Array<uint8_t, -1, -1, kDescriptorBytes>& descriptors,
      const RealRows3& position_m, const Numbers& reference_uid, const Numbers& i,
      const Numbers& k, const Numbers& j, const RealArray<-1>& octave_scale) {
      require_lengths(
        T_map_camera.size(), "keyframe_uid", keyframe_uid, "octave", octave, "descriptors",
        descriptors);
      require(
        descriptors.size(1) == octave.size(1), "descriptors: not as many features as octave");
      require_lengths(position_m.size(), "reference_uid", reference_uid);
      require_lengths(i.size(), "k", k, "j", j);
      require_range("i", i, 0, T_map_camera.size());
      require_range("k", k, 0, octave.size(1));
      require_range("j", j, 0, position_m.size());
      require_ascending("j: must ascend", j);
      require(octave_scale.size() > 0, "octave_scale: must not be empty");
      auto found = unlocked([&] {
        return graph::point_statistics(
          {T_map_camera, keyframe_uid, octave, {descriptors, octave.num_elements()}},
          {position_m, reference_uid}, {i, k, j}, octave_scale);
      });
      return make<PointStatistics>(
        std::move(found.rows), give_rows<3>(std::move(found.view_direction)),
        std::move(found.reference), std::move(found.max_distance_m),
        give_rows<kDescriptorBytes>(std::move(found.descriptors)));
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
    T_map_camera, keyframe_uid: (K, 4, 4) poses and (K,) uids of the keyframes.
    octave, descriptors: (K, F) and (K, F, 32), of their features.
    position_m, reference_uid: (P, 3) positions of all points, and (P,) uids of their reference
        keyframes.
    i, k, j: (N,) rows of keyframes, which observe in these features these points; j ascends.
    octave_scale: (L,) scales of the octaves, at least one; octaves from L on have the last one.)");
  module.def(
    "move_points",
    [](
      const Matrices& motions, const Numbers& which, const Changed<double>& position_m,
      const Changed<float>& view_direction) {
      require_range("which", which, -1, motions.size());
      const auto count = static_cast<std::size_t>(which.size());
      require(position_m.shape(0) == count, "position_m: another length than which");
      require(view_direction.shape(0) == count, "view_direction: another length than which");
      const nb::gil_scoped_release release;
      graph::move_points(motions, which, position_m.data(), view_direction.data());
    },
    "motions"_a, "which"_a, "position_m"_a.noconvert(), "view_direction"_a.noconvert(), R"(
Apply rigid motions (G, 4, 4) to points and their viewing directions, in place.

Args:
    which: (N,) index of the motion of each point; -1: the point stays.
    position_m, view_direction: (N, 3) of the points, which are changed.)");
}

}  // namespace hoid::bindings
