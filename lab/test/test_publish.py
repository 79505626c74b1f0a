"""Results in the documents: rows have their commit, and commits are not mixed."""

from dataclasses import replace
from pathlib import Path

import pytest

from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.plan.plan import Job, Plan, load_plan
from hoid_benchmarks.publish.error_table import error_table
from hoid_benchmarks.publish.figures import ATE, TIME, WORTH, digest, figures
from hoid_benchmarks.publish.layouts import layouts_svg
from hoid_benchmarks.publish.pages import (
    DECISIONS,
    RESULTS,
    ROOT,
    drawn_figures,
    marked_pages,
    publish_faults,
    publish_report,
    results_path,
    rewritten,
    write_pages,
    written_pages,
)
from hoid_benchmarks.publish.results_file import Kept, Row, keep, read_kept, write_kept
from hoid_benchmarks.report.views import make_table, with_commits
from hoid_common.errors import InputError

PLAN = """
experiments:
  - {id: one, title: One, view: comparison, sequences: [a], filters: [none, hoid2d],
     detectors: [truth], seeds: [0, 1]}
  - {id: two, title: Two, view: comparison, sequences: [b], filters: [none, hoid2d],
     detectors: [truth], seeds: [0, 1]}
"""
PAGE = '# Page\n\n<!-- bench tiny one two -->\nold\n<!-- /bench -->\n\nEnd.\n'


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / 'docs/results').mkdir(parents=True)
    (tmp_path / 'README.md').write_text('# Nothing\n')
    (tmp_path / 'docs/page.md').write_text(PAGE)
    (tmp_path / 'tiny.yaml').write_text(PLAN)
    return tmp_path


@pytest.fixture
def plan(root: Path) -> Plan:
    return load_plan(str(root / 'tiny.yaml'))


def results(plan: Plan, commit: str) -> dict[Job, Result]:
    """Return results in which a filter reduces an error of 8 cm by 75 %."""
    return {
        job: Result(
            job,
            {'ate_rmse_m': 0.08 if job.filter == 'none' else 0.02, 'coverage': 1.0},
            commit=commit,
            machine='M',
        )
        for job in plan.jobs()
    }


def test_every_page_shows_what_the_files_of_results_hold() -> None:
    pages = marked_pages(ROOT)
    assert ROOT / 'README.md' in pages
    for page in pages:
        text = page.read_text()
        assert rewritten(text, ROOT) == text, f'{page}: run make reference'


def test_pages_written_as_a_whole_are_current() -> None:
    for path, text in written_pages(ROOT).items():
        assert path.read_text() == text, f'{path}: run make reference'


def test_figures_are_of_the_results_and_name_what_they_show() -> None:
    drawn = drawn_figures(ROOT)
    assert {ATE, TIME} <= set(drawn)
    for name, marks in drawn.items():
        page = (ROOT / RESULTS / name).read_text()
        assert digest(marks) in page, f'{name}: run make reference'
        for words in {mark.row for mark in marks} | {mark.group for mark in marks}:
            assert f'>{words}</text>' in page


def test_a_figure_draws_medians_and_ranges_in_units_of_its_axis() -> None:
    compared = Kept(
        ('sequence', 'filter', 'detector', 'RMSE [m]', 'frame [ms]: median / p95'),
        (
            Row(('a', 'none', '-', '0.0080 [0.0070-0.0100]', '7.0 / 8.0'), 'c', 'M'),
            Row(('a', 'hoid2d', 'truth', '0.0010', '9.0 / 9.5'), 'c', 'M'),
            Row(('a', 'hoid2d', 'own', '0.0020 [0.0010-0.0040]', '7.5 / 9.0'), 'c', 'M'),
            Row(('b', 'none', '-', '0.0050', '3.0 / 4.0'), 'c', 'quicker'),
        ),
    )
    parts = Kept(
        ('variant', 'sequence', 'filter', 'detector', 'ATE RMSE [m]'),
        (
            Row(('default', 'a', 'hoid+', 'own', '0.0020 [0.0010-0.0030]'), 'c', 'M'),
            Row(('p.x=False', 'a', 'hoid+', 'own', '0.0040 [0.0020-0.0060]'), 'c', 'M'),
        ),
    )
    drawn = figures({'one': compared, 'seed_method': compared}, {'parts': parts})
    assert [mark[:2] for mark in drawn[ATE]] == [('a', 'none'), ('a', 'hoid2d'), ('b', 'none')]
    assert [mark[2:] for mark in drawn[ATE]] == [
        pytest.approx((7.0, 8.0, 10.0)),
        pytest.approx((1.0, 2.0, 4.0)),
        pytest.approx((5.0, 5.0, 5.0)),
    ]
    assert [mark[1:] for mark in drawn[TIME]] == [
        ('none', 7.0, 7.0, 8.0),
        ('hoid2d', 8.25, 8.25, 9.5),
    ]
    renamed = replace(compared, rows=(Row(('carry-box', 'none', '-', '0.01', ''), 'c', 'M'),))
    assert figures({'one': renamed}, {})[ATE][0].row == 'somebody carries a box'
    assert drawn[WORTH] == [('p.x', 'hoid+, a', *map(pytest.approx, (1.0, 2.0, 3.0)))]


def test_the_sketch_of_the_layouts_shows_their_topics() -> None:
    sketch = layouts_svg(ROOT)
    for words in ('Dense map: cloud_map', 'object_map/markers', 'time per stage [ms]'):
        assert f'>{words}</text>' in sketch
    assert sketch.count('>3-D view</text>') == 2


def test_the_list_of_decisions_has_every_page() -> None:
    page = (ROOT / DECISIONS / 'index.md').read_text()
    numbers = [line.split('. ')[0] for line in page.splitlines()[5:]]
    assert numbers == [str(k + 1) for k in range(len(numbers))]


def test_published_values_stand_beside_ours() -> None:
    page = (ROOT / RESULTS / 'literature.md').read_text()
    assert '| CFP-SLAM | 0.0066 | 0.0141 |' in page
    ours = next(
        row
        for row in read_kept(results_path(ROOT, 'readme'))['static'].rows
        if row.cells[1] == 'none'
    )
    assert f'| this project, no filter | {ours.cells[3].split()[0]} | - |' in page


def test_a_table_names_its_commit_and_machine_once(root: Path, plan: Plan) -> None:
    assert keep(plan, results(plan, 'c1'), results_path(root, 'tiny')) == ('one', 'two')
    write_pages(root)
    text = (root / 'docs/page.md').read_text()
    better = '**0.0200** [0.0200-0.0200]'
    assert f'| `a` | 0.0800 [0.0800-0.0800] | {better} |\n| `b` |' in text
    assert 'Made at commit c1, on M.' in text
    assert '\nRecorded. RMSE in m.\n' in text
    assert '\n\n| sequence | `none` | `hoid2d`, ground-truth boxes |\n' in text
    assert text.startswith('# Page\n')
    assert text.endswith('<!-- /bench -->\n\nEnd.\n')
    assert '\nold\n' not in text


def test_rows_of_another_commit_say_so(root: Path, plan: Plan) -> None:
    path = results_path(root, 'tiny')
    keep(plan, results(plan, 'c1'), path)
    renewed = plan.only(['two'])
    assert keep(renewed, results(renewed, 'c2'), path) == ('two',)
    assert [row.commit for one in read_kept(path).values() for row in one.rows] == [
        *('c1', 'c1'),
        *('c2', 'c2'),
    ]
    text = rewritten(PAGE, root)
    assert '| filter | detector | commit | `a` | `b` |' in text
    assert [line.split('|')[3].strip() for line in text.splitlines() if line[:3] == '| `'] == [
        *('c1', 'c1'),
        *('c2', 'c2'),
    ]
    assert 'Made at commits c1, c2, on M.' in text


def test_a_table_of_errors_has_its_longer_list_downwards() -> None:
    columns = ('variant', 'sequence', 'filter', 'detector', 'ATE RMSE [m]', 'coverage')
    rows = [
        Row((variant, 'a', 'motion', '-', error, coverage), 'c', 'M')
        for variant, error, coverage in (('default', '0.1', '1.000'), ('x=0', '0.2', '0.500'))
    ]
    heads, lines, caption = error_table(columns, rows)
    assert heads == ('variant', 'filter', 'a')
    assert lines == [('default', 'motion', '0.1'), ('x=0', 'motion', '0.2, coverage 0.500')]
    assert caption == 'ATE RMSE in m.'


def test_a_page_selects_columns_and_says_equal_ones_once(root: Path, plan: Plan) -> None:
    keep(plan, results(plan, 'c1'), results_path(root, 'tiny'))
    page = PAGE.replace('one two', 'one | filter, RMSE [m], coverage')
    text = rewritten(page, root)
    assert 'In all rows: coverage 1.000.\n\n| filter | RMSE [m] |\n' in text
    with pytest.raises(InputError, match='no column tilt among'):
        rewritten(page.replace('filter', 'tilt'), root)


def test_rows_that_differ_in_their_variant_only_are_one_row(root: Path) -> None:
    rows = (
        Row(('x', '0.1'), 'c1, c2', 'M'),
        Row(('y', '0.2'), 'c1', 'M'),
        Row(('z', '0.2'), 'c1', 'M'),
    )
    write_kept(results_path(root, 'tiny'), {'one': Kept(('variant', 'ATE'), rows)})
    lines = rewritten(PAGE.replace('one two', 'one'), root).splitlines()
    assert [line for line in lines if line[:3] == '| `'] == ['| `x` | 0.1 |', '| `y`; `z` | 0.2 |']
    assert 'Made at commits c1, c2, on M.' in lines


def test_an_experiment_that_is_not_complete_stays_as_it_was(root: Path, plan: Plan) -> None:
    path = results_path(root, 'tiny')
    every = results(plan.only(['one']), 'c1')
    assert keep(plan, every, path) == ('one',)
    before = path.read_text()
    missing = dict(list(results(plan, 'c2').items())[1:-1])
    assert keep(plan, missing, path) == ()
    assert path.read_text() == before
    assert 'Not run yet: `./hoid bench tiny --only two --publish`.' in rewritten(PAGE, root)


def test_runs_of_two_commits_are_not_compared(plan: Plan) -> None:
    every = results(plan.only(['one']), 'c1')
    mixed = [r if r.job.filter == 'none' else replace(r, commit='c2') for r in every.values()]
    table = with_commits(make_table(plan.experiments[0], mixed), mixed)
    better, commit = table.columns.index('better'), table.columns.index('commit')
    assert [(row[better].text, row[commit].text) for row in table.rows] == [
        ('-', 'c1'),
        ('-', 'c2'),
    ]


def test_reports_are_files_beside_their_pages(root: Path) -> None:
    reports = {name: root / RESULTS / f'{name}.txt' for name in ('faults', 'rooms')}
    publish_report(root, 'rooms', '| b | 2 |\n')
    publish_faults(root, '| a | 1 |\n| c | 2 |\n')
    publish_faults(root, '| c | 3 |\n')
    assert reports['rooms'].read_text() == '| b | 2 |\n'
    assert reports['faults'].read_text() == '| a | 1 |\n| c | 3 |\n'


def test_a_damaged_file_of_results_is_named(root: Path) -> None:
    results_path(root, 'tiny').write_text('{"one": []}')
    with pytest.raises(InputError, match=r'tiny\.json: not a file of results'):
        rewritten(PAGE, root)
