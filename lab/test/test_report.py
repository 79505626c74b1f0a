"""Results, tables, notes and the page, without running the system."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from hoid_benchmarks.jobs.results import Result, key_value, read_result, spread, write_result
from hoid_benchmarks.plan.kinds import kinds_text
from hoid_benchmarks.plan.plan import Experiment, Job, Plan, load_plan
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.report.headlines import headlines
from hoid_benchmarks.report.literature import published
from hoid_benchmarks.report.notes import curve_note
from hoid_benchmarks.report.report import Report
from hoid_benchmarks.report.runs import RunList
from hoid_benchmarks.report.views import failures, make_table, missing


def result(job: Job, ate: float) -> Result:
    return Result(job, {'ate_rmse_m': ate, 'coverage': 1.0, 'ate_mean_m': ate})


def test_an_ablation_does_not_mix_filters(tmp_path: Path) -> None:
    path = tmp_path / 'plan.yaml'
    path.write_text(
        'experiments: [{id: a, title: A, view: ablation, sequences: [s], filters: [none, motion],'
        ' seeds: [0, 1], variants: [{slam.tracking.consensus.enabled: false}]}]'
    )
    (experiment,) = load_plan(str(path)).experiments
    results = [result(job, 0.5 if job.filter == 'none' else 0.1) for job in experiment.jobs]
    rows = make_table(experiment, results).rows
    off = 'slam.tracking.consensus.enabled=False'
    assert [tuple(cell.text for cell in row[:5]) for row in rows] == [
        ('default', 's', 'none', '-', '0.5000 [0.5000-0.5000]'),
        (off, 's', 'none', '-', '0.5000 [0.5000-0.5000]'),
        ('default', 's', 'motion', '-', '0.1000 [0.1000-0.1000]'),
        (off, 's', 'motion', '-', '0.1000 [0.1000-0.1000]'),
    ]


def test_results_are_stored_by_job(tmp_path: Path) -> None:
    job = Job('a', 'none', '', 0)
    assert read_result(tmp_path, job) is None
    write_result(tmp_path, result(job, 0.01))
    found = read_result(tmp_path, job)
    assert found is not None
    assert found.summary['ate_rmse_m'] == 0.01
    assert read_result(tmp_path, replace(job, seed=1)) is None


def test_the_page_names_the_machines_of_the_runs(tmp_path: Path) -> None:
    jobs = [Job('a', 'none', '', seed) for seed in range(4)]
    machines = ('Xeon, 2 cores', 'EPYC, 8 cores', 'Xeon, 2 cores', '')  # '': an old version's
    for job, machine in zip(jobs, machines, strict=True):
        write_result(tmp_path, replace(result(job, 0.01), machine=machine))
    found = {job: r for job in jobs if (r := read_result(tmp_path, job))}
    plan = Plan('p', (Experiment('e', 't', 'accuracy', '', '', '', tuple(jobs)),), './hoid bench')
    store = Store(tmp_path, tmp_path)
    page = Report(plan, found, tmp_path, RunList(plan, store, tmp_path)).write().read_text()
    assert '<dt>Machine</dt><dd>EPYC, 8 cores; Xeon, 2 cores</dd>' in page
    older = Report(plan, {jobs[3]: found[jobs[3]]}, tmp_path, RunList(plan, store, tmp_path))
    assert '<dt>Machine</dt>' not in older.write().read_text()


def test_the_spread_is_over_successful_runs() -> None:
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
    assert [c.text for c in row[5:8]] == ['none', '1.000', '']


def test_a_difference_within_the_range_of_the_runs_is_equal(plan: Plan) -> None:
    compare = plan.experiments[0]
    noise = {0: 0.0, 1: 0.1}  # of runs with different seeds
    better = {}
    for filtered in (0.25, 0.35):
        ate = {'none': 0.4, 'hoid2d': filtered}
        every = [result(j, ate[j.filter] + noise[j.seed]) for j in compare.jobs]
        table = make_table(compare, every)
        better[filtered] = next(r[4] for r in table.rows if r[1].text == 'hoid2d')
        (headline,) = headlines(plan, {r.job: r for r in every})
        assert headline.value.text.startswith(better[filtered].text)
    assert better[0.25].text == '33.3 %'  # 0.25 to 0.35 against 0.4 to 0.5
    assert (better[0.35].text, better[0.35].value) == ('equal', 0.0)  # 0.35 to 0.45


def test_the_origin_of_the_images_is_named() -> None:
    assert kinds_text(['crowd', 'fr1_xyz', 'synth-3', 'crowd', 'fr1_xyz_people']) == (
        'Rendered: crowd, synth-3; recorded: fr1_xyz; recorded, with people pasted in: '
        'fr1_xyz_people.'
    )
    assert kinds_text(['crowd', 'synth-3']) == 'Rendered.'
    assert kinds_text([]) == ''


def test_the_comparison_shows_the_online_error_and_the_time_of_a_frame(plan: Plan) -> None:
    compare = plan.experiments[0]
    more = {'ate_online_rmse_m': 0.03, 'stage_ms': {'frame': {'median': 11.34, 'p95': 12.0}}}
    plain = [result(j, 0.02) for j in compare.jobs]
    table = make_table(compare, [replace(r, summary={**r.summary, **more}) for r in plain])
    columns = ('online RMSE [m]', 'coverage', 'frame [ms]: median / p95')
    assert table.columns[5:8] == columns
    words = {tuple(cell.text for cell in row[5:8]) for row in table.rows}
    assert words == {('0.0300 [0.0300-0.0300]', '1.000', '11.3 / 12.0')}


@pytest.mark.parametrize(('after_m', 'words'), [(0.01, '50.0 % better'), (0.021, '5.0 % worse')])
def test_headlines_state_better_or_worse(plan: Plan, after_m: float, words: str) -> None:
    jobs = plan.experiments[0].jobs
    results = {j: result(j, 0.02 if j.filter == 'none' else after_m) for j in jobs}
    (headline,) = headlines(plan, results)
    assert headline.value.text == words


def test_only_stages_that_were_timed_are_rows(plan: Plan) -> None:
    stages = replace(plan.experiments[0], view='stages')
    job = stages.jobs[0]
    times = {'track': {'median': 2.0, 'p95': 3.0}, 'detect': None}
    table = make_table(stages, [Result(job, {'stage_ms': times})])
    assert [[c.text for c in row[3:]] for row in table.rows] == [['track', '2.00', '3.00']]


def test_failed_runs_are_listed_with_their_errors(plan: Plan) -> None:
    jobs = plan.experiments[0].jobs
    results = [Result(jobs[0], {}, 'sequence a is missing'), *(result(j, 1.0) for j in jobs[1:])]
    table = failures(results)
    assert [c.text for c in table.rows[0]] == [jobs[0].label, 'sequence a is missing']
    assert len(table.rows) == 1


def test_published_values_are_marked_as_not_rerun() -> None:
    for table in published():
        assert 'not rerun' in table.title
        assert all(len(row) == len(table.columns) for row in table.rows)


def test_the_row_of_this_project_needs_a_run() -> None:
    ours = [Result(Job('fr1_xyz', 'none', '', s), {'ate_rmse_m': 0.01}) for s in (0, 1)]
    dynamic, static, _ = published([*ours, Result(Job('fr1_desk', 'none', '', 0), {}, 'died')])
    assert [c.text for c in static.rows[-1][:3]] == [
        'this project, none',
        '0.0100 [0.0100-0.0100]',
        '-',
    ]
    assert len(published()[1].rows) == len(static.rows) - 1
    assert len(published()[0].rows) == len(dynamic.rows)


def test_each_detector_has_its_row_of_this_project() -> None:
    ates_m = {'yolox_nano': 0.5, 'yolov8n_int8': 0.02}
    jobs = [Job('fr3_walking_xyz', 'hoid+', name, 0) for name in ates_m]
    dynamic, *_ = published([result(job, ates_m[job.detector]) for job in jobs])
    assert [[c.text for c in row[:3]] for row in dynamic.rows[-2:]] == [
        ['this project, hoid+, yolox_nano', '-', '0.5000'],
        ['this project, hoid+, yolov8n_int8', '-', '0.0200'],
    ]


def test_missing_sequences_are_listed_once(plan: Plan) -> None:
    results = [Result(j, {}, 'unpack it', missing=True) for j in plan.jobs()]
    table = missing(results)
    assert [[c.text for c in row] for row in table.rows] == [['a', 'unpack it']]
    assert failures(results).rows == ()


def test_the_note_on_a_curve() -> None:
    jobs = [
        Job('a', 'hoid2d', 'x', seed, parameters=(('filter.min_interaction_area', area),))
        for area in (0.1, 0.4, 0.6)
        for seed in (0, 1)
    ]
    curve = Experiment('e', 't', 'curve', '', '', 'filter.min_interaction_area', tuple(jobs))
    meters = {0.1: 0.02, 0.4: 0.01, 0.6: 0.03}
    results = [
        result(j, meters[dict(j.parameters)[curve.varied]] * (1 + 0.1 * j.seed)) for j in jobs
    ]
    note = curve_note(curve, results)
    assert 'Lowest ATE over all sequences at 0.4' in note
    assert '100 % at 0.1 and 200 % at 0.6' in note
    assert 'Runs with equal parameters vary by 5 %' in note
    assert curve_note(replace(curve, varied='missed_share'), results) == ''


def test_the_note_on_a_curve_of_verdicts() -> None:
    varied = 'filter.min_interaction_area'
    wrong = {0.1: (0, 16), 0.4: (1, 4), 0.8: (7, 0)}
    results = [
        Result(
            Job(scene, 'hoid2d', 'truth', 0, 'verdicts', ((varied, area),)),
            {
                'verdicts': {
                    'handled': 10 * share,
                    'passed': 20 * share,
                    'wrongly_static': static * share,
                    'wrongly_dynamic': dynamic * share,
                    'found_share': 1 - static / 10,
                    'spared_share': 1 - dynamic / 20,
                    'balanced': 1 - static / 20 - dynamic / 40,
                },
                'ate_rmse_m': 0.01,
            },
        )
        for area, (static, dynamic) in wrong.items()
        for scene, share in (('a', 1), ('b', 3))
    ]
    curve = Experiment('e', 't', 'verdicts', '', '', varied, tuple(r.job for r in results))
    note = curve_note(curve, results)
    assert note.startswith('hoid2d: best separation at 0.4; at 0.1 100 % of the handled objects')
    assert 'at 0.8 30 % of the handled objects are removed and 100 % of the others' in note
    assert 'the ends of the range cost 0 % at 0.1 and 0 % at 0.8' in note
    (row, *_) = make_table(curve, results).rows
    words = [cell.text for cell in row[3:10]]
    assert words == ['0.1', '1.000', '0.200', '0.600', '0 of 10', '16 of 20', '0.0100']
