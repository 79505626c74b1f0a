"""The text of errors that quote files or messages."""

from __future__ import annotations

import pytest

from hoid_common.errors import ConfigError, HoidError, InputError, counted


@pytest.mark.parametrize('text', ['a: b "\u00e9t\u00e9"', '', 'x' * 900])
def test_printable_text_is_unchanged(text: str) -> None:
    assert str(InputError(text)) == text


def test_control_characters_are_escaped() -> None:
    assert str(InputError('names "\x1b[2J\u202e\udcff\n\0"')) == (
        'names "\\x1b[2J\\u202e\\udcff\\n\\x00"'
    )


def test_a_long_text_keeps_its_beginning_and_end() -> None:
    for part in ('x' * 10**6, '\x1b[2J' * 1000):
        message = str(ConfigError(f'file: "{part}" is not one of a, b'))
        assert len(message) < 1000
        assert message.startswith('file: "')
        assert message.endswith('" is not one of a, b')


def test_an_error_can_wrap_another_error() -> None:
    assert str(HoidError(OSError(28, 'No space'))) == '[Errno 28] No space'


@pytest.mark.parametrize(('number', 'text'), [(0, '0 maps'), (1, '1 map'), (2, '2 maps')])
def test_a_noun_after_one_is_singular(number: int, text: str) -> None:
    assert counted(number, 'map') == text
