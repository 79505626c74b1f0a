from dataclasses import FrozenInstanceError, dataclass
from math import inf
from pathlib import Path
from typing import Any

import pytest

from hoid_common.config import Config, param, section
from hoid_common.errors import ConfigError
from hoid_common.io.yaml_file import load_params


@dataclass(frozen=True)
class Inner(Config):
    share: float = param(0.5, 'a share', limits=(0.0, 1.0), read_only=False)
    classes: tuple[str, ...] = param(('cup',), 'classes')


@dataclass(frozen=True)
class Outer(Config):
    count: int = param(3, 'a number', limits=(1, inf))
    mode: str = param('fast', 'a mode', choices=('fast', 'slow'))
    enabled: bool = param(default=True, description='a switch')
    inner: Inner = Inner()


def test_params_have_dotted_names_in_order_of_declaration() -> None:
    assert [(p.name, p.value) for p in Outer().params()] == [
        ('count', 3),
        ('mode', 'fast'),
        ('enabled', True),
        ('inner.share', 0.5),
        ('inner.classes', ('cup',)),
    ]


def test_all_parameters_of_an_expert_section_are_expert_parameters() -> None:
    @dataclass(frozen=True)
    class Whole(Config):
        plain: Outer = section(Outer)
        deep: Outer = section(Outer, expert=True)
        own: int = param(1, 'a number', expert=True)

    experts = {p.name for p in Whole().params() if p.spec.expert}
    deep = {f'deep.{p.name}' for p in Outer().params()}
    assert experts == {*deep, 'own'}
    assert Whole().updated({'deep.inner.share': 1}).deep.inner.share == 1.0


def test_a_list_of_one_empty_string_is_read_as_empty() -> None:
    assert Outer().updated({'inner.classes': ('',)}).inner.classes == ()
    assert Outer().updated({'inner.classes': ('', 'cup')}).inner.classes == ('', 'cup')


def test_params_have_their_specs() -> None:
    specs = {p.name: p.spec for p in Outer().params()}
    assert specs['inner.share'].limits == (0.0, 1.0)
    assert not specs['inner.share'].read_only
    assert specs['mode'].choices == ('fast', 'slow')


def test_updated_replaces_only_the_named_values() -> None:
    new = Outer().updated({'inner.share': 0.25, 'mode': 'slow'})
    assert (new.inner.share, new.mode, new.count, new.inner.classes) == (0.25, 'slow', 3, ('cup',))
    assert Outer().inner.share == 0.5


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('inner.share', 1.5, r'inner\.share must be in \[0\.0, 1\.0\], got 1\.5'),
        ('inner.share', float('nan'), r'inner\.share must be in'),
        ('count', 0, 'count must be at least 1, got 0'),
        ('count', 2.5, r'count must be int, got 2\.5'),
        ('count', True, 'count must be int, got True'),
        ('enabled', 1, 'enabled must be bool, got 1'),
        ('mode', 'lazy', 'mode must be one of fast, slow, got .lazy.'),
        ('inner.classes', 'cup', r'inner\.classes must be list'),
        (
            'inner.classes',
            ('cup', 1),
            r"inner\.classes must be a list of strings, got \['cup', 1\]",
        ),
        ('inner.classes', None, r'inner\.classes must be list, got None'),
        ('speed', 1, '"speed"$'),
        ('inner.shares', 1, r'"inner\.shares"; did you mean inner\.share\?'),
        ('share', 1, r'"share"; did you mean inner\.share\?'),
        ('inner', 1, r'"inner"; did you mean inner\.share, inner\.classes\?'),
        ('count.x', 1, r'"count\.x"; did you mean count\?'),
    ],
)
def test_errors_name_the_invalid_parameter(name: str, value: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Outer().updated({name: value})


def test_errors_of_the_constructor_name_the_class() -> None:
    with pytest.raises(ConfigError, match=r'Inner\.share must be in'):
        Inner(share=2.0)


def test_whole_numbers_become_floats_for_float_parameters() -> None:
    share = Outer().updated({'inner.share': 1}).inner.share
    assert isinstance(share, float)
    assert share == 1.0


def test_configs_are_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        Outer().count = 4  # type: ignore[misc]


def write(folder: Path, text: str) -> Path:
    path = folder / 'params.yaml'
    path.write_text(text)
    return path


def test_parameter_files_may_have_sections_of_several_nodes(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '/**: {ros__parameters: {count: 7}}\n'
        '/robot/outer: {ros__parameters: {inner: {share: 1, classes: [a, b]}}}\n'
        'other: {ros__parameters: {count: 9}}\n',
    )
    config = Outer().updated(load_params(path, 'outer'))
    assert (config.count, config.inner.share, config.inner.classes) == (7, 1.0, ('a', 'b'))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: [', 'is not YAML'),
        ('- 1', 'is not a ROS parameter file'),
        ('', 'is not a ROS parameter file'),
        ('\x00\x7f', 'is not YAML'),
        ('outer: {count: 1}', 'section "outer" has no "ros__parameters"'),
    ],
)
def test_errors_name_the_bad_parameter_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_params(write(tmp_path, text), 'outer')


def test_a_missing_parameter_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'none\.yaml: no such file'):
        load_params(tmp_path / 'none.yaml', 'outer')
