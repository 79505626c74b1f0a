"""Meshes of clouds: where the surface is, which side is its front, and what files have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import InputError
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, FloatArray
from hoid_scene.dense.cloud_labels import CloudLabels
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.mesh import Mesh, mesh_of, write_mesh

trimesh: Any = pytest.importorskip(
    'trimesh', reason='meshes are an optional extra: requirements/mesh.lock'
)
CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
VOXEL_M = 0.025
RED, BLUE = (20, 30, 200), (210, 40, 10)


def mesh(points_m: FloatArray, T_map_camera: FloatArray, sigma_m: float = 0.003) -> Mesh:
    """Return the mesh of noisy points, red and a cup where y > 0, otherwise blue and nothing."""
    noise = np.random.default_rng(0).normal(0, sigma_m, points_m.shape)
    is_left = points_m[:, 1] > 0
    cloud = ColoredCloud(
        (points_m + noise).astype(np.float32), np.where(is_left[:, None], RED, BLUE).astype('u1')
    )
    labels = CloudLabels(is_left.astype(np.uint32), ('cup',))
    return mesh_of(cloud, labels, VOXEL_M, CAMERA, T_map_camera)


def wall(size_m: float = 3.0) -> FloatArray:
    """Return the points of a wall at x = 2 m, over several blocks of the grid."""
    side = np.arange(-size_m / 2, size_m / 2, VOXEL_M)
    return np.stack([np.full(len(side) ** 2, 2.0), *map(np.ravel, np.meshgrid(side, side))], 1)


@pytest.fixture(scope='module')
def of_wall() -> Mesh:
    return mesh(wall(), T_BODY_OPTICAL[None])


def test_a_wall_is_one_flat_piece_that_faces_the_camera(of_wall: Mesh) -> None:
    assert np.abs(of_wall.vertices_m[:, 0] - 2.0).max() < 0.012
    assert np.abs(of_wall.vertices_m[:, 0] - 2.0).mean() < 0.003
    found = trimesh.Trimesh(of_wall.vertices_m, of_wall.faces, process=False)
    assert found.body_count == 1
    assert found.area == pytest.approx(9.0, rel=0.05)
    assert (found.face_normals[:, 0] < -0.7).all()
    edges = found.edges_sorted[trimesh.grouping.group_rows(found.edges_sorted, require_count=1)]
    inner = np.abs(found.vertices[edges].mean(axis=1)[:, 1:]).max(axis=1) < 1.4
    assert not inner.any()  # neither a hole nor a seam between blocks


def test_colors_and_labels_are_those_of_the_nearest_points(of_wall: Mesh) -> None:
    is_left = of_wall.vertices_m[:, 1] > VOXEL_M
    is_right = of_wall.vertices_m[:, 1] < -VOXEL_M
    assert (of_wall.colors_bgr[is_left] == RED).all()
    assert (of_wall.colors_bgr[is_right] == BLUE).all()
    assert of_wall.labels[is_left].all()
    assert not of_wall.labels[is_right].any()


def test_a_wall_between_two_rooms_has_two_fronts() -> None:
    back = T_BODY_OPTICAL.copy()
    back[:3, :3] = np.diag([-1.0, -1, 1]) @ back[:3, :3]
    back[0, 3] = 4.2
    points = np.concatenate([wall(1.0), wall(1.0) + np.array([0.2, 0, 0])])
    found = mesh(points, np.array([T_BODY_OPTICAL, back]))
    solid = trimesh.Trimesh(found.vertices_m, found.faces, process=False)
    x, normals = solid.triangles_center[:, 0], solid.face_normals[:, 0]
    assert (normals[x < 2.1] < 0).all()
    assert (normals[x > 2.1] > 0).all()


def looking_at_origin(direction: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of a camera 1.5 m from the origin, in a direction (3,)."""
    T = np.eye(4)
    ahead = -direction / np.linalg.norm(direction)
    right = np.cross(ahead, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    T[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    T[:3, 3] = -1.5 * ahead
    return T


def test_a_ball_has_its_radius() -> None:
    n = np.arange(2000)  # spread evenly, as the points of voxels are (Fibonacci lattice)
    z, turn = 1 - (2 * n + 1) / len(n), n * np.pi * (1 + np.sqrt(5))
    points = 0.3 * np.stack([np.cos(turn), np.sin(turn), z], 1)
    points[:, :2] *= np.sqrt(1 - z**2)[:, None]
    ring = [looking_at_origin(np.array(axis)) for axis in np.concatenate([np.eye(3), -np.eye(3)])]
    found = mesh(points, np.array(ring), 0.0)
    radii = np.linalg.norm(found.vertices_m, axis=1)
    assert radii == pytest.approx(0.3, abs=0.01)
    assert trimesh.Trimesh(found.vertices_m, found.faces, process=False).is_watertight


def test_a_file_has_the_mesh_and_the_names_of_its_labels(of_wall: Mesh, tmp_path: Path) -> None:
    plain, semantic, glb = (tmp_path / name for name in ('a.ply', 'b.ply', 'c.glb'))
    write_mesh(plain, of_wall)
    write_mesh(semantic, of_wall, is_semantic=True)
    write_mesh(glb, of_wall)
    read = trimesh.load(plain, process=False)
    np.testing.assert_allclose(read.vertices, of_wall.vertices_m, atol=1e-6)
    np.testing.assert_array_equal(read.faces, of_wall.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, 2::-1], of_wall.colors_bgr)
    assert b'comment label 1 cup\n' in semantic.read_bytes()
    read = trimesh.load(semantic, process=False)
    labels = read.metadata['_ply_raw']['vertex']['data']['label']
    np.testing.assert_array_equal(labels, of_wall.labels)
    scene = trimesh.load(glb)
    low, high = scene.bounds
    assert (low[2], high[2]) == pytest.approx((-1.5, 1.5), abs=0.06)  # map y is glTF -z
    assert (low[0], high[0]) == pytest.approx((2.0, 2.0), abs=0.02)


def test_a_cloud_without_surface_is_refused() -> None:
    lonely = np.array([[0.0, 0, 1], [3, 3, 1], [6, -3, 1]])
    with pytest.raises(InputError, match='no surface yet'):
        mesh(lonely, T_BODY_OPTICAL[None])
