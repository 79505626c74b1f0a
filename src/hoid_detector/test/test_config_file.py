"""The shipped parameter file."""

from __future__ import annotations

from pathlib import Path

from hoid_common.io.param_file import load_params
from hoid_detector.config import DetectorConfig

FILE = Path(__file__).parents[1] / 'config' / 'hoid_detector.yaml'
OF_THE_NODE = {
    'model': '',
    'niceness': 0,
    'autostart': True,
    'input.reliability': 'best_effort',
    'input.compressed': False,
}


def test_shipped_values_are_the_defaults() -> None:
    values = load_params(FILE, 'hoid_detector')
    assert {name: values.pop(name) for name in OF_THE_NODE} == OF_THE_NODE
    assert DetectorConfig().updated(values) == DetectorConfig()
    assert 'score_threshold' in values
