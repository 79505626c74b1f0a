"""The table of fault-injection outcomes."""

from hoid_benchmarks.faults.cases import Outcome, merged, table

_FOUND = (
    Outcome('node killed', 0, '', wall_s=2.0, note='gap 0.1 s'),
    Outcome('node killed', 1, 'no odometry for 0.4 s', wall_s=1.0, note='gap 0.4 s'),
)


def test_a_row_has_the_note_of_its_worst_case() -> None:
    assert '| node killed | 2 | 1 | 0 | 1.5 s | 2.0 s | - | gap 0.4 s |' in table(_FOUND)
    assert '- node killed, seed 1: no odometry for 0.4 s' in table(_FOUND)
    assert '| node killed | 1 | 1 | 0 | 2.0 s | 2.0 s | - | gap 0.1 s |' in table(_FOUND[:1])


def test_a_note_with_a_rank_counts_by_it() -> None:
    longer = _FOUND[1]._replace(complaint='', note_rank=0.4)
    row = table((_FOUND[0]._replace(note_rank=0.1), longer)).splitlines()[2]
    assert row.endswith('| gap 0.4 s |')


def test_later_rows_replace_those_of_their_kind() -> None:
    other = Outcome('disk full', 0, '')
    rows = merged(table((*_FOUND, other)), table(_FOUND[:1])).splitlines()[2:]
    assert [row.split(' | ')[0] for row in rows] == ['| node killed', '| disk full']
    assert '| 1 | 1 |' in rows[0]
