"""The recorder of a trajectory returns its poses, and its memory stays bounded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common import se3
from hoid_common.sync import RESTART_NS
from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.model.trajectory import TrajectoryRecorder, current_pass

from .world import tracked_at

MANY = 5000


def tracked(stamp_ns: int, T_map_camera: FloatArray, reference_uid: int = 0) -> TrackedFrame:
    return tracked_at(T_map_camera, stamp_ns, reference_uid)


def recorded(count: int, atlas: Atlas) -> TrajectoryRecorder:
    """Return a recorder of frames 1 mm apart, whose reference keyframes do not exist."""
    recorder, T = TrajectoryRecorder(atlas), np.eye(4)
    for n in range(count):
        T = T.copy()
        T[0, 3] = 0.001 * n
        recorder.add(tracked(10**9 + n, T, n // 10))
    return recorder


def test_poses_come_back_to_the_bit() -> None:
    poses = se3.exp(np.random.default_rng(0).normal(size=(MANY, 6)))
    recorder = TrajectoryRecorder(Atlas(1.2, 8))
    for n, pose in enumerate(poses):
        recorder.add(tracked(n, pose))
    online = recorder.online()
    assert len(recorder) == MANY
    np.testing.assert_array_equal(online.stamps_ns, np.arange(MANY))
    np.testing.assert_array_equal(online.T_world_camera, poses)


def test_nothing_recorded_is_an_empty_trajectory() -> None:
    nothing = TrajectoryRecorder(Atlas(1.2, 8))
    for trajectory in (nothing.online(), nothing.final(), nothing.keyframes()):
        assert len(trajectory) == 0


def test_the_parts_are_the_whole() -> None:
    recorder = recorded(MANY, Atlas(1.2, 8))
    parts, whole = list(recorder.parts('online')), recorder.online()
    assert len(parts) > 2
    np.testing.assert_array_equal(
        np.concatenate([part.T_world_camera for part in parts]), whole.T_world_camera
    )


@pytest.mark.slow
def test_frames_hang_on_what_took_the_place_of_many_removed_keyframes() -> None:
    atlas = Atlas(1.2, 8)
    there, step = se3.exp(np.array([[0.1, 0, 0, 0.5, 0, 0], [0, 0, 0, 1e-3, 0, 0]]))
    i = atlas.add_keyframe(tracked(0, there).frame, there, map_id=0)
    recorder, uid = TrajectoryRecorder(atlas), int(atlas.keyframes.uid[i])
    for n in range(MANY):  # each of another keyframe that is removed, the one hung on the next
        recorder.add(replace(tracked(n, there, uid + MANY - n), T_reference_camera=step))
    recorder.redirect(Redirect(uid + n, uid + n - 1, step) for n in range(MANY, 0, -1))
    final = recorder.parts('final')
    atlas.set_poses(np.array([i]), np.eye(4)[None])  # which is later than the question
    poses = Trajectory.joined(final).T_world_camera
    np.testing.assert_allclose(
        poses[:, 0, 3], there[0, 3] + 1e-3 * np.arange(MANY + 1, 1, -1), atol=1e-9
    )
    now = recorder.pose(MANY - 1)
    assert now is not None
    np.testing.assert_allclose(now, step @ step, atol=1e-12)


def test_a_revised_frame_is_elsewhere_now_and_was_where_it_was_said() -> None:
    atlas = Atlas(1.2, 8)
    first, moved = se3.exp(np.array([[0.1, 0, 0, 0.5, 0, 0], [0, 0.2, 0, 0, 1.0, 0]]))
    i = atlas.add_keyframe(tracked(0, first).frame, first, map_id=0)
    recorder, T = TrajectoryRecorder(atlas), se3.exp(np.full(6, 0.1))
    uid = int(atlas.keyframes.uid[i])
    for n in range(1030):  # more than are stored together
        recorder.add(replace(tracked(n, first @ T, uid), T_reference_camera=T))
    recorder.revise(1026, moved)
    final, online = recorder.final().T_world_camera, recorder.online().T_world_camera
    np.testing.assert_allclose(final[1026], moved, atol=1e-12)
    np.testing.assert_allclose(np.delete(final, 1026, 0), online[:-1], atol=1e-12)
    np.testing.assert_array_equal(online[1026], first @ T)
    atlas.set_poses(np.array([i]), moved[None])  # with which it goes from now on
    now = recorder.pose(1026)
    assert now is not None
    np.testing.assert_allclose(now, moved @ se3.inverse(first) @ moved, atol=1e-12)


def test_a_frame_whose_reference_is_unknown_is_not_revised() -> None:
    atlas = Atlas(1.2, 8)
    first, moved, T = se3.exp(
        np.array([[0.1, 0, 0, 0.5, 0, 0], [0, 0.2, 0, 0, 1.0, 0], [0.1] * 6])
    )
    i = atlas.add_keyframe(tracked(0, first).frame, first, map_id=0)
    recorder, uid = TrajectoryRecorder(atlas), int(atlas.keyframes.uid[i])
    recorder.add(replace(tracked(0, first, uid + 100), T_reference_camera=T))
    assert recorder.pose(0) is None
    recorder.revise(0, moved)
    recorder.redirect([Redirect(uid + 100, uid, np.eye(4))])  # makes the reference known
    np.testing.assert_allclose(recorder.final().T_world_camera, [first @ T], atol=1e-12)


def test_a_frame_that_becomes_a_keyframe_is_where_this_is_mapped() -> None:
    atlas = Atlas(1.2, 8)
    first, last = tracked(1, np.eye(4)), tracked(2, se3.exp(np.array([0, 0, 0, 0.1, 0, 0])))
    atlas.add_keyframe(first.frame, first.T_map_camera, 0)
    recorder = TrajectoryRecorder(atlas)
    recorder.add(last)
    recorder.become_keyframe(1)
    assert len(recorder.final()) == 0  # the mapper is late
    T_mapped = se3.exp(np.array([0, 0, 0, 0.12, 0, 0]))
    atlas.add_keyframe(last.frame, T_mapped, 0, uid=1)
    np.testing.assert_array_equal(recorder.final().T_world_camera, T_mapped[None])
    np.testing.assert_array_equal(recorder.online().T_world_camera, last.T_map_camera[None])


def test_final_poses_cover_maps_that_a_measured_motion_connects() -> None:
    atlas = Atlas(1.2, 8)
    recorder = TrajectoryRecorder(atlas)
    T_step, T_moved = se3.exp(np.array([[0, 0.1, 0, 0.2, 0, 0], [0.3, 0, 0.1, 1.0, 2.0, 0]]))
    frames = []
    for n, map_id in enumerate([0, 1, 1, 2]):  # the main map is 1; a lost camera starts the next
        T = np.linalg.matrix_power(T_step, n)
        row = atlas.add_keyframe(tracked(n, T).frame, T, map_id)
        uid = int(atlas.keyframes.uid[row])
        frames.append(replace(tracked(n, T, uid), T_reference_camera=np.eye(4)))
        recorder.add(frames[-1])
    assert recorder.final().stamps_ns.tolist() == [1, 2]
    recorder.link(frames[0], frames[1], T_step)
    assert recorder.final().stamps_ns.tolist() == [0, 1, 2]
    recorder.link(frames[2], frames[3], T_step)
    expected = np.stack([frame.T_map_camera for frame in frames])
    np.testing.assert_allclose(recorder.final().T_world_camera, expected, atol=1e-12)
    rows = np.flatnonzero(atlas.keyframes.map_id == 1)
    atlas.set_poses(rows, T_moved @ atlas.keyframes.T_map_camera[rows])  # a corrected main map
    np.testing.assert_allclose(recorder.final().T_world_camera, T_moved @ expected, atol=1e-12)
    np.testing.assert_array_equal(recorder.online().T_world_camera, expected)


def bridged(map_id: int) -> tuple[TrajectoryRecorder, FloatArray, FloatArray]:
    """Return a recorder after a bridge with linear drift, its final poses before, and true ones.

    The camera is found at the third step, in the map with this id.
    """
    atlas = Atlas(1.2, 8)
    T_map_first = se3.exp(np.array([0.3, 0, 0.1, 1.0, 2.0, 0]))
    rows = [
        atlas.add_keyframe(tracked(n, T_map_first).frame, T_map_first, n_map)
        for n, n_map in enumerate((0, map_id))
    ]
    reference, found = (int(uid) for uid in atlas.keyframes.uid[rows])
    recorder, true = TrajectoryRecorder(atlas), []
    for n in range(4):
        T = np.eye(4)
        T[:3, 3] = [0.1 * n, 0.0, 0.01 * n]  # without the drift of 0.02 m along y at each step
        true.append(T_map_first @ T)
        T[1, 3] = 0.02 * n
        if n < 3:
            pose = replace(tracked(n, T_map_first @ T, reference), T_reference_camera=T)
            recorder.add(pose)
    before = recorder.final().T_world_camera
    last = replace(tracked(3, true[3], found), T_reference_camera=np.eye(4))
    recorder.end_bridge(2, T_map_first @ T, last)
    return recorder, before, np.stack(true[:3])


def test_bridged_poses_are_corrected_once_the_camera_is_found() -> None:
    recorder, before, true = bridged(map_id=0)
    np.testing.assert_allclose(recorder.final().T_world_camera, true, atol=1e-12)
    np.testing.assert_allclose(recorder.online().T_world_camera, before, atol=1e-12)


def test_bridged_poses_stay_if_the_camera_is_found_in_another_map() -> None:
    recorder, before, true = bridged(map_id=1)
    assert len(before) == len(true)
    np.testing.assert_array_equal(recorder.final().T_world_camera, before)


def test_nothing_is_corrected_if_no_frame_was_bridged() -> None:
    recorder = recorded(3, Atlas(1.2, 8))
    recorder.end_bridge(0, np.eye(4), tracked(3, np.eye(4)))
    assert recorder.online().T_world_camera[:, 0, 3].tolist() == [0.0, 0.001, 0.002]


def test_a_frame_whose_map_is_gone_is_nowhere() -> None:
    assert recorded(3, Atlas(1.2, 8)).pose(1) is None


@given(st.lists(st.integers(0, 4 * RESTART_NS).map(lambda ns: ns // 10**8 * 10**8), max_size=12))
def test_the_current_pass_has_increasing_stamps(stamps_ns: list[int]) -> None:
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    poses[:, 0, 3] = np.arange(len(stamps_ns))
    found = current_pass(Trajectory(np.array(stamps_ns, np.int64), poses))
    restarts = [
        n for n in range(1, len(stamps_ns)) if stamps_ns[n] <= stamps_ns[n - 1] - RESTART_NS
    ]
    latest = stamps_ns[restarts[-1] if restarts else 0 :]
    assert found.stamps_ns.tolist() == sorted(set(latest))
    skipped = len(stamps_ns) - len(latest)
    first = [skipped + latest.index(stamp_ns) for stamp_ns in sorted(set(latest))]
    assert found.T_world_camera[:, 0, 3].tolist() == first  # each pose keeps its stamp
