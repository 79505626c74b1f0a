"""Plans, sequences and the commands that repeat jobs, without running the system."""

import argparse
from dataclasses import replace
from pathlib import Path

import pytest

from hoid_bags.tum.cameras import camera_from_name
from hoid_benchmarks import commands
from hoid_benchmarks.commands import add_bench_arguments, repeating_command
from hoid_benchmarks.jobs.worker import command_of
from hoid_benchmarks.plan.plan import Job, Plan, load_plan, load_profile
from hoid_benchmarks.plan.sequences import Store, scene_options
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError


@pytest.mark.slow
@pytest.mark.parametrize('name', ['quick', 'full', 'readme', 'ablation', 'official'])
def test_shipped_plans_load_and_their_parameters_exist(name: str) -> None:
    jobs = load_plan(name).jobs()
    assert jobs
    for job in jobs:
        RunConfig().updated({'filter.strategy': job.strategy, **dict(job.parameters)})


def test_an_experiment_overrides_its_profile(tmp_path: Path) -> None:
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
    assert all(names[name] != value for name, value in profile.items())  # it has an effect
    with pytest.raises(ConfigError, match='no profile "orb_slam4": there is orb_slam3'):
        load_profile('orb_slam4')


def test_a_sequence_with_its_imu_is_the_same_recording(tmp_path: Path) -> None:
    store = Store(tmp_path, tmp_path / 'made')
    (tmp_path / 'data' / 'd435_office').mkdir(parents=True)
    for name in ('turn-1', 'd435_office'):
        assert store.locate(f'{name}_imu') == store.locate(name) is not None
    assert '--imu' in scene_options('turn-1')


def test_jobs_are_shared_between_experiments_and_no_filter_needs_no_detector(plan: Plan) -> None:
    jobs = plan.jobs()
    assert len(jobs) == 2 + 4 + 2  # none: per seed; hoid2d: x and y; curve adds one setting
    assert all(job.detector == '' for job in jobs if job.filter == 'none')
    assert len({job.key for job in jobs}) == len(jobs)


# Modes whose results do not depend on the seed.
_ONE_SEED = ('timed', 'detect', 'pictures', 'masks')


@pytest.mark.parametrize('name', ['full', 'readme'])
def test_every_shipped_accuracy_has_five_seeds_at_least(name: str) -> None:
    for experiment in load_plan(name).experiments:
        seeds = {job.seed for job in experiment.jobs}
        one_is_enough = all(job.mode in _ONE_SEED for job in experiment.jobs)
        expected = {0} if one_is_enough else set(range(max(5, len(seeds))))
        assert seeds == expected, experiment.id


def test_unknown_plans_views_and_experiments_are_refused(plan: Plan, plan_file: Path) -> None:
    with pytest.raises(ConfigError, match='full'):
        load_plan('nonsense')
    with pytest.raises(ConfigError, match='compare, curve'):
        plan.only(['nonsense'])
    plan_file.write_text(plan_file.read_text().replace('comparison', 'pie'))
    with pytest.raises(ConfigError, match='view must be one of'):
        load_plan(str(plan_file))


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


def test_seeds_vary_the_number_of_features_and_seed_0_does_not() -> None:
    job = Job('a', 'none', '', 0)
    numbers = [
        replace(job, seed=k).settings().get('filter.extraction.num_features') for k in range(5)
    ]
    assert numbers == [None, 1010, 990, 1020, 980]
    half = replace(job, seed=1, parameters=(('filter.extraction.num_features', 500),))
    assert half.settings() == {'filter.extraction.num_features': 505}


def test_the_error_of_a_missing_sequence_names_its_source(tmp_path: Path) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made')
    with pytest.raises(InputError, match='rgbd_dataset_freiburg3_walking_xyz'):
        store.find('fr3_walking_xyz')
    with pytest.raises(InputError, match='freiburg1_xyz'):
        store.find('fr1_xyz_people')
    official = tmp_path / 'tum' / 'rgbd_dataset_freiburg1_xyz'
    official.mkdir(parents=True)
    assert replace(store, official=tmp_path / 'tum').find('fr1_xyz') == official


def test_a_recording_of_an_own_camera_is_converted_with_it(tmp_path: Path) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made')
    assert store.locate('d435_office') is None
    folder = tmp_path / 'shared' / 'data' / 'd435_office'
    folder.mkdir(parents=True)
    assert store.locate('d435_office') == tmp_path / 'made' / 'd435_office'
    command, source, *_, units_per_m = store.recipe('d435_office')
    assert (command, source, units_per_m) == ('convert', str(folder), '1000')


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
    names = {'quick', 'full', 'readme', 'ablation', 'scenes', 'hand_held', 'official', 'budget'}
    assert {p.stem for p in folder.glob('*.yaml')} == names


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for name in ('rgbd_dataset_freiburg3_walking_rpy', 'rgbd_bonn_crowd', 'holiday'):
        (tmp_path / 'data' / name).mkdir(parents=True)
    return tmp_path / 'data'


def test_the_entry_official_means_all_available_sequences(
    data: Path, plan_file: Path, tmp_path: Path
) -> None:
    store = Store(tmp_path / 'shared', tmp_path / 'made', data)
    assert store.official_sequences() == ('bonn_crowd', 'fr3_walking_rpy')
    assert store.find('fr3_walking_rpy') == data / 'rgbd_dataset_freiburg3_walking_rpy'
    assert camera_from_name(store.find('bonn_crowd').name) is not None
    with pytest.raises(InputError, match='rgbd_dataset_freiburg3_walking_xyz'):
        store.find('fr3_walking_xyz')
    text = plan_file.read_text().replace('[a]', '[a, fr3_walking_rpy, official]', 1)
    plan_file.write_text(text)
    plan = load_plan(str(plan_file), store.official_sequences())
    names = dict.fromkeys(job.sequence for job in plan.experiments[0].jobs)
    assert list(names) == ['a', 'fr3_walking_rpy', 'bonn_crowd']


def test_a_data_folder_without_official_names_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='no folder with an official name'):
        Store(tmp_path, tmp_path, tmp_path).official_sequences()
    with pytest.raises(InputError, match='no such folder'):
        Store(tmp_path, tmp_path, tmp_path / 'nowhere').official_sequences()


def test_the_options_of_a_scene_come_from_the_file_or_its_name() -> None:
    assert '--people' in scene_options('crowd')
    assert scene_options('synth-3-no-people+frames=9') == [
        '--seed',
        '3',
        '--no-people',
        '--frames=9',
    ]
    assert scene_options('fr1_xyz') == []
