"""Parameters of the filter's node: those of the filter, and how messages come together."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import param, section
from hoid_common.inputs.input_config import NodeConfig
from hoid_filter.config import FilterConfig
from hoid_filter.detections.detection_gate import GateConfig


@dataclass(frozen=True)
class FilterNodeConfig(NodeConfig, FilterConfig):
    """Parameters of the node."""

    sync_slop_s: float = param(
        0.02,
        'Largest difference between the stamps of colour and depth that belong together (s). '
        'Raise it when the camera stamps them apart and the diagnostics count unmatched images.',
        minimum=0.0,
        maximum=1.0,
    )
    detections: GateConfig = section(GateConfig)
