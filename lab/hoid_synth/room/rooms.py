"""Furnishing of one room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.mesh import Mesh, Surface, box, merged, quad
from hoid_synth.noise import Rng
from hoid_synth.room import furniture
from hoid_synth.room.world import Lamp, WorldBuilder, pose
from hoid_synth.texture import pictures, prints
from hoid_synth.texture.palette import Studio, make_palette, picture

HEIGHT_M = 2.6
DEPTH_M = 5.6
_SCREEN_TURN_RAD, _COUCH_TURN_RAD = 0.4, 0.6  # limited by what stands behind and beside

# Width in m, and the function that places it.
Slot = tuple[float, Callable[[WorldBuilder, FloatArray], None]]


class Furnisher:
    """Places furniture, pictures and walls of one room.

    Args:
        studio: Makes the pictures, with the random numbers of the room.
        builder: Receives what is placed.
        x0: Position of the left wall.
        width_m: Width of the room.
        turns: Random numbers of the angles by which furniture is turned; None: it is not turned.
        is_bare: Whether no pictures hang on the walls.
    """

    def __init__(
        self,
        studio: Studio,
        builder: WorldBuilder,
        x0: float,
        width_m: float,
        turns: Rng | None = None,
        *,
        is_bare: bool = False,
    ) -> None:
        self.studio, self.rng, self.builder = studio, studio.rng, builder
        self.palette = make_palette(studio)
        self.x0, self.width_m = x0, width_m
        self._turns, self._is_bare = turns, is_bare

    def turn_rad(self, most_rad: float) -> float:
        """Return a random angle by which a piece of furniture is turned, or 0."""
        return 0.0 if self._turns is None else float(self._turns.uniform(-most_rad, most_rad))

    def wall_pose(self, wall: str, along_m: float) -> FloatArray:
        """Return the pose (4, 4) of furniture at a wall, `along_m` from the wall's left end."""
        x0, x1, y1 = self.x0, self.x0 + self.width_m, DEPTH_M
        return {
            'back': pose(x0 + along_m, y1, 0, 0),
            'left': pose(x0, along_m, 0, np.pi / 2),
            'right': pose(x1, y1 - along_m, 0, -np.pi / 2),
            'front': pose(x1 - along_m, 0, 0, np.pi),
        }[wall]

    def shell(self, open_sides: tuple[str, ...], accent: str) -> None:
        """Add floor, ceiling, and all walls but the open sides."""
        w, d, h = self.width_m, DEPTH_M, HEIGHT_M
        p, at = self.palette, pose(self.x0, 0, 0, 0)
        walls = {
            'back': ((0, d, h), (w, 0, 0)),
            'left': ((0, 0, h), (0, d, 0)),
            'right': ((w, d, h), (0, -d, 0)),
            'front': ((w, 0, h), (-w, 0, 0)),
        }
        parts = [
            quad((0, d, 0), (w, 0, 0), (0, -d, 0), p.floor),
            quad((0, 0, h), (w, 0, 0), (0, d, 0), p.ceiling),
        ]
        for name, (origin, edge) in walls.items():
            if name in open_sides:
                continue
            surface = p.accent if name == accent else p.wall
            parts.append(quad(origin, edge, (0, 0, -h), surface))
            parts.append(_skirting(name, w, d, p.white))
        self.builder.add(merged(parts), at)
        add_ceiling_lamp(self.studio, self.builder, self.x0 + w / 2, d / 2)

    def window(self, wall: str, along_m: float) -> None:
        """Place a window with curtains on a wall, which lights the room."""
        T = self.wall_pose(wall, along_m)
        self.builder.add(furniture.window(self.studio, self.palette, 1.7, 1.25), T)
        inside = (T @ pose(0, -0.3, 1.5, 0))[:3, 3]
        spread = [[-0.6, 0, -0.4], [0.6, 0, -0.4], [0, 0, 0.4]]
        self.builder.lamps.append(Lamp(inside + np.array(spread) @ T[:3, :3].T, 1.5))

    def hang(
        self, wall: str, along_m: float, height_m: float, size_m: tuple[float, float], s: Surface
    ) -> None:
        """Place a flat object on a wall."""
        w, h = size_m[0] / 2, size_m[1]
        front = box(
            (-w, -0.02, height_m),
            (w, -0.002, height_m + h),
            self.palette.white,
            {'front': s},
            ('back',),
        )
        self.builder.add(front, self.wall_pose(wall, along_m))

    def pictures(
        self, wall: str, spans: list[tuple[float, float]], low_m: float, top_m: float = 2.3
    ) -> None:
        """Place pictures side by side above spans of a wall."""
        for start, end in () if self._is_bare else spans:
            along = start
            while end - along > 0.35:
                width = min(float(self.rng.uniform(0.38, 0.85)), end - along)
                height = min(width * float(self.rng.uniform(0.75, 1.45)), top_m - low_m)
                z = low_m + (top_m - low_m - height) * float(self.rng.uniform(0.3, 0.7))
                self.hang(
                    wall,
                    along + width / 2,
                    z,
                    (width, height),
                    picture(self.studio, width, height),
                )
                along += width + float(self.rng.uniform(0.12, 0.4))

    def clock(self, wall: str, along_m: float) -> None:
        """Place a clock high on a wall."""
        face = self.studio.sheet(
            prints.clock(self.studio.paint(), self.studio.shape(0.34, 0.34, 1.5))
        )
        mesh = box(
            (-0.17, -0.04, 2.08),
            (0.17, -0.002, 2.42),
            self.palette.black,
            {'front': face},
            ('back',),
        )
        self.builder.add(mesh, self.wall_pose(wall, along_m), 'clock')

    def desk(self, builder: WorldBuilder, T: FloatArray, width_m: float = 1.5) -> None:
        """Place a desk with a computer, a chair and pictures above."""
        p, h, w = self.palette, furniture.DESK_HEIGHT_M, width_m / 2
        builder.add(furniture.desk(p, width_m), T, '', (-w, -0.62, w, 0))
        side = -1.0 if self.rng.random() < 0.5 else 1.0
        x = 0.28 * side
        screen_at = T @ pose(x, -0.17, h, self.turn_rad(_SCREEN_TURN_RAD))
        builder.add(furniture.monitor(self.studio, p), screen_at, 'tv')
        keys = self.studio.sheet(
            prints.keyboard(self.studio.paint(), self.studio.shape(0.42, 0.15, 2.0))
        )
        board = box((-0.21, -0.075, 0), (0.21, 0.075, 0.02), p.black, {'top': keys})
        builder.add(board, T @ pose(x, -0.45, h, float(self.rng.uniform(-0.1, 0.1))), 'keyboard')
        for _ in range(2):
            sheet = self.studio.sheet(
                prints.paper(self.studio.paint(), self.studio.shape(0.21, 0.3, 1.5))
            )
            flat = box((-0.105, -0.15, 0), (0.105, 0.15, 0.004), p.white, {'top': sheet})
            at = pose(
                -x + float(self.rng.uniform(-0.1, 0.1)),
                -0.16,
                h + 0.001,
                float(self.rng.uniform(-0.6, 0.6)),
            )
            builder.add(flat, T @ at)
        builder.add_spot(T, (-0.42 * side, -0.36, h), (-0.42 * side, -1.0))
        yaw_rad = np.pi + float(self.rng.uniform(-0.35, 0.35)) + self.turn_rad(np.pi)
        chair_at = pose(x, -0.86, 0, yaw_rad)
        builder.add(
            furniture.chair(self.studio, p), T @ chair_at, 'chair', (-0.25, -0.25, 0.25, 0.25)
        )

    def bookshelf(self, builder: WorldBuilder, T: FloatArray, width_m: float = 1.1) -> None:
        """Place a bookshelf."""
        w = width_m / 2
        builder.add(
            furniture.bookshelf(self.studio, self.palette, width_m), T, '', (-w, -0.3, w, 0)
        )

    def cupboard(self, builder: WorldBuilder, T: FloatArray, width_m: float = 1.0) -> None:
        """Place a wardrobe."""
        w = width_m / 2
        builder.add(
            furniture.cupboard(self.studio, self.palette, width_m), T, '', (-w, -0.52, w, 0)
        )

    def sideboard(self, builder: WorldBuilder, T: FloatArray, width_m: float = 1.5) -> None:
        """Place a sideboard with a television and spots for objects."""
        p, h, w = self.palette, furniture.SIDEBOARD_HEIGHT_M, width_m / 2
        builder.add(furniture.sideboard(self.studio, p, width_m), T, '', (-w, -0.38, w, 0))
        screen_at = T @ pose(-w + 0.48, -0.18, h, self.turn_rad(_SCREEN_TURN_RAD))
        builder.add(furniture.monitor(self.studio, p, 0.8), screen_at, 'tv')
        for x in (0.3, 0.58):
            builder.add_spot(T, (x, -0.19, h), (x, -0.78))

    def couch(self, builder: WorldBuilder, T: FloatArray) -> None:
        """Place a sofa."""
        yaw_rad = self.turn_rad(_COUCH_TURN_RAD)
        T = T @ pose(0, -0.95 * abs(np.sin(yaw_rad)), 0, yaw_rad)  # its corner is at the wall
        builder.add(furniture.couch(self.palette), T, 'couch', (-0.95, -0.9, 0.95, 0))

    def standing(self, mesh: Mesh, x: float, y: float, class_name: str, half_m: float) -> None:
        """Place a free-standing object."""
        T = pose(self.x0 + x, y, 0, float(self.rng.uniform(-3, 3)))
        self.builder.add(mesh, T, class_name, (-half_m, -half_m, half_m, half_m))

    def table_group(self, x: float, y: float, yaw_rad: float) -> None:
        """Place a rug, a table with chairs at its ends, and spots for objects on and around it."""
        p, b, h = self.palette, self.builder, furniture.TABLE_HEIGHT_M
        T = pose(self.x0 + x, y, 0, yaw_rad)
        image = prints.rug(self.studio.paint(), self.studio.shape(2.8, 1.9, 0.9))
        b.add(
            box(
                (-1.4, -0.95, 0.0), (1.4, 0.95, 0.008), self.studio.sheet(image), omit=('bottom',)
            ),
            T,
        )
        b.add(furniture.table(p, 1.5, 0.8), T, 'dining table', (-0.75, -0.4, 0.75, 0.4))
        for side in (-1, 1):
            at = pose(
                side * 0.98,
                float(self.rng.uniform(-0.1, 0.1)),
                0,
                -side * np.pi / 2 + self.rng.uniform(-0.4, 0.4) + self.turn_rad(np.pi),
            )
            b.add(furniture.chair(self.studio, p), T @ at, 'chair', (-0.25, -0.25, 0.25, 0.25))
            for dx in (-0.48, 0.0, 0.48):
                b.add_spot(T, (dx, side * 0.22, h), (dx, side * 0.8))

    def along(
        self, wall: str, slots: list[Slot], start_m: float, end_m: float
    ) -> list[tuple[float, float]]:
        """Place furniture along a wall in random order; return the covered spans."""
        order = self.rng.permutation(len(slots))
        free = end_m - start_m - sum(s[0] for s in slots)
        gaps = self.rng.dirichlet(np.full(len(slots) + 1, 2.0)) * max(free, 0.0)
        at = start_m
        spans = []
        for gap, k in zip(gaps, order, strict=False):
            width, place = slots[int(k)]
            at += float(gap)
            place(self.builder, self.wall_pose(wall, at + width / 2))
            spans.append((at, at + width))
            at += width
        return spans


def add_ceiling_lamp(studio: Studio, builder: WorldBuilder, x_m: float, y_m: float) -> None:
    """Add a square lamp at the ceiling."""
    corners = [[-0.3, -0.3], [-0.3, 0.3], [0.3, -0.3], [0.3, 0.3]]
    middle = np.array([x_m, y_m, HEIGHT_M - 0.12])
    builder.lamps.append(Lamp(middle + np.pad(corners, ((0, 0), (0, 1))), 3.2))
    shade = studio.sheet(pictures.filled((32, 32), (205, 230, 245)), glow=1.0)
    builder.add(box((-0.3, -0.3, 0), (0.3, 0.3, 0.06), shade), pose(x_m, y_m, HEIGHT_M - 0.06, 0))


def _skirting(wall: str, w: float, d: float, s: Surface) -> Mesh:
    low, high = {
        'back': ((0, d - 0.015, 0), (w, d, 0.08)),
        'left': ((0, 0, 0), (0.015, d, 0.08)),
        'right': ((w - 0.015, 0, 0), (w, d, 0.08)),
        'front': ((0, 0, 0), (w, 0.015, 0.08)),
    }[wall]
    return box(low, high, s, omit=('bottom',))
