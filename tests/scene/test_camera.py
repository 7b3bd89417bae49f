"""The camera, what rays meet, and stains as it sees them, beside geometry by hand."""

from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.scene import Camera, Cup, Pose, Stain, Surface, Table, capture, draw_surface
from halfseen.scene.cups import SURFACES
from halfseen.scene.moving import projector_columns_px, shaded_within, shown_within
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.rays import RowRays, at_rest, first_met
from halfseen.scene.record import COLOUR_CAMERA, colours, middle_m, painted
from halfseen.scene.table import TABLE_TOP_M, look_at
from halfseen.scene.view import IdealView, Sight, ideal_view, table_view
from halfseen.scene.xtion import XTION, depth_from_disparity_m, disparity_noise_px, noisy_disparity_px, sense, xtion_at

FOCAL_PX, SHAPE = 577.0, (480, 640)
ORIGIN = Pose((0.0, 0.0, 0.0))
SMALL = Camera(ORIGIN, (160.0, 160.0), (79.5, 59.5), 120, 160)
"""A coarse camera whose frame is the world's: looks along z, y down."""


def test_camera_looks_at_its_target_is_level_and_sees_as_far_aside_as_the_sensor():
    target_m = np.array([0.3, 0.2, 0.8])
    camera = xtion_at(look_at(np.array([-0.4, -0.9, 1.4]), target_m))
    assert camera.project(target_m[None])[0] == pytest.approx([319.5, 239.5], abs=1e-3)
    right, down, _ = camera.world_from_camera.rotation.T
    assert right[2] == pytest.approx(0.0, abs=1e-6)
    assert down[2] < 0
    field_rad = 2 * np.arctan(np.array([320, 240]) / camera.focal_px)
    assert np.rad2deg(field_rad) == pytest.approx([58, 45], abs=1e-4)


def test_inverse_and_composition_of_poses_and_pixel_rays_are_what_project_undoes(rng):
    points_m = rng.normal(size=(5, 3))
    first, then = about_axis((1.0, 0.0, 0.0), 0.7), about_axis((0.0, 0.0, 1.0), -1.1)
    pose = Pose((1.0, 2.0, 3.0), compose(first, then))
    assert np.allclose(pose.apply_inverse(pose.apply(points_m)), points_m)
    one_by_one = Pose((0.0, 0.0, 0.0), then).apply(Pose((0.0, 0.0, 0.0), first).apply(points_m))
    assert np.allclose(pose.apply(points_m) - [1.0, 2.0, 3.0], one_by_one)
    camera = Camera(pose, (100.0, 110.0), (31.5, 23.5), num_rows=48, num_columns=64)
    point_m = pose.apply(rng.uniform(0.5, 2.0) * camera.pixel_rays()[7, 50][None])
    assert camera.project(point_m)[0] == pytest.approx([50, 7], abs=1e-9)


def seen_of_boxes(camera, *boxes_m):
    """The ideal view of fixed boxes (centre, half sizes) along the axes; body i + 1 is box i."""
    spec = mujoco.MjSpec()
    for centre_m, half_m in boxes_m:
        spec.worldbody.add_body(pos=centre_m).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half_m)
    return ideal_view(Sight(at_rest(spec.compile()), camera, XTION.baseline_m))


def test_ideal_depth_of_a_wall_is_its_distance_along_the_axis_and_of_nothing_nan():
    wall = seen_of_boxes(SMALL, ([0.0, 0.0, 2.05], [9.0, 9.0, 0.05]))
    assert wall.depth_m == pytest.approx(np.full((120, 160), 2.0), abs=1e-9)
    assert wall.incidence_cosine == pytest.approx(1 / np.linalg.norm(SMALL.pixel_rays(), axis=2), abs=1e-9)
    assert wall.is_lit.all()
    nothing = seen_of_boxes(SMALL, ([0.0, 0.0, -1.0], [0.1, 0.1, 0.1]))
    assert np.isnan(nothing.depth_m).all()
    assert (nothing.labels == -1).all()
    assert not nothing.is_lit.any()


def test_shadow_of_the_projector_is_where_geometry_puts_it(rng):
    """A thin plate before a wall; the projector at x = +7.5 cm leaves a shadow on the plate's left, and only there."""
    camera = Camera(ORIGIN, (FOCAL_PX, FOCAL_PX), (319.5, 20.0), num_rows=41, num_columns=640)
    view = seen_of_boxes(camera, ([0.0, 0.0, 1.05], [2.0, 2.0, 0.05]), ([0.0, 0.0, 0.8005], [0.05, 0.2, 0.0005]))
    wall_x_m = (np.arange(640) - 319.5) / FOCAL_PX
    is_plate = np.abs(wall_x_m) <= 0.05 / 0.8
    shadow_edge_m = XTION.baseline_m - (XTION.baseline_m + 0.05) / 0.8
    is_shadow = ~is_plate & (wall_x_m > shadow_edge_m) & (wall_x_m < 0)
    assert is_shadow.sum() > 5
    assert np.array_equal(view.body[20] == 2, is_plate)
    assert np.array_equal(~view.is_lit[20], is_shadow)
    assert np.array_equal(np.isnan(sense(view, FOCAL_PX, rng)[20]), is_shadow)


def sensed(depth_m, rng, angle_deg=0.0):
    """What the sensor makes of a wall that is everywhere as deep, and met at an angle."""
    cosine = np.full(SHAPE, np.cos(np.deg2rad(angle_deg)))
    nowhere, everywhere = np.zeros(SHAPE, dtype=np.int64), np.ones(SHAPE, dtype=bool)
    return sense(IdealView(np.full(SHAPE, depth_m), nowhere, cosine, everywhere), FOCAL_PX, rng)


def test_noise_grows_as_the_square_of_depth(rng):
    depths_m = np.array([0.7, 1.0, 1.5, 2.2, 3.0])
    spread_m = np.array([np.std(sensed(z, rng)) for z in depths_m])
    assert np.polyfit(np.log(depths_m), np.log(spread_m), 1)[0] == pytest.approx(2.0, abs=0.1)
    disparity_spread_px = np.hypot(0.1, XTION.disparity_step_px / np.sqrt(12))
    assert spread_m == pytest.approx(depths_m**2 / (FOCAL_PX * XTION.baseline_m) * disparity_spread_px, rel=0.1)


def test_noise_is_shared_by_neighbours_only(rng):
    noise_px = disparity_noise_px(SHAPE, rng)
    near, far = (np.corrcoef(noise_px[:, :-k].ravel(), noise_px[:, k:].ravel())[0, 1] for k in (1, 40))
    assert near > 0.5
    assert abs(far) < 0.05
    assert np.std(noise_px) == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(
    ("depth_m", "angle_deg", "lost"),
    [(0.4, 0, 1.0), (0.6, 0, 0.0), (3.2, 0, 0.0), (4.0, 0, 1.0), (1.0, 70, 0.0), (1.0, 81.5, 0.5), (1.0, 86, 1.0)],
)
def test_returns_come_from_the_range_only_and_grazing_rays_are_lost(depth_m, angle_deg, lost, rng):
    share = np.isnan(sensed(depth_m, rng, angle_deg)).mean()
    assert share == pytest.approx(lost, abs=0.01 if angle_deg else 0.0)


@pytest.mark.slow
def test_disparity_comes_in_eighths_of_a_pixel_the_nearest_without_noise(picture):
    focal_px = picture.cloud.intrinsics[0, 0]
    eighths = 8 * focal_px * XTION.baseline_m / picture.depth_m[np.isfinite(picture.depth_m)]
    assert np.max(np.abs(eighths - np.round(eighths))) < 1e-6
    assert len(np.unique(np.round(eighths))) > 100
    depth_m = np.array([[0.6, 1.0, 3.0, np.nan]])
    measured_px = noisy_disparity_px(depth_m, np.zeros((1, 4)), FOCAL_PX)
    exact_px = FOCAL_PX * XTION.baseline_m / depth_m
    assert np.all(np.abs(measured_px - exact_px)[:, :3] <= XTION.disparity_step_px / 2)
    assert np.isnan(measured_px[0, 3])
    # No depth without positive disparity.
    depth_m = depth_from_disparity_m(np.array([[0.0, -0.125, 43.275, np.nan]]), FOCAL_PX)
    assert np.isnan(depth_m[0, [0, 1, 3]]).all()
    assert depth_m[0, 2] == pytest.approx(1.0)


INTRINSICS = np.array([[50.0, 0.0, 30.0], [0.0, 52.0, 20.0], [0.0, 0.0, 1.0]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def solids(rng, num_solids, middle_m):
    """Outward facets of tetrahedra, none of which holds the origin."""
    facets = []
    while len(facets) < num_solids:
        corners = rng.normal(size=(4, 3)) * 0.4 + rng.uniform(*middle_m)
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[0, 1]] = corners[[1, 0]]
        sides = corners[TETRAHEDRON]
        is_outside = np.linalg.det(sides) < 0  # the origin is before this side
        if is_outside.any():
            facets.append(sides)
    return np.concatenate(facets)


def met_by_brute_force(corners, rays):
    """Depth at which each ray meets any side of any facet first."""
    directions = np.column_stack([rays.column, rays.row, np.ones(len(rays.row))]) @ np.linalg.inv(INTRINSICS).T
    # Each direction as a sum of the three corners of each facet.
    shares = np.einsum("fij,rj->fri", np.linalg.inv(np.moveaxis(corners, 1, 2)), directions)
    is_met = (shares >= 0).all(axis=2)
    depth = np.where(is_met, 1.0 / np.where(is_met, shares.sum(axis=2), 1.0), np.inf)
    return depth.min(axis=0), depth.argmin(axis=0)


@pytest.mark.parametrize(
    "middle_m",
    [([-1, -1, 1.5], [1, 1, 4]), ([-2, -2, -1], [2, 2, 1])],
    ids=["before the camera", "on both sides of its plane"],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_as_asking_every_ray_about_every_facet(middle_m, seed):
    rng = np.random.default_rng(seed)
    corners = solids(rng, 12, middle_m)
    rays = RowRays(rng.integers(0, 40, 500), rng.uniform(-40, 100, 500))
    met = first_met(corners, INTRINSICS, rays)
    depth_m, facet = met_by_brute_force(corners, rays)
    np.testing.assert_allclose(met.depth_m, depth_m, rtol=1e-7)
    np.testing.assert_array_equal(met.facet, np.where(np.isfinite(depth_m), facet, -1))


def test_a_level_side_bounds_no_column():
    corners = np.array([[[-0.2, -0.1, 1.0], [-0.2, 0.1, 1.0], [0.2, 0.1, 1.0]]])
    row, column = (each.ravel() for each in np.mgrid[:40, :60])
    met = first_met(corners, INTRINSICS, RowRays(row, column.astype(float)))
    x, y = (column - 30) / 50, (row - 20) / 52
    is_within = (x >= -0.2) & (y <= 0.1) & (y >= x / 2)
    is_edge = (np.abs(y - x / 2) < 1e-9) | (np.abs(x + 0.2) < 1e-9)
    np.testing.assert_array_equal((met.facet == 0)[~is_edge], is_within[~is_edge])
    np.testing.assert_allclose(met.depth_m[met.facet == 0], 1.0)


CAMERA = Camera(Pose((0.0, 0.0, 0.0)), (100.0, 100.0), (49.5, 39.5), 80, 100)
BOX_M = np.array(list(product((-0.05, 0.05), (-0.1, 0.1), (1.0, 1.2))))[None]
BASELINE_M = 0.1


def test_a_box_shows_within_its_outline_and_little_more_and_beside_the_picture_nowhere():
    row, column = np.nonzero(shown_within(BOX_M, CAMERA))
    assert (column.min(), column.max()) == (42, 57)
    assert (row.min(), row.max()) == (27, 52)
    for aside_m in (-5.0, 5.0):
        assert not shown_within(BOX_M + np.array([aside_m, 0.0, 0.0]), CAMERA).any()
    assert not shown_within(np.zeros((0, 8, 3)), CAMERA).any()


def test_shadows_fall_to_the_left_of_what_makes_them():
    depth_m = np.full((80, 100), 2.0)
    depth_m[:, :3] = np.nan
    shaded = shaded_within(BOX_M, CAMERA, BASELINE_M, depth_m)
    # The projector's picture of the box is 10 columns to the left (at 1 m), that of a wall at 2 m is 5.
    row, column = np.nonzero(shaded[:, 8:])
    assert (column.min() + 8, column.max() + 8) == (37, 53)
    assert (row.min(), row.max()) == (27, 52)
    # What is beyond the left border of the projector's picture may be dark; what is nowhere is not.
    assert shaded[0, 3:5].all()
    assert not shaded[:, :3].any()
    np.testing.assert_allclose(projector_columns_px(CAMERA, BASELINE_M, depth_m)[0, 5], 0.0)


WHITE, BROWN = (238, 236, 230), (98, 62, 30)
CUP = Cup(0.10, 0.04, 0.04, wall_m=0.003)
SILENT = replace(COLOUR_CAMERA, noise=0.0, ambient_share=1.0)
TOWARDS_CAMERA_RAD = -np.pi / 2


@pytest.fixture(scope="module")
def lone() -> Table:
    eye_m, target_m = np.array([0.0, -0.6, TABLE_TOP_M + 0.35]), np.array([0.0, 0.0, TABLE_TOP_M + 0.05])
    camera = Camera(look_at(eye_m, target_m), (400.0, 400.0), (119.5, 99.5), 200, 240)
    return Table((CUP,), (Pose((0.0, 0.0, TABLE_TOP_M)),), camera)


@pytest.fixture(scope="module")
def lone_view(lone):
    return table_view(lone, 0.075)


def on_a_cylinder(lone: Table, stain: Stain) -> int:
    """Pixels that show a stain on a cylinder: each ray is met with its walls, its rim and its bottom by the formula."""
    start = lone.world_from_cup[0].apply_inverse(np.array([lone.camera.world_from_camera.position_m]))[0]
    way = lone.camera.pixel_rays().reshape(-1, 3) @ lone.camera.world_from_camera.rotation.T
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
def test_stained_pixels_are_those_that_geometry_says(lone, lone_view, angle_rad, height_m, is_inside, is_seen):
    stain = Stain(angle_rad, height_m, 0.012, is_inside, BROWN)
    surface = Surface(CUP, WHITE, (stain,))
    picture = colours(lone_view, lone.camera, [surface], lone.world_from_cup, np.random.default_rng(0), SILENT)
    num_stained = int((picture == BROWN).all(axis=2).sum())
    expected = on_a_cylinder(lone, stain)
    assert (expected > 20) == is_seen
    assert num_stained == pytest.approx(expected, abs=0.03 * expected)


def test_what_is_seen_slantwise_is_darker_pixels_are_noisy_and_the_rest_has_its_own_colours(lone, lone_view):
    def drawn(*camera):
        return colours(lone_view, lone.camera, surface, lone.world_from_cup, np.random.default_rng(0), *camera)

    surface = [Surface(CUP, WHITE)]
    shaded, noisy, picture = drawn(replace(COLOUR_CAMERA, noise=0.0)), drawn(), drawn(SILENT)
    is_slant, is_straight = lone_view.incidence_cosine < 0.3, lone_view.incidence_cosine > 0.9
    assert shaded[(lone_view.body == 1) & is_slant].max() < shaded[(lone_view.body == 1) & is_straight].min()
    assert np.std(noisy.astype(float) - shaded) == pytest.approx(COLOUR_CAMERA.noise, rel=0.05)
    np.testing.assert_array_equal(noisy, drawn())
    for body, colour in ((0, COLOUR_CAMERA.furniture), (1, WHITE), (-1, COLOUR_CAMERA.dark)):
        assert (picture[lone_view.body == body] == colour).all()


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


def test_a_capture_has_the_same_depths_with_colour_and_without(lone):
    surfaces = [Surface(CUP, WHITE)]
    plain, coloured = capture(lone, 3), capture(lone, 3, surfaces=surfaces)
    np.testing.assert_array_equal(plain.cloud.points_m, coloured.cloud.points_m)
    assert plain.cloud.colours is None
    np.testing.assert_array_equal(coloured.cloud.colours, capture(lone, 3, surfaces=surfaces).cloud.colours)
