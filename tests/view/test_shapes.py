"""Shadows and what is hidden, against points drawn at random and lines of sight followed step by step."""

import numpy as np
import pytest

from halfseen.view.shapes import convex_mesh, is_behind, revealed_by, shadow

EYE_M = np.array([0.0, -0.8, 0.7])


def box(middle_m, half_m):
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return convex_mesh(np.asarray(middle_m) + signs * half_m)


def in_box(points_m, middle_m, half_m):
    return (np.abs(points_m - np.asarray(middle_m)) <= half_m).all(axis=-1)


def followed(points_m, middle_m, half_m):
    """Which lines of sight meet a box, by a thousand steps along each."""
    steps = np.linspace(0.0, 1.0, 1001)[:, None, None]
    return in_box(points_m + steps * (EYE_M - points_m), middle_m, half_m).any(axis=0)


def test_a_mesh_of_points_faces_outward_and_has_their_volume():
    mesh = box([0.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("fd,fd->f", a, np.cross(b, c)).sum() / 6 == pytest.approx(8 * 0.1 * 0.2 * 0.3)
    assert len(mesh.vertices_m) == 8


def test_what_is_behind_a_box_is_what_lines_of_sight_say():
    middle_m, half_m = np.array([0.02, 0.0, 0.06]), np.array([0.04, 0.03, 0.06])
    points_m = np.random.default_rng(3).uniform([-0.1, -0.1, 0.0], [0.12, 0.3, 0.15], (2000, 3))
    behind, slowly = is_behind(points_m, box(middle_m, half_m), EYE_M), followed(points_m, middle_m, half_m)
    assert 100 < slowly.sum() < 1900
    # Steps may jump over an edge that the line of sight just touches.
    assert not (slowly & ~behind).any()
    assert (behind != slowly).sum() <= 4


def test_a_shadow_is_the_box_and_all_between_it_and_the_table_that_it_hides():
    middle_m, half_m = np.array([0.02, 0.0, 0.06]), np.array([0.04, 0.03, 0.06])
    solid = box(middle_m, half_m)
    dark = shadow(solid, EYE_M)
    points_m = np.random.default_rng(5).uniform([-0.2, -0.1, 0.001], [0.2, 0.5, 0.2], (4000, 3))
    a, b, c = (dark.vertices_m[dark.faces[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a)
    is_inside = (np.einsum("nfd,fd->nf", points_m[:, None] - a, outward) <= 1e-12).all(axis=1)
    assert is_inside.sum() > 100
    assert (is_inside == is_behind(points_m, solid, EYE_M)).all()
    assert dark.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)


def test_a_lift_reveals_what_only_it_hides():
    front, back, aside = (box([x, y, 0.05], [0.04, 0.03, 0.05]) for x, y in ((0, 0), (0, 0.1), (0.5, 0)))
    revealed_m = revealed_by(0, [front, back, aside], EYE_M)
    assert len(revealed_m) > 20
    assert in_box(revealed_m, [0, 0.1, 0.05], np.array([0.04, 0.03, 0.05]) + 1e-9).all()
    assert is_behind(revealed_m, front, EYE_M).all()
    assert len(revealed_by(2, [front, back, aside], EYE_M)) == 0
    again = box([0, -0.1, 0.15], [0.05, 0.03, 0.15])  # before the first: a lift of one alone shows less
    assert len(revealed_by(0, [front, back, aside, again], EYE_M)) < len(revealed_m)
