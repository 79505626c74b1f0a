"""Forwarding of Python's `logging`, which modules without ROS use, to a node's logger."""

from __future__ import annotations

import logging

from rclpy.node import Node


class _NodeHandler(logging.Handler):
    def __init__(self, node: Node) -> None:
        super().__init__()
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # rclpy raises an error when a line of code logs with another severity than before, hence a
        # line for each severity.
        if record.levelno >= logging.CRITICAL:
            self._logger.fatal(text)
        elif record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)


def bridge_logging(node: Node) -> None:
    """Forward Python log records to a node's logger, and no longer to one bridged before."""
    root = logging.getLogger()
    for handler in [h for h in root.handlers if isinstance(h, _NodeHandler)]:
        root.removeHandler(handler)
    root.addHandler(_NodeHandler(node))
    # rclpy's severities have the same numbers as `logging`'s levels.
    root.setLevel(int(node.get_logger().get_effective_level()))
