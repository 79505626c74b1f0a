"""A wrong unit of depth shows in the nearest depth and the noise, even if the median is usual."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.io.depth import DepthUnitWarning
from hoid_common.values import Float32Array

NOISE_PER_M = 0.0006  # of the square of the depth


def wall_m(rng: np.random.Generator, scale: float = 1.0) -> Float32Array:
    """Return depth (480, 640) of a slanted wall from 1.5 to 4 m, read with a wrong unit."""
    true_m = np.tile(np.linspace(1.5, 4.0, 640), (480, 1))
    noisy_m = true_m + NOISE_PER_M * true_m**2 * rng.standard_normal(true_m.shape)
    return (scale * np.round(noisy_m, 3)).astype(np.float32)


def warning(scale: float) -> str:
    rng, unit = np.random.default_rng(0), DepthUnitWarning('set --depth-factor')
    return ''.join(unit.warning_for(wall_m(rng, scale)) for _ in range(12))


@pytest.mark.parametrize('scale', [1.0, 0.8, 1.3])
def test_depth_of_a_room_is_no_reason_for_a_warning(scale: float) -> None:
    assert warning(scale) == ''


@pytest.mark.parametrize(
    ('scale', 'change'), [(0.2, 'divided by 5'), (5.0, 'multiplied by 5'), (0.1, 'divided by 10')]
)
def test_the_likely_unit_is_said(scale: float, change: str) -> None:
    line = warning(scale)
    assert f'fit if the depth units per meter are {change}: if the unit is wrong' in line
    assert line.endswith('set --depth-factor')


def test_depth_without_noise_or_with_few_readings_is_judged_by_its_median() -> None:
    unit = DepthUnitWarning('x')
    assert not any(unit.warning_for(np.full((48, 640), 1.0, np.float32)) for _ in range(12))
    unit, sparse = DepthUnitWarning('x'), np.zeros((480, 640), np.float32)
    sparse[::16, ::16] = 0.2
    assert any('0.20 m' in unit.warning_for(sparse) for _ in range(12))
