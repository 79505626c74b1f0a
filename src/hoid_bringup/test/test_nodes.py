"""Nodes, names and parameters that the options of `hoid nodes` select."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import pytest

from hoid_bringup.live.budget import use_cores, within_budget
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM, NodeOptions
from hoid_bringup.live.nodes import add_nodes_arguments, node_options
from hoid_common.errors import ConfigError

FRAME_TREE = (('/tf', 'tf'), ('/tf_static', 'tf_static'))


def options(*argv: str) -> NodeOptions:
    parser = argparse.ArgumentParser()
    add_nodes_arguments(parser)
    return node_options(parser.parse_args(argv))


@pytest.mark.parametrize(
    ('argv', 'nodes'),
    [
        ((), (DETECTOR, FILTER, SLAM, SCENE)),
        (('--no-detector',), (FILTER, SLAM, SCENE)),
        (('--no-detector', '--no-scene'), (FILTER, SLAM)),
        (('--only', DETECTOR), (DETECTOR,)),
    ],
)
def test_options_select_the_nodes(argv: tuple[str, ...], nodes: tuple[str, ...]) -> None:
    assert options(*argv).nodes == nodes


def test_camera_topics_and_frame_tree_are_remapped() -> None:
    assert options().remappings == FRAME_TREE
    chosen = options('--camera', 'realsense', '--namespace', 'robot')
    color = '/camera/camera/color/image_raw'
    assert dict(chosen.remappings).items() >= dict(FRAME_TREE).items()
    assert ('rgb/image', color) in chosen.remappings
    assert ('rgb/image/compressed', f'{color}/compressed') in chosen.remappings
    assert chosen.namespace == 'robot'
    assert options('--namespace', 'robot', '--global-tf').remappings == ()
    assert ('imu', '/d435/imu') in options('--imu', '/d435/imu').remappings
    own = options('--topics', 'realsense', '--camera-namespace', '/robot/d435')
    assert ('rgb/image', '/robot/d435/color/image_raw') in own.remappings


def test_options_set_the_parameters_of_their_nodes() -> None:
    chosen = options('--compressed', '--base', 'base_link', '--filter', 'person').parameters
    assert all(of_node['input.compressed'] is True for of_node in chosen.values())
    assert chosen[SLAM]['frames.base'] == 'base_link'
    assert chosen[FILTER]['strategy'] == 'person'
    assert options().parameters == {DETECTOR: {}, FILTER: {}, SLAM: {}, SCENE: {}}


@pytest.mark.parametrize('name', ['robot', '/robot/arm_2', 'a/b/'])
def test_valid_namespaces_are_accepted(name: str) -> None:
    assert options('--namespace', name).namespace == name


@pytest.mark.parametrize(
    'name', ['two words', '2nd', 'a//b', 'ärm', '/'.join(['a' * 20] * 20) + '-']
)
def test_an_invalid_namespace_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f'--namespace {name}: use letters'):
        options('--namespace', name)


def test_a_parameter_file_is_checked_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'nowhere\.yaml: no such file'):
        options('--params', 'nowhere.yaml')
    path = tmp_path / 'params.yaml'
    path.write_text('hoid_filter: {strategy: none}\n')
    with pytest.raises(ConfigError, match='section "hoid_filter" has no "ros__parameters"'):
        options('--params', str(path))
    path.write_text('/**: {ros__parameters: {strategy: none}}\n')
    assert options('--params', str(path)).params_file == path


def test_one_core_leaves_out_detections_and_motion_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    assert within_budget(options(), 2) == options()
    assert caplog.messages == []
    chosen = within_budget(options('--base', 'base_link'), 1).parameters
    assert chosen[DETECTOR] == {'base_frame': 'base_link', 'rate_hz': 5.0}
    assert chosen[FILTER] == {'extraction.num_features': 750, 'motion.rate_hz': 15.0}
    assert (chosen[SLAM], chosen[SCENE]) == ({'frames.base': 'base_link'}, {})
    (line,) = caplog.messages
    assert 'objects are detected in at most 5 images per second' in line
    assert line.endswith('motion is segmented in at most 15 images per second')
    scene_only = options('--only', SCENE)
    assert within_budget(scene_only, 1) == scene_only


def test_one_core_keeps_what_the_user_has_given(
    caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    file = tmp_path / 'robot.yaml'
    file.write_text('/**:\n  ros__parameters:\n    rate_hz: 30.0\n')
    changed = ('filter.motion.rate_hz=0.0', 'filter.extraction.num_features=1000')
    given = options('--params', str(file), '--set', changed[0], '--set', changed[1])
    assert within_budget(given, 1) == given
    assert caplog.messages == []


def test_cores_are_limited_to_those_that_this_process_may_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    used: list[list[int]] = []
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {3, 5, 7})
    monkeypatch.setattr(os, 'sched_setaffinity', lambda _, cores: used.append(list(cores)))
    assert [use_cores(number) for number in (None, 8, 3, 2, 1)] == [3, 3, 3, 2, 1]
    assert used == [[3, 5], [3]]
    with pytest.raises(ConfigError, match='--cores 0'):
        use_cores(0)
