"""The text of errors that quote files or messages."""

from __future__ import annotations

import pytest

from hoid_common.errors import ConfigError, HoidError, InputError, counted, prefixed, replaced_by


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


def test_another_exception_becomes_an_error_with_its_cause() -> None:
    number = InputError('a.txt: no number')
    with pytest.raises(InputError) as caught, replaced_by(number, ValueError, KeyError):
        float('x')
    assert caught.value is number
    assert isinstance(number.__cause__, ValueError)
    full = OSError(28, 'disk full', 'b.txt')
    with (
        pytest.raises(InputError, match=r'^a\.txt: disk full$'),
        prefixed('a.txt: ', InputError, OSError),
    ):
        raise full
    with pytest.raises(ZeroDivisionError), prefixed('', InputError, OSError):
        raise ZeroDivisionError
