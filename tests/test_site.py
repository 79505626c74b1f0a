"""The documentation site in a real browser: tables of results can be sorted."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import Page

from hoid_system_tests.browser import headless_browser
from hoid_system_tests.documented import ROOT

pytestmark = pytest.mark.thorough

_TABLE = 'table[data-sorts]'


def first_numbers(page: Page, column: int) -> list[float]:
    """Return the first number of each cell in a column that has one, from top to bottom."""
    cells = (
        page.locator(_TABLE).first.locator(f'tbody tr td:nth-child({column})').all_inner_texts()
    )
    return [float(cell.split()[0]) for cell in cells if cell]


def test_tables_of_results_sort_by_mouse_and_by_keyboard(tmp_path: Path) -> None:
    build = [sys.executable, '-m', 'mkdocs', 'build', '--quiet', '--site-dir', str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    with headless_browser() as browser:
        page = browser.new_page()
        page.goto((tmp_path / 'results/strategies.html').as_uri())
        table = page.locator(_TABLE).first
        before = first_numbers(page, 3)
        table.get_by_role('button', name='group-1', exact=True).click()
        assert first_numbers(page, 3) == sorted(before) != before
        rows = table.locator('tbody tr')
        # A row without a number comes last.
        assert rows.last.locator('td').nth(2).inner_text() == ''
        heads = table.locator('th[aria-sort]')
        assert heads.evaluate_all('all => all.map(h => h.ariaSort)') == ['ascending']
        page.keyboard.press('Enter')
        assert first_numbers(page, 3) == sorted(before, reverse=True)
        assert rows.last.locator('td').nth(2).inner_text() == ''
        assert heads.evaluate_all('all => all.map(h => h.ariaSort)') == ['descending']
        page.keyboard.press('Tab')
        page.keyboard.press('Space')
        assert heads.inner_text() == 'group-2'
        second = first_numbers(page, 4)
        assert second == sorted(second)
