"""The states of tracking, the time without a tracked image, and when a lost camera maps anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_keyframe
from rgbd_slam.tracking.tracking_state import TrackingState, TrackingStates

from .ring_world import CAMERA, RingWorld, mapped, ring_poses

S = 1_000_000_000
NUM_IMAGES = 60  # in which the camera is lost, at 30 Hz


def new_states(atlas: Atlas | None = None) -> TrackingStates:
    return TrackingStates(atlas or Atlas(1.2, 8), CAMERA, SlamConfig())


def lost_s(*stamps_s: float) -> float:
    states = new_states()
    assert not any(states.image(round(S * stamp_s)) for stamp_s in stamps_s)
    return states.lost_s


def test_the_time_between_images_adds_up() -> None:
    assert lost_s(7.0) == 0
    assert lost_s(7.0, 7.1, 7.3) == pytest.approx(0.3)


def test_a_gap_counts_as_half_a_second_at_most() -> None:
    assert lost_s(7.0, 17.0) == pytest.approx(0.5)
    assert lost_s(7.0, 7.4, 17.0, 17.1) == pytest.approx(1.0)


def test_equal_and_swapped_stamps_count_once() -> None:
    assert lost_s(7.0, 7.2, 7.2, 7.1, 7.3) == pytest.approx(0.3)
    assert lost_s(7.0, 6.0, 6.5, 7.1) == pytest.approx(0.1)


def test_the_time_begins_anew_when_a_pose_is_discarded() -> None:
    states = new_states()
    for stamp_ns in (7 * S, 7 * S + S // 4):
        states.image(stamp_ns)
    states.discarded()
    assert states.lost_s == 0
    states.image(7 * S + S // 2)
    assert states.lost_s == 0.25


def test_stamps_that_jump_back_far_start_the_time_anew() -> None:
    states = new_states()
    assert not states.image(100 * S)
    states.image(100 * S + S // 4)
    assert states.image(3 * S)
    assert states.lost_s == 0
    assert not states.image(3 * S + S // 4)
    assert states.lost_s == 0.25


def ring_frame() -> tuple[Atlas, Frame, TrackedFrame]:
    """Return a map, a frame that shows it, and the same frame as it was tracked."""
    atlas, world = Atlas(1.2, 8), RingWorld()
    poses = ring_poses(36)[:3]
    rows = mapped(atlas, world, poses, poses)
    frame: Frame = atlas.keyframes.frame(int(rows[-1]))
    last: TrackedFrame = tracked_keyframe(frame, atlas, int(atlas.keyframes.uid[rows[-1]]))
    assert np.count_nonzero(last.current_points(atlas) != NO_POINT) > 100
    return atlas, frame, last


def test_events_lead_from_state_to_state() -> None:
    atlas, frame, _ = ring_frame()
    states, seen = new_states(atlas), list[TrackingState]()
    for event in (
        states.no_map,
        states.started,
        lambda: states.tracked(frame, is_on_map=True),
        lambda: states.tracked(frame, is_on_map=False),
        lambda: states.missed(is_followed=True, is_recorded=True),
        lambda: states.missed(is_followed=True, is_recorded=False),
        lambda: states.missed(is_followed=False, is_recorded=False),
        lambda: states.tracked(frame, is_on_map=True),
        states.discarded,
    ):
        event()
        seen.append(states.state)
    assert [state.name for state in seen] == [
        'NO_MAP', 'ON_MAP', 'ON_MAP', 'OFF_MAP', 'BRIDGED', 'DEAD_RECKONED', 'LOST', 'ON_MAP',
        'LOST',
    ]  # fmt: skip


def test_bridged_images_are_counted_until_the_camera_is_found() -> None:
    atlas, frame, _ = ring_frame()
    states = new_states(atlas)
    for is_recorded in (True, True, False):
        states.missed(is_followed=True, is_recorded=is_recorded)
    assert states.num_bridged == 2
    states.tracked(frame, is_on_map=True)
    assert states.num_bridged == 0


def test_a_pose_without_the_map_for_a_second_is_reported() -> None:
    atlas, frame, _ = ring_frame()
    states, notes = new_states(atlas), list[str]()
    for k in range(14):
        states.image(k * S // 10)
        states.tracked(replace(frame, stamp_ns=k * S // 10), is_on_map=k == 2)
        notes.append(states.note)
    assert [k for k, note in enumerate(notes) if note] == [13]
    assert notes[13].startswith('for 1 s fewer than 30 points of the map have been seen')


def _lost_in(num_tracked: int, nearer: float) -> bool:
    """Return whether a map starts after a loss in a map of so many tracked images.

    Args:
        num_tracked: Images that were tracked in the first map of a session.
        nearer: Depth of what is then in view, as a share of the depth of the map.
    """
    atlas, frame, last = ring_frame()
    states = new_states(atlas)
    states.started()
    for _ in range(num_tracked):
        states.image(0)
        states.tracked(frame, is_on_map=True)
    seen = replace(frame, depth_m=nearer * frame.depth_m)
    for n in range(1, NUM_IMAGES + 1):
        states.image(n * S // 30)
        states.missed(is_followed=False, is_recorded=False)
        if states.wants_map(seen, last):
            return True
    return False


@pytest.mark.parametrize('num_tracked', [5, 30])
def test_a_hand_before_the_camera_starts_no_map(num_tracked: int) -> None:
    assert not _lost_in(num_tracked, nearer=0.3)


@pytest.mark.parametrize('num_tracked', [5, 30])
def test_new_ground_starts_a_map(num_tracked: int) -> None:
    assert _lost_in(num_tracked, nearer=3.0)
