"""Evaluation of masks on a scene with known results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hoid_benchmarks.jobs import masks
from hoid_benchmarks.jobs.labeled import rendered_people
from hoid_benchmarks.jobs.masks import (
    CASES,
    MaskCase,
    Tally,
    evaluate_masks,
    find_case,
    mask_report,
    mask_rows,
    variants,
)
from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.plan.perturb import perturb_detections
from hoid_benchmarks.plan.plan import Experiment, Job, Perturbation
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.report.views import make_table
from hoid_common.errors import ConfigError
from hoid_common.values import Detections, RgbdFrame
from hoid_filter.config import FilterConfig
from hoid_filter.strategy import FilterInput
from hoid_synth.config import SceneConfig

STORE = Store(Path('/nowhere'), Path('/nowhere'))
HEIGHT, WIDTH = 60, 80


def test_corners_are_counted_by_what_the_strategy_keeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person's box covers the left half, with corners on two moving and two static places."""
    found = Detections(
        0, np.array([[0, 0, 40, 60]], np.float32), ('person',), np.ones(1, np.float32)
    )
    pixels = 30 * WIDTH + np.array([10, 50, 20, 60])
    moving = np.array([True, True, False, False])
    view = FilterInput(0, found, np.full((HEIGHT, WIDTH), 2.0, np.float32), pixels)
    monkeypatch.setattr(masks, '_views', lambda *_: iter([(view, moving, ~moving)]))
    configs = {name: FilterConfig(strategy=name) for name in ('person', 'none')}
    person, nothing = evaluate_masks(CASES['rendered-1'], configs, STORE).values()
    assert person == Tally(moving=2, moving_kept=1, static=2, static_lost=1)
    assert nothing == Tally(2, 2, 2, 0, frames_that_differ=1)


def test_a_job_evaluates_every_variant_and_its_page_shows_the_shares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    job = Job('synth-1', 'hoid+', 'truth', 0, 'masks', (), Perturbation(missed_every=3))

    def stub(case: MaskCase, configs: Mapping[str, FilterConfig], _: Store) -> dict[str, Tally]:
        assert case == CASES['rendered-missed']
        assert list(configs) == list(variants())
        return {'hoid+': Tally(), 'none': Tally(4, 1, 8, 2, frames_that_differ=7)}

    monkeypatch.setattr(masks, 'evaluate_masks', stub)
    rows = mask_rows(job, STORE)
    assert rows[1] == ['none', 7, 1 / 4, 2 / 8, 1 / 7]
    result = Result(job, json.loads(json.dumps({'masks': rows})))
    table = make_table(Experiment('m', 'Masks', 'masks', '', '', '', (job,)), [result])
    assert [cell.text for cell in table.rows[1]] == [
        'synth-1', 'truth', 'missed_every=3', 'none', '7', '25.0 %', '25.0 %', '14.3 %',
    ]  # fmt: skip
    assert len(table.columns) == len(table.rows[1])


def test_every_switch_and_strategy_is_a_variant() -> None:
    names = variants()
    assert names['hoid+'] == FilterConfig()
    assert not names['without remember'].plus.remember
    assert {'none', 'person', 'hoid2d', 'hoid3d', 'descriptor'} < set(names)


def test_unknown_case_is_named() -> None:
    with pytest.raises(ConfigError, match='no case nonsense'):
        mask_report(['nonsense'], STORE)


def test_frames_of_a_case_are_chosen_by_its_name() -> None:
    assert find_case('static-false@10-50') == replace(
        CASES['static-false'], first_frame=10, end_frame=50
    )
    with pytest.raises(ConfigError, match='frames are given as in static-false@150-330'):
        find_case('static-false@10')


@pytest.mark.slow
def test_people_move_and_what_stands_about_does_not() -> None:
    config = SceneConfig(seed=1, num_frames=2, width_px=64)
    for frame, moving, exact in rendered_people(config, workers=1):
        assert exact is not None
        inside = np.zeros(moving.shape, bool)
        for x1, y1, x2, y2 in exact.boxes_xyxy_px.astype(int).tolist():
            inside[y1:y2, x1:x2] = True
        assert moving.shape == frame.depth_m.shape
        assert not moving[~inside].any()
        people = exact.boxes_xyxy_px[[name == 'person' for name in exact.class_names]]
        for x1, y1, x2, y2 in people.astype(int).tolist():
            assert moving[y1:y2, x1:x2].mean() > 0.2


def test_false_person_comes_every_so_often() -> None:
    frame = RgbdFrame(0, np.zeros((100, 200, 3), np.uint8), np.ones((100, 200), np.float32))
    detect = perturb_detections(
        lambda f: Detections.none(f.stamp_ns), Perturbation(false_every=3), seed=0
    )
    found = [detect(frame) for _ in range(6)]
    assert [len(d) for d in found if d is not None] == [0, 0, 1, 0, 0, 1]
    assert found[2] is not None
    np.testing.assert_allclose(found[2].boxes_xyxy_px, [[9, 4.5, 191, 95.5]], rtol=1e-5)
