"""The table of found objects: those of `tracked_objects` at the end, and of the object map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoid_benchmarks.rooms.object_scores import (
    FoundObject,
    ObjectScores,
    all_scores,
    score_objects,
)
from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_benchmarks.rooms.room_run import MappedRoom
from hoid_common.values import FloatArray

HEADER = (
    'room', 'objects of', 'recall', 'precision', 'class right', 'doubles per object',
    'center cm', 'small: center cm', 'seen part: center cm', 'seen part: size cm',
    'seen part: area %',
)  # fmt: skip
_TRACKS, _MAP = '`tracked_objects`', '`object_map`'


class ObjectTable:
    """Collects the scores of rooms."""

    def __init__(self) -> None:
        self._scores: dict[str, dict[str, ObjectScores]] = {_TRACKS: {}, _MAP: {}}

    def add(self, name: str, room: MappedRoom, true: Sequence[TrueObject]) -> None:
        """Score the objects of a room at its end."""
        tracks = room.tracks[max(room.tracks)] if room.tracks else ()
        at_rest = [
            FoundObject(track.class_name, PlacedBox.along_map(track.position_map_m, track.size_m))
            for track in tracks
            if track.state.is_at_rest
        ]
        mapped = [
            FoundObject(item.class_name, PlacedBox(item.T_map_object, item.size_m))
            for item in room.objects
            if item.is_present
        ]
        self._scores[_TRACKS][name] = score_objects(at_rest, true)
        self._scores[_MAP][name] = score_objects(mapped, true)

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of all rooms, and of all together."""
        out: list[tuple[str, ...]] = []
        for source, scores in self._scores.items():
            out += [(f'`{name}`', source, *_cells(score)) for name, score in scores.items()]
            if len(scores) > 1:
                out.append(('all', source, *_cells(all_scores(scores.values()))))
        return out


def _cells(scores: ObjectScores) -> Sequence[str]:
    return (
        _share(scores.num_recalled, scores.num_expected),
        _share(scores.num_right, scores.num_found),
        _share(scores.num_class_right, scores.num_right),
        f'{scores.num_double / max(scores.num_right, 1):.2f}',
        _errors(scores.center_m),
        _errors(scores.small_center_m),
        _errors(scores.seen_center_m),
        _errors(scores.size_m),
        _errors(scores.area),
    )


def _share(part: int, total: int) -> str:
    return f'{100 * part / total:.1f} % of {total}' if total else '-'


def _errors(errors: FloatArray) -> str:
    """Return the median and the 90th percentile, in hundredths."""
    if len(errors) == 0:
        return '-'
    median, high = 100 * np.percentile(errors, (50, 90))
    return f'{median:.1f} / {high:.0f}'
