"""Motion segmentation while a camera with a rolling shutter turns fast."""

from dataclasses import replace

import numpy as np
import pytest

from hoid_filter.config import FilterConfig
from hoid_filter.feature_filter import FeatureFilter
from hoid_synth.config import SceneConfig
from hoid_synth.scene import SceneRenderer

STATIC = SceneConfig(
    seed=13, num_frames=45, width_px=320, num_people=0, path='rpy', pace=4.0, shutter_s=0.03
)
PEOPLE = replace(STATIC, num_people=3, together=True, near_m=1.5, pace=3.0)
NUM_FIRST = 5  # images without enough evidence yet


def removed_shares(config: SceneConfig) -> tuple[float, float]:
    """Return the shares of features on static surface and on people that are removed."""
    renderer = SceneRenderer(config)
    feature_filter = FeatureFilter(FilterConfig(strategy='motion'), config.camera)
    counts = np.zeros((2, 2), np.int64)  # static or people; kept or removed
    for i in range(config.frames):
        synth = renderer.frame(i)
        result = feature_filter.process(synth.frame, None, for_picture=True)
        is_person = np.isin(synth.instance_image, renderer.stage.world.person_instances)
        for is_removed, uv_px in enumerate((result.features.uv_px, result.removed_uv_px)):
            u, v = np.rint(uv_px).astype(np.int64).T
            if i >= NUM_FIRST:
                counts[:, is_removed] += np.bincount(is_person[v, u], minlength=2)
    static, people = counts[:, 1] / np.maximum(counts.sum(axis=1), 1)
    return float(static), float(people)


@pytest.mark.slow
def test_static_surface_does_not_move_while_the_camera_turns() -> None:
    static, _ = removed_shares(STATIC)
    assert static < 0.05  # 0.02; 0.2 where a shifted row counts as motion


@pytest.mark.slow
def test_people_are_found_while_the_camera_turns() -> None:
    _, people = removed_shares(PEOPLE)
    assert people > 0.75  # 0.87
