"""The picture of an object map and a list: boxes, classes and states in real images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from hoid_benchmarks.objects.image_boxes import draw_box, write_text
from hoid_benchmarks.objects.list_scores import ListScores, Verdict
from hoid_benchmarks.objects.object_list import ListedObject
from hoid_common.io.files import written
from hoid_common.values import ByteArray, CameraModel, FloatArray
from hoid_scene.objects.mapped_object import MapObject

_COLUMNS, _QUALITY = 3, 85
_COLORS_BGR = {
    Verdict.RIGHT: (60, 200, 60),
    Verdict.DOUBLE: (0, 140, 255),
    Verdict.WRONG: (50, 50, 255),
    Verdict.UNSURE: (190, 190, 190),
}
_LISTED_BGR, _MISSED_BGR = (255, 255, 255), (0, 255, 255)


def write_picture(
    path: Path,
    images_bgr: Mapping[int, ByteArray],
    poses: Mapping[int, FloatArray],
    camera: CameraModel,
    listed: Sequence[ListedObject],
    objects: Sequence[MapObject],
    scores: ListScores,
) -> None:
    """Write a JPEG with the images of a list, and the boxes of the map and of the list in them.

    Args:
        path: The file.
        images_bgr: The images (H, W, 3) by stamp [ns].
        poses: Their poses T_map_camera (4, 4); may lack some.
        camera: Camera of the images.
        listed: The objects of the list.
        objects: The objects of the map, in the order of the scores.
        scores: The scores.

    Raises:
        InputError: The file cannot be written.
    """
    drawn = []
    for stamp_ns, image_bgr in sorted(images_bgr.items()):
        picture = image_bgr.copy()
        for item in listed:
            if stamp_ns in item.boxes_px and not item.is_unsure:
                is_missed = item.name in scores.missed
                color = _MISSED_BGR if is_missed else _LISTED_BGR
                low, high = item.boxes_px[stamp_ns].astype(int).reshape(2, 2).tolist()
                cv2.rectangle(picture, low, high, color, 1)
                if is_missed:
                    write_text(picture, item.name, (low[0], high[1] - 4), color)
        if stamp_ns in poses:
            for found, verdict in zip(objects, scores.verdicts, strict=True):
                draw_box(picture, found, poses[stamp_ns], camera, _COLORS_BGR[verdict])
        else:
            write_text(picture, 'no pose in the main map', (5, 20), _MISSED_BGR)
        drawn.append(picture)
    drawn += [np.zeros_like(drawn[0])] * (-len(drawn) % _COLUMNS)
    rows = [np.hstack(drawn[k : k + _COLUMNS]) for k in range(0, len(drawn), _COLUMNS)]
    _, data = cv2.imencode('.jpg', np.vstack(rows), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
    with written(path):
        path.write_bytes(data.tobytes())
