"""Colours of clouds: through every format bit for bit, as other programs write them, and refused where they are not."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from plyfile import PlyData, PlyElement
from pypcd4 import Encoding, PointCloud

from drawn_tables import K
from halfseen.errors import CloudError
from halfseen.perception import Cloud, read_cloud, write_pcd
from halfseen.perception.colours import pixel_colours
from halfseen.perception.range_image import range_image

ROWS, COLUMNS = 4, 5
NUM = ROWS * COLUMNS
# Of the file that halfseen 0.1.0 wrote before clouds had colour.
BYTES_BEFORE = "ec599a1378633eac0d8e89932b65b7defe4c51b2cb62ae67054e625753b846f3"


@pytest.fixture
def points() -> np.ndarray:
    points = np.random.default_rng(3).uniform(0.2, 1.5, size=(NUM, 3)).astype(np.float32).astype(np.float64)
    points[7] = np.nan
    return points


@pytest.fixture
def colours() -> np.ndarray:
    """Any, with the ends of the range: their bits are floats of all kinds."""
    colours = np.random.default_rng(4).integers(0, 256, size=(NUM, 3), dtype=np.uint8)
    colours[:3] = [[0, 0, 0], [255, 255, 255], [128, 0, 255]]
    return colours


def packed(colours: np.ndarray, alpha: int = 0) -> np.ndarray:
    """One whole number a colour, by the definition of PCL: 0xAARRGGBB."""
    return np.array([alpha << 24 | int(r) << 16 | int(g) << 8 | int(b) for r, g, b in colours], dtype=np.uint32)


def test_another_library_reads_the_colours_that_were_written(tmp_path, points, colours):
    write_pcd(Cloud(points, colours=colours), tmp_path / "cloud.pcd")
    other = PointCloud.from_path(tmp_path / "cloud.pcd")
    assert other.fields == ("x", "y", "z", "rgb")
    np.testing.assert_array_equal(PointCloud.decode_rgb(other.pc_data["rgb"]), colours)


def test_without_colour_a_file_is_as_it_was_before_there_was_any(tmp_path):
    points = np.arange(1.0, 61.0).reshape(NUM, 3)
    write_pcd(Cloud(points, (ROWS, COLUMNS), K, "a cloud"), tmp_path / "cloud.pcd")
    written = (tmp_path / "cloud.pcd").read_bytes()
    assert hashlib.sha256(written).hexdigest() == BYTES_BEFORE
    assert read_cloud(tmp_path / "cloud.pcd").colours is None


@pytest.mark.parametrize("encoding", list(Encoding))
@pytest.mark.parametrize(("field", "kind"), [("rgb", np.float32), ("rgb", np.uint32), ("rgba", np.uint32)])
@pytest.mark.parametrize("alpha", [0, 255])
def test_pcd_files_of_another_library_are_read_right(tmp_path, points, colours, encoding, field, kind, alpha):
    points[7] = 1.0
    bits = packed(colours, alpha).view(kind) if kind is np.float32 else packed(colours, alpha)
    columns = [*points.astype(np.float32).T, bits]
    cloud = PointCloud.from_points(columns, ("x", "y", "z", field), (np.float32, np.float32, np.float32, kind))
    cloud.save(tmp_path / "cloud.pcd", encoding=encoding)
    read = read_cloud(tmp_path / "cloud.pcd").colours
    if encoding is Encoding.ASCII and kind is np.float32:
        assert read is None  # ten decimals, or "nan": what it wrote holds no colour any more
    else:
        np.testing.assert_array_equal(read, colours)


def test_a_float_written_out_in_text_is_a_colour(tmp_path, points, colours):
    points[7] = np.nan
    header = ["FIELDS x y z rgb", "SIZE 4 4 4 4", "TYPE F F F F", f"WIDTH {NUM}", "HEIGHT 1", f"POINTS {NUM}"]
    rows = [f"{x:.9g} {y:.9g} {z:.9g} {c:.9g}" for (x, y, z), c in zip(points, packed(colours).view("f4"), strict=True)]
    (tmp_path / "cloud.pcd").write_text("\n".join([*header, "DATA ascii", *rows]))
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.pcd").colours, colours)


@pytest.mark.parametrize("is_text", [True, False])
def test_ply_files_of_another_library_are_read_right(tmp_path, points, colours, is_text):
    vertex = np.empty(
        NUM, dtype=[("x", "f4"), ("blue", "u1"), ("y", "f4"), ("red", "u1"), ("z", "f4"), ("green", "u1")]
    )
    for k, (axis, name) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        vertex[axis], vertex[name] = points[:, k], colours[:, k]
    PlyData([PlyElement.describe(vertex, "vertex")], text=is_text).write(str(tmp_path / "cloud.ply"))
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.ply").colours, colours)


def bad_npz(path: Path, rgb: np.ndarray) -> None:
    np.savez(path, depth_m=np.ones((ROWS, COLUMNS)), K=K, rgb=rgb)


def bad_ply(path: Path) -> None:
    vertex = np.ones(NUM, dtype=[(name, "f4") for name in ("x", "y", "z", "red", "green", "blue")])
    PlyData([PlyElement.describe(vertex, "vertex")]).write(str(path))


def bad_pcd(path: Path) -> None:
    kinds = (np.float32, np.float32, np.float32, np.uint8)
    PointCloud.from_points([np.ones(NUM, kind) for kind in kinds], ("x", "y", "z", "rgb"), kinds).save(path)


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("a.npz", lambda p: bad_npz(p, np.ones((ROWS, COLUMNS, 3))), r"rgb is float64 of shape \(4, 5, 3\)"),
        ("b.npz", lambda p: bad_npz(p, np.ones((ROWS, 3), np.uint8)), r"uint8 of shape \(4, 5, 3\), a colour for each"),
        ("c.ply", bad_ply, "red, green and blue are float32, float32, float32"),
        ("d.pcd", bad_pcd, "field rgb has TYPE U, SIZE 1 and COUNT 1"),
    ],
)
def test_colours_of_another_kind_are_refused_in_one_line(tmp_path, name, write, message):
    write(tmp_path / name)
    with pytest.raises(CloudError, match=message) as caught:
        read_cloud(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "leave it out" in str(caught.value)


def test_a_colour_for_each_point_and_not_to_be_changed(points, colours):
    # Where shapes are executed, they are refused before the cloud is made.
    with pytest.raises((CloudError, TypeCheckError), match=r"of shape \(19, 3\), beside 20 points|u8\[19,3\]"):
        Cloud(points, colours=colours[1:])
    cloud = Cloud(points, colours=colours)
    colours[0] = 9
    assert not cloud.colours[0].any()
    with pytest.raises(ValueError, match="read-only"):
        cloud.colours[0] = 1


def a_wall(num_rows: int = 30, num_columns: int = 40) -> tuple[Cloud, np.ndarray]:
    picture = np.random.default_rng(5).integers(0, 256, size=(num_rows, num_columns, 3), dtype=np.uint8)
    depth = np.full((num_rows, num_columns), 1.0)
    depth[2, 3] = np.nan
    focal = np.array([[40.0, 0.0, 20.0], [0.0, 40.0, 15.0], [0.0, 0.0, 1.0]])
    return Cloud.from_depth(depth, focal, "wall", picture), picture


def test_pixels_of_an_unorganised_cloud_have_the_colour_of_their_nearest_point():
    cloud, _ = a_wall()
    near = np.flatnonzero(np.isfinite(cloud.points_m[:, 2]))
    points = np.concatenate([0.9 * cloud.points_m[near], cloud.points_m[near]])
    colours = np.concatenate([cloud.colours[near], 255 - cloud.colours[near]])
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


@pytest.mark.parametrize("shape", [(ROWS, COLUMNS), None])
def test_a_pcd_keeps_every_bit_of_colour(tmp_path, points, colours, shape):
    write_pcd(Cloud(points, shape, K, colours=colours), tmp_path / "cloud.pcd")
    read = read_cloud(tmp_path / "cloud.pcd")
    np.testing.assert_array_equal(read.points_m, points)
    np.testing.assert_array_equal(read.colours, colours)
    assert read.colours.dtype == np.uint8
    assert read.shape == shape


def test_pixels_of_an_organised_cloud_have_their_own_colours():
    cloud, picture = a_wall()
    seen = pixel_colours(range_image(cloud), cloud)
    picture[2, 3] = 0
    np.testing.assert_array_equal(seen, picture)
