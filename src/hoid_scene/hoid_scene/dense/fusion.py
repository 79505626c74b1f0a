"""Fusion of one image into submaps: adds surface, and carves free space (decision 022).

Each image adds the surface that it measures and removes the voxels that it sees through, so that
a person who stood still and then left leaves nothing behind. Readings on dynamic objects add no
surface, but the space in front of them is free as well. A voxel is confirmed when enough of the
images that observe it agree. The projective update follows Newcombe et al., KinectFusion (ISMAR
2011), sec. 3.3, with an occupancy count (Hornung et al., OctoMap, 2013) instead of a signed
distance, which would need five times as many voxels.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import Comparison, DepthCamera, DepthView, Surface
from hoid_scene.dense.submap import SIDE, Evidence, Submap, transform
from hoid_scene.place import Anchor, Place


class PosedView(NamedTuple):
    """An image with its pose and its keyframe, for fusion."""

    view: DepthView
    slot: int  # number of the stored image
    anchor: Anchor  # keyframe and pose of the image


class Fusion:
    """Updates the submaps that an image observes, and starts submaps where none exists."""

    def __init__(self, camera: CameraModel, config: DenseConfig) -> None:
        self.camera = DepthCamera(camera, config)
        self._config = config

    def integrate(
        self,
        posed: PosedView,
        submaps: Sequence[Submap],
        only: Collection[Submap] | None = None,
    ) -> list[Submap]:
        """Carve the voxels that an image sees through, then add the surface that it measures.

        Return the created submaps. `only` contains the submaps that may change; None: all may.
        """
        near = self._in_view(posed, submaps)
        observed = [s for s in near if only is None or s in only]
        evidence = self._evidence(posed, observed)
        surfaces, rest = _split(self.camera.measure(posed.view, posed.anchor.T_map_camera), near)
        for submap in observed:
            self._update(submap, posed, evidence[submap], surfaces.get(submap))
        return self._create(posed, rest)

    def _in_view(self, posed: PosedView, submaps: Sequence[Submap]) -> list[Submap]:
        same = [submap for submap in submaps if submap.place.map_id == posed.anchor.map_id]
        if not same:
            return []
        centers_m = _centers_m(same, se3.inverse(posed.anchor.T_map_camera))
        is_near = self.camera.in_view(centers_m, same[0].radius_m)
        return [same[i] for i in np.flatnonzero(is_near)]

    def _evidence(self, posed: PosedView, submaps: list[Submap]) -> dict[Submap, Evidence]:
        """Compare the voxels of submaps with an image.

        A measured surface confirms the voxels within half a voxel of it, not only the one that it
        falls into: a surface on the border of two voxels falls into either at random.
        """
        if not submaps:
            return {}
        T_camera_map = se3.inverse(posed.anchor.T_map_camera)
        points = [transform(T_camera_map @ s.T_map_submap, s.points_m()) for s in submaps]
        seen = self.camera.compare(np.concatenate(points), posed.view)
        masks = self._masks(seen, sum(map(len, points)))
        ends = np.cumsum([len(part) for part in points])[:-1]
        parts = zip(*(np.split(mask, ends) for mask in masks), strict=True)
        return {s: Evidence(*part) for s, part in zip(submaps, parts, strict=True)}

    def _masks(self, seen: Comparison, count: int) -> Evidence:
        margin_m = self._config.carve_margin_m + seen.noise_m
        near_m = 0.5 * self._config.voxel_m + seen.noise_m
        distance_m = np.abs(seen.gap_m)
        chosen = (
            seen.gap_m > margin_m,
            seen.is_static & (distance_m <= margin_m),
            seen.is_static & (distance_m <= near_m),
        )
        masks = [np.zeros(count, np.bool_) for _ in chosen]
        for mask, rows in zip(masks, chosen, strict=True):
            mask[seen.rows[rows]] = True
        return Evidence(*masks)

    def _update(
        self, submap: Submap, posed: PosedView, evidence: Evidence, surface: Surface | None
    ) -> None:
        submap.poses[posed.slot] = se3.inverse(submap.T_map_submap) @ posed.anchor.T_map_camera
        if surface is not None or evidence.is_carved.any() or evidence.is_observed.any():
            submap.fused.add(posed.slot)
            submap.num_fused += 1
            submap.update(evidence, surface)

    def _create(self, posed: PosedView, surface: Surface) -> list[Submap]:
        side_m = SIDE * self._config.voxel_m
        cubes = np.floor(surface.points_m / side_m).astype(np.int64)
        created = []
        while len(cubes):
            submap = Submap(Place.at(cubes[0] * side_m, posed.anchor), self._config)
            surfaces, surface = _split(surface, [submap])
            cubes = np.floor(surface.points_m / side_m).astype(np.int64)
            none = np.zeros(0, np.bool_)
            self._update(submap, posed, Evidence(none, none, none), surfaces[submap])
            created.append(submap)
        return created


def _centers_m(submaps: Iterable[Submap], T: FloatArray) -> FloatArray:
    """Return the centers (N, 3) of submaps, transformed from the map frame."""
    return se3.transform(T, np.array([s.center_map_m for s in submaps]).reshape(-1, 3))


def _split(surface: Surface, submaps: list[Submap]) -> tuple[dict[Submap, Surface], Surface]:
    """Divide a surface among submaps; return each part, in the submap's frame, and the rest.

    The first submap that has space for a voxel gets it, so that the same voxel belongs to the same
    submap until a correction moves the submaps.
    """
    parts = {}
    left = np.arange(len(surface.points_m))
    for submap in submaps:
        x, y, z = surface.points_m[left].T
        center_m, radius_m = submap.center_map_m, submap.radius_m
        near = (np.abs(x - center_m[0]) < radius_m) & (np.abs(y - center_m[1]) < radius_m)
        at = np.flatnonzero(near & (np.abs(z - center_m[2]) < radius_m))
        local_m = se3.transform(se3.inverse(submap.T_map_submap), surface.points_m[left[at]])
        inside = submap.contains(local_m)
        rows = left[at[inside]]
        if len(rows):
            parts[submap] = Surface(
                local_m[inside], surface.colors_bgr[rows], surface.weights[rows]
            )
            left = np.delete(left, at[inside])
    return parts, Surface(*(column[left] for column in surface))
