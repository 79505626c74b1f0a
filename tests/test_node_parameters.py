"""Parameters of a node: their sources, checks, descriptions and changes at run time."""

from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter

from hoid_common.errors import ConfigError
from hoid_system_tests.sample_bench import Rule, SampleBench, Settings


def started(domain_id: int, *args: str) -> Settings:
    """Return the config of a node that is started with arguments."""
    sample = SampleBench(domain_id, *args)
    try:
        return sample.node.parameters.config
    finally:
        sample.close()


def test_defaults_are_those_of_the_config(domain_id: int) -> None:
    assert started(domain_id) == Settings()


def test_parameters_come_from_the_command_line(domain_id: int) -> None:
    config = started(
        domain_id, '-p', 'number:=5', '-p', 'rule.share:=1', '-p', 'rule.classes:=[cup, book]'
    )
    assert (config.number, config.rule.share, config.rule.classes) == (5, 1.0, ('cup', 'book'))


def test_parameters_come_from_a_file(domain_id: int, tmp_path: Path) -> None:
    path = tmp_path / 'params.yaml'
    path.write_text('sample: {ros__parameters: {rule: {share: 0.25}, mode: slow}}')
    config = started(domain_id, '--params-file', str(path))
    assert (config.rule.share, config.mode) == (0.25, 'slow')


@pytest.mark.parametrize('text', ['[]', "['']"])
def test_a_list_may_be_empty(domain_id: int, tmp_path: Path, text: str) -> None:
    path = tmp_path / 'params.yaml'
    path.write_text(f'sample: {{ros__parameters: {{rule: {{classes: {text}}}, mode: slow}}}}')
    assert started(domain_id, '--params-file', str(path)) == Settings(mode='slow')
    assert started(domain_id, '-p', 'rule.classes:=[]') == Settings()


@pytest.mark.parametrize(
    ('value', 'message'),
    [
        ('number:=[]', r'number must be int, got .*'),
        ('number:=10', r'number must be in \[1, 9\], got 10'),
        ('number:=many', r'number must be int, got .many.'),
        ('mode:=lazy', 'mode must be one of fast, slow'),
    ],
)
def test_unusable_parameters_are_refused(domain_id: int, value: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        started(domain_id, '-p', value)


def set_parameter(sample: SampleBench, name: str, value: Any) -> Any:
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return sample.probe.call(SetParameters, 'sample/set_parameters', request).results[0]


def test_a_misspelled_parameter_is_reported(
    domain_id: int, capfd: pytest.CaptureFixture[str]
) -> None:
    assert started(domain_id, '-p', 'rule.shared:=0.75') == Settings()
    message = 'no parameter is called "rule.shared", it has no effect; did you mean rule.share?'
    assert message in capfd.readouterr().err


def test_parameters_change_at_run_time(sample: SampleBench) -> None:
    assert set_parameter(sample, 'rule.share', 0.75).successful
    assert set_parameter(sample, 'rule.classes', ['cup']).successful
    assert sample.node.parameters.config.rule == Rule(0.75, ('cup',))
    assert [change.rule.share for change in sample.node.changes] == [0.75, 0.75]


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('rule.share', 1.5, 'rule.share out of range Min: 0.0, Max: 1.0'),
        ('mode', 'lazy', 'mode must be one of fast, slow'),
        ('number', 4, 'read-only'),
        ('rule.classes', None, 'rule.classes must be list, got None'),  # None deletes it
        ('rule.classes', [1, 2], 'rule.classes must be a list of strings, got [1, 2]'),
    ],
)
def test_unusable_changes_are_refused(
    sample: SampleBench, name: str, value: Any, message: str
) -> None:
    result = set_parameter(sample, name, value)
    assert not result.successful
    assert message in result.reason
    assert sample.node.parameters.config == Settings()


def test_descriptors_hold_description_range_and_choices(sample: SampleBench) -> None:
    request = DescribeParameters.Request(names=['rule.share', 'number', 'mode'])
    answer = sample.probe.call(DescribeParameters, 'sample/describe_parameters', request)
    share, number, mode = answer.descriptors
    assert (share.description, share.read_only) == ('a share', False)
    assert share.floating_point_range[0].to_value == 1.0
    assert (number.read_only, number.integer_range[0].to_value) == (True, 9)
    assert mode.additional_constraints == 'one of fast, slow'
