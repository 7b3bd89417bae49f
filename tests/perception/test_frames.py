"""Clouds whose file says a viewpoint, in either frame: the same answer as the same points without one."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drawn_tables import EYE_M, TABLE_FROM_CAMERA, Can, draw
from halfseen.errors import CloudError
from halfseen.perception import Cloud, perceive, read_cloud, write_pcd
from halfseen.perception.frames import turned_pinhole
from halfseen.perception.range_image import range_image
from halfseen.scene import table_paths
from refusals import refused

PCL_CAMERA = [*(f"view_p{axis}" for axis in "xyz"), *(f"{row}_axis{column}" for row in "xyz" for column in "xyz")]
RNG = np.random.default_rng(7)
POSES = [(RNG.uniform(-1.5, 1.5, 3), Rotation.random(rng=RNG)) for _ in range(3)]


def write(path: Path, points, shape, viewpoint, *comments: str) -> Cloud:
    """Write a cloud by hand as PCD, and read it."""
    rows, columns = shape or (1, len(points))
    lines = [*comments, "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", f"WIDTH {columns}", f"HEIGHT {rows}"]
    lines += [f"VIEWPOINT {' '.join(repr(float(number)) for number in viewpoint)}", f"POINTS {len(points)}"]
    path.write_bytes("\n".join([*lines, "DATA binary", ""]).encode() + points.astype("<f4").tobytes())
    return read_cloud(path)


def write_ply(path: Path, points, shape, eye_m, turn) -> Cloud:
    """Write a cloud as PCL does, and read it."""
    camera = ["element camera 1", *(f"property float {name}" for name in PCL_CAMERA)]
    camera += ["property int viewportx", "property int viewporty"]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [*(f"property float {axis}" for axis in "xyz"), *camera, "end_header", ""]
    grid = np.array(shape[::-1] if shape else [len(points), 1], "<i4")
    numbers = np.concatenate([eye_m, turn.as_matrix().ravel()])
    body = points.astype("<f4").tobytes() + numbers.astype("<f4").tobytes() + grid.tobytes()
    path.write_bytes("\n".join(head).encode() + body)
    return read_cloud(path)


def pose_of(place_m, turn):
    """Numbers of VIEWPOINT: a place, then w, x, y and z."""
    return [*place_m, *turn.as_quat(scalar_first=True)]


def holed(cloud: Cloud) -> np.ndarray:
    points = cloud.points_m.copy()
    points[np.random.default_rng(0).random(len(points)) < 0.2] = np.nan
    return points


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A shipped cloud as it is without a viewpoint, with holes, and without what it says of its camera."""
    cloud = read_cloud(table_paths()[5])
    found = write(tmp_path_factory.mktemp("plain") / "plain.pcd", holed(cloud), cloud.shape, [0, 0, 0, 1, 0, 0, 0])
    return found, range_image(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "pose"),
    [
        *[(way, pose) for way in ("camera", "world") for pose in range(3)],
        *[("mirrored", 0), ("no turn", 1), ("short", 2), ("ply", 0), ("ply world", 1), ("ply columns", 2)],
    ],
)
def test_an_organised_cloud_with_a_viewpoint_is_the_image_that_it_is_without(plain, tmp_path, way, pose):
    cloud, image = plain
    eye_m, turn = POSES[pose]
    points, viewpoint = cloud.points_m, pose_of(eye_m, turn)
    if way == "mirrored":
        points = points * [-1.0, 1.0, 1.0]
    if way not in ("camera", "ply"):
        points = points @ turn.as_matrix().T + eye_m
    if way == "no turn":
        viewpoint = viewpoint[:3]
    if way == "short":
        viewpoint = [*eye_m, *(0.3 * np.array(viewpoint[3:]))]
    if way.startswith("ply"):
        turn = turn.inv() if way == "ply columns" else turn
        found = write_ply(tmp_path / "cloud.ply", points, cloud.shape, eye_m, turn)
    else:
        found = write(tmp_path / "cloud.pcd", points, cloud.shape, viewpoint)
    np.testing.assert_array_equal(found.eye_m, np.float32(eye_m) if way == "ply world" else found.eye_m)
    seen = range_image(found)
    assert not seen.is_virtual
    np.testing.assert_allclose(seen.points_m, image.points_m, atol=3e-6)
    np.testing.assert_allclose(seen.intrinsics, image.intrinsics, rtol=1e-4)
    # Back in the frame of the file.
    again = seen.points_m.reshape(-1, 3) @ seen.cloud_from_camera.T + found.eye_m
    np.testing.assert_allclose(again, found.points_m, atol=1e-6)


@pytest.mark.slow
def test_occlusions_are_those_of_the_untouched_cloud_and_places_are_in_the_frame_of_the_file(plain, tmp_path):
    cloud, _ = plain
    (eye_m, turn), view = POSES[1], perceive(cloud)
    moved = write(tmp_path / "moved.pcd", turn.apply(cloud.points_m.copy()) + eye_m, cloud.shape, pose_of(eye_m, turn))
    own = write(tmp_path / "own.pcd", cloud.points_m, cloud.shape, pose_of(eye_m, turn))
    write_pcd(moved, tmp_path / "again.pcd")
    for found, place_m in ((moved, turn.apply), (own, None), (read_cloud(tmp_path / "again.pcd"), turn.apply)):
        seen = perceive(found)
        np.testing.assert_allclose(seen.hides, view.hides, atol=1e-3)
        for one, other in zip(seen.objects, view.objects, strict=True):
            expected = other.centroid_m if place_m is None else place_m(other.centroid_m.copy()) + eye_m
            np.testing.assert_allclose(one.centroid_m, expected, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
def test_every_shipped_cloud_has_its_occlusions_in_either_frame_organised_and_not(tmp_path, number):
    cloud = read_cloud(table_paths()[number])
    loose = Cloud(cloud.points_m[np.isfinite(cloud.points_m[:, 2])])
    for plain in (Cloud(cloud.points_m, cloud.shape), loose):
        view = perceive(plain)
        for eye_m, turn in POSES if plain.shape else POSES[:1]:
            for points in (plain.points_m, turn.apply(plain.points_m.copy()) + eye_m):
                seen = perceive(write(tmp_path / "a.pcd", points, plain.shape, pose_of(eye_m, turn)))
                # Pixels of loose points are as wide as neighbouring rays are apart, which rounds.
                np.testing.assert_allclose(seen.hides, view.hides, atol=1e-3 if plain.shape else 0.03)


@pytest.fixture(scope="module")
def loose():
    points = draw(Can(0.0, -0.05), Can(0.02, 0.10)).cloud.points_m
    return points[np.isfinite(points[:, 2])]


TURN = Rotation.from_matrix(TABLE_FROM_CAMERA)


def test_loose_points_are_in_the_frame_from_which_a_camera_sees_them(loose, tmp_path):
    world = TURN.apply(loose) + EYE_M
    for points, viewpoint, is_own in (
        (loose, pose_of(EYE_M, TURN), True),
        (world, pose_of(EYE_M, TURN), False),
        (world, EYE_M, False),
    ):
        np.testing.assert_array_equal(write(tmp_path / "a.pcd", points, None, viewpoint).eye_m, 0 if is_own else EYE_M)
    # From both places a camera sees them; on a grid, from one.
    aside = pose_of([0.1, 0.0, -0.3], Rotation.from_rotvec([0.0, 0.2, 0.0]))
    np.testing.assert_array_equal(write(tmp_path / "b.pcd", loose, None, aside).eye_m, 0)


def test_a_doubt_is_refused_unless_a_comment_says_which_frame_it_is(loose, tmp_path):
    rng = np.random.default_rng(0)
    scattered = loose + rng.normal(0.0, 0.003, loose.shape)
    aside = pose_of([0.1, 0.0, -0.3], Rotation.from_rotvec([0.0, 0.2, 0.0]))
    around = rng.normal(0.0, 1.0, loose.shape)
    for points, message in ((scattered, "may be in either frame"), (around, "may be in neither frame")):
        with refused(f"{message}.*points_frame camera, or points_frame viewpoint", CloudError):
            write(tmp_path / "a.pcd", points, None, aside)
        for frame, eye_m in (("camera", [0, 0, 0]), ("viewpoint", aside[:3])):
            found = write(tmp_path / "a.pcd", points, None, aside, f"# points_frame {frame}")
            np.testing.assert_array_equal(found.eye_m, eye_m)


def test_a_ray_without_return_that_was_moved_to_the_viewpoint_is_none(plain, tmp_path):
    cloud, _ = plain
    eye_m, turn = POSES[2]
    moved = turn.apply(np.nan_to_num(cloud.points_m)) + eye_m
    assert write(tmp_path / "a.pcd", moved, cloud.shape, pose_of(eye_m, turn)).num_returns == cloud.num_returns


def test_a_turned_camera_is_found_from_its_pixels_and_rays_by_what_made_them():
    rng = np.random.default_rng(3)
    K = np.array([[510.0, 0.0, 300.0], [0.0, 530.0, 250.0], [0.0, 0.0, 1.0]])
    for turn in Rotation.random(5, rng=rng):
        at_px = rng.uniform(0, 480, (400, 2))
        ray = np.linalg.solve(K, np.column_stack([at_px, np.ones(400)]).T).T
        found = turned_pinhole(turn.apply(ray * rng.uniform(0.5, 2.0, (400, 1))), at_px)
        np.testing.assert_allclose(found.intrinsics, K, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.axes, turn.as_matrix(), atol=1e-9)
        assert found.misfit_px < 1e-6
