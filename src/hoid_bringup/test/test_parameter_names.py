"""Parameter names in `--set` are the same for run, replay and nodes."""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hoid_bringup import cli
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM, NodeOptions, node_specs
from hoid_bringup.live.nodes import add_nodes_arguments, node_options
from hoid_bringup.run.options import add_method_arguments, run_config
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError

SAME = (
    ('filter.detections.on_loss', 'detections.on_loss', 'hoid_filter.detections.on_loss'),
    ('scene.dense.voxel_m', 'dense.voxel_m', 'hoid_scene.dense.voxel_m'),
    ('scene.objects.rate_hz', 'objects.rate_hz', 'hoid_scene.objects.rate_hz'),
    ('detector.model', 'model', 'hoid_detector.model'),
    (
        'filter.extraction.num_features',
        'extraction.num_features',
        'filter.extraction.num_features',
    ),
    ('slam.seed', 'seed', 'rgbd_slam.seed'),
    ('detector.input_size_px', 'hoid_detector.input_size_px', 'detector.input_size_px'),
)
GIVEN: dict[str, Any] = {
    'filter.detections.on_loss': 'stop',
    'scene.dense.voxel_m': 0.1,
    'scene.objects.rate_hz': 5.0,
    'detector.model': 'x.onnx',
    'filter.extraction.num_features': 500,
    'slam.seed': 3,
    'detector.input_size_px': 320,
}


def of_run(*texts: str) -> RunConfig:
    parser = argparse.ArgumentParser()
    add_method_arguments(parser)
    return run_config(parser.parse_args([word for text in texts for word in ('--set', text)]))


def of_nodes(*texts: str) -> NodeOptions:
    parser = argparse.ArgumentParser()
    add_nodes_arguments(parser)
    return node_options(parser.parse_args([word for text in texts for word in ('--set', text)]))


@pytest.mark.parametrize('names', SAME, ids=lambda names: names[0])
def test_a_parameter_has_the_same_names_everywhere(names: tuple[str, ...]) -> None:
    full = names[0]
    stage, _, own = full.partition('.')
    node = {'detector': DETECTOR, 'filter': FILTER, 'slam': SLAM, 'scene': SCENE}[stage]
    for name in names:
        assert of_run(f'{name}={GIVEN[full]}').changed() == {full: GIVEN[full]}
        assert of_nodes(f'{name}={GIVEN[full]}').parameters[node] == {own: GIVEN[full]}
        assert RunConfig.from_summary_options({name: GIVEN[full]}).changed() == {full: GIVEN[full]}


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('autostart=false', r'write detector\.autostart or filter\.autostart or slam\.autostart'),
        ('input.compressed=true', 'several nodes have a parameter "input.compressed"'),
        ('voxel_m=0.1', r'no parameter is called "voxel_m"; did you mean scene\.dense\.voxel_m\?'),
        ('dense.voxel_n=0.1', r'did you mean scene\.dense\.voxel_m'),
        ('seed=1.5', r'slam\.seed must be int, got 1\.5'),
        ('dense.voxel_m=fine', r"scene\.dense\.voxel_m must be float, got 'fine'"),
        ('seed', 'expected NAME=VALUE'),
        ('seed=!!int x', '--set seed: is not YAML'),
    ],
)  # fmt: skip
def test_errors_are_the_same_in_run_and_nodes(text: str, message: str) -> None:
    for read in (of_run, of_nodes):
        with pytest.raises(ConfigError, match=message):
            read(text)


def test_the_map_directory_is_that_of_both_nodes_that_have_one() -> None:
    parameters = of_nodes('map_directory=/maps').parameters
    assert parameters[SLAM] == parameters[SCENE] == {'map_directory': '/maps'}
    parameters = of_nodes('map_directory=/maps', 'scene.map_directory=/other').parameters
    assert parameters[SCENE] == {'map_directory': '/other'}


def test_whole_numbers_and_lists_are_converted() -> None:
    config = of_run('dense.voxel_m=0.1', 'depth_limit_m=1', "classes=['']", 'providers=[]')
    assert config.changed() == {'filter.depth_limit_m': 1.0, 'scene.dense.voxel_m': 0.1}
    assert type(config.filter.depth_limit_m) is float
    given = of_nodes('classes=[]', 'depth_limit_m=1').parameters
    assert given[DETECTOR] == {'classes': ()}
    assert given[FILTER] == {'depth_limit_m': 1.0}


def test_an_expert_parameter_is_passed_with_the_switch_expert() -> None:
    specs = node_specs(of_nodes('strategy=hoid+', 'classes=[]', 'dense.voxel_m=0.025'))
    given = {
        spec.name: {text for flag, text in pairwise(spec.argv) if flag == '-p'} for spec in specs
    }
    always = 'use_sim_time:=false'
    assert given[FILTER] == {'strategy:="hoid+"', always}
    assert given[DETECTOR] == {'classes:=[""]', always}
    assert given[SLAM] == {always}
    assert given[SCENE] == {'dense.voxel_m:=0.025', 'expert:=true', always}


def test_offline_runs_refuse_parameters_of_live_nodes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    argv = ['run', str(tmp_path), '--out', str(tmp_path / 'out'), '--set', 'frames.base=base']
    assert cli.main(argv) == 1
    error = 'hoid run: slam.frames.base: for live nodes only; use "hoid replay", or leave it out\n'
    assert capfd.readouterr().err == error


def test_parameters_for_live_nodes_exist() -> None:
    names = [leaf.name for leaf in RunConfig().params()]
    for part in RunConfig.LIVE_ONLY:
        assert any(name.startswith(part) for name in names), part
