"""Plans, results, tables and the page, without running the system."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hoid_benchmarks.check import check
from hoid_benchmarks.literature import published
from hoid_benchmarks.page import Head, Section, render_page
from hoid_benchmarks.perturb import PerturbedSequence, cover_columns, perturb_detections
from hoid_benchmarks.plan import Job, Perturbation, Plan, load_plan
from hoid_benchmarks.results import Result, key_value, read_result, spread, write_result
from hoid_benchmarks.sequences import Store
from hoid_benchmarks.tables import failures, make_table
from hoid_benchmarks.worker import command_of
from hoid_bringup.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.values import CameraModel, Detections, RgbdFrame

PLAN = """
experiments:
  - id: compare
    title: None against HOID
    view: comparison
    sequences: [a]
    filters: [none, hoid2d]
    detectors: [x, y]
    seeds: [0, 1]
  - id: curve
    title: Missed
    view: curve
    vary: {missed_share: [0.0, 0.5]}
    sequences: [a]
    filters: [hoid2d]
    detectors: [x]
    seeds: [0, 1]
"""


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    path = tmp_path / 'plan.yaml'
    path.write_text(PLAN)
    return load_plan(str(path))


def result(job: Job, ate: float) -> Result:
    return Result(job, {'ate_rmse_m': ate, 'coverage': 1.0, 'ate_mean_m': ate})


@pytest.mark.parametrize('name', ['quick', 'full'])
def test_shipped_plans_load_and_their_parameters_exist(name: str) -> None:
    jobs = load_plan(name).jobs()
    assert jobs
    for job in jobs:
        RunConfig().updated({'filter.strategy': job.filter, **dict(job.parameters)})


def test_jobs_are_shared_between_experiments_and_no_filter_needs_no_detector(plan: Plan) -> None:
    jobs = plan.jobs()
    assert len(jobs) == 2 + 4 + 2  # none: per seed; hoid2d: x and y; curve adds one setting
    assert all(job.detector == '' for job in jobs if job.filter == 'none')
    assert len({job.key for job in jobs}) == len(jobs)


def test_unknown_plans_views_and_experiments_are_refused(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='full'):
        load_plan('nonsense')
    with pytest.raises(ConfigError, match='compare, curve'):
        plan.only(['nonsense'])
    bad = tmp_path / 'bad.yaml'
    bad.write_text(PLAN.replace('comparison', 'pie'))
    with pytest.raises(ConfigError, match='view must be one of'):
        load_plan(str(bad))


def test_results_survive_and_a_cut_off_one_is_none(tmp_path: Path) -> None:
    job = Job('a', 'none', '', 0)
    assert read_result(tmp_path, job) is None
    write_result(tmp_path, result(job, 0.01))
    found = read_result(tmp_path, job)
    assert found is not None
    assert found.summary['ate_rmse_m'] == 0.01
    assert read_result(tmp_path, replace(job, seed=1)) is None


def test_spread_is_the_median_of_runs_that_ended_well() -> None:
    job = Job('a', 'none', '', 0)
    runs = [result(job, x) for x in (0.3, 0.1, 0.2)] + [Result(job, {}, 'died')]
    found = spread(runs, key_value('ate_rmse_m'))
    assert found == (0.2, 0.1, 0.3, 3)
    assert math.isnan(spread(runs, key_value('stage_ms.track.median')).median)


def test_the_comparison_states_improvement_in_percent(plan: Plan) -> None:
    compare = plan.experiments[0]
    ate = {'none': 0.4, 'hoid2d': 0.02}
    table = make_table(compare, [result(j, ate[j.filter]) for j in compare.jobs])
    row = next(r for r in table.rows if r[1].text == 'hoid2d')
    assert row[3].text.startswith('0.0200')
    assert row[4].text == '95.0 %'
    assert table.markdown().count('\n') == 2 + len(table.rows)
    assert table.csv().splitlines()[0].startswith('sequence,filter')


def test_failed_runs_are_rows_that_say_why(plan: Plan) -> None:
    jobs = plan.experiments[0].jobs
    results = [Result(jobs[0], {}, 'sequence a is missing'), *(result(j, 1.0) for j in jobs[1:])]
    table = failures(results)
    assert [c.text for c in table.rows[0]] == [jobs[0].label, 'sequence a is missing']
    assert len(table.rows) == 1


def test_the_page_is_self_contained_and_escapes(plan: Plan) -> None:
    sections = [
        Section(
            replace(e, about='a < b & c'),
            make_table(e, [result(j, 0.01) for j in e.jobs]),
            ({'data': [], 'layout': {'title': {'text': '</script>'}}},),
        )
        for e in plan.experiments
    ]
    commands = {job: ' '.join(command_of(job, job.sequence)) for job in plan.jobs()}
    page = render_page(Head('T', 'M', 'V', 'C'), sections, [published()], commands)
    body = page[page.index('<body>') :]
    assert 'a &lt; b &amp; c' in body
    assert '<\\/script>' in body
    assert not re.search(r'(src|href)="https?:', body)
    for target in set(re.findall(r'href="#([^"]+)"', body)):
        assert f'id="{target}"' in body


def test_published_values_are_marked_as_not_rerun() -> None:
    table = published()
    assert 'not rerun' in table.title
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_commands_repeat_the_job() -> None:
    job = Job('a', 'hoid2d', 'x', 3, parameters=(('filter.min_interaction_area', 0.3),))
    words = command_of(job, 'PATH')
    assert words[:2] == ['run', 'PATH']
    assert '--set filter.min_interaction_area=0.3' in ' '.join(words)
    assert command_of(replace(job, live=True), 'PATH')[0] == 'replay'


def test_bounds_hold_break_and_miss(tmp_path: Path) -> None:
    bounds = tmp_path / 'bounds.yaml'
    rule = {'name': 'ate', 'value': 'ate_rmse_m', 'sequence': 'a', 'filter': 'none', 'max': 0.02}
    bounds.write_text(json.dumps({'bounds': [rule]}))
    job = Job('a', 'none', '', 0)
    assert check([result(job, 0.01)], bounds) == []
    assert 'ate: 0.03 is not in' in check([result(job, 0.03)], bounds)[0]
    assert len(check([], bounds)) == 1
    assert 'died' in check([result(job, 0.01), Result(job, {}, 'died')], bounds)[0]


def test_missing_sequences_say_where_to_get_them(tmp_path: Path) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made')
    with pytest.raises(InputError, match='rgbd_dataset_freiburg3_walking_xyz'):
        store.find('fr3_walking_xyz')
    with pytest.raises(InputError, match='freiburg1_xyz'):
        store.find('fr1_xyz_people')
    official = tmp_path / 'tum' / 'rgbd_dataset_freiburg1_xyz'
    official.mkdir(parents=True)
    assert replace(store, official=tmp_path / 'tum').find('fr1_xyz') == official


class Recording:
    name, ground_truth, true_detections, fault = 'r', None, None, None
    camera = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)

    def __len__(self) -> int:
        return 90

    def __iter__(self) -> Iterator[RgbdFrame]:
        for i in range(90):
            yield RgbdFrame(
                i * 33_333_333,
                np.full((48, 64, 3), 9, np.uint8),
                np.full((48, 64), 2.0, np.float32),
            )


def test_perturbed_frames_are_the_same_each_time_and_as_hard_as_asked() -> None:
    hard = PerturbedSequence(Recording(), Perturbation(depth_missing_share=0.3), 1)
    first, again = (np.stack([f.depth_m for f in hard]) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (first == 0).mean() == pytest.approx(0.3, abs=0.01)
    noisy = PerturbedSequence(Recording(), Perturbation(depth_noise=0.01), 1)
    assert np.std([f.depth_m for f in noisy]) == pytest.approx(0.04, rel=0.05)


def test_a_looped_recording_goes_forth_and_back_in_time_order() -> None:
    looped = PerturbedSequence(Recording(), Perturbation(loops=3), 0)
    stamps = [f.stamp_ns for f in looped]
    assert len(stamps) == len(looped) == 270
    assert (np.diff(stamps) > 0).all()


def test_the_cover_hides_its_share_of_the_width() -> None:
    for stamp_ns in range(0, 10**10, 10**9):
        left, right = cover_columns(640, 0.4, stamp_ns)
        assert 0 <= left < right <= 640
        assert right - left == 256


def detect(frame: RgbdFrame) -> Detections:
    box = np.array([[1, 2, 3, 4]], np.float32)
    return Detections(frame.stamp_ns, box, ('person',), np.ones(1, np.float32))


def outcomes(perturbation: Perturbation) -> list[Detections | None]:
    source = perturb_detections(detect, perturbation, 0)
    return [source(frame) for frame in Recording()]


def is_empty(found: Detections | None) -> bool:
    return found is not None and len(found) == 0


def test_missed_detections_are_empty_and_late_ones_none() -> None:
    missed = [is_empty(d) for d in outcomes(Perturbation(missed_share=0.4))]
    assert np.mean(missed) == pytest.approx(0.4, abs=0.12)
    third = [is_empty(d) for d in outcomes(Perturbation(missed_every=3))]
    assert third[:6] == [False, False, True] * 2
    slow = outcomes(Perturbation(detector_hz=10.0))
    assert sum(d is not None for d in slow) == 30
    run = [is_empty(d) for d in outcomes(Perturbation(missed_run=10))]
    assert sum(run) == 0  # the first run comes after 3 s
    covered = outcomes(Perturbation(covered_share=0.5))[0]
    assert covered is not None
    assert covered.class_names == ('person', 'person')


def test_every_named_plan_file_is_shipped() -> None:
    folder = Path(__file__).parents[1] / 'hoid_benchmarks' / 'experiments'
    assert {p.stem for p in folder.glob('*.yaml')} == {'quick', 'full'}
