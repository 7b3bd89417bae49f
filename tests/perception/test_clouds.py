import io
import struct

import lzf
import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from drawn_tables import Can, K, draw
from halfseen.errors import CloudError
from halfseen.perception import XTION, Cloud, DepthSensor, perceive, read_cloud, write_pcd
from halfseen.perception.picture import COLOURS, DOTS_PER_INCH, THUMBNAIL_INCHES, thumbnail
from halfseen.perception.range_image import VIRTUAL_PIXEL_SCALE, range_image

ROWS, COLUMNS = 4, 5


@pytest.fixture
def points() -> np.ndarray:
    points = np.random.default_rng(3).uniform(0.2, 1.5, size=(ROWS * COLUMNS, 3)).astype(np.float32).astype(np.float64)
    points[7] = np.nan
    return points


def pcd_header(width: int, height: int, data: str, fields: str = "x y z") -> bytes:
    num = len(fields.split())
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {fields}",
        "SIZE " + " ".join(["4"] * num),
        "TYPE " + " ".join(["F"] * num),
        "COUNT " + " ".join(["1"] * num),
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {width * height}",
        f"DATA {data}",
    ]
    return ("\n".join(lines) + "\n").encode()


def pcd_body(points: np.ndarray, data: str) -> bytes:
    rows = points.astype("<f4")
    if data == "ascii":
        text = io.StringIO()
        np.savetxt(text, rows, fmt="%.9g")
        return text.getvalue().encode()
    if data == "binary":
        return rows.tobytes()
    plain = rows.T.tobytes()
    packed = lzf.compress(plain) or b""
    return struct.pack("<II", len(packed), len(plain)) + packed


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("is_organised", [True, False])
def test_every_kind_of_pcd_is_read(tmp_path, data, is_organised):
    points = np.tile(np.arange(1.0, 61.0).reshape(20, 3), (1, 1))
    points[7] = np.nan
    width, height = (COLUMNS, ROWS) if is_organised else (COLUMNS * ROWS, 1)
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd_header(width, height, data) + pcd_body(points, data))
    cloud = read_cloud(path)
    assert cloud.shape == ((ROWS, COLUMNS) if is_organised else None)
    np.testing.assert_array_equal(cloud.points_m, points)
    assert cloud.num_returns == 19


def test_ascii_pcd_with_more_fields_and_loose_spacing(tmp_path):
    path = tmp_path / "cloud.pcd"
    body = b"9 1.5  2.5 3.5 \n9 4.5 5.5\t6.5\n"
    path.write_bytes(pcd_header(2, 1, "ascii", fields="rgb x y z") + body)
    np.testing.assert_array_equal(read_cloud(path).points_m, [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]])


@pytest.mark.parametrize("is_text", [True, False])
def test_every_kind_of_ply_is_read(tmp_path, points, is_text):
    vertex = np.empty(len(points), dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1")])
    for k, axis in enumerate("xyz"):
        vertex[axis] = points[:, k]
    vertex["red"] = 200
    path = tmp_path / "cloud.ply"
    PlyData([PlyElement.describe(vertex, "vertex")], text=is_text).write(str(path))
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points_m, points, rtol=1e-6)
    assert cloud.shape is None


@pytest.mark.parametrize("empty", [0.0, np.nan, -1.0, np.inf])
def test_npz_depth_without_return(tmp_path, empty):
    depth = np.full((ROWS, COLUMNS), 2.0, dtype=np.float32)
    depth[1, 2] = empty
    path = tmp_path / "cloud.npz"
    np.savez(path, depth_m=depth, K=K)
    cloud = read_cloud(path)
    assert cloud.shape == (ROWS, COLUMNS)
    np.testing.assert_array_equal(cloud.intrinsics, K)
    image = cloud.points_m.reshape(ROWS, COLUMNS, 3)
    assert np.isnan(image[1, 2]).all()
    np.testing.assert_allclose(image[3, 4], [(4 - K[0, 2]) / K[0, 0] * 2, (3 - K[1, 2]) / K[1, 1] * 2, 2.0])


@pytest.mark.parametrize("shape", [(ROWS, COLUMNS), None])
@pytest.mark.parametrize("intrinsics", [K, None])
def test_write_then_read_is_the_same_cloud(tmp_path, points, shape, intrinsics):
    written = Cloud(points, shape, intrinsics, "a cloud", np.array([0.0, 0.5, 0.0]))
    write_pcd(written, tmp_path / "cloud.pcd")
    read = read_cloud(tmp_path / "cloud.pcd")
    np.testing.assert_array_equal(read.points_m, points)
    assert read.shape == shape
    np.testing.assert_array_equal(read.eye_m, [0.0, 0.5, 0.0])
    if intrinsics is None:
        assert read.intrinsics is None
    else:
        np.testing.assert_array_equal(read.intrinsics, intrinsics)
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.pcd"]


class Evil:
    def __reduce__(self):
        return (print, ("never unpickled",))


def npz(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **({"depth_m": np.ones((4, 5)), "K": K} | arrays))
    return file.getvalue()


NUMBERED = np.arange(1.0, 61.0).reshape(20, 3)
NUMBERS = {
    data: pcd_header(20, 1, data) + pcd_body(NUMBERED, data) for data in ("ascii", "binary", "binary_compressed")
}
PLY = b"ply\nformat binary_little_endian 1.0\nelement vertex 20\n"
PLY += b"property float x\nproperty float y\nproperty float z\nend_header\n" + b"\x00" * 100
CUT, NO_K = "cut short|not a whole", "3 by 3 and finite"


def pcd(old: bytes, new: bytes) -> bytes:
    """A good file with something else in its header."""
    assert old in NUMBERS["ascii"]
    return NUMBERS["ascii"].replace(old, new)


BAD = {
    "suffix": (".xyz", b"1 2 3", r"'.xyz'.*\.pcd, \.ply, \.npz"),
    "pickle": (".npz", npz(depth_m=np.array([Evil()], dtype=object)), "never pickled"),
    "K shape": (".npz", npz(K=np.eye(2)), NO_K),
    "K not finite": (".npz", npz(K=K * np.nan), NO_K),
    "K negative": (".npz", npz(K=-K), "must be positive"),
    "K text": (".npz", npz(K=np.full((3, 3), "a")), NO_K),
    "whole numbers": (".npz", npz(depth_m=np.ones((4, 5), int)), "floats in metres"),
    "flat": (".npz", npz(depth_m=np.ones(20)), "image of floats"),
    "millimetres": (".npz", npz(depth_m=np.full((4, 5), 900.0)), "divide millimetres by 1000"),
    "nothing": (".npz", npz(depth_m=np.full((4, 5), np.nan)), "not one of 20 points"),
    "cut npz": (".npz", npz()[: len(npz()) // 2], "cut short"),
    "empty npz": (".npz", b"", "cut short|not a whole|never pickled"),
    "text as npz": (".npz", b"hello there", "never pickled|cut short"),
    "cut ascii": (".pcd", NUMBERS["ascii"][: len(NUMBERS["ascii"]) // 2 + 110], CUT),
    "cut binary": (".pcd", NUMBERS["binary"][:-24], CUT),
    "cut packed": (".pcd", NUMBERS["binary_compressed"][:-9], CUT),
    "cut header": (".pcd", NUMBERS["ascii"][:60], "no DATA line"),
    "many values": (".pcd", pcd(b"COUNT 1 1 1", b"COUNT 1 1 1000000000"), "a COUNT from 1 to 4096"),
    "fewer counts": (".pcd", pcd(b"COUNT 1 1 1", b"COUNT 1 1"), "3 TYPE and 2 COUNT"),
    "odd type": (".pcd", pcd(b"TYPE F F F", b"TYPE F F Q"), "a TYPE is F, U or I"),
    "no points": (".pcd", pcd(b"POINTS 20", b"POINTS -1"), "POINTS is '-1'; it is a whole number"),
    "many points": (".pcd", pcd(b"POINTS 20", b"POINTS 9999999999"), "was cut short"),
    "half a viewpoint": (".pcd", pcd(b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT 1"), "VIEWPOINT is '1'; give x, y and z"),
    "words for one": (".pcd", pcd(b"VIEWPOINT 0 0 0", b"VIEWPOINT a b c"), "VIEWPOINT is 'a b c'; give numbers"),
    "bomb": (
        ".pcd",
        pcd_header(10**9, 1, "binary_compressed") + pcd_body(NUMBERED, "binary_compressed"),
        "unpacked, it has 12,000 MB",
    ),
    "no z": (".pcd", pcd_header(2, 1, "ascii", fields="x y") + b"1 2\n3 4\n", "needs x, y and z"),
    "intrinsics": (".pcd", pcd(b"VERSION 0.7", b"# intrinsics 1 2\nVERSION 0.7"), "fx fy cx cy"),
    "shape": (".pcd", pcd(b"WIDTH 20\nHEIGHT 1", b"WIDTH 6\nHEIGHT 4"), "do not fill"),
    "many vertices": (".ply", PLY.replace(b"vertex 20", b"vertex 999999999999"), "999999999999 are announced"),
    "cut ply": (".ply", PLY, "not a whole"),
    "no ply": (".ply", b"solid nonsense", "not a whole"),
    "ply of faces": (
        ".ply",
        b"ply\nformat ascii 1.0\nelement face 1\nproperty float a\nend_header\n1\n",
        "no element 'vertex'",
    ),
}


def test_an_npz_without_its_arrays_is_refused(tmp_path):
    np.savez(tmp_path / "cloud.npz", depth=np.ones((4, 5)))
    with pytest.raises(CloudError, match=r"lacks \['K', 'depth_m'\]"):
        read_cloud(tmp_path / "cloud.npz")


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, case, capsys):
    suffix, content, message = BAD[case]
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(content)
    with pytest.raises(CloudError, match=message) as caught:
        read_cloud(path)
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""


def test_a_missing_file_is_refused_and_what_is_no_file_is_named(tmp_path):
    with pytest.raises(CloudError, match="no such file"):
        read_cloud(tmp_path / "none.pcd")
    (tmp_path / "folder.pcd").mkdir()
    with pytest.raises(CloudError, match="it is a folder and no file"):
        read_cloud(tmp_path / "folder.pcd")
    (tmp_path / "link.npz").symlink_to("/dev/zero")
    with pytest.raises(CloudError, match="it is a device and no file, where the link leads"):
        read_cloud(tmp_path / "link.npz")


def cloud_of(rng, num_points=1500):
    """Points of few coordinates, so that rays and depths are shared by some."""
    across = rng.integers(-20, 20, (num_points, 2)) / 32
    depth = rng.integers(4, 7, num_points) / 4
    return np.column_stack([across * depth[:, None], depth])


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_has_the_nearest_of_its_points(seed):
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


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_is_as_wide_as_rays_are_apart(seed):
    points = cloud_of(np.random.default_rng(seed), 600)
    rays = np.unique(points[:, :2] / points[:, 2:], axis=0)
    apart = np.linalg.norm(rays[:, None] - rays, axis=2) + np.diag(np.full(len(rays), np.inf))
    pitch = VIRTUAL_PIXEL_SCALE * np.median(apart.min(axis=1))
    assert 1 / range_image(Cloud(points)).intrinsics[0, 0] == pytest.approx(pitch, rel=1e-12)


def test_noise_grows_with_the_square_of_the_distance_from_a_floor_on():
    assert isinstance(XTION, DepthSensor)
    np.testing.assert_allclose(XTION.noise_m(np.array([0.1, 1.0, 2.0])), [0.001, 0.003, 0.012])


def pixels_of(view):
    with Image.open(io.BytesIO(thumbnail(view))) as image:
        return np.asarray(image.convert("RGB"), dtype=float) / 255.0


def is_colour(pixels, place):
    wanted = np.array([int(COLOURS[place][k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.abs(pixels - wanted).max(axis=-1) < 0.02


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
