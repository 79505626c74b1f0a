"""Which images are looked at, and where they hang."""

from collections.abc import Callable

import numpy as np

from hoid_common.values import Trajectory
from rgbd_slam.frame_poses import FramePoses, Rate

POSE = np.eye(4)
MOVED = np.diag([1.0, 1.0, 1.0, 1.0])
MOVED[0, 3] = 0.5
PERIOD_NS = 33_333_333


def keyframes(*stamps_ns: int) -> Callable[[], Trajectory]:
    return lambda: Trajectory(np.array(stamps_ns, np.int64), np.array([MOVED] * len(stamps_ns)))


def taken(rate: Rate, stamps_ns: list[int]) -> list[int]:
    out = []
    for stamp_ns in stamps_ns:
        if rate.is_due(stamp_ns):
            rate.take(stamp_ns)
            out.append(stamp_ns)
    return out


def test_a_rate_is_kept_on_average_whatever_the_frame_rate() -> None:
    stamps = [i * PERIOD_NS for i in range(300)]
    assert len(taken(Rate(10.0), stamps)) == 100
    assert len(taken(Rate(7.0), stamps)) == 71  # both ends of 10 s count
    assert len(taken(Rate(60.0), stamps)) == 300


def test_a_rate_goes_on_after_a_gap_and_when_time_starts_anew() -> None:
    rate = Rate(10.0)
    assert taken(rate, [0, 10**10, 10**10 + 10**8]) == [0, 10**10, 10**10 + 10**8]
    assert taken(rate, [5, 10, 10**8 + 5]) == [5, 10**8 + 5]


def test_images_are_fused_at_one_rate_and_looked_at_at_another() -> None:
    poses = FramePoses(3.0, 10.0)
    offered = [poses.pick(i * PERIOD_NS, POSE, keyframes(0), is_keyframe=False) for i in range(90)]
    picked = [pose for pose in offered if pose is not None]
    assert sum(pose.keyframes is not None for pose in picked) == 9
    assert sum(pose.follow for pose in picked) == 30


def test_a_keyframe_is_where_the_corrected_map_has_it() -> None:
    pose = FramePoses(3.0, None).pick(7, POSE, keyframes(3, 7), is_keyframe=True)
    assert pose is not None
    np.testing.assert_array_equal(pose.T_map_camera, MOVED)


def test_a_keyframe_on_its_way_into_the_map_waits_for_the_next_image() -> None:
    poses = FramePoses(3.0, None)
    assert poses.pick(7, POSE, keyframes(3), is_keyframe=True) is None
    pose = poses.pick(8, POSE, keyframes(3), is_keyframe=False)
    assert pose is not None
    np.testing.assert_array_equal(pose.T_map_camera, POSE)


def test_nothing_is_picked_when_nobody_looks() -> None:
    assert FramePoses(None, None).pick(0, POSE, keyframes(0), is_keyframe=False) is None
