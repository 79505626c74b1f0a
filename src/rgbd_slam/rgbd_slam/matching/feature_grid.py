"""An index of the features of a frame, for searches in windows around pixels."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.model.frame import Frame

_BAND_PX = 16.0  # not tuned: height of the bands of rows by which features are sorted
# Chosen: more than the width of any image, so that keys of different bands do not overlap.
_ROW_PX = 65536.0


class FeatureGrid:
    """Features sorted by band of image rows, then by column.

    In each band, the features in a window are a slice, which `searchsorted` finds for all windows
    at once.
    """

    def __init__(self, frame: Frame) -> None:
        u, v = frame.measurement_px[:, 0], frame.measurement_px[:, 1]
        self._low_v = float(v.min()) if len(v) else 0.0
        key = np.floor((v - self._low_v) / _BAND_PX) * _ROW_PX + u.astype(np.float64)
        self._order = np.argsort(key, kind='stable')
        self._key = key[self._order]
        self._uv = np.ascontiguousarray(frame.measurement_px[self._order, :2].T)

    def search(self, uv_px: FloatArray, radius_px: FloatArray) -> tuple[IntArray, IntArray]:
        """Return windows (C,) and features (C,) of all pairs of a window and a feature in it.

        Args:
            uv_px: (2, Q) centers of the windows.
            radius_px: (Q,) half sides of the square windows.
        """
        u, v = uv_px
        band = np.floor((v - radius_px - self._low_v) / _BAND_PX)
        last = np.floor((v + radius_px - self._low_v) / _BAND_PX)
        spans = (last - band).astype(np.int64) + 1
        if len(spans) == 0 or len(self._order) == 0:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        query = np.repeat(np.arange(len(u)), spans)
        base = (_ranges(spans) + band[query]) * _ROW_PX + u[query]
        reach = radius_px[query]
        start = np.searchsorted(self._key, base - reach)
        count = np.searchsorted(self._key, base + reach) - start
        query = np.repeat(query, count)
        row = np.repeat(start, count) + _ranges(count)
        near = np.abs(self._uv[1][row] - v[query]) < radius_px[query]
        return query[near], self._order[row[near]]


def _ranges(counts: IntArray) -> IntArray:
    """Return arange(count) for each count, concatenated."""
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    out: IntArray = np.arange(total) - np.repeat(ends - counts, counts)
    return out
