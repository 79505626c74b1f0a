"""Quality of service (QoS) profiles of all topics."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from hoid_common.inputs.input_config import RELIABLE


def profile(depth: int, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    """Return the profile of a queue of `depth` messages; latched: transient-local durability."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


# QoS of results. The depths are chosen: 10 messages are a third of a second at 30 Hz; tf2 uses 100
# for /tf.
OUTPUT = profile(10)
STATE = profile(10, latched=True)  # results that stay valid until the next message
LATCHED = profile(1, latched=True)  # maps and paths: each message replaces the previous one
TF = profile(100)
TF_STATIC = profile(100, latched=True)
CLOCK = profile(1, reliable=False)


def input_qos(reliability: str, depth: int) -> QoSProfile:
    return profile(depth, reliable=reliability == RELIABLE)
