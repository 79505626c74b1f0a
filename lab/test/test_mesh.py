import numpy as np
import pytest

from hoid_synth import mesh
from hoid_synth.mesh import Mesh, Surface
from hoid_synth.render.tracer import Tracer
from hoid_synth.room.world import pose
from hoid_synth.static_model import _squared_distance

PLAIN = Surface(0)


def outward_shapes() -> dict[str, Mesh]:
    line = np.array([[0, 0, 0], [0, 0, 0.5], [0.1, 0, 1.0]])
    return {
        'box': mesh.box((-0.5, -0.4, -0.3), (0.5, 0.4, 0.3), PLAIN),
        'tube': mesh.tube(line, np.full((3, 2), 0.2), (1, 0, 0), PLAIN),
        'cylinder': mesh.cylinder((0, 0, 0), 1.0, 0.3, PLAIN),
        'ellipsoid': mesh.ellipsoid((0, 0, 0), (0.3, 0.4, 0.5), PLAIN),
    }


@pytest.mark.parametrize('name', outward_shapes())
def test_normals_point_outwards(name: str) -> None:
    shape = outward_shapes()[name]
    away = shape.vertices_m - shape.vertices_m.mean(0)
    along = np.einsum('ij,ij->i', away, shape.normals)
    assert along.mean() > 0.1
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1, atol=1e-5)


def test_box_has_its_area_and_whole_textures() -> None:
    a, b, c = 0.3, 0.5, 0.7
    shape = mesh.box((0, 0, 0), (a, b, c), Surface(0, (0.1, 0.1)))
    corners = shape.vertices_m[shape.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() / 2 == pytest.approx(2 * (a * b + b * c + c * a), rel=1e-5)
    assert shape.uv.max() == pytest.approx(7, abs=1e-4)  # 0.7 m in repetitions of 0.1 m


def test_merged_and_transformed_keep_faces_together() -> None:
    one = mesh.box((0, 0, 0), (1, 1, 1), PLAIN).as_instance(3)
    two = one.as_instance(5).transformed(pose(2.0, 0, 0, np.pi / 2))
    both = mesh.merged([one, two])
    assert set(both.instance) == {3, 5}
    second = both.vertices_m[both.faces[both.instance == 5]].reshape(-1, 3)
    np.testing.assert_allclose(second.min(0), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(second.max(0), [2, 1, 1], atol=1e-6)


def test_rays_end_on_the_near_side_of_a_box() -> None:
    shape = mesh.box((-1, 2, -1), (1, 3, 1), PLAIN)
    tracer = Tracer(shape.vertices_m, shape.faces)
    ways = np.array([[0, 1, 0], [0.2, 2, 0.1], [0, -1, 0]], np.float32)
    hits = tracer.first_hits(np.zeros(3), ways)
    np.testing.assert_allclose(hits.t, [2, 1, np.inf], rtol=1e-6)
    blocked = tracer.occluded(
        np.zeros((2, 3), np.float32), np.array([[0, 1.9, 0], [0, 2.1, 0]], np.float32)
    )
    assert blocked.tolist() == [False, True]


@pytest.mark.parametrize(
    ('point', 'distance'),
    [((0.2, 0.2, 0.5), 0.5), ((-1, 0.5, 0), 1.0), ((1, 1, 0), 0.5**0.5), ((-3, -4, 0), 5.0)],
)
def test_distance_to_a_triangle(point: tuple[float, float, float], distance: float) -> None:
    triangle = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    square = _squared_distance(np.array([point]), triangle)
    assert np.sqrt(square[0]) == pytest.approx(distance)
