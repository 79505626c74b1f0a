"""One picture of the best pictures of several objects, with their classes and numbers."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from hoid_common.values import ByteArray
from hoid_scene.objects.mapped_object import MapObject

_TILE_PX, _TEXT_PX, _MARGIN_PX, _COLUMNS = 150, 22, 6, 5  # chosen: layout of the sheet
_FONT, _FONT_SCALE, _TEXT_BGR = cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40)


def picture_sheet(objects: Sequence[MapObject]) -> ByteArray | None:
    """Return the pictures of objects in rows, (H, W, 3); None without any picture."""
    tiles = [_tile(item) for item in objects if item.jpeg]
    if not tiles:
        return None
    columns = min(len(tiles), _COLUMNS)
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[n : n + columns]) for n in range(0, len(tiles), columns)]
    return np.vstack(rows)


def _tile(item: MapObject) -> ByteArray:
    tile = np.full((_TILE_PX + _TEXT_PX, _TILE_PX, 3), 255, np.uint8)
    text, at = f'{item.class_name} {item.object_id}', (_MARGIN_PX, _TILE_PX + _TEXT_PX // 2)
    cv2.putText(tile, text, at, _FONT, _FONT_SCALE, _TEXT_BGR, 1, cv2.LINE_AA)
    found = cv2.imdecode(np.frombuffer(item.jpeg, np.uint8), cv2.IMREAD_COLOR)
    if found is None:  # a damaged picture may have a valid header
        return tile
    room = _TILE_PX - 2 * _MARGIN_PX
    scale = room / max(found.shape[:2])
    size = [max(1, round(scale * side)) for side in found.shape[1::-1]]
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    small = cv2.resize(found, size, interpolation=method)
    top, left = ((_TILE_PX - side) // 2 for side in small.shape[:2])
    tile[top : top + small.shape[0], left : left + small.shape[1]] = small
    return tile
