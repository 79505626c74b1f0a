"""How far a person is."""

import numpy as np
import pytest

from hoid_filter.torso import torso_depth_m


@pytest.mark.parametrize('depth_mm', [1299, 1300, 1301, 2100, 4700])
def test_a_flat_person_is_as_far_as_every_reading_says(depth_mm: int) -> None:
    """Also where rounding puts a reading on the border of two bins."""
    depth_m = np.full((40, 40), depth_mm / 1000, np.float32)
    assert torso_depth_m(depth_m, (0.0, 0.0, 40.0, 40.0)) == pytest.approx(depth_mm / 1000)


def test_a_person_hidden_in_part_stays_as_far_as_a_moment_ago() -> None:
    depth_m = np.full((40, 40), 3.0, np.float32)
    depth_m[16:] = 1.5  # a table in front
    assert torso_depth_m(depth_m, (0.0, 0.0, 160.0, 160.0), 3.1) == pytest.approx(3.0)


def test_what_was_the_background_when_a_person_came_in_is_not_held_to() -> None:
    """Only an arm was in the image, and the wall behind it was taken for the person."""
    depth_m = np.full((40, 40), 3.6, np.float32)
    depth_m[:, 6:34] = 2.6
    assert torso_depth_m(depth_m, (0.0, 0.0, 160.0, 160.0), 3.9) == pytest.approx(2.6)
