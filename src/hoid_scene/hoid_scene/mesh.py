"""A mesh of the dense map, computed with scikit-image and written with trimesh (extra `mesh`).

The surface is where the mean of the distances from the tangent planes of near points is 0 (Hoppe
et al., SIGGRAPH 1992; the weights are those of implicit moving least squares, Kolluri, SODA 2005).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import BoolArray, ByteArray, CameraModel, FloatArray, IntArray
from hoid_scene.dense.cloud_labels import CloudLabels
from hoid_scene.dense.submap import ColoredCloud

# Chosen, none is tuned: number of neighbors from which a normal is computed; distance in cells up
# to which a point has weight, and standard deviation of this weight; least sum of weights at a
# corner of a surface.
_NEIGHBORS, _REACH, _SIGMA, _MIN_WEIGHT = 16, 2, 0.8, 0.3
_BLOCK = 96  # cells along a side of a block: the grid of one takes 30 MB
_MIN_FACES = 50  # smaller pieces of the surface are noise, and left out
# A camera sees a point if no other point in the same cell of its image, which has so many columns
# and rows, is nearer by more than this. At most so many cameras are used, and only points up to
# this range.
_OCCLUDED_M, _COLUMNS, _ROWS, _MAX_CAMERAS, _RANGE_M = 0.15, 64, 48, 300, 6.0
_T_GLTF_MAP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # y points up
_SEMANTIC_HUE = 0.61803  # golden ratio: colors of numbers that follow each other differ most

_cubes: Any = marching_cubes  # it has no type hints


class Mesh(NamedTuple):
    """Triangles with a color, and a label for each vertex."""

    vertices_m: FloatArray  # (V, 3), map frame
    faces: IntArray  # (F, 3) indices of vertices, counterclockwise seen from outside
    colors_bgr: ByteArray  # (V, 3)
    labels: NDArray[np.uint32]  # (V,) as in `CloudLabels`
    class_names: Sequence[str]  # name of the class by label - 1


def mesh_of(
    cloud: ColoredCloud,
    labels: CloudLabels | None,
    voxel_m: float,
    camera: CameraModel,
    T_map_camera: FloatArray,
) -> Mesh:
    """Return the mesh of a cloud; its faces point to the cameras (K, 4, 4) that see them.

    InputError if the cloud has no surface.
    """
    points_m = cloud.points_m.astype(np.float64)
    tree = cKDTree(points_m)
    normals = _normals(points_m, tree, _view_directions(points_m, camera, T_map_camera))
    parts = list(_blocks(points_m, normals, voxel_m))
    if not parts:
        raise InputError('the dense map has no surface yet: show the camera the place longer')
    found = _joined(parts)
    vertices_m = np.asarray(found.vertices, np.float64)
    _, nearest = tree.query(vertices_m)
    number = np.zeros(len(points_m), np.uint32) if labels is None else labels.labels
    names = () if labels is None else labels.class_names
    return Mesh(
        vertices_m, np.asarray(found.faces), cloud.colors_bgr[nearest], number[nearest], names
    )


def _joined(parts: Sequence[tuple[FloatArray, IntArray]]) -> Any:
    """Return parts (V, 3), (F, 3) as one mesh; pieces of fewer than 50 faces are left out."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = np.concatenate([part + start for (_, part), start in zip(parts, starts, strict=True)])
    found = trimesh.Trimesh(np.concatenate([vertices for vertices, _ in parts]), faces)
    label: Any = trimesh.graph.connected_component_labels
    pieces = label(found.face_adjacency, len(found.faces))
    found.update_faces(np.bincount(pieces)[pieces] >= _MIN_FACES)
    found.remove_unreferenced_vertices()
    return found


def semantic_colors(labels: NDArray[np.uint32], colors_bgr: ByteArray) -> ByteArray:
    """Return a color (N, 3) for each label: one for each class, and gray where there is none."""
    hue = (180 * (labels * _SEMANTIC_HUE % 1)).astype(np.uint8)
    hsv = np.stack([hue, np.full_like(hue, 200), np.full_like(hue, 230)], axis=1)
    of_class = np.asarray(cv2.cvtColor(hsv[None], cv2.COLOR_HSV2BGR), np.uint8)[0]
    gray = colors_bgr.mean(axis=1, keepdims=True).astype(np.uint8).repeat(3, axis=1)
    return np.asarray(np.where(labels[:, None] > 0, of_class, gray), np.uint8)


def write_mesh(path: Path, mesh: Mesh, *, is_semantic: bool = False) -> None:
    """Write a mesh as binary PLY or as GLB, by the ending of the path.

    In a GLB, the y axis points up. A semantic mesh has the colors of classes, and in PLY a
    property `label` of each vertex and comments with the names.
    """
    colors = semantic_colors(mesh.labels, mesh.colors_bgr) if is_semantic else mesh.colors_bgr
    out: Any = trimesh.Trimesh(
        mesh.vertices_m, mesh.faces, vertex_colors=colors[:, ::-1], process=False
    )
    if path.suffix == '.glb':
        out.apply_transform(_T_GLTF_MAP)
        path.write_bytes(out.export(file_type='glb'))
        return
    if is_semantic:
        out.vertex_attributes['label'] = mesh.labels.astype(np.int32)
    data: bytes = out.export(file_type='ply', vertex_normal=False)
    names = [f'comment label {n} {name}\n' for n, name in enumerate(mesh.class_names, 1) if name]
    first = data.index(b'element vertex')
    comments = ''.join(names if is_semantic else [])
    path.write_bytes(data[:first] + comments.encode() + data[first:])


def _normals(points_m: FloatArray, tree: Any, towards: FloatArray) -> FloatArray:
    """Return the unit normals (N, 3) of points, on the side of the directions (N, 3)."""
    out = np.empty_like(points_m)
    for start in range(0, len(points_m), 100_000):
        rows = slice(start, start + 100_000)
        _, near = tree.query(points_m[rows], min(_NEIGHBORS, len(points_m)))
        local_m = points_m[near] - points_m[near].mean(axis=1, keepdims=True)
        _, vectors = np.linalg.eigh(np.einsum('nki,nkj->nij', local_m, local_m))
        out[rows] = vectors[:, :, 0]
    is_behind = (out * towards).sum(axis=1) < 0
    out[is_behind] *= -1
    return out


def _view_directions(
    points_m: FloatArray, camera: CameraModel, T_map_camera: FloatArray
) -> FloatArray:
    """Return the sums (N, 3) of the unit vectors from points to the cameras that see them.

    For points that no used camera sees, it is the vector to the nearest camera.
    """
    out = np.zeros_like(points_m)
    for T in T_map_camera[:: max(1, -(-len(T_map_camera) // _MAX_CAMERAS))]:
        local_m = se3.transform(se3.inverse(T), points_m)
        ahead = np.flatnonzero((local_m[:, 2] > 0.1) & (local_m[:, 2] < _RANGE_M))
        uv = camera.project_px(local_m[ahead])
        sides = np.array([camera.width_px, camera.height_px])
        inside = ((uv >= 0) & (uv < sides)).all(axis=1)
        ahead, uv = ahead[inside], uv[inside]
        column, row = (uv / sides * (_COLUMNS, _ROWS)).astype(np.int64).T
        cell, depth_m = row * _COLUMNS + column, local_m[ahead, 2]
        nearest_m = np.full((_ROWS, _COLUMNS), np.inf)
        np.minimum.at(nearest_m.reshape(-1), cell, depth_m)
        # 3x3: some cells have no point.
        hidden_m = minimum_filter(nearest_m, 3).reshape(-1) + _OCCLUDED_M
        seen = ahead[depth_m < hidden_m[cell]]
        rays_m = T[:3, 3] - points_m[seen]
        out[seen] += rays_m / np.linalg.norm(rays_m, axis=1, keepdims=True)
    is_unseen = ~out.any(axis=1)
    _, nearest = cKDTree(T_map_camera[:, :3, 3]).query(points_m[is_unseen])
    out[is_unseen] = T_map_camera[nearest, :3, 3] - points_m[is_unseen]
    return out


def _blocks(
    points_m: FloatArray, normals: FloatArray, cell_m: float
) -> Iterator[tuple[FloatArray, IntArray]]:
    """Yield vertices (V, 3) [m] and faces (F, 3) of the surface in each block of the grid."""
    grid = points_m / cell_m
    block = np.floor(grid / _BLOCK).astype(np.int64)
    for corner in np.unique(block, axis=0) * _BLOCK:
        low, high = corner - _REACH, corner + _BLOCK + 1 + _REACH
        inside = ((grid >= low) & (grid < high)).all(axis=1)
        found = _surface(grid[inside] - corner, normals[inside])
        if found is not None:
            yield (found[0] + corner) * cell_m, found[1]


def _surface(points: FloatArray, normals: FloatArray) -> tuple[FloatArray, IntArray] | None:
    """Return the surface of points (N, 3) in one block, in cells; None if there is none."""
    side = _BLOCK + 1
    total, weights = _summed(points, normals, side)
    is_known: BoolArray = (weights > _MIN_WEIGHT).reshape(side, side, side)
    mean = (total / np.maximum(weights, _MIN_WEIGHT)).reshape(side, side, side)
    if not is_known.any() or mean[is_known].min() >= 0 or mean[is_known].max() <= 0:
        return None
    # scikit-image takes a cell if the mask is set at its last corner; all eight must be known.
    is_used = minimum_filter(is_known, 2)
    try:
        vertices, faces, *_ = _cubes(mean, 0.0, mask=is_used, gradient_direction='descent')
    except (ValueError, RuntimeError):  # no cell has a surface
        return None
    # Rounded, so that vertices on the border of two blocks are the same in both.
    return vertices.astype(np.float64).round(3), faces.astype(np.int64)


def _summed(points: FloatArray, normals: FloatArray, side: int) -> tuple[FloatArray, FloatArray]:
    """Return sums for each corner (side ** 3,) of the cells of a block.

    These are weighted distances [cells] from the tangent planes of points, and the weights.
    """
    total, weights = np.zeros(side**3), np.zeros(side**3)
    first = np.floor(points).astype(np.int64)
    steps = range(1 - _REACH, 1 + _REACH)
    for step in product(steps, steps, steps):
        corner = first + step
        used = ((corner >= 0) & (corner < side)).all(axis=1)
        offset = corner[used] - points[used]
        weight = np.exp((offset**2).sum(axis=1) / (-2 * _SIGMA**2))
        at = corner[used] @ np.array([side * side, side, 1])
        height = (offset * normals[used]).sum(axis=1)
        total += np.bincount(at, weight * height, side**3)
        weights += np.bincount(at, weight, side**3)
    return total, weights
