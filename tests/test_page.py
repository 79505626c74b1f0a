"""The page of results: its text, and its display in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Page

from hoid_benchmarks.plan.plan import Experiment, Job
from hoid_benchmarks.report.literature import published
from hoid_benchmarks.report.page import Head, Headline, RunGroup, Section, render_page
from hoid_benchmarks.report.page import Page as Content
from hoid_benchmarks.report.tables import Cell, Table
from hoid_system_tests.browser import headless_browser, shown_on_a_phone

pytestmark = pytest.mark.thorough

JOBS = tuple(Job('a', 'none', '', seed) for seed in range(3))
_INK_IS_THE_TEXT_COLOR = (
    "() => getComputedStyle(document.querySelector('.xtitle')).fill"
    ' === getComputedStyle(document.body).color'
)
VALUES = (0.2, 0.1, 10.0)


def content() -> Content:
    cells = [(Cell(f'row {i}'), Cell(f'{v}', v, (JOBS[i],))) for i, v in enumerate(VALUES)]
    table = Table('numbers', 'Numbers', ('name', 'ATE [m]'), tuple(cells))
    names = ['b</script>', *(f'fr1_xyz_people hoid+ yolox_nano {k}' for k in range(7))]
    plot = {
        'data': [{'type': 'scatter', 'name': n, 'x': [0, 1, 2], 'y': [1, 3, 2]} for n in names],
        'layout': {
            'title': {'text': 'A curve'},
            'xaxis': {'title': {'text': 'x'}},
            'yaxis': {'title': {'text': 'y'}},
        },
    }
    experiment = Experiment('e', 'Title', 'curve', 'a < b & c', 'the paper differs', '', JOBS)
    section = Section(experiment, table, (plot, plot), note='A note.', missing=('fr3_x',))
    other = replace(experiment, id='e2', part='Another part')
    runs = [RunGroup(f'run {i}', (f'./hoid run {i}',), ('ATE 1 m',)) for i in range(3)]
    head = Head('T', {'Machine': 'M'}, (Headline(Cell('97 %', 97.0, JOBS[:1]), 'what'),))
    sections = [section, Section(other, table, ())]
    return Content(head, sections, published(), runs, {job: i for i, job in enumerate(JOBS)})


def test_the_page_is_self_contained_and_escapes_text() -> None:
    page = render_page(content())
    body = page[page.index('<body>') :]
    assert 'a &lt; b &amp; c' in body
    assert 'b<\\/script>' in body
    assert not re.search(r'(src|href)="https?:', body)
    for target in set(re.findall(r'href="#([^"]+)"', body)) - {'missing'}:
        assert f'id="{target}"' in body


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with headless_browser() as running:
        yield running


@pytest.fixture(scope='module')
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp('page') / 'index.html'
    path.write_text(render_page(content()))
    return path.as_uri()


@pytest.fixture
def page(browser: Browser, url: str) -> Iterator[Page]:
    with shown_on_a_phone(browser, url) as shown:
        yield shown


def column(page: Page, number: int) -> list[str]:
    return page.locator(f'#table-numbers tbody td:nth-child({number})').all_inner_texts()[:3]


def test_columns_sort_by_value_in_both_directions(page: Page) -> None:
    header = page.locator('#table-numbers th button').nth(1)
    assert column(page, 2) == ['0.2', '0.1', '10.0']
    header.click()
    assert column(page, 2) == ['0.1', '0.2', '10.0']
    header.click()
    assert column(page, 1) == ['row 2', 'row 0', 'row 1']
    assert header.locator('..').get_attribute('aria-sort') == 'descending'


def test_plots_are_drawn_in_both_themes(page: Page) -> None:
    for theme in ('light', 'dark', 'light'):
        page.emulate_media(color_scheme=theme)
        assert page.locator('.plot .scatterlayer .trace path.js-line').count() == 2 * 8
        page.wait_for_function(_INK_IS_THE_TEXT_COLOR)  # plots are redrawn a moment later


def test_a_legend_is_beside_the_curves_and_hides_them(page: Page) -> None:
    legend = page.locator('.legend').first
    assert legend.locator('button').count() == 8
    names, plot = legend.bounding_box(), page.locator('.plot').first.bounding_box()
    assert names is not None
    assert plot is not None
    assert names['y'] + names['height'] <= plot['y']
    lines = page.locator('.plot').first.locator('.scatterlayer .trace path.js-line')
    for left in (7, 8):
        legend.locator('button').nth(1).click()
        page.wait_for_function(
            'n => document.querySelector(".plot").querySelectorAll(".js-line").length === n',
            arg=left,
        )
        assert lines.count() == left


def test_a_number_links_to_its_run_and_opens_it(page: Page) -> None:
    assert not page.locator('#run-1').get_attribute('open')
    page.locator('#table-numbers td a', has_text='0.1').first.click()
    page.wait_for_selector('#run-1[open]')
    assert page.locator('#run-1 pre').inner_text() == './hoid run 1'


def test_nothing_is_wider_than_a_phone(page: Page) -> None:
    assert page.evaluate('document.documentElement.scrollWidth') <= 390


def test_the_page_prints_to_pdf(page: Page) -> None:
    assert page.pdf(format='A4').startswith(b'%PDF')
