"""Without a detector model, the strategy falls back to motion, with a note."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM
from hoid_bringup.live.nodes import add_nodes_arguments, node_options, without_detector
from hoid_bringup.run import no_detector
from hoid_bringup.run.no_detector import NO_DETECTOR, lacks_model
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ModelError, NoModelError


def finds(monkeypatch: pytest.MonkeyPatch, error: Exception | None) -> None:
    def find() -> Path:
        if error is not None:
            raise error
        return Path('model.onnx')

    monkeypatch.setattr(no_detector, 'find_model', find)


def nodes(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_nodes_arguments(parser)
    return parser.parse_args(words)


def test_only_the_default_strategy_falls_back(monkeypatch: pytest.MonkeyPatch) -> None:
    finds(monkeypatch, NoModelError('none'))
    assert lacks_model(RunConfig(), ())
    assert lacks_model(RunConfig(), ['slam.seed'])
    for name in ('filter.strategy', 'strategy', 'hoid_filter.strategy'):
        assert not lacks_model(RunConfig(), [name])
    assert not lacks_model(RunConfig().updated({'detector.model': 'mine.onnx'}), ())
    for strategy in ('none', 'motion'):
        assert not lacks_model(RunConfig().updated({'filter.strategy': strategy}), ())
    finds(monkeypatch, None)
    assert not lacks_model(RunConfig(), ())


def test_a_missing_model_that_was_requested_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    finds(monkeypatch, ModelError('HOID_MODEL: gone does not exist'))
    with pytest.raises(ModelError, match='gone'):
        lacks_model(RunConfig(), ())


def test_without_a_model_no_detector_node_is_started(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finds(monkeypatch, NoModelError('none'))
    options = without_detector(node_options(nodes()))
    assert options.nodes == (FILTER, SLAM, SCENE)
    assert options.parameters[FILTER]['strategy'] == 'motion'
    assert capsys.readouterr().err == f'hoid nodes: {NO_DETECTOR}\n'
    for words in (
        ('--filter', 'hoid2d'),
        ('--detector', 'mine.onnx'),
        ('--set', 'filter.strategy=person'),
    ):
        assert without_detector(node_options(nodes(*words))).nodes == (
            DETECTOR,
            FILTER,
            SLAM,
            SCENE,
        )
    assert without_detector(node_options(nodes('--only', DETECTOR))).nodes == (DETECTOR,)


def test_a_strategy_in_the_parameter_file_is_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    finds(monkeypatch, NoModelError('none'))
    file = tmp_path / 'robot.yaml'
    file.write_text('/**/hoid_filter:\n  ros__parameters:\n    strategy: hoid3d\n')
    options = without_detector(node_options(nodes('--params', str(file))))
    assert options.nodes == (DETECTOR, FILTER, SLAM, SCENE)
    file.write_text('/**/hoid_filter:\n  ros__parameters:\n    min_interaction_area: 0.3\n')
    options = without_detector(node_options(nodes('--params', str(file))))
    assert options.nodes == (FILTER, SLAM, SCENE)
