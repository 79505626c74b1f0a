import numpy as np

from hoid_common import se3
from hoid_common.poses.frames import PoseBuffer
from hoid_common.values import FloatArray

MS = 1_000_000
TURN = np.array([0.0, 0.0, 0.2, 0.1, 0.0, 0.0])  # in 100 ms


def driven(share: float) -> FloatArray:
    return se3.exp(share * TURN)


def filled() -> PoseBuffer:
    poses = PoseBuffer()
    for i in range(3):
        poses.add(i * 100 * MS, driven(i))
    return poses


def test_poses_are_interpolated_with_constant_twist() -> None:
    poses = filled()
    for share in (0.0, 0.25, 1.0, 1.9, 2.0):
        T = poses.at(int(share * 100 * MS))
        assert T is not None
        np.testing.assert_allclose(T, driven(share), atol=1e-9)


def test_the_last_motion_is_extrapolated_briefly() -> None:
    poses = filled()
    T = poses.at(250 * MS)
    assert T is not None
    np.testing.assert_allclose(T, driven(2.5), atol=1e-9)
    assert poses.at(500 * MS) is None


def test_times_that_are_not_covered_have_no_pose() -> None:
    assert PoseBuffer().at(0) is None
    assert filled().at(-1) is None
    one = PoseBuffer()
    one.add(0, np.eye(4))
    assert one.at(1) is None


def test_old_poses_are_dropped_and_a_clock_set_back_clears_the_buffer() -> None:
    poses = filled()
    poses.add(20_000 * MS, np.eye(4))
    assert poses.at(50 * MS) is None
    poses.add(100 * MS, np.eye(4))
    assert poses.at(100 * MS) is not None
    assert poses.at(20_000 * MS) is None
