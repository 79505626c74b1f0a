import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import Trajectory
from true_rotation import true_prior

NS = 1_000_000_000
START = se3.exp(np.array([0.3, -0.2, 0.1, 1.0, 2.0, 3.0]))
MOTION = se3.exp(np.array([0.1, 0.2, -0.3, 0.5, 0.0, 0.2]))


def test_the_prior_has_the_true_rotation_since_the_first_image_and_no_position() -> None:
    truth = Trajectory(np.array([5, 6]) * NS, np.stack([START, START @ MOTION]))
    prior = true_prior(truth, 5 * NS + 1000, 6 * NS - 1000)
    np.testing.assert_allclose(prior.T_camera_map[:3, :3], MOTION[:3, :3].T, atol=1e-12)
    sigmas_deg = np.rad2deg(1 / np.sqrt(np.diag(prior.information)[:3]))
    assert sigmas_deg == pytest.approx([0.1] * 3)
    assert not prior.information[3:].any()
