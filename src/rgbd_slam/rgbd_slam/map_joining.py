"""Joining of saved maps of several days or robots that show the same places."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.errors import ConfigError
from hoid_common.values import IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import Join, LoopCloser
from rgbd_slam.loops.map_matching import MapFit, map_fits
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import renumbered
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.store.map_file import MapFile

# Chosen: every tenth keyframe of a joined map is also matched with the other maps. These loops
# show how well the maps agree, and correct their poses.
_LINK_EVERY = 10


class MapJoin(NamedTuple):
    """The result for one saved map: with which maps it was joined, and the evidence."""

    # Numbers of the saved maps that are now in one map with it, maybe joined by a third one.
    joined_with: tuple[int, ...]
    fits: tuple[MapFit, ...]  # fits with each other map that its keyframes match, joined or not
    links: tuple[Join, ...]  # further loops to other maps that were closed after it was joined

    @property
    def is_joined(self) -> bool:
        """Return whether the map was joined with another one."""
        return bool(self.joined_with)

    @property
    def disagreement_m(self) -> float | None:
        """Return the median distance (m) by which links moved a keyframe; None without links."""
        distances = [link.correction[0] for link in self.links if link.correction is not None]
        return float(np.median(distances)) if distances else None


class JoinedMaps(NamedTuple):
    """The result of `join_maps`."""

    content: MapFile  # maps that were not joined are separate maps in it
    joins: tuple[MapJoin, ...]  # one for each map except the first
    # By saved map: (K,) uids of its keyframes in `content`, in the same order.
    uids: tuple[IntArray, ...]


def join_maps(
    contents: Sequence[MapFile],
    config: SlamConfig,
    *,
    same: Collection[tuple[int, int]] = (),
    apart: Collection[tuple[int, int]] = (),
) -> JoinedMaps:
    """Join saved maps; the result is in the map frame of the first one.

    Two maps are joined if several keyframes of one match the other consistently, and most of the
    map points expected there are found (`MapFit.doubt`).

    Args:
        contents: At least two maps; their cameras may differ.
        same: Pairs of maps, by number, that are known to show the same places, so that they are
            joined by a single match.
        apart: Pairs of maps, by number, that must not be joined.

    Raises:
        MapFileError: The maps differ in the number or the scale of the octaves of their features.
    """
    first = contents[0]
    octaves = first.scale_factor, first.num_octaves
    camera = StereoCamera.from_model(first.camera, config.camera)
    atlas = Atlas(*octaves)
    rows: list[IntArray] = []
    # The first map is loaded last, because of two joined maps the one loaded later keeps its
    # frame.
    for content in reversed(contents):
        seen = content.seen_by(first.camera, *octaves, extend=False)
        rows.insert(0, restore(atlas, seen.map, camera, keep=bool(rows)))
    joiner = _Joiner(atlas, LoopCloser(atlas, camera, config), rows, same, apart)
    evidence = [joiner.join(n) for n in range(1, len(rows))]
    joins = [
        MapJoin(tuple(sorted(joiner.joined(n) - {n})), *found)
        for n, found in enumerate(evidence, 1)
    ]
    uids = [atlas.keyframes.uid[own] for own in rows]
    content = MapFile(first.camera, *octaves, snapshot(atlas), np.sort(np.concatenate(uids)))
    return JoinedMaps(content, tuple(joins), tuple(uids))


def without_loop(content: MapFile, number: int, config: SlamConfig) -> MapFile:
    """Return a saved map, adjusted again, without the loop or join `content.loops[number]`."""
    loops = content.loops_by_row
    if not 0 <= number < len(loops):
        raise ConfigError(f'no loop {number}: the map has {len(loops)}, numbered from 0')
    atlas = Atlas(content.scale_factor, content.num_octaves)
    camera = StereoCamera.from_model(content.camera, config.camera)
    rows = restore(atlas, content.map, camera, keep=False, loops=loops)
    LoopCloser(atlas, camera, config).remove(number)
    uids = np.arange(len(rows)) if content.uids is None else content.uids
    numbers = dict(zip(atlas.keyframes.uid[rows].tolist(), uids.tolist(), strict=True))
    return content._replace(map=snapshot(atlas), loops=renumbered(atlas.loops, numbers))


class _Joiner:
    """Joins saved maps, numbered `n` and `m`, whose keyframes are in one atlas."""

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

    def join(self, n: int) -> tuple[tuple[MapFit, ...], tuple[Join, ...]]:
        """Join map `n` with all maps that it fits; return its fits and links (see `MapJoin`)."""
        own, joined = self._rows[n], self.joined(n)
        numbers = range(len(self._rows))
        excluded = [m for m in numbers if m in joined or self._is_forbidden(n, m)]
        fits = map_fits(
            self._atlas,
            self._closer.detector,
            own,
            np.concatenate([self._rows[m] for m in excluded]),
        )
        links: list[Join] = []
        for fit in fits:
            others = self._within(self._map_id[[fit.place.keyframe]])
            is_known = any({n, m} == {*pair} for m in others for pair in self._same)
            if (is_known or not fit.doubt) and not self._is_forbidden(n, min(others)):
                self._closer.close_at(fit.i, fit.place)
                links += self._links(own)
        return tuple(fits), tuple(links)

    def joined(self, n: int) -> set[int]:
        """Return the numbers of the saved maps that are in one map with map `n`, including `n`."""
        return self._within(self._map_id[self._rows[n]])

    def _within(self, map_ids: IntArray) -> set[int]:
        """Return the numbers of the saved maps with keyframes in the maps with these ids (N,)."""
        return {
            m for m, rows in enumerate(self._rows) if np.isin(self._map_id[rows], map_ids).any()
        }

    def _is_forbidden(self, n: int, m: int) -> bool:
        """Return whether a join of maps `n` and `m` would join two maps that must stay apart."""
        both = self.joined(n) | self.joined(m)
        return any(both.issuperset(pair) for pair in self._apart)

    def _links(self, own: IntArray) -> Iterator[Join]:
        """Close loops at every tenth of the keyframes (K,) of a map; yield those to other maps."""
        uids = set(self._atlas.keyframes.uid[own].tolist())
        for i in own[::_LINK_EVERY].tolist():
            place = self._closer.detector.detect(
                i, np.flatnonzero(self._map_id != self._map_id[i])
            )
            if place is None:
                continue
            self._closer.close_at(i, place)
            join = self._closer.last_join
            if join is not None and join.edge.first_uid not in uids:
                yield join
