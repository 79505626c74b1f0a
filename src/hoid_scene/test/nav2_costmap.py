"""Nav2's static layer and costmap filters by their rules, for tests of the masks.

Written from the behavior of nav2_costmap_2d (static_layer.cpp, keepout_filter.cpp,
speed_filter.cpp, costmap_filter.cpp of Jazzy): each cycle only the window is updated that a layer
has asked for. The window is reset, the static layer writes its cells, and the keep-out filter
raises costs where the mask covers the window; a filter asks for no window itself.
"""

from __future__ import annotations

import numpy as np
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray

LETHAL, UNKNOWN = 254, 255


class Costmap:
    """A global costmap in the map frame with a static layer and both filters."""

    def __init__(self) -> None:
        self.cost: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._static: OccupancyGrid | None = None
        self._cells: NDArray[np.int8] = np.zeros((0, 0), np.int8)
        self._keep_out: OccupancyGrid | None = None
        self._speed: OccupancyGrid | None = None
        self._window: tuple[int, int, int, int] | None = None  # left, top, right, bottom
        self.limit_percent = 0.0  # 0: no limit
        self.num_errors = 0  # that the speed filter would log

    def on_map(self, msg: OccupancyGrid) -> None:
        """Receive the map; the costmap gets its size."""
        self._static = msg
        self._cells = cells_of(msg)
        self.cost = np.full(self._cells.shape, UNKNOWN, np.uint8)
        self._window = 0, 0, msg.info.width, msg.info.height

    def on_update(self, msg: OccupancyGridUpdate) -> None:
        """Receive a part of the map."""
        part = np.array(msg.data, np.int8).reshape(msg.height, msg.width)
        self._cells[msg.y : msg.y + msg.height, msg.x : msg.x + msg.width] = part
        self._window = msg.x, msg.y, msg.x + msg.width, msg.y + msg.height

    def on_keep_out(self, msg: OccupancyGrid) -> None:
        """Receive the mask of the keep-out filter."""
        self._keep_out = msg

    def on_speed(self, msg: OccupancyGrid) -> None:
        """Receive the mask of the speed filter."""
        self._speed = msg

    def cycle(self, x_m: float, y_m: float) -> None:
        """Update the costmap once, with the robot at a point."""
        if self._window is not None and self._static is not None:
            left, top, right, bottom = self._window
            self._window = None
            window = np.s_[top:bottom, left:right]
            cells = self._cells[window]
            self.cost[window] = np.select([cells < 0, cells >= 100], [UNKNOWN, LETHAL], 0)
            self._raise(window)
        self._limit(x_m, y_m)

    def _raise(self, window: tuple[slice, slice]) -> None:
        if self._keep_out is None or self._static is None:
            return
        rows, columns = (np.arange(s.start, s.stop) for s in window)
        mask, value = cells_of(self._keep_out), self.cost[window]
        row = self._index(rows, self._static.info.origin.position.y, 'y')
        column = self._index(columns, self._static.info.origin.position.x, 'x')
        ok = (
            ((row >= 0) & (row < mask.shape[0]))[:, None]
            & (column >= 0)
            & (column < mask.shape[1])
        )
        grid = mask[row.clip(0, mask.shape[0] - 1)][:, column.clip(0, mask.shape[1] - 1)]
        cost = np.rint(grid.astype(float) * LETHAL / 100).astype(np.uint8)
        raised = ok & (grid >= 0) & ((cost > value) | (value == UNKNOWN))
        self.cost[window] = np.where(raised, cost, value)

    def _index(self, cells: NDArray[np.intp], origin_m: float, axis: str) -> NDArray[np.intp]:
        assert self._keep_out is not None
        assert self._static is not None
        info = self._keep_out.info
        center_m = origin_m + (cells + 0.5) * self._static.info.resolution
        gap_m = center_m - float(getattr(info.origin.position, axis))
        return np.asarray(np.floor(gap_m / info.resolution), np.intp)

    def _limit(self, x_m: float, y_m: float) -> None:
        if self._speed is None:
            return
        info = self._speed.info
        column = int(np.floor((x_m - info.origin.position.x) / info.resolution))
        row = int(np.floor((y_m - info.origin.position.y) / info.resolution))
        if not (0 <= row < info.height and 0 <= column < info.width):
            self.num_errors += 1  # the last limit stays
            return
        value = int(cells_of(self._speed)[row, column])
        self.limit_percent = 100.0 - value if value else 0.0


def cells_of(msg: OccupancyGrid) -> NDArray[np.int8]:
    """Return the cells (H, W) of a grid."""
    return np.array(msg.data, np.int8).reshape(msg.info.height, msg.info.width)
