"""Joins saved maps of several days or robots into one, where they show the same places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.dense.submap_state import SubmapState
from rgbd_slam.loops.loop_closer import Join, LoopCloser, LoopEvent
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.model.trajectory import keyframe_poses
from rgbd_slam.scene.objects.object_map import ObjectMap
from rgbd_slam.scene.objects.object_map_state import ObjectMapState

# Chosen: after two maps were joined, every n-th keyframe is compared with the places of the other
# map as well. These links show how well the maps agree, and correct them along the way.
_LINK_EVERY = 10


class MapJoin(NamedTuple):
    """How one map was joined with those before it."""

    links: tuple[Join, ...]  # the first one joined the maps; none: it shows none of their places

    @property
    def is_joined(self) -> bool:
        """Return whether the map was joined."""
        return bool(self.links)

    @property
    def disagreement_m(self) -> float | None:
        """Return the median distance [m] by which later links contradicted the first ones.

        None is returned without later links.
        """
        distances = [link.correction[0] for link in self.links if link.correction is not None]
        return float(np.median(distances)) if distances else None


class JoinedMaps(NamedTuple):
    """Several maps as one."""

    content: MapFile  # maps that were not joined are apart in it
    joins: tuple[MapJoin, ...]  # of the second map and those after it
    # Whether the dense map of each map is in the result, or it has none. Dense maps in the format
    # of earlier versions, and those with voxels of another size than the first one, are left out.
    keeps_dense: tuple[bool, ...]


def join_maps(contents: Sequence[MapFile], config: SlamConfig) -> JoinedMaps:
    """Join saved maps; the result is in the frame of the first one.

    Args:
        contents: At least two maps; their cameras may differ.
        config: Parameters of the core.

    Raises:
        MapFileError: The maps have features of different octaves.
    """
    first = contents[0]
    octaves = first.scale_factor, first.num_octaves
    camera = StereoCamera.from_model(first.camera, config.camera)
    atlas = Atlas(*octaves)
    rows: list[IntArray] = []
    # Of two maps that are joined, the one that was restored later keeps its frame.
    for content in reversed(contents):
        state = content.seen_by(first.camera, *octaves, extend=False).map
        rows.append(restore(atlas, state, camera, keep=bool(rows)))
    rows.reverse()
    closer = LoopCloser(atlas, camera, config)
    joins = [MapJoin(tuple(_links(atlas, closer, own))) for own in rows[1:]]
    dense, keeps_dense = _joined_dense(contents, [atlas.keyframes.uid[own] for own in rows])
    objects = _joined_objects(contents, [atlas.keyframes.uid[own] for own in rows], atlas)
    content = MapFile(first.camera, *octaves, snapshot(atlas), dense, objects)
    return JoinedMaps(content, tuple(joins), keeps_dense)


def _joined_dense(
    contents: Sequence[MapFile], uids: Sequence[IntArray]
) -> tuple[SubmapState | None, tuple[bool, ...]]:
    """Return the submaps of all maps, which stay with their keyframes, and whose were kept.

    Args:
        contents: The maps.
        uids: The (K,) uids that the keyframes of each map have now; none has been removed.
    """
    saved_uids = np.sort(np.concatenate(uids))  # the order of a saved map
    parts: list[tuple[SubmapState, IntArray]] = []
    keeps = []
    for content, own in zip(contents, uids, strict=True):
        dense = content.dense
        fits = isinstance(dense, SubmapState) and (
            not parts or dense.voxel_m[0] == parts[0][0].voxel_m[0]
        )
        if isinstance(dense, SubmapState) and fits:
            parts.append((dense, np.searchsorted(saved_uids, own)))
        keeps.append(dense is None or fits)
    return SubmapState.joined(parts) if parts else None, tuple(keeps)


def _joined_objects(
    contents: Sequence[MapFile], uids: Sequence[IntArray], atlas: Atlas
) -> ObjectMapState | None:
    """Return the objects of all maps; those that are the same thing are one.

    Args:
        contents: The maps.
        uids: The (K,) uids that the keyframes of each map have now.
        atlas: The joined map.
    """
    keyframes, objects = keyframe_poses(atlas), ObjectMap(contents[0].camera)
    objects.correct(keyframes)
    for content, own in zip(contents, uids, strict=True):
        if content.objects is not None:
            objects.load(content.objects, own)
    objects.join()
    return objects.export(keyframes.uids) if len(objects) else None


def _links(atlas: Atlas, closer: LoopCloser, rows: IntArray) -> Iterator[Join]:
    """Join the map of keyframes (K,) with others, and yield the places that connect them."""
    own = set(atlas.keyframes.uid[rows].tolist())
    first = next((i for i in _spread(rows) if closer.process(i) is LoopEvent.MERGED), None)
    if first is None:
        return
    assert closer.last_join is not None
    yield closer.last_join
    for i in rows[::_LINK_EVERY].tolist():
        closer.process(i)
        if closer.last_join is not None and closer.last_join.place_uid not in own:
            yield closer.last_join


def _spread(rows: IntArray) -> Iterator[int]:
    """Yield rows from all over the map first, and those between them later."""
    step = 1 << max(len(rows) - 1, 0).bit_length()
    seen: set[int] = set()
    while step >= 1:
        for i in rows[::step].tolist():
            if i not in seen:
                seen.add(i)
                yield i
        step //= 2
