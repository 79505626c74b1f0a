"""Log lines about changes of tracking: begun, lost, found again, and a new map."""

from __future__ import annotations

from rclpy.node import Node

from hoid_common.slam_status import SlamState, SlamStatus


class TrackingLog:
    """Logs one line when the state of tracking changes, and nothing while it stays the same."""

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._last: SlamStatus | None = None
        self._lost_at = 0  # number of processed images when tracking was lost

    def update(self, status: SlamStatus) -> None:
        """Log what has changed since the status of the previous image."""
        last, self._last = self._last, status
        if status.frames_processed == 0 or (
            last is not None and status.frames_processed < last.frames_processed
        ):  # a session has started
            last = None
        was, now = SlamState.NOT_INITIALIZED if last is None else last.state, status.state
        if last is not None and status.maps > last.maps and was is not SlamState.NOT_INITIALIZED:
            self._logger.info(
                f'a new map was started; there are {status.maps} maps until a recognized place '
                'joins them'
            )
        elif now is SlamState.TRACKING and was is SlamState.NOT_INITIALIZED:
            self._logger.info('tracking has begun')
        elif now is SlamState.TRACKING and was is SlamState.LOST:
            number = status.frames_processed - self._lost_at
            self._logger.info(f'tracking was found again after {number} images')
        elif now is SlamState.LOST and was is SlamState.TRACKING:
            self._lost_at = status.frames_processed
            self._logger.info(f'tracking is lost: {status.message}')
