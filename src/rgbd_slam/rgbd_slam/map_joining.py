"""Joins saved maps of several days or robots into one, where they show the same places."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.errors import ConfigError
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import Join, LoopCloser
from rgbd_slam.loops.map_fit import MapFit, map_fits
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import renumbered
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.store.map_file import MapFile

# Chosen: after a map was joined with others, every tenth of its keyframes is compared with their
# places as well. These links show how well the maps agree, and correct their poses.
_LINK_EVERY = 10


class MapJoin(NamedTuple):
    """The result for one saved map: the maps that it was joined with, and the evidence."""

    # Numbers of the saved maps that are in one map with it now, possibly by way of a third one.
    joined_with: tuple[int, ...]
    # One for each other map whose places its keyframes show, whether or not the two were joined.
    fits: tuple[MapFit, ...]
    # Places of other maps that its keyframes show, searched after it was joined. They measure how
    # well the maps agree.
    links: tuple[Join, ...]

    @property
    def is_joined(self) -> bool:
        """Return whether the map was joined with another one."""
        return bool(self.joined_with)

    @property
    def disagreement_m(self) -> float | None:
        """Return the median distance [m] between keyframe poses in the joined map and by a link.

        None is returned if there are no links.
        """
        distances = [link.correction[0] for link in self.links if link.correction is not None]
        return float(np.median(distances)) if distances else None


class JoinedMaps(NamedTuple):
    """The result of `join_maps`."""

    content: MapFile  # maps that were not joined are separate maps in it
    joins: tuple[MapJoin, ...]  # one for each map except the first
    # One array for each saved map: the uids in `content` of its K keyframes, in the order of the
    # saved map.
    uids: tuple[IntArray, ...]


def join_maps(
    contents: Sequence[MapFile],
    config: SlamConfig,
    *,
    same: Collection[tuple[int, int]] = (),
    apart: Collection[tuple[int, int]] = (),
) -> JoinedMaps:
    """Join saved maps; the result is in the map frame of the first one.

    Two maps are joined if keyframes of one show several places of the other from consistent
    poses, and if most of the map points expected there are found (`MapFit.doubt`).

    Args:
        contents: At least two maps; their cameras may differ.
        config: Parameters of the core.
        same: Pairs of maps, by number, that are known to show the same places, so that they are
            joined at the first place that fits.
        apart: Pairs of maps, by number, that are never joined.

    Raises:
        MapFileError: The maps differ in the number or the scale of the octaves of their features.
    """
    first = contents[0]
    octaves = first.scale_factor, first.num_octaves
    camera = StereoCamera.from_model(first.camera, config.camera)
    atlas = Atlas(*octaves)
    rows = list(_restored(atlas, camera, contents))[::-1]
    joiner = _Joiner(atlas, LoopCloser(atlas, camera, config), rows, same, apart)
    evidence = [joiner.join(n) for n in range(1, len(rows))]
    joins = [MapJoin(joiner.others(n), *found) for n, found in enumerate(evidence, 1)]
    uids = [atlas.keyframes.uid[own] for own in rows]
    content = MapFile(first.camera, *octaves, snapshot(atlas), np.sort(np.concatenate(uids)))
    return JoinedMaps(content, tuple(joins), tuple(uids))


def without_loop(content: MapFile, number: int, config: SlamConfig) -> MapFile:
    """Return a saved map without one of its loops or joins, adjusted again.

    Args:
        content: The map.
        number: Number of the loop in `content.loops`.
        config: Parameters of the core.

    Raises:
        ConfigError: The map has no such loop.
    """
    loops = content.loops_by_row
    if not 0 <= number < len(loops):
        raise ConfigError(f'no loop {number}: the map has {len(loops)}, numbered from 0')
    atlas = Atlas(content.scale_factor, content.num_octaves)
    camera = StereoCamera.from_model(content.camera, config.camera)
    rows = restore(atlas, content.map, camera, keep=False, loops=loops)
    LoopCloser(atlas, camera, config).open(number)
    uids = np.arange(len(rows)) if content.uids is None else content.uids
    numbers = dict(zip(atlas.keyframes.uid[rows].tolist(), uids.tolist(), strict=True))
    return content._replace(map=snapshot(atlas), loops=renumbered(atlas.loops, numbers))


def _restored(
    atlas: Atlas, camera: StereoCamera, contents: Sequence[MapFile]
) -> Iterator[IntArray]:
    """Load the saved maps, the last one first, and yield the (K,) rows of the keyframes of each.

    The first map is loaded last, because of two maps that are joined, the one that was loaded
    later keeps its frame.
    """
    first = contents[0]
    for n, content in enumerate(reversed(contents)):
        seen = content.seen_by(first.camera, first.scale_factor, first.num_octaves, extend=False)
        yield restore(atlas, seen.map, camera, keep=n > 0)


class _Joiner:
    """Joins the maps in an atlas; see `join_maps`. Saved maps have numbers, here `n` and `m`.

    Args:
        atlas: The maps.
        closer: Finds places and joins maps.
        rows: For each saved map, the (K,) rows of its keyframes.
        same: As in `join_maps`.
        apart: As in `join_maps`.
    """

    def __init__(
        self,
        atlas: Atlas,
        closer: LoopCloser,
        rows: Sequence[IntArray],
        same: Collection[tuple[int, int]],
        apart: Collection[tuple[int, int]],
    ) -> None:
        self._map_id, self._closer, self._rows = atlas.keyframes.map_id, closer, rows
        self._atlas = atlas
        self._same, self._apart = same, apart

    def others(self, n: int) -> tuple[int, ...]:
        """Return the numbers of the other saved maps that are in one map with map `n` by now."""
        return tuple(m for m in self._joined(n) if m != n)

    def join(self, n: int) -> tuple[tuple[MapFit, ...], tuple[Join, ...]]:
        """Join map `n` with all others that it fits; return its fits and links (`MapJoin`)."""
        own, joined = self._rows[n], self._joined(n)
        numbers = range(len(self._rows))
        excluded = [m for m in numbers if m in joined or self._is_forbidden(n, m)]
        fits = map_fits(
            self._atlas, self._closer, own, np.concatenate([self._rows[m] for m in excluded])
        )
        links: list[Join] = []
        for fit in fits:
            others = self._within(self._map_id[[fit.place.keyframe]])
            is_known = any({n, m} == {*pair} for m in others for pair in self._same)
            if (is_known or not fit.doubt) and not self._is_forbidden(n, min(others)):
                self._closer.close_at(fit.i, fit.place)
                links += self._links(own)
        return tuple(fits), tuple(links)

    def _joined(self, n: int) -> set[int]:
        """Return `n` and the numbers of the saved maps that are in one map with it by now."""
        return self._within(self._map_id[self._rows[n]])

    def _within(self, map_ids: IntArray) -> set[int]:
        """Return the numbers of the saved maps with keyframes in any of the maps by id (N,)."""
        return {
            m for m, rows in enumerate(self._rows) if np.isin(self._map_id[rows], map_ids).any()
        }

    def _is_forbidden(self, n: int, m: int) -> bool:
        """Return whether joining maps `n` and `m` would join two maps that must stay apart."""
        both = self._joined(n) | self._joined(m)
        return any(both.issuperset(pair) for pair in self._apart)

    def _links(self, own: IntArray) -> Iterator[Join]:
        """Close loops at every tenth keyframe of a joined saved map; yield those to other maps.

        `own` (K,) are the rows of its keyframes.
        """
        uids = set(self._atlas.keyframes.uid[own].tolist())
        for i in own[::_LINK_EVERY].tolist():
            place = self._closer.find(i, np.flatnonzero(self._map_id != self._map_id[i]))
            if place is None:
                continue
            self._closer.close_at(i, place)
            join = self._closer.last_join
            if join is not None and join.place_uid not in uids:
                yield join
