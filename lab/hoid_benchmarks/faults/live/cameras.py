"""Cameras of any rate and size, which slide along a wall."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.sender import WALL_M, Scene, Sender
from hoid_benchmarks.faults.live.stage import Seen, Setup, shared, staged
from hoid_bringup.live.node_specs import FILTER, SLAM
from hoid_common.values import CameraModel

_WHILE_S = 3.0
_SPEED_MPS = 0.25
_MAX_ERROR_M = 0.02
_VIEW = 525 / 640  # focal length in widths of an image


class Camera(NamedTuple):
    """A kind of camera."""

    width_px: int
    rate_hz: float
    least_share: float  # of its images that odometry must come of; a large one is cut down to less


_CAMERAS = (
    Camera(320, 60.0, 0.5), Camera(640, 5.0, 0.9), Camera(640, 30.0, 0.8), Camera(640, 60.0, 0.3),
    Camera(1280, 15.0, 0.5), Camera(1920, 5.0, 0.5),
)  # fmt: skip


def camera_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of cameras that slide along a wall."""
    for seed in seeds:
        for i, camera in enumerate(_CAMERAS):
            scene = _sliding(camera)
            setup = Setup((FILTER, SLAM), has_scene=False, scene=scene, rate_hz=camera.rate_hz)
            kind = f'camera {camera.width_px} px wide, {camera.rate_hz:g} Hz'
            with staged(folder / f'{seed} {i}', setup) as stage:
                yield stage.outcome(kind, seed, _slide(stage.sender, camera))


def _sliding(camera: Camera) -> Scene:
    focal_px, height_px = _VIEW * camera.width_px, camera.width_px * 3 // 4
    model = CameraModel(
        camera.width_px, height_px, focal_px, focal_px,
        (camera.width_px - 1) / 2, (height_px - 1) / 2,
    )  # fmt: skip
    return Scene(model, max(1, round(_SPEED_MPS / camera.rate_hz * focal_px / WALL_M)))


def _slide(sender: Sender, camera: Camera) -> Callable[[], Seen]:
    def slide() -> Seen:
        share = sender.send_for(_WHILE_S)
        error_m = _error_m(sender)
        if error_m > _MAX_ERROR_M:
            return Seen(f'poses are wrong by {error_m:.3f} m')
        seen = shared(share, camera.least_share)
        return seen._replace(note=f'{seen.note}, error {1e3 * error_m:.1f} mm')

    return slide


def _error_m(sender: Sender) -> float:
    """Return the error of the way from the first image, root mean square."""
    known = [h for h in sender.heard if h.stamp_ns in sender.sent]
    positions_m = np.array([h.position_m for h in known])
    places_m = np.array([sender.sent[h.stamp_ns] for h in known])
    ways_m = np.linalg.norm(positions_m - positions_m[0], axis=1)
    return float(np.sqrt(np.mean((ways_m - np.abs(places_m - places_m[0])) ** 2)))
