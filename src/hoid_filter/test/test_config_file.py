"""The shipped parameter file."""

from __future__ import annotations

from pathlib import Path

from hoid_common.input_config import InputConfig
from hoid_common.io.param_file import load_params
from hoid_filter.config import FilterConfig
from hoid_filter.detections.detection_gate import GateConfig

FILE = Path(__file__).parents[1] / 'config' / 'hoid_filter.yaml'
SECTIONS = {'detections.': GateConfig(), 'input.': InputConfig()}


def test_shipped_values_are_the_defaults() -> None:
    values = load_params(FILE, 'hoid_filter')
    assert values.pop('sync_slop_s') == 0.02
    for prefix, default in SECTIONS.items():
        own = {name: values.pop(name) for name in list(values) if name.startswith(prefix)}
        assert own
        named = {name.removeprefix(prefix): value for name, value in own.items()}
        assert default.updated(named) == default
    assert FilterConfig().updated(values) == FilterConfig()


def test_empty_name_means_every_class() -> None:
    assert FilterConfig(dynamic_classes=('',)).may_be_handled('sink')
    assert FilterConfig(dynamic_classes=()).may_be_handled('sink')
    assert not FilterConfig().may_be_handled('sink')
    assert not FilterConfig(dynamic_classes=()).may_be_handled('person')
