"""Which images are looked at, and where they hang."""

import numpy as np

from rgbd_slam.model.keyframe_poses import NO_KEYFRAMES
from rgbd_slam.scene.fusion_scheduler import FusionScheduler, Rate

POSE = np.eye(4)
PERIOD_NS = 33_333_333


def taken(rate: Rate, stamps_ns: list[int]) -> list[int]:
    return [stamp_ns for stamp_ns in stamps_ns if rate.take_due(stamp_ns)]


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
    poses = FusionScheduler(3.0, 10.0)
    offered = [poses.pick(i * PERIOD_NS, POSE, 5, lambda: NO_KEYFRAMES) for i in range(90)]
    picked = [pose for pose in offered if pose is not None]
    assert {pose.reference_uid for pose in picked} == {5}
    assert sum(pose.keyframes is not None for pose in picked) == 9
    assert sum(pose.track_objects for pose in picked) == 30


def test_nothing_is_picked_when_nobody_looks() -> None:
    assert FusionScheduler(None, None).pick(0, POSE, 5, lambda: NO_KEYFRAMES) is None
