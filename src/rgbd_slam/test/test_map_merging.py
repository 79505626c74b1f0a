"""Maps that share a place become one map in the frame of the older, and can be separated."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import LoopCloser, LoopEvent, merge_maps
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import restore, snapshot

from .drifting_ring import errors_m, loop_edge
from .ring_world import CAMERA, RingWorld, mapped, ring_poses


def test_two_maps_become_one_in_the_frame_of_the_older() -> None:
    world, atlas = RingWorld(), Atlas(1.2, 8)
    truth = ring_poses(24, 0.5)
    T_other = se3.exp(np.array([0.3, -1.0, 0.2, 2.0, 0.5, -1.0]))
    old = mapped(atlas, world, truth[:14], truth[:14])
    new = mapped(atlas, world, truth[10:], T_other @ truth[10:], map_id=1)
    closer = LoopCloser(atlas, CAMERA, SlamConfig())
    events = [closer.process(int(i)) for i in new]
    assert events.count(LoopEvent.MERGED) == 1
    keyframes = atlas.keyframes
    assert set(keyframes.map_id[np.r_[old, new]].tolist()) == {0}
    assert (atlas.points.map_id[atlas.points.indices()] == 0).all()
    assert errors_m(atlas, new, truth[10:]).max() < 0.02
    alive = keyframes.indices()
    roots = ~np.isin(keyframes.parent_uid[alive], keyframes.uid[alive])
    assert roots.sum() == 1


def test_the_older_map_keeps_its_frame_whichever_side_recognizes() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(12, 0.2)
    T_other = se3.exp(np.array([0.0, 0.5, 0.0, 1.0, 0.0, 0.0]))
    old = mapped(atlas, RingWorld(), truth[:6], truth[:6])
    new = mapped(atlas, RingWorld(), truth[6:], T_other @ truth[6:], map_id=1)
    merge_maps(atlas, int(old[5]), int(new[2]), se3.inverse(truth[8]) @ truth[5])
    np.testing.assert_allclose(atlas.keyframes.T_map_camera[new], truth[6:], atol=1e-9)
    np.testing.assert_allclose(atlas.keyframes.T_map_camera[old], truth[:6], atol=1e-12)
    assert atlas.keyframes.parent_uid[new[2]] == atlas.keyframes.uid[old[5]]
    assert atlas.keyframes.parent_uid[new[0]] == atlas.keyframes.uid[new[1]]


def test_a_place_that_looks_alike_in_other_surroundings_joins_no_maps() -> None:
    """Two round rooms have one half of their walls in common."""
    poses, closed = ring_poses(36), []
    for share in (1.0, 0.5):
        here, there = RingWorld(), RingWorld()
        is_other = np.arctan2(there.points_m[:, 0], there.points_m[:, 2]) < np.pi * (1 - 2 * share)
        unlike = np.random.default_rng(5).integers(0, 256, there.descriptors.shape, np.uint8)
        there.descriptors = np.where(is_other[:, None], unlike, there.descriptors)
        atlas = Atlas(1.2, 8)
        rows = [mapped(atlas, here, poses, poses, 0), mapped(atlas, there, poses, poses, 1)]
        closer = LoopCloser(atlas, CAMERA, SlamConfig())
        closed.append([closer.process(i) for i in rows[1].tolist()])
    assert LoopEvent.MERGED in closed[0]
    assert LoopEvent.MERGED not in closed[1]


def test_two_maps_that_were_joined_wrongly_are_separate_again() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(24, 0.5)
    old = mapped(atlas, RingWorld(), truth[:12], truth[:12])
    new = mapped(atlas, RingWorld(seed=3), truth[12:], truth[12:], map_id=1)
    keyframes, T_old = atlas.keyframes, atlas.keyframes.T_map_camera[old]
    c, i = int(old[3]), int(new[4])
    ends = int(keyframes.uid[c]), int(keyframes.uid[i])
    atlas.loops = (loop_edge(ends[0], ends[1], np.eye(4))._replace(kind='merged'),)
    merge_maps(atlas, i, c, np.eye(4))
    assert len(np.unique(keyframes.map_id[np.r_[old, new]])) == 1

    LoopCloser(atlas, CAMERA, SlamConfig()).remove(0)

    assert not atlas.loops
    (id_old,), (id_new,) = (np.unique(keyframes.map_id[rows]) for rows in (old, new))
    assert id_old != id_new
    np.testing.assert_allclose(keyframes.T_map_camera[old], T_old, atol=0.01)
    roots = ~np.isin(keyframes.parent_uid[np.r_[old, new]], keyframes.uid[np.r_[old, new]])
    assert roots.sum() == 2
    assert restore(Atlas(1.2, 8), snapshot(atlas), CAMERA, keep=False) is not None
