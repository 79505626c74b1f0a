from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.poses.frames import StaticFrames
from hoid_common.values import FloatArray


def shift(x: float, y: float, yaw: float = 0.0) -> FloatArray:
    T = se3.exp(np.array([0, 0, yaw, 0, 0, 0.0]))
    T[:2, 3] = x, y
    return T


def test_chains_up_down_and_across() -> None:
    frames = StaticFrames()
    frames.add('base', 'mast', shift(0, 1, np.pi / 2))
    frames.add('mast', 'camera', shift(2, 0))
    frames.add('base', 'lidar', shift(5, 0))
    mast_camera, base_camera = shift(2, 0), shift(0, 1, np.pi / 2) @ shift(2, 0)
    lidar_camera = shift(-5, 0) @ base_camera
    for a, b, expected in (
        ('mast', 'camera', mast_camera),
        ('base', 'camera', base_camera),
        ('camera', 'base', se3.inverse(base_camera)),
        ('lidar', 'camera', lidar_camera),
        ('camera', 'camera', np.eye(4)),
    ):
        found = frames.find(a, b)
        assert found is not None
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_unknown_frames_and_loops_give_none() -> None:
    frames = StaticFrames()
    frames.add('a', 'b', np.eye(4))
    frames.add('b', 'a', np.eye(4))
    assert frames.find('a', 'elsewhere') is None
    assert frames.find('x', 'y') is None


def test_a_frame_is_at_the_identity_in_itself_even_if_it_is_unknown() -> None:
    """As in tf2: without any transform on /tf, a camera without a base is its own base."""
    found = StaticFrames().find('camera', 'camera')
    np.testing.assert_array_equal(found, np.eye(4))


def test_a_later_edge_replaces_an_earlier_one() -> None:
    frames = StaticFrames()
    frames.add('base', 'camera', shift(1, 0))
    frames.add('base', 'camera', shift(3, 0))
    found = frames.find('base', 'camera')
    assert found is not None
    assert found[0, 3] == 3


def test_with_edges_leaves_the_tree_unchanged() -> None:
    frames = StaticFrames()
    frames.add('base', 'camera', shift(1, 0))
    now = frames.with_edges([('map', 'base', shift(0, 2))])
    found = now.find('map', 'camera')
    assert found is not None
    np.testing.assert_allclose(found, shift(1, 2), atol=1e-12)
    assert frames.find('map', 'camera') is None


def test_too_many_frames_are_refused_and_known_ones_are_updated() -> None:
    frames = StaticFrames()
    for n in range(1000):
        frames.add('base', f'camera_{n}', shift(n, 0))
    with pytest.raises(
        MessageError, match='static frames: frame "more" exceeds the limit of 1000'
    ):
        frames.add('base', 'more', shift(0, 0))
    frames.add('base', 'camera_7', shift(3, 0))
    found = frames.find('base', 'camera_7')
    assert found is not None
    assert found[0, 3] == 3
    assert frames.find('base', 'more') is None
