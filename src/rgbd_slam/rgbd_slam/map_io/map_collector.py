"""Copies a map for a file, part by part, so that tracking never waits long."""

from __future__ import annotations

import numpy as np

from hoid_common.io.records import Record
from rgbd_slam.map_io.checkpoint_index import IndexedKeyframes, map_state
from rgbd_slam.map_io.map_parts import MapPart, MapParts
from rgbd_slam.map_io.segments import Rows, num_rows
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import MapState


class MapCollector:
    """Collects copies of the parts of a map until they are the whole map at one version.

    Args:
        atlas: The running map, which may change between the copies of two parts.
    """

    def __init__(self, atlas: Atlas) -> None:
        self._parts = MapParts(atlas)
        self._records: dict[str, list[Record]] = {'features': [], 'states': [], 'points': []}

    def copy(self) -> MapPart:
        """Return a copy of the next part, which must be passed to `add` before the next call.

        The map must not change during the call: it is made between two images.
        """
        return self._parts.copy()

    def add(self, part: MapPart) -> MapState | None:
        """Add a part; return the map in the core's map frame, or None if parts are missing."""
        firsts = (sum(map(num_rows, self._records[name])) for name in ('features', 'states'))
        self._parts.note(part, *firsts)
        for name, record in (
            ('features', part.features),
            ('states', part.states),
            ('points', part.points),
        ):
            self._records[name].append(record)
        if part.keyframes is None:
            return None
        keyframes = IndexedKeyframes.of(self._parts.located(part.keyframes))
        collected = {name: _rows(records) for name, records in self._records.items()}
        return map_state(keyframes, collected)


def _rows(records: list[Record]) -> Rows:
    filled = [record for record in records if num_rows(record)]
    counts = np.array([num_rows(record) for record in filled], np.int64)
    arrays = [record.arrays() for record in filled]
    return Rows(type(records[0]), arrays, np.cumsum(counts) - counts)
