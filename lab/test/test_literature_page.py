"""The page of published values compares recordings with themselves alone."""

from __future__ import annotations

from hoid_benchmarks.publish.literature_page import literature_page
from hoid_benchmarks.publish.results_file import Kept, Row

COLUMNS = ('sequence', 'filter', 'RMSE [m]')


def row(sequence: str, method: str, ate: str) -> Row:
    return Row((sequence, method, ate), 'abc', 'a machine')


def test_a_rendered_scene_is_not_taken_for_a_recording_of_the_same_name() -> None:
    """Bonn's `crowd` is a recording, `crowd` here is a rendered scene."""
    kept = {
        'real': Kept(COLUMNS, (row('fr1_xyz', 'none', '0.0067 [0.0066-0.0068]'),)),
        'rendered': Kept(COLUMNS, (row('crowd', 'none', '0.0023'), row('crowd', 'hoid+', '1'))),
    }
    page = literature_page(kept)
    assert '| this project, no filter | 0.0067 | - | - | - | - | - | run here, median (' in page
    assert page.count('this project, no filter') == 1
    assert '0.0023' not in page
