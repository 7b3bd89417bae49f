"""Pixels of clouds in any order beside loops over all points, their colours and noise, and pictures of what is seen."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from drawn_tables import Can, K, draw
from halfseen.perception import XTION, Cloud, DepthSensor, perceive
from halfseen.perception.labels import pixel_colours
from halfseen.perception.picture import COLOURS, DOTS_PER_INCH, THUMBNAIL_INCHES, sentence, thumbnail
from halfseen.perception.picture import draw as draw_picture
from halfseen.perception.plane import find_table, noise_factor
from halfseen.perception.range_image import NEIGHBOUR_SHARE, VIRTUAL_PIXEL_SCALE, WIDENING, range_image


def cloud_of(rng, num_points=1500):
    """Points of few coordinates, so that rays and depths are shared by some."""
    across = rng.integers(-20, 20, (num_points, 2)) / 32
    depth = rng.integers(4, 7, num_points) / 4
    return np.column_stack([across * depth[:, None], depth])


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_has_the_nearest_of_its_points_and_is_as_wide_as_rays_are_apart(seed):
    rng = np.random.default_rng(seed)
    points = cloud_of(rng)
    image = range_image(Cloud(points))
    pixels = image.points_m.reshape(-1, 3)
    for pixel in range(len(pixels)):
        its = points[image.pixel_of_point == pixel]
        nearest = min(its[:, [2, 0, 1]].tolist(), default=[np.nan] * 3)
        np.testing.assert_array_equal(pixels[pixel, [2, 0, 1]], nearest)
    assert max(np.bincount(image.pixel_of_point[image.pixel_of_point >= 0])) > 1
    again = range_image(Cloud(rng.permutation(points)))
    np.testing.assert_array_equal(again.points_m, image.points_m)


def rays_of(num_columns, num_rows, spacing):
    """Rays of a grid, to points at 1 m."""
    row, column = np.indices((num_rows, num_columns)).reshape(2, -1)
    return np.stack([column * spacing[0] - 0.3, row * spacing[1] - 0.2, np.ones(row.size)], axis=1)


def share_beside(image):
    """Of pixels with a return that are not the last of their row or column, how many have the next one beside them."""
    shares = []
    for lines in (image.is_return, image.is_return.T):
        gaps = np.concatenate([np.diff(np.flatnonzero(line)) for line in lines])
        shares.append(np.mean(gaps == 1))
    return min(shares)


def test_pixels_are_as_wide_as_rays_are_apart_and_wider_where_rays_leave_gaps():
    pitch = VIRTUAL_PIXEL_SCALE * 0.004
    whole = rays_of(150, 100, (0.004, 0.004))
    assert 1 / range_image(Cloud(whole)).intrinsics[0, 0] == pytest.approx(pitch, rel=1e-9)
    for thinned in (
        np.random.default_rng(0).permutation(whole)[::4],
        whole[np.random.default_rng(1).random(len(whole)) < 0.7],
        rays_of(50, 100, (0.012, 0.004)),
    ):
        image = range_image(Cloud(thinned))
        steps = np.log(1 / image.intrinsics[0, 0] / pitch) / np.log(WIDENING)
        assert share_beside(image) >= NEIGHBOUR_SHARE
        assert 1 <= round(steps) < 8


def test_noise_grows_with_the_square_of_the_distance_from_a_floor_on():
    assert isinstance(XTION, DepthSensor)
    np.testing.assert_allclose(XTION.noise_m(np.array([0.1, 1.0, 2.0])), [0.001, 0.003, 0.012])


def pixels_of(view):
    with Image.open(io.BytesIO(thumbnail(view))) as image:
        return np.asarray(image.convert("RGB"), dtype=float) / 255.0


def is_colour(pixels, place):
    wanted = np.array([int(COLOURS[place][k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.abs(pixels - wanted).max(axis=-1) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("places_m", [[(0.0, 0.0)], [(-0.2, 0.0), (0.2, 0.1)], [(0.0, -0.15), (0.02, 0.2)]])
def test_all_objects_are_within_the_frame_and_fill_it(places_m):
    view = perceive(draw(*(Can(*place) for place in places_m)).cloud)
    pixels = pixels_of(view)
    assert pixels.shape[:2] == (THUMBNAIL_INCHES[1] * DOTS_PER_INCH, THUMBNAIL_INCHES[0] * DOTS_PER_INCH)
    outlines = np.logical_or.reduce([is_colour(pixels, place) for place in range(len(places_m))])
    inner = outlines[1:-1, 1:-1]
    assert inner.sum() == outlines.sum()
    extents = [np.ptp(each) / size for each, size in zip(np.nonzero(outlines), outlines.shape, strict=True)]
    assert max(extents) > 0.75


@pytest.fixture
def wall():
    """A cloud of a wall of many colours, one of whose pixels has no return."""
    picture = np.random.default_rng(5).integers(0, 256, size=(30, 40, 3), dtype=np.uint8)
    depth = np.full((30, 40), 1.0)
    depth[2, 3] = np.nan
    return Cloud.from_depth(depth, np.array([[40.0, 0.0, 20.0], [0.0, 40.0, 15.0], [0.0, 0.0, 1.0]]), "wall", picture)


def test_pixels_have_their_own_colours_or_that_of_their_nearest_point(wall):
    own = wall.colours.reshape(30, 40, 3).copy()
    own[2, 3] = 0
    np.testing.assert_array_equal(pixel_colours(range_image(wall), wall), own)
    near = np.flatnonzero(np.isfinite(wall.points_m[:, 2]))
    points = np.concatenate([0.9 * wall.points_m[near], wall.points_m[near]])
    colours = np.concatenate([wall.colours[near], 255 - wall.colours[near]])
    order = np.random.default_rng(0).permutation(len(points))
    loose = Cloud(points[order], colours=colours[order])
    image = range_image(loose)
    assert image.is_virtual
    seen = pixel_colours(image, loose)
    # By brute force: the point of each pixel is looked up among all points.
    for row, column in np.argwhere(image.is_return):
        which = np.argmin(np.linalg.norm(points - image.points_m[row, column], axis=1))
        np.testing.assert_array_equal(seen[row, column], colours[which])
    assert not seen[~image.is_return].any()


@pytest.mark.parametrize("lost", [0.5, 0.7, 0.9])
def test_a_grid_that_lost_most_of_its_returns_shows_the_same_objects(lost):
    """At 0.7 no surface held together, and the table was said to be empty."""
    drawn = draw(Can(-0.1, 0.0), Can(0.1, 0.05), Can(0.0, -0.1))
    depth = np.where(np.random.default_rng(0).random(drawn.depth_m.shape) < lost, np.nan, drawn.depth_m)
    view = perceive(Cloud.from_depth(depth, K, "holes"))
    assert view.image.is_virtual
    assert sorted(round(seen.height_m, 2) for seen in view.objects) == pytest.approx([0.1] * 3, abs=0.011)


BEHIND_TWO = (Can(0.0, 0.1, 0.05, 0.12), Can(-0.06, -0.05, 0.035, 0.11), Can(0.045, -0.05, 0.025, 0.11))


@pytest.fixture(scope="module")
def view():
    return perceive(draw(*BEHIND_TWO).cloud)


def test_the_share_that_several_hide_is_not_said_of_one(view):
    """It said that object 1 alone hides what two hide together."""
    worst = max(view.objects, key=lambda seen: seen.occlusion)
    shares = view.hides[worst.id]
    assert np.sort(shares)[-2] > 0.05
    whole, most = f"({worst.occlusion:.2f})", f"({shares.max():.2f})"
    assert whole != most
    assert sentence(view).endswith(f"is hidden most {whole}, above all by object {shares.argmax()} {most}.")


def test_the_words_below_a_picture_lie_within_it(view, tmp_path):
    draw_picture(view, tmp_path / "view.png")
    below = np.asarray(Image.open(tmp_path / "view.png").convert("L"))[-60:]
    assert below.min() < 100
    assert below[:, :20].min() == below[:, -20:].min() == 255


# Cameras that err more than they are said to: the table shows it, and nothing is invented.
SPREAD_PX = 1.5
CANS = (Can(-0.15, 0.0, 0.04, 0.11), Can(0.0, 0.08, 0.035, 0.09), Can(0.14, -0.05, 0.04, 0.10))


def noisy_cloud_of(cans, factor, seed=0):
    """Cans as a camera sees them that errs by this multiple of an Xtion's noise, alike in neighbouring pixels."""
    depth = draw(*cans).depth_m
    error = gaussian_filter(np.random.default_rng(seed).standard_normal(depth.shape), SPREAD_PX, mode="wrap")
    error *= np.sqrt(4 * np.pi) * SPREAD_PX
    return Cloud.from_depth(depth + factor * XTION.noise_m(depth) * error, K, "noisy")


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 4.0])
def test_the_noise_of_a_table_is_measured_whatever_stands_there(factor):
    for cans in (CANS, ()):
        image = range_image(noisy_cloud_of(cans, factor))
        assert noise_factor(find_table(image), image) == pytest.approx(factor, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 3.0, 4.0])
def test_what_is_only_noise_is_no_object_and_no_can_is_several(factor):
    """At 4 there were five bumps on an empty table, and cans in pieces."""
    assert len(perceive(noisy_cloud_of((), factor)).objects) == 0
    heights_m = sorted(seen.height_m for seen in perceive(noisy_cloud_of(CANS, factor, seed=1)).objects)
    assert heights_m == pytest.approx([0.09, 0.10, 0.11], abs=0.015)


def test_depths_in_steps_of_two_centimetres_are_noise():
    depth = np.round(draw(*CANS).depth_m / 0.02) * 0.02
    assert len(perceive(Cloud.from_depth(depth, K, "steps")).objects) == 3
