"""How far a person is."""

import numpy as np
import pytest

from hoid_filter.torso import torso_depth_m


@pytest.mark.parametrize('depth_mm', [1299, 1300, 1301, 2100, 4700])
def test_a_flat_person_is_as_far_as_every_reading_says(depth_mm: int) -> None:
    """Also where rounding puts a reading on the border of two bins."""
    depth_m = np.full((40, 40), depth_mm / 1000, np.float32)
    assert torso_depth_m(depth_m, (0.0, 0.0, 40.0, 40.0)) == pytest.approx(depth_mm / 1000)
