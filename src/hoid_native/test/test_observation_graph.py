"""The observation graph agrees with a plain table of observations, whatever the order of calls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_native import ObservationGraph, move_points

IntArray = NDArray[np.int64]
NONE = -1
NUM_KEYFRAMES, NUM_FEATURES, NUM_POINTS = 6, 5, 8


def _rows(*values: int) -> IntArray:
    return np.array(values, np.int64)


def _graph(table: NDArray[np.int32]) -> ObservationGraph:
    graph = ObservationGraph()
    i, k = np.nonzero(table != NONE)
    graph.observe(i, k, table[i, k].astype(np.int64))
    for keyframe in range(len(table)):
        seen = table[keyframe]
        graph.connect(keyframe, seen[seen != NONE].astype(np.int64))
    return graph


@st.composite
def tables(draw: st.DrawFn) -> NDArray[np.int32]:
    """Return a (K, F) table of points in which no keyframe observes a point twice."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    table = np.array(
        [rng.permutation(NUM_POINTS)[:NUM_FEATURES] for _ in range(NUM_KEYFRAMES)], np.int32
    )
    table[rng.random(table.shape) < draw(st.floats(0, 1))] = NONE
    return table


@settings(max_examples=50, deadline=None)
@given(tables())
def test_observations_and_shared_points_are_those_of_the_table(table: NDArray[np.int32]) -> None:
    graph = _graph(table)
    j = np.arange(0, NUM_POINTS, 2)
    found = graph.observations(j)
    i, k = np.nonzero(np.isin(table, j))
    np.testing.assert_array_equal(np.stack(found), np.stack([i, k, table[i, k]]))

    by_point = graph.observations_by_point(j[::-1])
    of = np.lexsort((k, i, table[i, k]))
    np.testing.assert_array_equal(np.stack(by_point), np.stack([i, k, table[i, k]])[:, of])

    order = _rows(4, 1, 3)
    found = graph.observations(j, order)
    n, k = np.nonzero(np.isin(table[order], j))
    np.testing.assert_array_equal(np.stack(found), np.stack([order[n], k, table[order][n, k]]))

    sees = np.zeros((NUM_KEYFRAMES, NUM_POINTS + 1), np.int64)
    np.put_along_axis(sees, table.astype(np.int64), 1, axis=1)
    shared = sees[:, :-1] @ sees[:, :-1].T
    np.fill_diagonal(shared, 0)
    for keyframe in range(NUM_KEYFRAMES):
        near = graph.neighbors(keyframe)
        rows = np.argsort(-shared[keyframe], kind='stable')
        rows = rows[shared[keyframe, rows] > 0]
        np.testing.assert_array_equal(near.rows, rows)
        np.testing.assert_array_equal(near.shared, shared[keyframe, rows])
    edges = graph.edges(2)
    first, second = np.nonzero(np.triu(shared >= 2))
    np.testing.assert_array_equal(
        np.stack(edges), np.stack([first, second, shared[first, second]])
    )
    np.testing.assert_array_equal(graph.count_observed(j, order), sees[order][:, j].sum(1))
    np.testing.assert_array_equal(
        graph.points_of(table, order), np.unique(table[order][table[order] != NONE])
    )


@settings(max_examples=50, deadline=None)
@given(tables(), tables())
def test_a_graph_that_was_changed_equals_a_new_one(
    old: NDArray[np.int32], new: NDArray[np.int32]
) -> None:
    graph = _graph(old)
    i, k = np.nonzero(old != NONE)
    graph.unobserve(i, k, old[i, k].astype(np.int64))
    i, k = np.nonzero(new != NONE)
    graph.observe(i, k, new[i, k].astype(np.int64))
    for keyframe in range(NUM_KEYFRAMES):
        seen = new[keyframe]
        graph.connect(keyframe, seen[seen != NONE].astype(np.int64))
    fresh = _graph(new)
    every = np.arange(NUM_POINTS)
    np.testing.assert_array_equal(
        np.stack(graph.observations(every)), np.stack(fresh.observations(every))
    )
    np.testing.assert_array_equal(np.stack(graph.edges()), np.stack(fresh.edges()))


def test_connections_are_symmetric_and_can_be_replaced() -> None:
    graph = ObservationGraph()
    graph.set_neighbors(2, _rows(0, 5), _rows(30, 7))
    assert graph.neighbors(5).rows.tolist() == [2]
    graph.set_neighbors(2, _rows(1), _rows(9))
    assert graph.neighbors(5).rows.tolist() == []
    assert np.stack(graph.edges()).tolist() == [[1], [2], [9]]
    graph.clear()
    assert graph.neighbors(2).rows.tolist() == []


def test_the_shortest_path_uses_shared_points_and_the_tree() -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = [0, 1, 2, 3, 9]
    poses[4, :2, :2] = [[0, -1], [1, 0]]  # turned by 90 degrees
    graph = ObservationGraph()
    graph.set_neighbors(0, _rows(1), _rows(20))
    graph.set_neighbors(2, _rows(1, 3), _rows(20, 14))
    parents = _rows(NONE, NONE, NONE, 0, NONE)

    def length_m(start: int, goal: int) -> float:
        return graph.path_length_m(poses, parents, start, goal, 15, 0.5)

    assert length_m(0, 2) == pytest.approx(2)
    assert length_m(2, 3) == pytest.approx(2 + 3)  # by 1, 0 and the tree
    assert length_m(1, 1) == 0
    assert length_m(0, 4) == np.inf
    graph.set_neighbors(4, _rows(3), _rows(15))
    assert length_m(3, 4) == pytest.approx(6 + 0.5 * np.pi / 2)
    with pytest.raises(ValueError, match='goal'):
        length_m(0, 5)


def test_repeated_points_are_returned_once() -> None:
    graph = ObservationGraph()
    graph.observe(_rows(3), _rows(4), _rows(9))
    assert np.stack(graph.observations(_rows(9, 9))).tolist() == [[3], [4], [9]]


def test_wrong_arguments_raise() -> None:
    graph = ObservationGraph()
    with pytest.raises(ValueError, match='no such observation'):
        graph.unobserve(_rows(0), _rows(0), _rows(0))
    with pytest.raises(ValueError, match='k: expected 1 rows'):
        graph.observe(_rows(0), _rows(0, 1), _rows(0))
    with pytest.raises(ValueError, match='j: '):
        graph.observe(_rows(0), _rows(0), _rows(NONE))
    with pytest.raises(ValueError, match='keyframes: '):
        graph.points_of(np.zeros((2, 3), np.int32), _rows(2))
    with pytest.raises(ValueError, match='must ascend'):
        graph.set_neighbors(0, _rows(2, 1), _rows(1, 1))


def test_points_move_with_their_motion() -> None:
    quarter = np.array([[0.0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    position_m = np.array([[1.0, 2, 3], [1, 2, 3]])
    direction = np.array([[1, 0, 0], [1, 0, 0]], np.float32)
    move_points(quarter[None], _rows(0, NONE), position_m, direction)
    assert position_m.tolist() == [[3, 1, 3], [1, 2, 3]]
    assert direction.tolist() == [[0, 1, 0], [1, 0, 0]]
    with pytest.raises(ValueError, match='which'):
        move_points(quarter[None], _rows(0, 1), position_m, direction)
