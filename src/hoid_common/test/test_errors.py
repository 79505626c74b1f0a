"""What an error says of what it repeats."""

from __future__ import annotations

import pytest

from hoid_common.errors import ConfigError, HoidError, InputError


@pytest.mark.parametrize('text', ['a: b "\u00e9t\u00e9"', '', 'x' * 900])
def test_what_can_be_shown_is_said_as_it_is(text: str) -> None:
    assert str(InputError(text)) == text


def test_a_terminal_is_not_steered_by_what_a_file_says() -> None:
    assert str(InputError('names "\x1b[2J\u202e\udcff\n\0"')) == (
        'names "\\x1b[2J\\u202e\\udcff\\n\\x00"'
    )


def test_a_long_one_keeps_its_beginning_and_its_end() -> None:
    for part in ('x' * 10**6, '\x1b[2J' * 1000):
        said = str(ConfigError(f'file: "{part}" is not one of a, b'))
        assert len(said) < 1000
        assert said.startswith('file: "')
        assert said.endswith('" is not one of a, b')


def test_it_wraps_other_errors() -> None:
    assert str(HoidError(OSError(28, 'No space'))) == '[Errno 28] No space'
