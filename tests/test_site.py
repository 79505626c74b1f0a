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
        page.locator(_TABLE).nth(1).locator(f'tbody tr td:nth-child({column})').all_inner_texts()
    )
    return [float(cell.split()[0]) for cell in cells if cell]


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('site')
    build = [sys.executable, '-m', 'mkdocs', 'build', '--quiet', '--site-dir', str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return folder


def test_the_search_works_from_files_and_without_a_network(site: Path) -> None:
    with headless_browser() as browser:
        page = browser.new_context(offline=True).new_page()
        requested: list[str] = []
        page.on('request', lambda request: requested.append(request.url))
        page.goto((site / 'index.html').as_uri())
        page.get_by_role('textbox', name='Search').press_sequentially('rolling shutter')
        page.locator('.md-search-result__link').first.wait_for(state='attached')
        found = page.locator('.md-search-result__link').all_inner_texts()
        assert any('Rolling shutter' in text for text in found)
        assert [url for url in requested if not url.startswith(('file:', 'data:'))] == []


def test_tables_of_results_sort_by_mouse_and_by_keyboard(site: Path) -> None:
    with headless_browser() as browser:
        page = browser.new_page()
        page.goto((site / 'results/strategies.html').as_uri())
        table = page.locator(_TABLE).nth(1)
        before = first_numbers(page, 3)
        table.get_by_role('button', name='fr1_xyz_people', exact=True).click()
        assert first_numbers(page, 3) == sorted(before) != before
        heads = table.locator('th[aria-sort]')
        assert heads.evaluate_all('all => all.map(h => h.ariaSort)') == ['ascending']
        page.keyboard.press('Enter')
        assert first_numbers(page, 3) == sorted(before, reverse=True)
        assert heads.evaluate_all('all => all.map(h => h.ariaSort)') == ['descending']
        page.keyboard.press('Tab')
        page.keyboard.press('Space')
        assert heads.inner_text() == 'fr1_xyz'
        second = first_numbers(page, 4)
        assert second == sorted(second)
        last = table.locator('tbody tr').last.locator('td').nth(3)
        assert last.inner_text() == ''  # a row without a number comes last in either order
        page.keyboard.press('Space')
        assert first_numbers(page, 4) == sorted(second, reverse=True) != second
        assert last.inner_text() == ''
