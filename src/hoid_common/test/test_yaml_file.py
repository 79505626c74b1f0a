import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hoid_common.errors import InputError
from hoid_common.io.yaml_file import MAX_BYTES, MAX_DEPTH, MAX_NODES, parse_yaml, read_yaml

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec='utf-8', exclude_categories=['Cs', 'Cc'])),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text('abc.:_ 0', min_size=1), inner, max_size=4)
    ),
    max_leaves=20,
)


def error_of(read: Callable[[], object]) -> str:
    try:
        read()
    except InputError as error:
        return str(error)
    return ''


@pytest.mark.slow
@given(plain)
@settings(max_examples=60)
def test_plain_data_survive_a_round_trip(value: Any) -> None:
    assert parse_yaml(yaml.safe_dump(value), 'x') == value


@pytest.mark.slow
@given(st.text(max_size=60) | st.text('[]{}-:?,&*!|>%@`"\'# \n\ta1.', max_size=60))
@example('2020-13-45')
@example('1:99:99')
@example('!!int "x"')
@example('!!timestamp "x"')
@example('&a [*a, *a]')
@example('<<: {a: 1}')
@example('<<: 3')
@example('? [1]\n: 2')
@example('=')
@example('0x')
@example('0o9')
@example('._')
@example('\x00')
@example('--- 1\n--- 2')
@settings(max_examples=300)
def test_any_text_is_a_value_or_an_error_in_one_line(text: str) -> None:
    message = error_of(lambda: parse_yaml(text, 'name'))
    assert message.startswith('name: is not YAML (') or not message
    assert message.isprintable()
    assert len(message) < 200


@given(st.binary(max_size=80))
@settings(max_examples=200)
def test_any_file_is_a_value_or_an_error_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / 'any.yaml'
    path.write_bytes(content)
    message = error_of(lambda: read_yaml(path))
    assert (
        message.startswith((f'{path}: is not YAML (', f'{path}: not a text file')) or not message
    )
    assert message.isprintable()


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('1e-3', 0.001),
        ('5', 5),
        ('-0x1F', -31),
        ('.inf', float('inf')),
        ('-.5e1', -5.0),
        ('yes', True),
        ('', None),
        ('2020-13-45', '2020-13-45'),
        ('12:30:45', '12:30:45'),
        ('007', '007'),
        ('1_000', '1_000'),
        ('[]', []),
        ("['']", ['']),
        ('<<: {a: 1}', {'<<': {'a': 1}}),
    ],
)
def test_types_of_scalars(text: str, value: object) -> None:
    found = parse_yaml(text, 'x')
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: &x 1\nb: *x', 'line 2: an alias; write the value again'),
        ('!!int "x"', 'line 1: the tag tag:yaml.org,2002:int; write the plain value'),
        ('!!python/object/apply:os.system [ls]', 'the tag tag:yaml.org,2002:python/object/apply'),
        ('[' * 5000, f'nested deeper than {MAX_DEPTH}'),
        ('- ' * 5000 + '1', f'nested deeper than {MAX_DEPTH}'),
        ('[' + 'a,' * MAX_NODES + ']', f'more than {MAX_NODES} values'),
        ('1' * 400, 'line 1: a number of 400 characters'),
        ('1' * 400 + '.5', 'line 1: a number of 402 characters'),
        ('9223372036854775808', 'which is beyond 64 bits'),
        ('a: 1\na: 2', 'line 2: the key "a" twice'),
        ('? [1]\n: 2', 'line 1: a key that is a list or a mapping'),
    ],
)
def test_errors_name_reason_and_line(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, 'x')
    assert str(caught.value).startswith('x: is not YAML (')
    assert message in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    'unit',
    [
        '[',
        '{a: ',
        '- ',
        '? ',
        '"',
        "'a': ",
        '&a ',
        '!a ',
        'a: [\n',
        '# \n',
        '\t',
        '|\n a',
        'a,',
        '- a\n',
    ],
)
def test_a_hostile_text_costs_no_more_than_its_size(unit: str) -> None:
    text = (unit * MAX_BYTES)[:MAX_BYTES]
    began_s = time.thread_time()
    error_of(lambda: parse_yaml(text, 'x'))
    assert time.thread_time() - began_s < 5.0


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / 'large.yaml'
    path.write_bytes(b'#' * (MAX_BYTES + 1))
    with pytest.raises(InputError, match=r'large\.yaml: larger than 0\.5 MB'):
        read_yaml(path)
    with pytest.raises(InputError, match=r'x: larger than 0\.5 MB'):
        parse_yaml('#' * (MAX_BYTES + 1), 'x')
