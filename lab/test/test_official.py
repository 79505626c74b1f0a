"""Official sequences of a reader: names of folders, the plan, and the printed tables."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from hoid_benchmarks.commands import add_bench_arguments, bench_command
from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.plan.official import (
    find_official,
    official_name,
    packed_official,
    short_name,
)
from hoid_benchmarks.plan.plan import Job, Plan, load_plan
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.publish.official import official_text, sequences_text
from hoid_common.errors import ConfigError, InputError


@pytest.mark.parametrize(
    ('folder', 'name'),
    [
        ('rgbd_dataset_freiburg3_walking_xyz', 'fr3_walking_xyz'),
        ('rgbd_dataset_freiburg3_walking_xyz (1)', 'fr3_walking_xyz'),
        ('Freiburg3-Walking-XYZ', 'fr3_walking_xyz'),
        ('fr1 desk', 'fr1_desk'),
        ('rgbd_bonn_moving_nonobstructing_box2', 'bonn_moving_nonobstructing_box2'),
        ('rgbd_bonn_dataset', ''),
        ('rgbd_dataset_freiburg4_walking_xyz', ''),
        ('holiday', ''),
    ],
)
def test_official_folders_are_known_by_their_names(folder: str, name: str) -> None:
    assert short_name(folder) == name


def test_sequences_are_found_in_folders_in_folders(tmp_path: Path) -> None:
    nested = tmp_path / 'rgbd_dataset_freiburg3_walking_xyz/rgbd_dataset_freiburg3_walking_xyz'
    crowd = tmp_path / 'rgbd_bonn_dataset/rgbd_bonn_crowd'
    for folder in (nested, crowd, tmp_path / 'rgbd_bonn_crowd'):
        folder.mkdir(parents=True)
    for folder in (nested, crowd):
        (folder / 'rgb.txt').touch()
    for name in ('rgbd_dataset_freiburg3_walking_rpy.tgz', 'rgbd_bonn_crowd.zip', 'a.zip'):
        (tmp_path / name).touch()
    assert find_official(tmp_path) == {'bonn_crowd': crowd, 'fr3_walking_xyz': nested}
    assert find_official(nested) == {'fr3_walking_xyz': nested}
    assert packed_official(tmp_path) == ['rgbd_dataset_freiburg3_walking_rpy.tgz']


def test_folders_of_eth3d_and_openloris_are_known_by_their_files(tmp_path: Path) -> None:
    cables, cafe = tmp_path / 'training/cables_1', tmp_path / 'cafe/cafe1-1'
    for folder, names in (
        (cables, ('rgb.txt', 'calibration.txt')),
        (cafe, ('color.txt', 'aligned_depth.txt')),
    ):
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).touch()
    assert find_official(tmp_path) == {'eth3d_cables_1': cables, 'openloris_cafe1_1': cafe}
    assert official_name('eth3d_cables_1') == 'cables_1'
    assert official_name('openloris_cafe1_1') == 'cafe1_1'
    assert official_name('holiday') == ''


def test_an_archive_that_is_not_unpacked_is_named(tmp_path: Path) -> None:
    (tmp_path / 'rgbd_bonn_crowd.zip').touch()
    with pytest.raises(InputError, match=r'no folder .*; unpack rgbd_bonn_crowd\.zip'):
        Store(tmp_path, tmp_path, tmp_path).official_sequences()


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['official'], 'give the folder'),
        (['full', 'FOLDER'], 'bench full: unexpected FOLDER; only official has FOLDER'),
        (['official', 'FOLDER', '--publish'], 'omit --publish'),
    ],
)
def test_a_folder_belongs_to_official_only(words: list[str], message: str) -> None:
    parser = argparse.ArgumentParser()
    add_bench_arguments(parser)
    with pytest.raises(ConfigError, match=message):
        bench_command(parser.parse_args(words))


def official_plan(*here: str) -> Plan:
    return load_plan('official', here).on(here)


def test_the_plan_has_the_papers_tables_for_the_sequences_that_are_there() -> None:
    plan = official_plan('bonn_crowd', 'fr3_walking_xyz')
    jobs = {e.id: len(e.jobs) for e in plan.experiments}
    # Two sequences and five seeds; only the paper's sequences vary the parameters of the rules.
    assert jobs == {'table_3': 40, 'table_3_orb_slam3': 20, 'table_2': 30, 'table_6': 25}
    assert [e.id for e in official_plan('bonn_crowd').experiments] == [
        'table_3',
        'table_3_orb_slam3',
    ]


def ate_m(job: Job) -> float:
    """Return an error of 0.4 m without a filter and of 0.02 m with one, plus 1 mm each seed."""
    has_rules_of_orb_slam3 = bool(job.parameters)
    plain_m = 0.4 if has_rules_of_orb_slam3 else 0.03
    return (plain_m if job.filter == 'none' else 0.02) + 0.001 * job.seed


def test_results_stand_beside_published_values_and_as_rows_of_readme() -> None:
    plan = official_plan('bonn_crowd', 'fr3_walking_xyz')
    results = {
        job: Result(job, {'ate_rmse_m': ate_m(job), 'coverage': 1.0, 'frames_total': 9})
        for job in plan.jobs()
    }
    text = official_text(plan, results)
    assert (
        '| fr3_walking_xyz | 0.721 ORB-SLAM2 | 0.4020 [0.4000-0.4040] | 0.0220 [0.0200-0.0240] '
        '| 94.5 % | 98 % | 0.0320 [0.0300-0.0340] | 0.0220 [0.0200-0.0240] | 1.000 |\n'
    ) in text
    assert '| bonn_crowd | - | 0.4020 ' in text
    assert '(Table 2)\n\n| sequence | filter | detector | filter.min_interaction_area |' in text
    assert text.endswith(
        'Rows of the table in README.md:\n\n'
        '| TUM `fr3_walking_xyz` | 0.721 (ORB-SLAM2, published) | 0.0320 | 0.0220 | yolox_nano |\n'
        '| Bonn `crowd` |  | 0.0320 | 0.0220 | yolox_nano |\n'
    )


def test_unfinished_results_are_left_out() -> None:
    plan = official_plan('fr3_walking_xyz')
    first = next(job for job in plan.jobs() if job.filter == 'none')
    text = official_text(plan, {first: Result(first, {'ate_rmse_m': 0.03})})
    assert '| fr3_walking_xyz | 0.721 ORB-SLAM2 | - | - | - | 98 % | 0.0300 | - | - |' in text
    assert 'README' not in text
    assert official_text(plan, {}) == ''


def test_what_a_folder_lacks_is_printed() -> None:
    text = sequences_text(['bonn_crowd'], ['bonn_crowd', 'fr3_walking_xyz'], ['x.tgz'])
    found, packed, lacking = text.splitlines()
    assert (found, packed) == ('found: bonn_crowd', 'not unpacked: x.tgz')
    assert 'not there: rgbd_dataset_freiburg3_walking_xyz (https://' in lacking
