"""A board that no detector finds passes a camera at rest and leaves no ghost in the dense map."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.run_config import RunConfig
from hoid_common.values import (
    UNKNOWN,
    ByteArray,
    CameraModel,
    Detections,
    ObjectState,
    RgbdFrame,
    Trajectory,
)

CAMERA = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5)
WALL_M, BOARD_M = 2.0, 1.0
STEP_PX, WIDTH_PX = 6, 90
PERIOD_NS = 33_333_333
HALF_WAY = 35  # images until the board is in the middle


def texture(seed: int, width_px: int) -> ByteArray:
    noise = np.random.default_rng(seed).integers(0, 255, (48, width_px // 5, 3), np.uint8)
    return np.asarray(cv2.resize(noise, (width_px, 240), interpolation=cv2.INTER_CUBIC), np.uint8)


WALL, BOARD = texture(1, 320), texture(2, WIDTH_PX)


class Passing:
    """A recording of the board that passes in front of a wall, seen by a camera at rest."""

    name = 'passing'
    camera = CAMERA
    ground_truth: Trajectory | None = None
    true_detections: dict[int, Detections] | None = None
    fault: str | None = None

    def __len__(self) -> int:
        return HALF_WAY

    def __iter__(self) -> Iterator[RgbdFrame]:
        for i in range(len(self)):
            bgr, depth_m = WALL.copy(), np.full((240, 320), WALL_M, np.float32)
            left = STEP_PX * i - WIDTH_PX
            shown = slice(max(left, 0), max(left + WIDTH_PX, 0))
            bgr[:, shown] = BOARD[:, max(-left, 0) : max(-left, 0) + shown.stop - shown.start]
            depth_m[:, shown] = BOARD_M
            yield RgbdFrame(i * PERIOD_NS, bgr, depth_m)


def run(strategy: str) -> tuple[OfflinePipeline, int]:
    """Return the pipeline after all images, and the number of cloud points not on the wall."""
    config = RunConfig().updated({'filter.strategy': strategy, 'scene.dense.rate_hz': 30})
    pipeline = OfflinePipeline(Passing(), config, lambda _: None, dense=True)
    for frame in Passing():
        pipeline.process(frame)
    cloud = pipeline.finish(Passing(), {}).cloud
    assert cloud is not None
    assert len(cloud.points_m) > 1000
    return pipeline, int(np.count_nonzero(cloud.points_m[:, 0] < (WALL_M + BOARD_M) / 2))


@pytest.mark.slow
def test_an_undetected_moving_object_leaves_no_ghost() -> None:
    pipeline, ghosts = run('motion')
    (board,) = pipeline.objects
    assert (board.class_name, board.state) == (UNKNOWN, ObjectState.MOVING)
    speed_mps = STEP_PX * BOARD_M / CAMERA.fx_px * 1e9 / PERIOD_NS
    assert board.velocity_camera_mps == pytest.approx((speed_mps, 0, 0), abs=0.1)
    assert ghosts == 0
    assert run('none')[1] > 100
