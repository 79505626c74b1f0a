"""Scores of maps and tracks with known errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.rooms.carries import (
    TrueCarry,
    count_filled,
    placed_objects,
    placed_tracks,
    score_carries,
    true_carries,
)
from hoid_benchmarks.rooms.object_scores import FoundObject, score_objects
from hoid_benchmarks.rooms.object_truth import TrueObject, true_objects
from hoid_benchmarks.rooms.placed_box import PlacedBox, least_area_axes
from hoid_benchmarks.rooms.room_ghost import Ghost, cylinder_depth_m
from hoid_benchmarks.rooms.room_run import MappedRoom, ObjectHistory, Tracks
from hoid_benchmarks.rooms.room_scores import level_error_deg, score
from hoid_bringup.run.run_config import RunConfig
from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import (
    CameraModel,
    Detections,
    FloatArray,
    ObjectState,
    RgbdFrame,
    Trajectory,
)
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject
from hoid_synth.config import SceneConfig
from hoid_synth.mesh import Surface, box, merged
from hoid_synth.room_truth import RoomTruth
from hoid_synth.truth import object_states, people_centers
from rgbd_slam.mapping.slam_map import SlamStats

pytestmark = pytest.mark.thorough

SCENE = SceneConfig(seed=1)
OFFSET_M = np.array([0.03, 0.0, 0.04])


@dataclass
class EverythingSeen:
    """Ground-truth boxes in which every class fills every image."""

    camera: CameraModel
    true_detections: dict[int, Detections]


@pytest.fixture(scope='module')
def truth() -> RoomTruth:
    return RoomTruth(SCENE, T_BODY_OPTICAL)


@pytest.fixture(scope='module')
def sequence(truth: RoomTruth) -> BagSequence:
    names = tuple({state.class_name for state in object_states(truth.stage, 0)})
    whole = np.tile([0, 0, 640, 480], (len(names), 1)).astype(np.float32)
    boxes = {
        SCENE.stamp_ns(i): Detections(SCENE.stamp_ns(i), whole, names, np.ones(len(names), 'f4'))
        for i in range(SCENE.frames)
    }
    return cast('BagSequence', EverythingSeen(SCENE.camera, boxes))


def in_map(truth: RoomTruth, points_m: FloatArray) -> FloatArray:
    return se3.transform(se3.inverse(truth.T_world_map), points_m)


def track(truth: RoomTruth, number: int, name: str, world_m: FloatArray) -> TrackedObject:
    state = ObjectState.PERSON if name == 'person' else ObjectState.AT_REST
    at = in_map(truth, world_m[None])[0]
    return TrackedObject(number, name, state, 0, 1.0, at, np.zeros(3), np.full(3, 0.1))


def tracks(truth: RoomTruth, *, new_ids: bool) -> Tracks:
    """Return tracks of all people and objects, each displaced by OFFSET_M."""
    out: Tracks = {}
    for i in range(0, SCENE.frames, 3):
        people = [
            track(truth, 900, 'person', p + OFFSET_M) for p in people_centers(truth.stage, i)
        ]
        first = 100 * i if new_ids else 0
        objects = [
            track(truth, first + k, state.class_name, np.array(state.center_m) + OFFSET_M)
            for k, state in enumerate(object_states(truth.stage, i))
        ]
        out[SCENE.stamp_ns(i)] = (*people, *objects)
    return out


def room(truth: RoomTruth, points_world_m: FloatArray, found: Tracks) -> MappedRoom:
    points = in_map(truth, points_world_m).astype(np.float32)
    T_map_floor = se3.inverse(truth.T_world_map)
    cells = np.where(truth.occupied(T_map_floor, (60, 80), 0.05), 100, 0).astype(np.int8)
    cells[:30] = -1
    cells[30:33] = 100 - cells[30:33]
    grid = Grid(cells, 0.05, T_map_floor, (0, 0))
    cloud = ColoredCloud(points, np.zeros((len(points), 3), np.uint8))
    return MappedRoom(cloud, grid, found, (), {}, Trajectory.joined([]), SlamStats(0, 0))


def test_map_points_and_grid_cells_are_scored(truth: RoomTruth) -> None:
    vertices = truth.stage.static_mesh.vertices_m[:300].astype(float)
    xy_m = truth.stage.bodies[0].xy_m[::3]
    path_m = np.c_[xy_m, np.full(len(xy_m), 1.2)]
    scores = score(room(truth, np.concatenate([vertices, path_m]), {}), truth)
    assert scores.num_points == 300 + len(path_m)
    apart = truth.distance_m(in_map(truth, path_m)) > 0.05
    assert scores.path_share == pytest.approx(apart.sum() / scores.num_points)
    assert scores.near_share >= 300 / scores.num_points
    assert scores.grid_share == pytest.approx(0.9)  # 3 of 30 rows are inverted
    assert scores.level_deg == pytest.approx(0.0, abs=1e-5)
    assert np.isnan(scores.people_m)


def test_the_level_is_the_angle_to_the_true_vertical(truth: RoomTruth) -> None:
    found = room(truth, np.zeros((1, 3)), {})
    assert found.grid is not None
    up = found.grid.T_map_origin @ [0, np.sin(0.1), np.cos(0.1), 0]
    assert level_error_deg(found, up[:3]) == pytest.approx(np.degrees(0.1))
    assert np.isnan(level_error_deg(replace(found, grid=None), up[:3]))


@pytest.mark.parametrize('new_ids', [False, True])
def test_tracks_are_compared_with_people_and_objects(
    truth: RoomTruth, sequence: BagSequence, new_ids: bool
) -> None:
    found = tracks(truth, new_ids=new_ids)
    assert score(room(truth, np.zeros((1, 3)), found), truth).people_m == pytest.approx(0.05)
    scores = score_carries(placed_tracks(found), true_carries(truth, sequence), truth)
    assert scores.num_known > 0
    assert scores.num_kept == (0 if new_ids else scores.num_known)
    assert scores.put_down_m == pytest.approx([0.05] * scores.num_known)
    assert scores.num_handled == 0


def test_a_cylinder_is_rendered_at_its_position() -> None:
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = T_BODY_OPTICAL[:3, :3]
    T_world_camera[2, 3] = 1.2
    rays = np.array([[[0, 0, 1], [0.5, 0, 1], [0, -0.5, 1], [0, 0.1, 1.0]]])
    depth_m = cylinder_depth_m(rays, T_world_camera, np.array([2.0, 0.0]))
    np.testing.assert_allclose(depth_m, [[1.8, 0, 0, 1.8]], atol=1e-6)


def test_an_undetected_person_is_mapped_and_removed_2_s_after_leaving() -> None:
    scene = SceneConfig(seed=2, num_people=0, num_frames=180, width_px=160)
    truth = RoomTruth(scene, T_BODY_OPTICAL)
    config = RunConfig().updated({'dense.pixel_stride': 1})
    ghost = Ghost(truth, config)
    wall_m = np.full((scene.height_px, scene.width_px), 6.0, np.float32)
    image = np.zeros((*wall_m.shape, 3), np.uint8)
    T_map_world = se3.inverse(truth.T_world_map)
    one = np.zeros(1, np.int64)
    keyframes = KeyframePoses(1, one, one, 0, np.eye(4)[None])
    for i in range(0, scene.frames, 10):
        T = T_map_world @ truth.stage.T_world_camera[i]
        pose = SceneRequest(scene.stamp_ns(i), T, 0, keyframes, track_objects=False)
        ghost.fuse(pose, RgbdFrame(scene.stamp_ns(i), image, wall_m), ())
    assert ghost.num_standing > 100
    assert ghost.num_left == 0


def test_true_objects_have_whole_boxes_and_seen_parts(truth: RoomTruth) -> None:
    found = true_objects(truth)
    assert sum(item.is_expected for item in found) > 5
    for item in found:
        assert item.class_name != 'person'
        np.testing.assert_array_equal(item.seen.T_map_box[:3, :3], item.whole.T_map_box[:3, :3])
        offset_m = (item.seen.center_m - item.whole.center_m) @ item.whole.T_map_box[:3, :3]
        assert (np.abs(offset_m) + item.seen.size_m / 2 < item.whole.size_m / 2 + 0.01).all()


def test_found_objects_are_scored() -> None:
    def true(x_m: float) -> TrueObject:
        box = PlacedBox.along_map(np.array([x_m + 0.2, 0.2, 0.2]), np.full(3, 0.4))
        none = np.empty((0, 3))
        return TrueObject('cup', box, box, none, is_expected=True, was_carried=False)

    def item(name: str, x_m: float, height_m: float) -> FoundObject:
        center_m, size_m = np.array([x_m, 0.2, 0.2]), np.array([0.4, 0.4, height_m])
        return FoundObject(name, PlacedBox.along_map(center_m, size_m))

    found = [item('cup', 0.23, 0.46), item('book', 0.3, 0.4), item('cup', 9.0, 0.4)]
    scores = score_objects(found, [true(0.0), true(2.0)])
    assert scores.num_expected == 2
    assert scores.num_recalled == scores.num_right == scores.num_class_right == 1
    assert scores.num_double == scores.num_false == 1
    assert scores.center_m == pytest.approx([0.03])
    assert scores.small_center_m == pytest.approx([0.03])
    assert scores.size_m == pytest.approx([0.02])
    assert len(scores.area) == 0  # the cup is small


def test_turned_boxes_are_compared_as_they_stand() -> None:
    T = np.eye(4)
    T[:2, :2] = np.sqrt(0.5) * np.array([[1, -1], [1, 1]])
    cube, along = PlacedBox(T, np.ones(3)), PlacedBox.along_map(np.zeros(3), np.ones(3))
    assert along.iou(cube) == pytest.approx(np.sqrt(0.5))  # they share a regular octagon
    along = PlacedBox.along_map(np.zeros(3), np.array([1.6, 0.8, 0.7]))
    quarter = PlacedBox(T @ T, np.array([0.8, 1.6, 0.7]))
    assert along.iou(quarter) == pytest.approx(1.0)
    assert along.size_error_m(quarter) == pytest.approx(0.0)
    table = PlacedBox(T, np.array([1.6, 0.8, 0.7]))
    true = TrueObject('table', table, table, np.empty((0, 3)), is_expected=True, was_carried=False)
    found = FoundObject('table', PlacedBox(T @ T @ T, np.array([0.9, 1.6, 0.7])))
    assert score_objects([found], [true]).area == pytest.approx([0.125])
    corners_m = np.array([[x, y, 0.0] for x in (-0.8, 0.8) for y in (-0.4, 0.4)]) @ T[:3, :3].T
    axes = least_area_axes(corners_m)[:3, :3]
    sides_m = np.ptp(corners_m @ axes, axis=0)
    assert sorted(sides_m) == pytest.approx([0.0, 0.8, 1.6], abs=1e-6)


def test_carries_are_scored(truth: RoomTruth, sequence: BagSequence) -> None:
    carries = true_carries(truth, sequence)
    shown = [carry for carry in carries if carry.is_shown]
    assert shown
    history = history_of(shown, keeps_number=True)
    scores = score_carries(placed_objects(history), carries, truth)
    assert scores.num_known == scores.num_kept == len(shown)
    num_both_seen = sum(carry.is_both_seen for carry in shown)
    assert scores.num_both_seen == scores.num_both_kept == num_both_seen
    assert scores.put_down_m == pytest.approx([np.linalg.norm(OFFSET_M)] * len(shown))
    assert (scores.num_handled, scores.num_false) == (len(shown), 0)
    other = history_of(shown, keeps_number=False)
    new = score_carries(placed_objects(other), carries, truth)
    assert (new.num_known, new.num_kept) == (len(shown), 0)
    assert (new.num_both_seen, new.num_both_kept) == (num_both_seen, 0)


def test_the_old_place_of_a_carry_must_be_shown_without_the_object(
    truth: RoomTruth, sequence: BagSequence
) -> None:
    carries = true_carries(truth, sequence)
    both = [carry for carry in carries if carry.is_both_seen]
    assert both
    assert all(carry.is_shown for carry in both)
    stage, half_m = truth.stage, np.full(3, 0.05)
    places_m = [se3.transform(truth.T_world_map, c.from_map_m[None])[0] for c in both]
    covers = [box(m - half_m, m + half_m, Surface(0)) for m in places_m]
    static = merged([stage.world.static, *covers])
    covered = RoomTruth(SCENE, T_BODY_OPTICAL)
    covered.stage = replace(stage, world=replace(stage.world, static=static))
    found = true_carries(covered, sequence)
    assert [carry.is_shown for carry in found] == [carry.is_shown for carry in carries]
    assert not any(carry.is_both_seen for carry in found)


def test_an_object_that_nobody_touched_is_called_moved_wrongly(truth: RoomTruth) -> None:
    at_rest = mapped(1, 'sofa', np.zeros(3), ObjectState.AT_REST)
    history: ObjectHistory = {
        1: (at_rest,),
        2: (mapped(1, 'sofa', np.zeros(3), ObjectState.HANDLED),),
    }
    scores = score_carries(placed_objects(history), [], truth)
    assert (scores.num_handled, scores.num_false) == (1, 1)


def history_of(carries: list[TrueCarry], *, keeps_number: bool) -> ObjectHistory:
    """Return a map that shows each carry: at rest, then handled, then moved."""
    out: ObjectHistory = {}
    for i in range(SCENE.frames):
        found = []
        for k, carry in enumerate(carries):
            is_new = i >= carry.end
            place_m = (carry.to_map_m if is_new else carry.from_map_m) + OFFSET_M
            state = ObjectState.HANDLED if i >= carry.first else ObjectState.AT_REST
            state = ObjectState.MOVED if is_new else state
            number = k if keeps_number or not is_new else k + 100
            found.append(mapped(number, carry.class_name, place_m, state))
        out[SCENE.stamp_ns(i)] = tuple(found)
    return out


def mapped(number: int, name: str, place_m: FloatArray, state: ObjectState) -> MapObject:
    T = np.eye(4)
    T[:3, 3] = place_m
    last_ns = SCENE.stamp_ns(0)
    return MapObject(number, name, ((name, 1.0),), state, T, np.ones(3), 9, 0, last_ns, 1.0)


def test_a_filled_place_has_points_on_most_of_its_surface() -> None:
    surface_m = np.linspace((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 50)
    box = PlacedBox.along_map(np.zeros(3), np.ones(3))
    item = TrueObject('cup', box, box, surface_m, is_expected=True, was_carried=True)
    assert count_filled([item], surface_m[:30] + 0.01) == (1, 1)
    assert count_filled([item], surface_m[:20] + 0.01) == (0, 1)
