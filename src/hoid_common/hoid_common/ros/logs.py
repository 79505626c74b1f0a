"""Core modules log through `logging`; a node's own logger carries it on to /rosout."""

from __future__ import annotations

import logging

from rclpy.node import Node


class _NodeHandler(logging.Handler):
    def __init__(self, node: Node) -> None:
        super().__init__()
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # One line of code each: rclpy ties a severity to the place of the call.
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
    """Send what this process logs through `logging` to the node's logger, at its log level."""
    root = logging.getLogger()
    for handler in [h for h in root.handlers if isinstance(h, _NodeHandler)]:
        root.removeHandler(handler)
    root.addHandler(_NodeHandler(node))
    # rclpy numbers its severities as `logging` does.
    root.setLevel(int(node.get_logger().get_effective_level()))
