"""Upright boxes in the map frame, true and found ones, and their overlap."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray


class PlacedBox(NamedTuple):
    """A box whose third axis points up."""

    T_map_box: FloatArray  # (4, 4) pose of its center and axes
    size_m: FloatArray  # (3,) extents along its axes

    @classmethod
    def along_map(cls, center_m: FloatArray, size_m: FloatArray) -> PlacedBox:
        """Return the box with a center (3,) and extents (3,) along the axes of the map frame."""
        T = np.eye(4)
        T[:3, 3] = center_m
        return cls(T, size_m)

    @classmethod
    def around(cls, low_m: FloatArray, high_m: FloatArray, T_map_axes: FloatArray) -> PlacedBox:
        """Return the box between two corners (3,) along the axes of a frame (4, 4)."""
        box = cls.along_map((low_m + high_m) / 2, high_m - low_m)
        return cls(T_map_axes @ box.T_map_box, box.size_m)

    @property
    def center_m(self) -> FloatArray:
        """Return the center (3,)."""
        return self.T_map_box[:3, 3]

    def iou(self, other: PlacedBox) -> float:
        """Return the intersection over union of the volumes; other tilts are neglected."""
        T = se3.inverse(self.T_map_box) @ other.T_map_box
        heading_deg = float(np.degrees(np.arctan2(T[1, 0], T[0, 0])))
        own = ((0.0, 0.0), tuple(self.size_m[:2].tolist()), 0.0)
        others = (tuple(T[:2, 3].tolist()), tuple(other.size_m[:2].tolist()), heading_deg)
        _, corners = cv2.rotatedRectangleIntersection(own, others)
        if corners is None:
            return 0.0
        half_m, other_half_m = self.size_m[2] / 2, other.size_m[2] / 2
        low_m, high_m = max(-half_m, T[2, 3] - other_half_m), min(half_m, T[2, 3] + other_half_m)
        shared = cv2.contourArea(cv2.convexHull(corners)) * max(high_m - low_m, 0.0)
        return float(shared / max(self.size_m.prod() + other.size_m.prod() - shared, 1e-9))

    def size_error_m(self, other: PlacedBox) -> float:
        """Return the mean difference of the extents; each is compared with the nearest axis."""
        R = self.T_map_box[:3, :3].T @ other.T_map_box[:3, :3]
        is_swapped = abs(R[0, 1]) > abs(R[0, 0])
        sizes_m = other.size_m[[1, 0, 2]] if is_swapped else other.size_m
        return float(np.abs(self.size_m - sizes_m).mean())

    @property
    def area_m2(self) -> float:
        """Return the area of the footprint."""
        return float(self.size_m[:2].prod())


def least_area_axes(points_m: FloatArray) -> FloatArray:
    """Return a frame (4, 4), z up, along the least rectangle around the x and y of points."""
    _, _, angle_deg = cv2.minAreaRect(points_m[:, :2].astype(np.float32))
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    T = np.eye(4)
    T[:2, :2] = (cosine, -sine), (sine, cosine)
    return T
