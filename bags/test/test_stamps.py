from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.io.stamps import format_stamp_s, parse_stamp_ns


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_every_nanosecond_survives_text(stamp_ns: int) -> None:
    assert parse_stamp_ns(format_stamp_s(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ('text', 'stamp_ns'),
    [
        ('1305031102.175304', 1_305_031_102_175_304_000),
        ('1305031102.175304001', 1_305_031_102_175_304_001),
        ('1.305031102175304e+09', 1_305_031_102_175_304_000),
        ('12', 12_000_000_000),
        ('0.0000000004', 0),
    ],
)
def test_known_stamps(text: str, stamp_ns: int) -> None:
    assert parse_stamp_ns(text) == stamp_ns


@pytest.mark.parametrize(
    'text',
    ['', 'abc', 'nan', 'inf', '-1', '1e12', '1.2.3', 'sNaN', '1e999999', '9e999980', '9' * 5000],
)
def test_what_is_no_stamp(text: str) -> None:
    with pytest.raises(ValueError, match=r'seconds|ROS stamp'):
        parse_stamp_ns(text)
