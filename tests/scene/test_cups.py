from collections import Counter

import numpy as np
import pytest

from halfseen.scene import Cup, Pose
from halfseen.scene.cups import NUM_AROUND, body_mesh, handle_mesh
from halfseen.scene.rays import cast
from halfseen.scene.room import lone_cup_model

MUG = Cup(0.1, 0.045, 0.040, wall_m=0.003, bottom_m=0.006, handle_m=0.03)


def enclosed_volume_m3(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("build", [body_mesh, handle_mesh])
def test_surface_is_closed_and_looks_outward(build):
    vertices, faces = build(MUG)
    edges = Counter((int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3))
    assert set(edges.values()) == {1}
    assert all((end, start) in edges for start, end in edges)
    assert enclosed_volume_m3(vertices, faces) > 0


def test_volume_of_a_straight_cup_is_that_of_the_prism():
    cup = Cup(0.1, 0.04, 0.04, wall_m=0.003, bottom_m=0.005)
    polygon = NUM_AROUND / 2 * np.sin(2 * np.pi / NUM_AROUND)
    expected = polygon * (0.04**2 * 0.1 - 0.037**2 * 0.095)
    assert enclosed_volume_m3(*body_mesh(cup)) == pytest.approx(expected, rel=1e-9)


def test_cup_is_hollow():
    model = lone_cup_model(MUG, Pose((0.0, 0.0, 0.0)))
    down = cast(model, np.array([0.003, 0.001, 1.0]), np.array([[0.0, 0.0, -1.0]]), 5.0)
    assert 1.0 - down.distance_m[0] == pytest.approx(MUG.bottom_m, abs=1e-7)  # meshes are float32


def test_handle_has_a_hole():
    model = lone_cup_model(MUG, Pose((0.0, 0.0, 0.0)))
    x_m = MUG.radius_at(0.05) + 0.4 * MUG.handle_m
    heights_m = np.linspace(0.02, 0.09, 71)
    is_met = []
    for z_m in heights_m:
        across = cast(model, np.array([x_m, -1.0, z_m]), np.array([[0.0, 1.0, 0.0]]), 5.0)
        is_met.append(across.body[0] > 0)
    assert any(is_met)
    assert not is_met[len(is_met) // 2]
