"""Parameters of the filter with a special value."""

from __future__ import annotations

from hoid_filter.config import FilterConfig


def test_empty_name_means_every_class() -> None:
    assert FilterConfig(dynamic_classes=('',)) == FilterConfig(dynamic_classes=())
    assert FilterConfig(dynamic_classes=()).may_be_handled('sink')
    assert not FilterConfig().may_be_handled('sink')
    assert not FilterConfig(dynamic_classes=()).may_be_handled('person')
