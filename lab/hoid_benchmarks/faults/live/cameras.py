"""Cameras of several image sizes and rates that move along a wall."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import (
    CaseResult,
    Setup,
    odometry_result,
    running_nodes,
)
from hoid_benchmarks.faults.live.sender import WALL_M, Scene, Sender
from hoid_bringup.live.node_specs import FILTER, SLAM
from hoid_common.values import CameraModel

_WHILE_S = 3.0
_SPEED_MPS = 0.25
_MAX_ERROR_M = 0.02
_VIEW = 525 / 640  # focal length / image width, that of the TUM cameras


class Camera(NamedTuple):
    """Image width, rate and the required share of images with odometry."""

    width_px: int
    rate_hz: float
    # Required share of images with odometry; lower where one machine cannot process all images.
    least_share: float


_CAMERAS = (
    Camera(320, 60.0, 0.5), Camera(640, 5.0, 0.9), Camera(640, 30.0, 0.8), Camera(640, 60.0, 0.3),
    Camera(1280, 15.0, 0.5), Camera(1920, 5.0, 0.5),
)  # fmt: skip


def camera_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of cameras that move along a wall at 0.25 m/s."""
    for seed in seeds:
        for i, camera in enumerate(_CAMERAS):
            scene = _wall_scene(camera)
            setup = Setup((FILTER, SLAM), scene=scene, rate_hz=camera.rate_hz)
            kind = f'camera {camera.width_px} px wide, {camera.rate_hz:g} Hz'
            with running_nodes(folder / f'{seed} {i}', setup) as harness:
                yield harness.outcome(kind, seed, _slide(harness.sender, camera))


def _wall_scene(camera: Camera) -> Scene:
    focal_px, height_px = _VIEW * camera.width_px, camera.width_px * 3 // 4
    model = CameraModel(
        camera.width_px, height_px, focal_px, focal_px,
        (camera.width_px - 1) / 2, (height_px - 1) / 2,
    )  # fmt: skip
    return Scene(model, max(1, round(_SPEED_MPS / camera.rate_hz * focal_px / WALL_M)))


def _slide(sender: Sender, camera: Camera) -> Callable[[], CaseResult]:
    def slide() -> CaseResult:
        share = sender.send_for(_WHILE_S)
        error_m = _error_m(sender)
        if error_m > _MAX_ERROR_M:
            return CaseResult(f'the RMS position error is {error_m:.3f} m')
        seen = odometry_result(share, camera.least_share)
        return seen._replace(note=f'{seen.note}, error {1e3 * error_m:.1f} mm')

    return slide


def _error_m(sender: Sender) -> float:
    """Return the RMS error of the distance from the position of the first image."""
    known = [h for h in sender.heard if h.stamp_ns in sender.sent]
    positions_m = np.array([h.position_m for h in known])
    places_m = np.array([sender.sent[h.stamp_ns] for h in known])
    distances_m = np.linalg.norm(positions_m - positions_m[0], axis=1)
    return float(np.sqrt(np.mean((distances_m - np.abs(places_m - places_m[0])) ** 2)))
