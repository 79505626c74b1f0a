"""Log lines about start, loss and recovery of tracking, new maps, and progress every 10 s."""

from __future__ import annotations

import time

import numpy as np
from rclpy.node import Node

from hoid_common.errors import counted
from hoid_common.slam_status import SlamState, SlamStatus

_PERIOD_S = 10.0  # chosen: often enough to see that the node works, without too many lines


class TrackingLog:
    """Logs changes of the tracking state, and every 10 s tracked images/s and ms per image."""

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._last: SlamStatus | None = None
        self._lost_at = 0  # number of images that were processed when tracking was lost
        self._since_s = time.monotonic()  # start of the current period of 10 s
        self._track_ms: list[float] = []  # durations of the images tracked in the current period

    def update(self, status: SlamStatus) -> None:
        """Log changes since the status of the previous image, and progress if it is due."""
        last, self._last = self._last, status
        if status.frames_processed == 0 or (
            last is not None and status.frames_processed < last.frames_processed
        ):  # a new session has started
            last = None
        was, now = SlamState.NOT_INITIALIZED if last is None else last.state, status.state
        if last is not None and status.maps > last.maps and was is not SlamState.NOT_INITIALIZED:
            several = f'; {status.maps} maps exist until a recognized place joins them'
            self._logger.info('a new map was started' + (several if status.maps > 1 else ''))
        elif now is SlamState.TRACKING and was is SlamState.NOT_INITIALIZED:
            self._logger.info('tracking has begun')
        elif now is SlamState.TRACKING and was is SlamState.LOST:
            number = status.frames_processed - self._lost_at
            self._logger.info(f'tracking was recovered after {counted(number, "image")}')
        elif now is SlamState.LOST and was is SlamState.TRACKING:
            self._lost_at = status.frames_processed
            self._logger.info(f'tracking is lost: {status.message}')
        self._log_progress(status)

    def _log_progress(self, status: SlamStatus) -> None:
        if status.state is SlamState.TRACKING:
            self._track_ms.append(status.stage_ms.get('track', 0.0))
        elapsed_s = time.monotonic() - self._since_s
        if elapsed_s < _PERIOD_S:
            return
        if self._track_ms:
            self._logger.info(
                f'tracking, {len(self._track_ms) / elapsed_s:.1f} Hz, '
                f'{np.median(self._track_ms):.0f} ms, {counted(status.keyframes, "keyframe")}'
            )
        self._since_s, self._track_ms = time.monotonic(), []
