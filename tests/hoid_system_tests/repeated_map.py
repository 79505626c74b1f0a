"""A large map, made of copies of a small one."""

from __future__ import annotations

import numpy as np

from rgbd_slam.model.map_state import MapState


def repeated(state: MapState, times: int) -> MapState:
    """Return a state with `times` copies of one, as separate maps."""
    arrays = {name: np.concatenate([array] * times) for name, array in state.arrays().items()}
    for name, size in (
        ('parent', len(state)), ('point', len(state.position_m)), ('reference', len(state)),
        ('map_id', 1),
    ):  # fmt: skip
        rows = getattr(state, name)
        arrays[name] = np.concatenate(
            [np.where(rows < 0, rows, rows + n * size) for n in range(times)]
        )
    return MapState.of(arrays)
