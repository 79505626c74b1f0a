"""The simulated building: geometry, routes, features, tiled maps and virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_benchmarks.building.drive import Drive, Image
from hoid_benchmarks.building.lag import longest_detached_s, reattached_s
from hoid_benchmarks.building.tiled_map import tiled
from hoid_benchmarks.building.virtual_mapper import Delay
from hoid_benchmarks.building.world.camera import MODEL, NO_LANDMARK, FeatureCamera
from hoid_benchmarks.building.world.floors import Building, CellKey, CellKind, Opening
from hoid_benchmarks.building.world.landmarks import LandmarkStore
from hoid_benchmarks.building.world.route import CORNER, FULL_TURN, Route, first_mark
from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import Float32Array, FloatArray
from rgbd_slam.store import map_file

ROOM = CellKey(CellKind.ROOM, 0, 0, 0)
TWIN = CellKey(CellKind.ROOM, 0, 1, 0, 0, 1)


def all_landmarks(building: Building) -> dict[int, Float32Array]:
    """Return the positions (3,) of all landmarks by id."""
    store = LandmarkStore(building)
    found: dict[int, Float32Array] = {}
    for cell in building.cells.values():
        landmarks = store.of(cell)
        found |= dict(zip(landmarks.ids.tolist(), landmarks.position_m, strict=True))
    return found


def corridor_pose() -> FloatArray:
    """Return T_world_camera (4, 4) in the corridor along x, looking along it."""
    T: FloatArray = Route(Building(1, 1)).poses()[0]
    return T


def turned_deg(T_world_camera: FloatArray) -> FloatArray:
    """Return the (N,) angles between the viewing direction of poses (N, 4, 4) and the first."""
    cosine = T_world_camera[:, :3, 2] @ T_world_camera[0, :3, 2]
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def test_an_opening_passes_the_lines_of_sight_through_it() -> None:
    door = Opening(0, 1.0, (-0.5, 0.0), (0.5, 2.0))
    eye = np.array([0, 0, 1], np.float32)
    points = np.array([[3, 0, 1], [3, 3, 1], [3, 0, 5], [0.5, 0, 1], [-3, 0, 1]], np.float32)

    assert door.passes(eye, points).tolist() == [True, False, False, False, False]


def test_a_feature_is_where_its_landmark_projects_to() -> None:
    building = Building(1, 1)
    camera, T_world_camera = FeatureCamera(building), corridor_pose()

    features = camera.observe(T_world_camera, 1)

    known = camera.landmark_ids != NO_LANDMARK
    landmarks = all_landmarks(building)
    points = np.array([landmarks[n] for n in camera.landmark_ids[known].tolist()], np.float64)
    in_camera = se3.transform(se3.inverse(T_world_camera), points)
    error_px = features.uv_px[known] - MODEL.project_px(in_camera)
    has_depth = features.depth_m[known] > 0
    error_m = features.depth_m[known][has_depth] - in_camera[has_depth, 2]
    assert np.count_nonzero(known) > 500
    assert np.abs(np.median(error_px, axis=0)).max() < 0.1
    assert np.percentile(np.linalg.norm(error_px, axis=1), 90) < 4.0
    assert np.percentile(np.abs(error_m), 90) < 2 * 1.2e-3 * 6.0**2
    assert 0.85 < has_depth.mean() < 0.95


def test_the_same_seed_gives_the_same_features_and_another_one_does_not() -> None:
    def observed(building_seed: int, camera_seed: int) -> FloatArray:
        camera = FeatureCamera(Building(1, 1, seed=building_seed), camera_seed)
        return camera.observe(corridor_pose(), 1).uv_px.astype(np.float64)

    first = observed(0, 0)
    np.testing.assert_array_equal(observed(0, 0), first)
    for other in (observed(0, 1), observed(1, 0)):
        assert other.shape != first.shape or not np.array_equal(other, first)


def test_nothing_is_seen_through_a_wall() -> None:
    building = Building(1, 1)
    store, camera = LandmarkStore(building), FeatureCamera(building)
    T_world_camera = corridor_pose()
    T_world_camera[0, 3] = 2.0  # 3 m before the middle of the first room, which is behind the wall

    camera.observe(T_world_camera, 1)

    far_wall = store.of(building.cells[CellKey(CellKind.CORRIDOR_X, 0, 0, 1)])
    assert not np.isin(camera.landmark_ids, far_wall.ids).any()


def test_rooms_with_the_same_template_share_most_landmarks() -> None:
    building = Building(2, 1, alike_share=1.0, num_templates=1)
    store = LandmarkStore(building)

    room, twin = (store.of(building.cells[key]).descriptors for key in (ROOM, TWIN))

    same = {d.tobytes() for d in room} & {d.tobytes() for d in twin}
    assert len(same) / len(room) == pytest.approx(0.87, abs=0.05)


def test_a_route_is_continuous_and_stays_inside_the_building() -> None:
    building = Building(2, 2, floors=2)
    route = Route(building)
    route.around(1, 1, rooms=1, every=2)
    route.climb()
    route.to_junction(1, 0, rooms=2)

    T = route.poses()

    steps = se3.log(se3.inverse(T[:-1]) @ T[1:])
    assert np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).max() < 0.06  # 0.5 m/s at 10 Hz
    assert np.degrees(np.linalg.norm(steps[:, :3], axis=1)).max() < 5.0  # 42 deg/s
    assert T[-1, 2, 3] - T[0, 2, 3] == pytest.approx(3.2, abs=0.05)
    cell = None
    for pose in T:
        cell = building.cell_at(pose[:3, 3], cell)


def test_marks_are_where_the_camera_begins_to_turn() -> None:
    route = Route(Building(2, 2))
    route.to_junction(1, 0, rooms=1)
    route.to_junction(1, 1)
    T = route.poses()

    corner, turn = (first_mark(route.marks, name) for name in (CORNER, FULL_TURN))
    assert turned_deg(T[corner : corner + 25])[-1] == pytest.approx(90, abs=2)
    assert turned_deg(T[turn : turn + 90]).max() > 170  # the camera is pitched


def test_a_late_mapper_changes_the_map_after_its_delay_only() -> None:
    building = Building(1, 1)
    route = Route(building)
    route.to_junction(1, 0)
    truth = route.trajectory()
    with Drive(FeatureCamera(building), truth, Delay(constant_s=0.5)) as drive:
        drive.run(0, 40)

    delays_s = [answer.answer_s - answer.request_s for answer in drive.worker.answers]
    assert delays_s
    assert min(delays_s) == pytest.approx(0.5)
    assert drive.images[-1].state is SlamState.TRACKING


def test_two_drives_are_equal_whatever_their_cpu_times() -> None:
    def driven() -> FloatArray:
        building = Building(1, 1)
        route = Route(building)
        route.to_junction(1, 0)
        delay = Delay(stall_s=1.0, stall_at_s=2.0)
        with Drive(FeatureCamera(building), route.trajectory(), delay) as drive:
            drive.run(0, 40)
            return drive.session.map.trajectory('online').T_world_camera

    np.testing.assert_array_equal(driven(), driven())


def test_a_tiled_map_is_valid_and_starts_with_the_map_itself() -> None:
    building = Building(1, 1)
    route = Route(building)
    route.to_junction(1, 0)
    with Drive(FeatureCamera(building), route.trajectory()) as drive:
        drive.run(0, 40)
        content = drive.session.map.export()

    three = tiled(content, 3)

    count = len(content.map)
    assert len(three.map) == 3 * count
    for name, values in content.map.arrays().items():
        np.testing.assert_array_equal(getattr(three.map, name)[: len(values)], values)
    np.testing.assert_array_equal(np.flatnonzero(three.map.parent == -1), [0])
    bits = np.unpackbits(
        three.map.descriptors[: len(content.map.descriptors)]
        ^ (three.map.descriptors[len(content.map.descriptors) :][: len(content.map.descriptors)]),
        axis=1,
    )
    assert (bits == bits[0]).all()
    assert 80 < bits[0].sum() < 176
    map_file.check(three)


def test_reattachment_counts_from_the_answer_and_has_to_last() -> None:
    tracked = [300] * 20 + [0] * 10 + [200] * 5 + [0] * 5 + [150] * 20
    images = [Image(0.1 * n, SlamState.TRACKING, count, 1.0) for n, count in enumerate(tracked)]

    assert reattached_s(images, 2.5) == pytest.approx(1.5)
    assert reattached_s(images, 4.5) == 0.0
    assert reattached_s(images[:40], 2.5) == np.inf
    assert longest_detached_s(images) == pytest.approx(1.0)
