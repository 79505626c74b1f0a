"""Depth cameras of an ordinary ROS shell, in a process of their own: depth arrives right."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import Image

from hoid_common.inputs.registration import Registration
from hoid_common.ros import conversions
from hoid_common.values import CameraModel, Float32Array
from hoid_system_tests.plain_rgbd import (
    COLOR_K,
    DEPTH_MM,
    HALF_MM,
    KINDS,
    OWN_K,
    OWN_MM,
    OWN_PX,
    TOPICS,
    X_M,
    start_plain_rgbd,
)
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start

pytestmark = pytest.mark.thorough


def expected_m(kind: str) -> Float32Array:
    """Return depth at the pixels of color."""
    if kind == 'own frame':
        T_color_depth = np.eye(4)
        T_color_depth[0, 3] = X_M
        depth, color = CameraModel(*OWN_PX, *OWN_K), CameraModel(640, 480, *COLOR_K)
        return Registration(depth, color, T_color_depth)((OWN_MM / 1000).astype(np.float32))
    if kind == 'half':
        return np.kron(HALF_MM / 1000, np.ones((2, 2))).astype(np.float32)
    return (DEPTH_MM / 1000).astype(np.float32)


@pytest.mark.parametrize('kind', KINDS)
def test_depth_of_a_plain_camera_is_right(
    start: Start, probe: Probe, kind: str, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    depths = probe.collect(Image, 'hoid_filter/static_depth', wait=False)
    remap = ('-r', f'depth/image:={TOPICS[kind]}') if kind in TOPICS else ()
    start('hoid_filter', 'hoid_filter_node', {'strategy': 'motion'}, ros_args=remap)
    monkeypatch.setitem(os.environ, 'ROS_DOMAIN_ID', str(domain_id))
    camera = start_plain_rgbd(kind)
    try:
        probe.spin_until(lambda: len(depths) >= 5, 'no depth', 60.0)
    finally:
        camera.kill()
        camera.wait()
    found_m = conversions.depth_from_msg(depths[-1])
    wanted_m = expected_m(kind)
    # Motion is judged from noise here and there; where depth is published, it is right.
    is_kept = found_m > 0
    np.testing.assert_allclose(found_m[is_kept], wanted_m[is_kept], atol=1e-4)
    assert is_kept.sum() > 0.9 * (wanted_m > 0).sum()


def test_the_document_lists_every_camera() -> None:
    page = Path(__file__).resolve().parents[1] / 'docs/results/inputs.md'
    assert f'is right for {", ".join(KINDS)}.' in page.read_text(encoding='utf-8')
