"""The map keeps observations, counts, covisibility and copies consistent."""

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hoid_common.values import IntArray
from rgbd_slam.model import atlas as atlas_module
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT, KeyframeTable
from rgbd_slam.model.points import PointTable


def make_frame(n: int, stamp_ns: int = 0) -> Frame:
    rng = np.random.default_rng(stamp_ns)
    uv = rng.uniform(0, 400, (n, 2))
    depth = np.where(np.arange(n) % 2, 2.0, 0.0).astype(np.float32)
    right = np.where(depth > 0, uv[:, 0] - 20, np.nan)
    return Frame(
        stamp_ns,
        np.column_stack([uv, right]).astype(np.float32),
        depth,
        np.zeros(n, np.uint8),
        np.zeros(n, np.float32),
        rng.integers(0, 256, (n, 32), dtype=np.uint8),
        np.ones(n, np.bool_),
    )


def idx(*values: int) -> IntArray:
    return np.array(values, np.int64)


@pytest.fixture
def two_keyframes() -> tuple[Atlas, int, int, IntArray]:
    atlas = Atlas(1.2, 8)
    a = atlas.add_keyframe(make_frame(10, 1), np.eye(4), 0)
    pose = np.eye(4)
    pose[0, 3] = 0.5
    b = atlas.add_keyframe(make_frame(12, 2), pose, 0, a)
    j = atlas.add_points(
        a, np.arange(6), np.column_stack([np.arange(6.0), np.zeros(6), np.full(6, 2.0)])
    )
    atlas.observe(b, idx(0, 1, 2), j[:3])
    atlas.update_connections(b)
    return atlas, a, b, j


def test_counts_follow_observations(two_keyframes: tuple[Atlas, int, int, IntArray]) -> None:
    atlas, a, b, j = two_keyframes
    assert atlas.points.num_observations[j].tolist() == [2, 2, 2, 1, 1, 1]
    assert atlas.points.num_stereo[j].tolist() == [0, 2, 0, 1, 0, 1]
    assert np.stack(atlas.graph.edges()).tolist() == [[a], [b], [3]]
    assert atlas.covisible(a).tolist() == [b]
    seen = atlas.observations_of(j[:2])
    assert seen.i.tolist() == [a, a, b, b]
    assert seen.k.tolist() == [0, 1, 0, 1]


def test_a_point_that_nothing_observes_is_gone(
    two_keyframes: tuple[Atlas, int, int, IntArray],
) -> None:
    atlas, a, _, j = two_keyframes
    atlas.unobserve(a, np.arange(6))
    assert atlas.points.alive[j].tolist() == [True] * 3 + [False] * 3


def test_fusing_moves_observations_once(two_keyframes: tuple[Atlas, int, int, IntArray]) -> None:
    atlas, a, b, j = two_keyframes
    new = atlas.add_points(b, idx(7, 8), np.ones((2, 3)))
    atlas.replace_points(j[[3, 0]], new)
    assert atlas.keyframes.point_of_feature[a, 3] == new[0]
    assert atlas.keyframes.point_of_feature[a, 0] == new[1]
    assert (
        atlas.keyframes.point_of_feature[b, 0] == NO_POINT
    )  # b sees the new point already, in feature 8
    assert atlas.points.num_observations[new].tolist() == [2, 2]
    assert not atlas.points.alive[j[[0, 3]]].any()


def test_removed_keyframe_leaves_a_redirect(
    two_keyframes: tuple[Atlas, int, int, IntArray],
) -> None:
    atlas, a, b, j = two_keyframes
    uid_a, uid_b = atlas.keyframes.uid[[a, b]]
    atlas.remove_keyframe(b)
    (redirect,) = atlas.redirects.take()
    assert (redirect.uid, redirect.parent_uid) == (uid_b, uid_a)
    np.testing.assert_allclose(redirect.T_parent_camera[:3, 3], [0.5, 0, 0])
    assert atlas.points.num_observations[j].tolist() == [1] * 6
    with pytest.raises(ValueError, match='root'):
        atlas.remove_keyframe(a)


def test_reused_rows_get_new_uids(two_keyframes: tuple[Atlas, int, int, IntArray]) -> None:
    atlas, a, _, j = two_keyframes
    uid = atlas.points.uid[j].copy()
    atlas.remove_points(j)
    again = atlas.add_points(a, np.arange(6), np.ones((6, 3)))
    assert again.tolist() == j.tolist()
    assert not np.isin(atlas.points.uid[again], uid).any()


def test_changes_bring_a_copy_up_to_date(
    two_keyframes: tuple[Atlas, int, int, IntArray],
) -> None:
    atlas, a, b, j = two_keyframes
    copy = Atlas(1.2, 8)
    first = atlas.changes_since(0)
    copy.apply(first)
    atlas.set_positions(j[:1], np.array([[9.0, 9.0, 9.0]]))
    for n in range(40):  # beyond the first capacity
        i = atlas.add_keyframe(make_frame(2000, n), np.eye(4), 0, a)
        atlas.observe(i, np.arange(3), j[:3])
        atlas.update_connections(i)
    atlas.remove_keyframe(b)
    change = atlas.changes_since(first.version)
    copy.apply(change)
    for table, other in ((atlas.points, copy.points), (atlas.keyframes, copy.keyframes)):
        sent = {*table.columns} - {*table.local} | ({'point_of_feature'} & {*table.columns})
        for name in sorted(sent):
            live = table.uid >= 0
            np.testing.assert_array_equal(
                getattr(table, name)[live], getattr(other, name)[live], err_msg=name
            )
            np.testing.assert_array_equal(table.uid, other.uid)
    assert len(change.points.rows) == 3
    np.testing.assert_array_equal(np.stack(copy.graph.edges()), np.stack(atlas.graph.edges()))
    np.testing.assert_array_equal(
        np.stack(copy.observations_of(j)), np.stack(atlas.observations_of(j))
    )
    assert len(copy.redirects.take()) == 1


def test_scale_range_and_direction() -> None:
    atlas = Atlas(1.2, 8)
    frame = make_frame(2)
    frame.octave[:] = 2
    i = atlas.add_keyframe(frame, np.eye(4), 0)
    j = atlas.add_points(i, idx(1), np.array([[0.0, 0.0, 3.0]]))
    assert atlas.points.max_distance_m[j[0]] == pytest.approx(3 * 1.2**2)
    assert atlas.points.min_distance_m[j[0]] == pytest.approx(3 * 1.2**2 / 1.2**7)
    np.testing.assert_allclose(atlas.points.view_direction[j[0]], [0, 0, 1])


def test_points_that_an_adjustment_moves_out_of_the_world_are_removed(
    two_keyframes: tuple[Atlas, int, int, IntArray],
) -> None:
    atlas, a, b, j = two_keyframes
    uids = atlas.points.uid[j[:3]]
    atlas.set_positions(j[:3], np.array([[1.0, 2, 3], [1e30, 0, 0], [np.nan, 0, 0]]))
    assert np.isin(uids, atlas.points.uid).tolist() == [True, False, False]
    assert atlas.points.position_m[j[0]].tolist() == [1, 2, 3]
    assert atlas.observations_of(j[:3]).i.tolist() == [a, b]


def test_nothing_but_the_atlas_writes_the_columns_of_its_tables() -> None:
    package = Path(atlas_module.__file__).parents[1]
    columns = {*KeyframeTable().columns, *PointTable().columns}
    writers = {
        path.name
        for path in package.rglob('*.py')
        for node in ast.walk(ast.parse(path.read_text()))
        for target in written(node)
        if target.attr in columns
    }
    assert writers == {'atlas.py', 'keyframes.py', 'map_tables.py', 'soa_table.py'}


def written(node: ast.AST) -> Iterator[ast.Attribute]:
    """Yield the attributes that a statement assigns to by index: `x.name` of `x.name[...] = y`."""
    targets = node.targets if isinstance(node, ast.Assign) else []
    targets = [node.target] if isinstance(node, ast.AugAssign) else targets
    for target in targets:
        if isinstance(target, ast.Subscript) and isinstance(target.value, ast.Attribute):
            yield target.value
