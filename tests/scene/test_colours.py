"""Stains as they are drawn, and as a camera sees them, beside rays met with a cylinder by hand."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.scene import Camera, Cup, Pose, Stain, Surface, Table, capture, draw_surface
from halfseen.scene.cups import SURFACES
from halfseen.scene.record import COLOUR_CAMERA, colours, middle_m, painted
from halfseen.scene.table import TABLE_TOP_M, look_at
from halfseen.scene.view import table_view

WHITE, BROWN = (238, 236, 230), (98, 62, 30)
CUP = Cup(0.10, 0.04, 0.04, wall_m=0.003)
SILENT = replace(COLOUR_CAMERA, noise=0.0, ambient_share=1.0)
TOWARDS_CAMERA_RAD = -np.pi / 2


@pytest.fixture(scope="module")
def table() -> Table:
    eye_m, target_m = np.array([0.0, -0.6, TABLE_TOP_M + 0.35]), np.array([0.0, 0.0, TABLE_TOP_M + 0.05])
    camera = Camera(look_at(eye_m, target_m), (400.0, 400.0), (119.5, 99.5), 200, 240)
    return Table((CUP,), (Pose((0.0, 0.0, TABLE_TOP_M)),), camera)


@pytest.fixture(scope="module")
def view(table):
    return table_view(table, 0.075)


def on_a_cylinder(table: Table, stain: Stain) -> int:
    """Pixels that show a stain on a cylinder: each ray is met with its walls, its rim and its bottom by the formula."""
    start = table.world_from_cup[0].apply_inverse(np.array([table.camera.world_from_camera.position_m]))[0]
    way = table.camera.pixel_rays().reshape(-1, 3) @ table.camera.world_from_camera.rotation.T
    outer, inner = CUP.rim_radius_m, CUP.rim_radius_m - CUP.wall_m
    met = []
    for radius in (outer, inner):
        a, b = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2]
        root = b * b - a * (start[:2] @ start[:2] - radius**2)
        for sign in (-1, 1):
            t = (-b + sign * np.sqrt(np.maximum(root, 0.0))) / a
            height = start[2] + t * way[:, 2]
            met.append(np.where((root > 0) & (height >= 0) & (height <= CUP.height_m), t, np.inf))
    for surface_m, width_m in ((CUP.height_m, outer), (CUP.bottom_m, inner)):
        t = (surface_m - start[2]) / way[:, 2]
        across = np.linalg.norm(start[:2] + t[:, None] * way[:, :2], axis=1)
        is_there = (across < width_m) & ((surface_m < CUP.height_m) | (across > inner)) & (t > 0)
        met.append(np.where(is_there, t, np.inf))
    first, nearest = np.argmin(met, axis=0), np.min(met, axis=0)
    is_side = np.isin(first, (2, 3) if stain.is_inside else (0, 1)) & np.isfinite(nearest)
    point = start + np.where(is_side, nearest, 0.0)[:, None] * way
    middle = (inner if stain.is_inside else outer) * np.array([np.cos(stain.angle_rad), np.sin(stain.angle_rad)])
    apart_m = np.linalg.norm(point - np.append(middle, stain.height_m), axis=1)
    return int((is_side & (apart_m < stain.radius_m)).sum())


@pytest.mark.parametrize(
    ("angle_rad", "height_m", "is_inside", "is_seen"),
    [
        (TOWARDS_CAMERA_RAD, 0.05, False, True),
        (TOWARDS_CAMERA_RAD + 0.9, 0.06, False, True),
        (-TOWARDS_CAMERA_RAD, 0.05, False, False),
        (-TOWARDS_CAMERA_RAD, 0.085, True, True),
        (TOWARDS_CAMERA_RAD, 0.085, True, False),
    ],
)
def test_stained_pixels_are_those_that_geometry_says(table, view, angle_rad, height_m, is_inside, is_seen):
    stain = Stain(angle_rad, height_m, 0.012, is_inside, BROWN)
    surface = Surface(CUP, WHITE, (stain,))
    picture = colours(view, table.camera, [surface], table.world_from_cup, np.random.default_rng(0), SILENT)
    num_stained = int((picture == BROWN).all(axis=2).sum())
    expected = on_a_cylinder(table, stain)
    assert (expected > 20) == is_seen
    assert num_stained == pytest.approx(expected, abs=0.03 * expected)


def test_what_is_seen_slantwise_is_darker_pixels_are_noisy_and_the_rest_has_its_own_colours(table, view):
    def drawn(*camera):
        return colours(view, table.camera, surface, table.world_from_cup, np.random.default_rng(0), *camera)

    surface = [Surface(CUP, WHITE)]
    shaded, noisy, picture = drawn(replace(COLOUR_CAMERA, noise=0.0)), drawn(), drawn(SILENT)
    is_slant, is_straight = view.incidence_cosine < 0.3, view.incidence_cosine > 0.9
    assert shaded[(view.body == 1) & is_slant].max() < shaded[(view.body == 1) & is_straight].min()
    assert np.std(noisy.astype(float) - shaded) == pytest.approx(COLOUR_CAMERA.noise, rel=0.05)
    np.testing.assert_array_equal(noisy, drawn())
    for body, colour in ((0, COLOUR_CAMERA.furniture), (1, WHITE), (-1, COLOUR_CAMERA.dark)):
        assert (picture[view.body == body] == colour).all()


def test_a_handle_is_plain_and_stains_cover_spots():
    cup = Cup(0.10, 0.04, 0.04, handle_m=0.03)
    stain = Stain(0.0, 0.05, 0.03, False, BROWN)
    spot = replace(stain, radius_m=0.035, colour=(1, 2, 3))
    handle = np.array([[0.065, 0.0, 0.05]])
    wall = np.array([[0.04, 0.0, 0.05], [0.04, 0.0, 0.0825], [-0.04, 0.0, 0.05], [0.037, 0.0, 0.05]])
    surface = Surface(cup, WHITE, (stain,), (spot,))
    assert painted(surface, handle).tolist() == [list(WHITE)]
    assert painted(surface, wall).tolist() == [list(BROWN), [1, 2, 3], list(WHITE), list(WHITE)]


def test_what_is_drawn_is_within_the_law_and_the_same_again(rng):
    assert len({draw_surface(CUP, True, np.random.default_rng(7)) for _ in range(2)}) == 1
    cup = Cup(0.10, 0.045, 0.035)
    dirty = [draw_surface(cup, True, rng) for _ in range(600)]
    clean = [draw_surface(cup, False, rng) for _ in range(600)]
    assert all(surface.is_dirty for surface in dirty)
    assert not any(surface.is_dirty for surface in clean)
    assert {len(surface.stains) for surface in dirty} == {1, 2, 3}
    assert {len(surface.spots) for surface in dirty} == {len(surface.spots) for surface in clean} == {0, 1, 2}
    stains = [stain for surface in dirty for stain in surface.stains]
    spots = [spot for surface in clean for spot in surface.spots]
    for discs, (smallest, largest) in ((stains, SURFACES.stain_radius_m), (spots, SURFACES.spot_radius_m)):
        assert smallest <= min(disc.radius_m for disc in discs) <= max(disc.radius_m for disc in discs) <= largest
        # Three standard errors of a share of one half.
        assert np.mean([disc.is_inside for disc in discs]) == pytest.approx(0.5, abs=1.5 / np.sqrt(len(discs)))
    for disc in stains:
        assert 0.01 - 1e-9 <= disc.height_m <= 0.095 + 1e-9
        radius = cup.radius_at(disc.height_m) - cup.wall_m * disc.is_inside
        assert np.hypot(*middle_m(disc, cup)[:2]) == pytest.approx(radius)


def test_a_capture_has_the_same_depths_with_colour_and_without(table):
    surfaces = [Surface(CUP, WHITE)]
    plain, coloured = capture(table, 3), capture(table, 3, surfaces=surfaces)
    np.testing.assert_array_equal(plain.cloud.points_m, coloured.cloud.points_m)
    assert plain.cloud.colours is None
    np.testing.assert_array_equal(coloured.cloud.colours, capture(table, 3, surfaces=surfaces).cloud.colours)
