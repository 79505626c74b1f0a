"""The oracle filter."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_benchmarks.jobs.exact import ExactFilter, moving_masks
from hoid_benchmarks.plan.sequences import scene_of
from hoid_common.errors import InputError
from hoid_filter.config import ExtractionConfig
from hoid_synth.scene import SceneRenderer

SCENE = 'synth-1-path=xyz+near=1.5+no-people+event=trolley+speed=0.1+frames=2+width=160'


def test_nothing_on_what_moves_is_left(tmp_path: Path) -> None:
    scene = scene_of(SCENE)
    assert scene is not None
    renderer = SceneRenderer(scene)
    assert renderer.stage.world.mover is not None
    shown = renderer.frame(1)
    moving = shown.instance_image == renderer.stage.world.mover[1]
    assert moving.mean() > 0.1
    *_, mask = moving_masks(scene)
    assert (mask != moving).mean() < 0.002
    for _ in range(2):  # the masks are rendered, then read
        exact = ExactFilter(SCENE, tmp_path / 'masks' / 'scene.npy', ExtractionConfig())
        found = exact.process(shown.frame)
        u, v = np.rint(found.features.uv_px).astype(int).T
        near = cv2.dilate(moving.view(np.uint8), np.ones((7, 7), np.uint8)) > 0
        assert len(u) > 50
        assert not near[v, u].any()
        assert 0 < found.num_removed < found.num_features_in


def test_of_a_recording_it_is_not_known() -> None:
    with pytest.raises(InputError, match='fr1_xyz'):
        ExactFilter('fr1_xyz', Path('none.npy'), ExtractionConfig())
