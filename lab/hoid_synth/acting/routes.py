"""Paths around the furniture by A* on a grid."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, FloatArray
from hoid_synth.mesh import Rect, Vector
from hoid_synth.room.world import World

CELL_M = 0.1
BODY_RADIUS_M = 0.27
_DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
_STEPS = tuple((dr, dc, math.hypot(dr, dc)) for dr, dc in _DIRECTIONS)


class FloorMap:
    """Grid of the floor where a person can walk."""

    def __init__(self, world: World, keep_out: Sequence[Rect] = ()) -> None:
        self._size_m = max(r[2] for r in world.rooms), max(r[3] for r in world.rooms)
        columns, rows = (int(np.ceil(s / CELL_M)) for s in self._size_m)
        walls = np.ones((rows, columns), np.uint8)
        for room in world.rooms:
            _fill(walls, room, 0)
        for doorway in world.doorways:
            _fill(walls, (doorway[0] - 0.1, doorway[1], doorway[2] + 0.1, doorway[3]), 0)
        for rect in (*world.obstacles, *keep_out):
            _fill(walls, rect, 1)
        self._blocked = _grown(walls)
        self._empty = walls

    def route(self, start_m: Vector, end_m: Vector, around: Sequence[Rect] = ()) -> FloatArray:
        """Return the points (N, 2) of a path from start to end; N = 0 if there is none."""
        blocked = self._blocked
        if around:
            walls = self._empty.copy()
            for rect in around:
                _fill(walls, rect, 1)
            blocked = _grown(walls)
        straight = np.array([start_m, end_m], float)
        if _line_free(straight[0], straight[1], blocked):
            return straight
        cells = _a_star(blocked, self._cell(start_m), self._cell(end_m))
        if not cells:
            return np.empty((0, 2))
        points = (np.array(cells)[:, ::-1] + 0.5) * CELL_M
        points[0], points[-1] = start_m, end_m
        return _smoothed(_pulled(points, blocked))

    def is_free(self, at_m: Vector) -> bool:
        """Return whether a person can stand at a position."""
        return not self._blocked[self._cell(at_m)]

    def _cell(self, at_m: Vector) -> tuple[int, int]:
        rows, columns = self._blocked.shape
        return (
            min(max(int(at_m[1] / CELL_M), 0), rows - 1),
            min(max(int(at_m[0] / CELL_M), 0), columns - 1),
        )


def _fill(walls: ByteArray, rect: Rect, value: int) -> None:
    x1, y1, x2, y2 = (max(0, round(v / CELL_M)) for v in rect)
    walls[y1 : max(y2, y1 + 1), x1 : max(x2, x1 + 1)] = value


def _grown(walls: ByteArray) -> BoolArray:
    framed = cv2.copyMakeBorder(walls, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=[1])
    distance = cv2.distanceTransform(1 - framed, cv2.DIST_L2, 5)[1:-1, 1:-1] * CELL_M
    return np.asarray(distance < BODY_RADIUS_M)


def _a_star(
    blocked: BoolArray, start: tuple[int, int], end: tuple[int, int]
) -> list[tuple[int, int]]:
    """Return the cells of a shortest path; start and end may lie in blocked cells."""
    rows, columns = blocked.shape
    to_end = np.hypot(*np.ogrid[-end[0] : rows - end[0], -end[1] : columns - end[1]]).tolist()
    weight = np.where(blocked, 8.0, 1.0).tolist()
    cost = {start: 0.0}
    parent: dict[tuple[int, int], tuple[int, int]] = {}
    queue = [(0.0, start)]
    while queue:
        _, here = heapq.heappop(queue)
        if here == end:
            return _unrolled(parent, end)
        for dr, dc, length in _STEPS:
            row, column = there = here[0] + dr, here[1] + dc
            if not (0 <= row < rows and 0 <= column < columns):
                continue
            price = cost[here] + length * weight[row][column]
            if price < cost.get(there, math.inf):
                cost[there], parent[there] = price, here
                heapq.heappush(queue, (price + to_end[row][column], there))
    return []


def _unrolled(
    parent: dict[tuple[int, int], tuple[int, int]], end: tuple[int, int]
) -> list[tuple[int, int]]:
    cells = [end]
    while cells[-1] in parent:
        cells.append(parent[cells[-1]])
    return cells[::-1]


def _pulled(points: FloatArray, blocked: BoolArray) -> FloatArray:
    """Return the path without the corners that a straight free line can skip."""
    kept = [points[0]]
    k = 0
    while k < len(points) - 1:
        ahead = len(points) - 1
        while ahead > k + 1 and not _line_free(points[k], points[ahead], blocked):
            ahead -= 1
        kept.append(points[ahead])
        k = ahead
    return np.array(kept)


def _line_free(a: FloatArray, b: FloatArray, blocked: BoolArray) -> bool:
    steps = int(np.ceil(np.linalg.norm(b - a) / (0.5 * CELL_M))) + 1
    cells = ((a + np.linspace(0, 1, steps)[:, None] * (b - a)) / CELL_M).astype(int)
    rows = np.clip(cells[:, 1], 0, blocked.shape[0] - 1)
    columns = np.clip(cells[:, 0], 0, blocked.shape[1] - 1)
    return not blocked[rows, columns][1:-1].any()


def _smoothed(points: FloatArray, rounds: int = 3) -> FloatArray:
    """Return the path with rounded corners (Chaikin, 1974) and the same ends."""
    for _ in range(rounds):
        a, b = points[:-1], points[1:]
        inner = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], 1).reshape(-1, 2)
        points = np.concatenate([points[:1], inner[1:-1], points[-1:]])
    return points
