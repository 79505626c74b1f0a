"""Quality of service of every topic, named in one place."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from hoid_common.inputs.input_config import RELIABLE


def latched(depth: int) -> QoSProfile:
    """Return the QoS of an output, or its input, whose last messages reach who comes late too."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


# Results: nothing is lost while a subscriber keeps up.
OUTPUT = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE
)
STATE = latched(OUTPUT.depth)  # a result, of which the last one holds until the next
LATCHED = latched(1)  # maps and paths
TF = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
TF_STATIC = latched(100)
CLOCK = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT
)


def input_qos(reliability: str, depth: int) -> QoSProfile:
    """Return the QoS of an input of this reliability ("best_effort" or "reliable") and queue.

    A best-effort input hears every publisher; a reliable one hears only reliable publishers.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=(
            ReliabilityPolicy.RELIABLE
            if reliability == RELIABLE
            else ReliabilityPolicy.BEST_EFFORT
        ),
    )
