"""Plans, results, tables and the page, without running the system."""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import pytest

from hoid_bags.tum.cameras import camera_from_name
from hoid_benchmarks import commands
from hoid_benchmarks.commands import add_bench_arguments, repeating_command
from hoid_benchmarks.jobs.results import Result, key_value, read_result, spread, write_result
from hoid_benchmarks.jobs.worker import command_of
from hoid_benchmarks.plan.plan import Experiment, Job, Plan, load_plan, load_profile
from hoid_benchmarks.plan.sequences import Store, scene_options
from hoid_benchmarks.report.headlines import headlines
from hoid_benchmarks.report.literature import published
from hoid_benchmarks.report.notes import curve_note
from hoid_benchmarks.report.report import Report
from hoid_benchmarks.report.runs import RunList
from hoid_benchmarks.report.views import failures, make_table, missing
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError

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


@pytest.mark.slow
@pytest.mark.parametrize('name', ['quick', 'full', 'readme', 'ablation'])
def test_shipped_plans_load_and_their_parameters_exist(name: str) -> None:
    jobs = load_plan(name).jobs()
    assert jobs
    for job in jobs:
        RunConfig().updated({'filter.strategy': job.strategy, **dict(job.parameters)})


def test_a_profile_sets_what_an_experiment_does_not(tmp_path: Path) -> None:
    path = tmp_path / 'plan.yaml'
    path.write_text(
        'experiments: [{id: a, title: A, view: curve, sequences: [s], filters: [none], seeds: [0],'
        ' profile: orb_slam3, fixed: {slam.mapping.rounds: 2}, vary: {slam.mapping.window: [8]}}]'
    )
    (job,) = load_plan(str(path)).jobs()
    profile = load_profile('orb_slam3')
    changed = {'slam.mapping.rounds': 2, 'slam.mapping.window': 8}
    assert dict(job.parameters) == {**profile, **changed}
    assert all(profile[name] != value for name, value in changed.items())
    names = {leaf.name: leaf.value for leaf in RunConfig().params()}
    assert all(names[name] != value for name, value in profile.items())  # else it says nothing
    with pytest.raises(ConfigError, match='no profile "orb_slam4": there is orb_slam3'):
        load_profile('orb_slam4')


def test_jobs_are_shared_between_experiments_and_no_filter_needs_no_detector(plan: Plan) -> None:
    jobs = plan.jobs()
    assert len(jobs) == 2 + 4 + 2  # none: per seed; hoid2d: x and y; curve adds one setting
    assert all(job.detector == '' for job in jobs if job.filter == 'none')
    assert len({job.key for job in jobs}) == len(jobs)


_ONE_SEED = (
    'timed',
    'detect',
    'pictures',
    'masks',
)  # costs and pictures: nothing that a seed changes


@pytest.mark.parametrize('name', ['full', 'readme'])
def test_every_shipped_accuracy_has_five_seeds_at_least(name: str) -> None:
    for experiment in load_plan(name).experiments:
        seeds = {job.seed for job in experiment.jobs}
        one_is_enough = all(job.mode in _ONE_SEED for job in experiment.jobs)
        expected = {0} if one_is_enough else set(range(max(5, len(seeds))))
        assert seeds == expected, experiment.id


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


def test_the_page_names_the_machines_that_ran_not_the_one_that_reports(tmp_path: Path) -> None:
    jobs = [Job('a', 'none', '', seed) for seed in range(4)]
    machines = ('Xeon, 2 cores', 'EPYC, 8 cores', 'Xeon, 2 cores', '')  # '': an older result
    for job, machine in zip(jobs, machines, strict=True):
        write_result(tmp_path, replace(result(job, 0.01), machine=machine))
    found = {job: r for job in jobs if (r := read_result(tmp_path, job))}
    plan = Plan('p', (Experiment('e', 't', 'accuracy', '', '', '', tuple(jobs)),), './hoid bench')
    store = Store(tmp_path, tmp_path)
    page = Report(plan, found, tmp_path, RunList(plan, store, tmp_path)).write().read_text()
    assert '<dt>Machine</dt><dd>EPYC, 8 cores; Xeon, 2 cores</dd>' in page
    older = Report(plan, {jobs[3]: found[jobs[3]]}, tmp_path, RunList(plan, store, tmp_path))
    assert '<dt>Machine</dt>' not in older.write().read_text()


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
    assert [c.text for c in row[5:8]] == ['none', '1.000', '']


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
def test_headlines_say_which_way_it_went(plan: Plan, after_m: float, words: str) -> None:
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


def test_failed_runs_are_rows_that_say_why(plan: Plan) -> None:
    jobs = plan.experiments[0].jobs
    results = [Result(jobs[0], {}, 'sequence a is missing'), *(result(j, 1.0) for j in jobs[1:])]
    table = failures(results)
    assert [c.text for c in table.rows[0]] == [jobs[0].label, 'sequence a is missing']
    assert len(table.rows) == 1


def test_published_values_are_marked_as_not_rerun() -> None:
    for table in published():
        assert 'not rerun' in table.title
        assert all(len(row) == len(table.columns) for row in table.rows)


def test_our_own_row_stands_beside_published_ones_where_it_was_run() -> None:
    ours = [Result(Job('fr1_xyz', 'none', '', s), {'ate_rmse_m': 0.01}) for s in (0, 1)]
    dynamic, static = published([*ours, Result(Job('fr1_desk', 'none', '', 0), {}, 'died')])
    assert [c.text for c in static.rows[-1][:3]] == [
        'this project, none',
        '0.0100 [0.0100-0.0100]',
        '-',
    ]
    assert len(published()[1].rows) == len(static.rows) - 1
    assert len(published()[0].rows) == len(dynamic.rows)


def test_our_own_row_is_of_the_detector_that_the_table_names() -> None:
    ates_m = {'yolox_nano': 0.5, 'yolov8n_int8': 0.02}
    jobs = [Job('fr3_walking_xyz', 'hoid+', name, 0) for name in ates_m]
    dynamic, _ = published([result(job, ates_m[job.detector]) for job in jobs])
    words = [c.text for c in dynamic.rows[-1][:3]]
    assert words == ['this project, hoid+, yolov8n_int8', '-', '0.0200']


def test_commands_repeat_the_job() -> None:
    job = Job('a', 'hoid2d', 'x', 3, parameters=(('filter.min_interaction_area', 0.3),))
    words = command_of(job, 'PATH')
    assert words[:2] == ['run', 'PATH']
    assert '--set filter.min_interaction_area=0.3' in ' '.join(words)
    assert '--set filter.extraction.num_features=1020' in ' '.join(words)
    assert command_of(replace(job, mode='live'), 'PATH')[0] == 'replay'


@pytest.mark.parametrize(
    ('words', 'command'),
    [
        (['full'], './hoid bench full --out docs/out/bench'),
        (['full', '--out', '../out/bench'], './hoid bench full'),
        (
            ['my.yaml', '--data', '/tum', '--out', 'two words'],
            "./hoid bench docs/my.yaml --data ../tum --out 'docs/two words'",
        ),
    ],
)
def test_the_command_on_the_page_repeats_data_and_folder_from_the_root(
    words: list[str], command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'root' / 'docs').mkdir(parents=True)
    monkeypatch.chdir(tmp_path / 'root' / 'docs')
    monkeypatch.setattr(commands, '_ROOT', tmp_path / 'root')
    parser = argparse.ArgumentParser()
    add_bench_arguments(parser)
    args = parser.parse_args([w.replace('/tum', f'{tmp_path}/tum') for w in words])
    assert repeating_command(args.what, args) == command


def test_seeds_vary_the_feature_budget_and_seed_0_is_the_default() -> None:
    job = Job('a', 'none', '', 0)
    budgets = [
        replace(job, seed=k).settings().get('filter.extraction.num_features') for k in range(5)
    ]
    assert budgets == [None, 1010, 990, 1020, 980]
    half = replace(job, seed=1, parameters=(('filter.extraction.num_features', 500),))
    assert half.settings() == {'filter.extraction.num_features': 505}


def test_missing_sequences_say_where_to_get_them(tmp_path: Path) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made')
    with pytest.raises(InputError, match='rgbd_dataset_freiburg3_walking_xyz'):
        store.find('fr3_walking_xyz')
    with pytest.raises(InputError, match='freiburg1_xyz'):
        store.find('fr1_xyz_people')
    official = tmp_path / 'tum' / 'rgbd_dataset_freiburg1_xyz'
    official.mkdir(parents=True)
    assert replace(store, official=tmp_path / 'tum').find('fr1_xyz') == official


def test_a_scene_is_rendered_anew_when_any_module_of_the_renderer_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'room').mkdir()
    (tmp_path / '__init__.py').touch()
    module = tmp_path / 'room' / 'rooms.py'
    monkeypatch.setattr('hoid_synth.__file__', str(tmp_path / '__init__.py'))
    store = Store(tmp_path, tmp_path)
    paths = []
    for text in ('a = 1', 'a = 2', 'a = 1'):
        module.write_text(text)
        paths.append(store.locate('crowd'))
    assert paths[0] == paths[2] != paths[1]


def test_every_named_plan_file_is_shipped() -> None:
    folder = Path(__file__).parents[1] / 'hoid_benchmarks' / 'plan' / 'experiments'
    names = {'quick', 'full', 'readme', 'ablation', 'scenes'}
    assert {p.stem for p in folder.glob('*.yaml')} == names


def test_missing_sequences_are_named_once_and_not_filled_in(plan: Plan) -> None:
    results = [Result(j, {}, 'unpack it', missing=True) for j in plan.jobs()]
    table = missing(results)
    assert [[c.text for c in row] for row in table.rows] == [['a', 'unpack it']]
    assert failures(results).rows == ()


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for name in ('rgbd_dataset_freiburg3_walking_rpy', 'rgbd_bonn_crowd', 'holiday'):
        (tmp_path / 'data' / name).mkdir(parents=True)
    return tmp_path / 'data'


def test_official_folders_add_their_rows_by_themselves(data: Path, tmp_path: Path) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made', data)
    assert store.official_sequences() == ('bonn_crowd', 'fr3_walking_rpy')
    assert store.find('fr3_walking_rpy') == data / 'rgbd_dataset_freiburg3_walking_rpy'
    assert camera_from_name(store.find('bonn_crowd').name) is not None
    with pytest.raises(InputError, match='rgbd_dataset_freiburg3_walking_xyz'):
        store.find('fr3_walking_xyz')
    path = tmp_path / 'plan.yaml'
    path.write_text(PLAN.replace('[a]', '[a, fr3_walking_rpy, official]', 1))
    plan = load_plan(str(path), store.official_sequences())
    names = dict.fromkeys(job.sequence for job in plan.experiments[0].jobs)
    assert list(names) == ['a', 'fr3_walking_rpy', 'bonn_crowd']


def test_a_data_folder_without_official_names_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='no folder with an official name'):
        Store(tmp_path, tmp_path, tmp_path).official_sequences()
    with pytest.raises(InputError, match='no such folder'):
        Store(tmp_path, tmp_path, tmp_path / 'nowhere').official_sequences()


def test_scenes_have_options_by_name_or_in_it() -> None:
    assert '--people' in scene_options('crowd')
    assert scene_options('synth-3-no-people+frames=9') == [
        '--seed',
        '3',
        '--no-people',
        '--frames=9',
    ]
    assert scene_options('fr1_xyz') == []


def test_a_curve_is_put_in_words() -> None:
    jobs = [
        Job('a', 'hoid2d', 'x', seed, parameters=(('filter.min_interaction_area', area),))
        for area in (0.1, 0.4, 0.6)
        for seed in (0, 1)
    ]
    curve = Experiment('e', 't', 'curve', '', '', 'filter.min_interaction_area', tuple(jobs))
    metres = {0.1: 0.02, 0.4: 0.01, 0.6: 0.03}
    results = [
        result(j, metres[dict(j.parameters)[curve.varied]] * (1 + 0.1 * j.seed)) for j in jobs
    ]
    note = curve_note(curve, results)
    assert 'Lowest ATE over all sequences at 0.4' in note
    assert '100 % at 0.1 and 200 % at 0.6' in note
    assert 'Seeds alone vary ATE by 5 %' in note
    assert curve_note(replace(curve, varied='missed_share'), results) == ''


def test_a_verdict_curve_is_put_in_words() -> None:
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
    assert note.startswith('hoid2d: told apart best at 0.4; at 0.1 100 % of the handled ones go')
    assert 'at 0.8 30 % of the handled ones go and 100 % of the others stay' in note
    assert 'the ends of the range cost 0 % at 0.1 and 0 % at 0.8' in note
    (row, *_) = make_table(curve, results).rows
    words = [cell.text for cell in row[3:10]]
    assert words == ['0.1', '1.000', '0.200', '0.600', '0 of 10', '16 of 20', '0.0100']
