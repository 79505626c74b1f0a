"""`hoid bench objects`: the object maps of real recordings, compared with lists of what is there.

Each recording is mapped with each detector. The pictures show the boxes of the map, with numbers,
classes and states, in the images of the list: green is right, orange double, red wrong, gray
unsure; plain rectangles are listed objects, yellow if they were not found. Beside each is
a sheet of the best pictures of its objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.sequence import open_sequence
from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.objects.image_boxes import box_in_image
from hoid_benchmarks.objects.list_picture import write_picture
from hoid_benchmarks.objects.list_scores import (
    FoundBoxes,
    ListScores,
    Verdict,
    score_list,
)
from hoid_benchmarks.objects.losses import why_missed
from hoid_benchmarks.objects.object_list import (
    ListedObject,
    listed_recordings,
    read_list,
    reference_up,
)
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.rooms.room_run import MappedRoom, map_room
from hoid_benchmarks.rooms.room_scores import level_error_deg
from hoid_bringup.run.run_config import RunConfig
from hoid_common.io.images import encode_jpeg
from hoid_common.values import CameraModel, FloatArray, Trajectory
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.picture_sheet import picture_sheet

_DETECTORS = ('yolox_nano', 'yolov8n_int8')
_HEADER = (
    'recording', 'detector', 'listed', 'found', 'right', 'double', 'wrong', 'unsure',
    'precision', 'recall', 'doubles per object', 'level deg',
)  # fmt: skip
_ERROR_HEADER = (
    'recording', 'detector', 'error', 'object of the map, or why it is missed',
    'nearest listed object', 'sum of scores, images', 'size m',
)  # fmt: skip
_QUALITY = 85  # chosen: of a JPEG
_SAME_IMAGE_NS = 20_000_000  # the association limit of the ATE
_BAR = ('bar', *[''] * 7, '>= 85 %', '>= 75 %', '< 0.05', '< 2')


class _Row(NamedTuple):
    recording: str
    detector: str
    scores: ListScores
    objects: tuple[MapObject, ...]
    why_missed: dict[str, str]  # by the name of a missed object
    level_deg: float  # error of the vertical of the grid; NaN: no grid, or no reference


def object_report(only: Sequence[str], store: Store, detector: str | None, out: Path) -> str:
    """Return Markdown tables of the scores, and of what is wrong or missed; write the pictures.

    Args:
        only: Names of recordings; empty: all that have a list and are there.
        store: Folders of the recordings.
        detector: Detector model; None: YOLOX-nano, then YOLOv8n.
        out: Folder for the pictures.

    Raises:
        InputError: A recording has no list, or is missing.
    """
    names = only or [name for name in listed_recordings() if store.locate(name) is not None]
    lists = {name: read_list(name) for name in names}
    out.mkdir(parents=True, exist_ok=True)
    rows = [
        _evaluated(name, lists[name], store, model, out)
        for model in ([detector] if detector else _DETECTORS)
        for name in names
    ]
    parts = [(_HEADER, [_BAR, *_score_rows(rows)]), (_ERROR_HEADER, list(_error_rows(rows)))]
    return '\n'.join(markdown_table(header, cells) for header, cells in parts if cells)


def _evaluated(name: str, listed: list[ListedObject], store: Store, model: str, out: Path) -> _Row:
    sequence = open_sequence(store.find(name))
    camera = sequence.camera
    config = RunConfig().updated({'detector.model': model, 'object_map.enabled': True})
    room = map_room(sequence, config)
    present = tuple(item for item in room.objects if item.is_present)
    stamps_ns = {stamp_ns for item in listed for stamp_ns in item.boxes_px}
    trajectory = room.trajectory
    all_poses = zip(trajectory.stamps_ns.tolist(), trajectory.T_world_camera, strict=True)
    poses = {stamp_ns: T for stamp_ns, T in all_poses if stamp_ns in stamps_ns}
    everything = (*present, *room.tentative, *(o for o in room.objects if not o.is_present))
    boxes = _boxes_of(everything, poses, camera)
    scores = score_list(boxes[: len(present)], listed)
    why = {
        item.name: why_missed(item, everything, boxes, room.verdicts, poses)
        for item in listed
        if item.name in scores.missed
    }
    images = {f.stamp_ns: f.image_bgr for f in sequence if f.stamp_ns in stamps_ns}
    path = out / f'{name}_{Path(model).stem}.jpg'
    write_picture(path, images, poses, camera, listed, present, scores)
    if (sheet := picture_sheet(present)) is not None:
        path.with_stem(f'{path.stem}_objects').write_bytes(encode_jpeg(sheet, _QUALITY))
    level_deg = _level_deg(room, sequence.ground_truth, reference_up(name))
    return _Row(name, model, scores, present, why, level_deg)


def _boxes_of(
    objects: Sequence[MapObject], poses: Mapping[int, FloatArray], camera: CameraModel
) -> list[FoundBoxes]:
    """Return the boxes of objects in images with known poses T_map_camera, by stamp [ns]."""
    return [
        FoundBoxes(item.class_name, {k: box_in_image(item, T, camera) for k, T in poses.items()})
        for item in objects
    ]


def _level_deg(room: MappedRoom, reference: Trajectory | None, up: FloatArray | None) -> float:
    """Return the error of the grid's vertical by the reference, whose axis `up` is vertical."""
    if reference is None or up is None:
        return float('nan')
    stamps_ns = room.trajectory.stamps_ns
    rows = np.searchsorted(reference.stamps_ns, stamps_ns).clip(max=len(reference) - 1)
    near = np.abs(reference.stamps_ns[rows] - stamps_ns) < _SAME_IMAGE_NS
    R_map_camera = room.trajectory.T_world_camera[near, :3, :3]
    R_camera_world = reference.T_world_camera[rows[near], :3, :3].transpose(0, 2, 1)
    return level_error_deg(room, (R_map_camera @ R_camera_world @ up).mean(axis=0))


def _score_rows(rows: Sequence[_Row]) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each recording, and of all recordings together, by detector."""
    for model in dict.fromkeys(row.detector for row in rows):
        own = [row for row in rows if row.detector == model]
        for row in own:
            level = f'{row.level_deg:.1f}' if np.isfinite(row.level_deg) else '-'
            yield f'`{row.recording}`', f'`{model}`', *_cells([row.scores]), level
        if len(own) > 1:
            yield 'all', f'`{model}`', *_cells([row.scores for row in own]), ''


def _cells(scores: Sequence[ListScores]) -> tuple[str, ...]:
    counts = {v: sum(score.count(v) for score in scores) for v in Verdict}
    num_listed = sum(score.num_listed for score in scores)
    right, num_found = counts[Verdict.RIGHT], sum(counts.values())
    num_judged = num_found - counts[Verdict.UNSURE]
    return (
        str(num_listed),
        str(num_found),
        *(str(counts[v]) for v in Verdict),
        f'{100 * right / num_judged:.0f} %' if num_judged else '-',
        f'{100 * right / num_listed:.0f} %',
        f'{counts[Verdict.DOUBLE] / max(right, 1):.2f}',
    )


def _error_rows(rows: Sequence[_Row]) -> Iterator[tuple[str, ...]]:
    """Yield a row for each object that is wrong or double, and for each one that was missed."""
    for row in rows:
        for item, verdict, match in zip(
            row.objects, row.scores.verdicts, row.scores.matches, strict=True
        ):
            if verdict in (Verdict.WRONG, Verdict.DOUBLE):
                size = ' x '.join(f'{side_m:.2f}' for side_m in item.size_m)
                number = f'{item.object_id} {item.class_name}'
                seen = f'{item.class_scores[0][1]:.1f} in {item.num_sightings}'
                yield row.recording, row.detector, verdict.value, number, match, seen, size
        for name in row.scores.missed:
            yield row.recording, row.detector, 'missed', row.why_missed[name], name, '', ''
