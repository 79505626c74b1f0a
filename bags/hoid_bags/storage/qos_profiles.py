"""QoS profiles in the form in which rosbag2 stores them with the topics of a bag."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from hoid_common.errors import InputError
from hoid_common.io.yaml_file import parse_yaml

_FOREVER = QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE, as rosbag2 writes it


def recorded_qos(depth: int = 10, *, reliable: bool = True, latched: bool = False) -> Qos:
    """Return a profile as rosbag2 stores it; latched: with transient-local durability."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=depth,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )


def stored_qos(text: str) -> list[Qos]:
    """Return the profiles in the YAML text that a recorder stored; empty if it is no list.

    Reliability, durability and depth are read, with defaults for missing entries. Recorders older
    than Iron write policies as numbers.
    """
    try:
        entries = parse_yaml(text, 'offered_qos_profiles')
    except InputError:
        return []
    return [_profile(e) for e in entries if isinstance(e, dict)] if entries else []


def _profile(entry: dict[Any, Any]) -> Qos:
    depth = entry.get('depth')
    latched = (QosDurability.TRANSIENT_LOCAL.value, 'transient_local')
    best_effort = (QosReliability.BEST_EFFORT.value, 'best_effort')
    return recorded_qos(
        depth if isinstance(depth, int) else 0,
        reliable=entry.get('reliability') not in best_effort,
        latched=entry.get('durability') in latched,
    )
