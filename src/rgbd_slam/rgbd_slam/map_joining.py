"""Joins saved maps of several days or robots into one, where they show the same places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.values import IntArray
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import Join, LoopCloser, LoopEvent
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.model.trajectory import keyframe_poses
from rgbd_slam.store.map_file import MapFile

# Chosen: after a map was joined with others, every tenth of its keyframes is compared with their
# places as well. These links show how well the maps agree, and correct their poses.
_LINK_EVERY = 10


class MapJoin(NamedTuple):
    """The links by which one map was joined with the other maps."""

    # Recognized places of the other maps; the first one joined the maps. Without any link, the map
    # shows none of their places and is not joined.
    links: tuple[Join, ...]

    @property
    def is_joined(self) -> bool:
        """Return whether the map was joined with another one."""
        return bool(self.links)

    @property
    def disagreement_m(self) -> float | None:
        """Return the median distance [m] of the later links from the joined map.

        It is the distance between a keyframe's pose in the map and its pose by the link. None is
        returned if there are no later links.
        """
        distances = [link.correction[0] for link in self.links if link.correction is not None]
        return float(np.median(distances)) if distances else None


class JoinedMaps(NamedTuple):
    """The map that `join_maps` has made of several maps, and what became of each of them."""

    content: MapFile  # maps that were not joined are separate maps in it
    joins: tuple[MapJoin, ...]  # one for each map except the first
    # For each map: True if its dense map is in the result, or if it has no dense map. Dense maps
    # in the format of earlier versions, and those with voxels of another size than the first dense
    # map, are left out.
    keeps_dense: tuple[bool, ...]


def join_maps(contents: Sequence[MapFile], config: SlamConfig) -> JoinedMaps:
    """Join saved maps; the result is in the map frame of the first one.

    Args:
        contents: At least two maps; their cameras may differ.
        config: Parameters of the core.

    Raises:
        MapFileError: The maps differ in the number or the scale of the octaves of their features.
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
    """Return the joined submaps of all maps (None: no map has any), and `JoinedMaps.keeps_dense`.

    Args:
        contents: The maps.
        uids: The (K,) uids that the keyframes of each map have now; none has been removed.
    """
    saved_uids = np.sort(np.concatenate(uids))  # the order of the keyframes in a saved map
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
    """Return the object map of all maps, in which duplicates are joined; None: no map has objects.

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
    """Join the map of keyframes (K,) with others, and yield the places that link them.

    Nothing is yielded if no keyframe shows a place of another map.
    """
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
    """Yield all rows once: first a few that are spread evenly, then those between them."""
    step = 1 << max(len(rows) - 1, 0).bit_length()
    seen: set[int] = set()
    while step >= 1:
        for i in rows[::step].tolist():
            if i not in seen:
                seen.add(i)
                yield i
        step //= 2
