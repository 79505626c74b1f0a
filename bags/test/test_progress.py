"""Log lines stand above a progress bar, and not in its line."""

from __future__ import annotations

import logging

import pytest

from hoid_bags.progress import AboveProgress, progress


def test_a_warning_does_not_stand_in_the_line_of_the_bar(
    capsys: pytest.CaptureFixture[str],
) -> None:
    logger = logging.Logger('test')
    logger.addHandler(AboveProgress())
    with progress(None, 3, 'frames') as bar:
        bar.update()
        bar.refresh()
        logger.warning('the depth images have a median of 0.20 m')
        bar.update()
    printed = capsys.readouterr().err
    assert 'frames' in printed
    assert printed.count('\rthe depth images have a median of 0.20 m\n') == 1


def test_a_quiet_command_draws_no_bar(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.ERROR)
    with progress(None, 3, 'frames') as bar:
        bar.update(3)
    assert capsys.readouterr().err == ''
