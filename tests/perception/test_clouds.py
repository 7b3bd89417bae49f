"""Clouds through every format bit for bit, as other programs write them, and refused where they are none."""

import hashlib
import io
import struct
from functools import partial
from pathlib import Path

import lzf
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from plyfile import PlyData, PlyElement
from pypcd4 import Encoding, PointCloud

from drawn_tables import K
from halfseen.errors import CloudError
from halfseen.perception import Cloud, read_cloud, write_pcd
from refusals import refused

ROWS, COLUMNS = 4, 5
NUM = ROWS * COLUMNS


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


def vertices(names: tuple[str, ...], colour_kind: str = "u1") -> np.ndarray:
    return np.ones(NUM, dtype=[(name, "f4" if name in "xyz" else colour_kind) for name in names])


def write_ply(path: Path, vertex: np.ndarray) -> None:
    PlyData([PlyElement.describe(vertex, "vertex")]).write(str(path))


def pcd_header(width: int, height: int, data: str, fields: str = "x y z") -> bytes:
    num = len(fields.split())
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {fields}"]
    lines += [f"{name} {' '.join([value] * num)}" for name, value in (("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1"))]
    lines += [f"WIDTH {width}", f"HEIGHT {height}", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {width * height}"]
    return "\n".join([*lines, f"DATA {data}", ""]).encode()


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
@pytest.mark.parametrize("shape", [(ROWS, COLUMNS), None])
def test_every_kind_of_pcd_is_read(tmp_path, data, shape):
    points, path = NUMBERED.copy(), tmp_path / "cloud.pcd"
    points[7] = np.nan
    rows, columns = shape or (1, NUM)
    path.write_bytes(pcd_header(columns, rows, data) + pcd_body(points, data))
    cloud = read_cloud(path)
    assert (cloud.shape, cloud.num_returns) == (shape, 19)
    np.testing.assert_array_equal(cloud.points_m, points)
    # More fields, and loose spacing, also in the header.
    header = (
        pcd_header(2, 1, "ascii", fields="rgb x y z").replace(b"FIELDS ", b"\nFIELDS\t").replace(b"TYPE ", b"TYPE  ")
    )
    path.write_bytes(header + b"9e-40 1.5  2.5 3.5 \n9e-40 4.5 5.5\t6.5\n")
    np.testing.assert_array_equal(read_cloud(path).points_m, [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]])


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


@pytest.mark.parametrize("has_colours", [True, False])
@pytest.mark.parametrize("shape", [(ROWS, COLUMNS), None])
@pytest.mark.parametrize("intrinsics", [K, None])
def test_write_then_read_is_the_same_cloud(tmp_path, points, colours, shape, intrinsics, has_colours):
    """To every bit; another library reads the same colours."""
    path, colours = tmp_path / "cloud.pcd", colours if has_colours else None
    write_pcd(Cloud(points, shape, intrinsics, "a cloud", np.array([0.0, 0.5, 0.0]), colours=colours), path)
    read = read_cloud(path)
    assert read.shape == shape
    np.testing.assert_array_equal(read.eye_m, [0.0, 0.5, 0.0])
    for found, written in ((read.points_m, points), (read.intrinsics, intrinsics), (read.colours, colours)):
        assert (found is None) == (written is None)
        np.testing.assert_array_equal(found, written)
    if has_colours:
        assert read.colours.dtype == np.uint8
        other = PointCloud.from_path(path)
        assert other.fields == ("x", "y", "z", "rgb")
        np.testing.assert_array_equal(PointCloud.decode_rgb(other.pc_data["rgb"]), colours)
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.pcd"]


class Evil:
    def __reduce__(self):
        return (print, ("never unpickled",))


def packed_npz(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npz(**arrays) -> bytes:
    return packed_npz(**({"depth_m": np.ones((4, 5)), "K": K} | arrays))


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
    "other arrays": (".npz", packed_npz(depth=np.ones((4, 5))), r"lacks \['K', 'depth_m'\]"),
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
    "no points": (".pcd", pcd(b"POINTS 20", b"POINTS -1"), "POINTS is '-1'; give a whole number"),
    "many points": (".pcd", pcd(b"POINTS 20", b"POINTS 9999999999"), "was cut short"),
    "half a viewpoint": (".pcd", pcd(b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT 1"), "VIEWPOINT is '1'; give x, y and z"),
    "no turn": (".pcd", pcd(b"0 0 0 1 0 0 0", b"0 0 1 0 0 0 0"), "VIEWPOINT is '0 0 1 0 0 0 0'; .* not all zeros"),
    "half a turn": (".pcd", pcd(b"0 0 0 1 0 0 0", b"0 0 0 1 0"), "VIEWPOINT is '0 0 0 1 0'; .* a quaternion w, x, y"),
    "no place": (".pcd", pcd(b"0 0 0 1 0 0 0", b"nan 0 0 1 0 0 0"), "VIEWPOINT is 'nan 0 0 1 0 0 0'"),
    "odd frame": (
        ".pcd",
        pcd(b"VERSION 0.7\n", b"# points_frame world\n").replace(b"0 0 0 1 0 0 0", b"0 0 1 1 0 0 0"),
        "points_frame says 'world'; give camera or viewpoint",
    ),
    "words for one": (
        ".pcd",
        pcd(b"VIEWPOINT 0 0 0", b"VIEWPOINT a b c"),
        "VIEWPOINT is 'a b c 1 0 0 0'; give numbers",
    ),
    "bomb": (
        ".pcd",
        pcd_header(10**9, 1, "binary_compressed") + pcd_body(NUMBERED, "binary_compressed"),
        "unpacked, it has 12,000 MB",
    ),
    "odd data": (".pcd", pcd(b"DATA ascii", b"DATA BINARY"), "DATA is 'BINARY'; choose among ascii, binary, binary_c"),
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


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, case, capsys):
    suffix, content, message = BAD[case]
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(content)
    with refused(message, CloudError) as caught:
        read_cloud(path)
    assert path.name in str(caught.value)
    assert capsys.readouterr().out == ""


def test_a_missing_file_is_refused_and_what_is_no_file_is_named(tmp_path):
    (tmp_path / "folder.pcd").mkdir()
    (tmp_path / "link.npz").symlink_to("/dev/zero")
    for name, message in (
        ("none.pcd", "no such file"),
        ("folder.pcd", "it is a folder, not a file"),
        ("link.npz", "it is a device, not a file .the link leads to"),
    ):
        with refused(message, CloudError):
            read_cloud(tmp_path / name)


# Of the file that halfseen 0.1.0 wrote before clouds had colour.
BYTES_BEFORE = "ec599a1378633eac0d8e89932b65b7defe4c51b2cb62ae67054e625753b846f3"


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


@pytest.mark.parametrize("written", ["float", "bits", "opaque"])
def test_a_float_or_its_bits_as_a_whole_number_in_text_are_a_colour(tmp_path, points, colours, written):
    points[7] = np.nan
    header = ["FIELDS x y z rgb", "SIZE 4 4 4 4", "TYPE F F F F", f"WIDTH {NUM}", "HEIGHT 1", f"POINTS {NUM}"]
    bits = packed(colours, alpha=255 if written == "opaque" else 0)
    words = [f"{each:.8g}" for each in bits.view("f4")] if written == "float" else map(str, bits)
    rows = [f"{x:.9g} {y:.9g} {z:.9g} {word}" for (x, y, z), word in zip(points, words, strict=True)]
    (tmp_path / "cloud.pcd").write_text("\n".join([*header, "DATA ascii", *rows]))
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.pcd").colours, colours)


@pytest.mark.parametrize("is_float", [True, False])
def test_text_of_too_few_digits_holds_no_colour(tmp_path, points, colours, is_float):
    """As C++ writes it by default: the blue was then any number."""
    numbers = packed(colours, alpha=0)
    rows = [
        f"1 1 {1 + k} {number:.6g}" for k, number in enumerate(numbers.view("f4") if is_float else numbers.tolist())
    ]
    (tmp_path / "cloud.pcd").write_bytes(pcd_header(NUM, 1, "ascii", "x y z rgb") + "\n".join(rows).encode())
    assert read_cloud(tmp_path / "cloud.pcd").colours is None


def test_red_alone_is_no_colour(tmp_path):
    write_ply(tmp_path / "red.ply", vertices(("x", "y", "z", "red")))
    red = read_cloud(tmp_path / "red.ply")
    assert (red.num_returns, red.shape, red.colours) == (NUM, None, None)


ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
FACES = ["property list uchar int vertex_indices"]


def faces(form: str) -> bytes:
    """Three lists by hand, one of them empty."""
    if form == "ascii":
        return b"3 0 1 2\n2 4 5\n0\n"
    return b"".join(bytes([len(row)]) + np.array(row, f"{ORDERS[form]}i4").tobytes() for row in ([0, 1, 2], [4, 5], []))


@pytest.mark.parametrize("form", ORDERS)
@pytest.mark.parametrize("kind", ["float", "double"])
@pytest.mark.parametrize(
    ("has_lists", "names"),
    [(False, ("red", "green", "blue")), (True, ("diffuse_red", "diffuse_green", "diffuse_blue")), (True, tuple("rgb"))],
)
def test_ply_files_of_both_byte_orders_are_read_past_other_properties_and_elements(
    tmp_path, points, colours, form, kind, has_lists, names
):
    """Written by hand: a reader that took a number for its neighbour, or turned its bytes, would miss by far."""
    red, green, blue = names
    kinds = {"nx": "float", "x": kind, "quality": "short", red: "uchar", "y": kind, green: "uchar", "flag": "char"}
    kinds |= {"z": kind, blue: "uchar", "where": "int"}
    sizes = {"float": "f4", "double": "f8", "short": "i2", "uchar": "u1", "char": "i1", "int": "i4"}
    vertex = np.zeros(NUM, [(name, ORDERS[form] + sizes[each]) for name, each in kinds.items()])
    vertex["nx"], vertex["quality"], vertex["flag"], vertex["where"] = -1.5, -7, -2, 123456
    for k, (axis, name) in enumerate(zip("xyz", names, strict=True)):
        vertex[axis], vertex[name] = points[:, k] + (0.0 if kind == "float" else 1e-12), colours[:, k]
    rows = "".join(f"{' '.join(repr(value.item()) for value in row)}\n" for row in vertex)
    body = rows.encode() if form == "ascii" else vertex.tobytes()
    head = [
        "ply",
        f"format {form} 1.0",
        "comment by hand, in a Büro",
        *(["element face 3", *FACES] if has_lists else []),
    ]
    head += [f"element vertex {NUM}", *(f"property {each} {name}" for name, each in kinds.items())]
    head += [*(["element strip 3", *FACES] if has_lists else []), "end_header", ""]
    lists = faces(form) if has_lists else b""
    (tmp_path / "cloud.ply").write_bytes("\n".join(head).encode() + lists + body + lists)
    cloud = read_cloud(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(cloud.points_m, np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64))
    np.testing.assert_array_equal(cloud.colours, colours)


@pytest.mark.parametrize("names", [("red", "green", "blue"), tuple("rgb")])
@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_colours_of_a_pcd_file_may_be_three_fields(tmp_path, points, colours, names, data):
    rows = np.zeros(NUM, [(axis, "<f4") for axis in "xyz"] + [(name, "u1") for name in names])
    for k, (axis, name) in enumerate(zip("xyz", names, strict=True)):
        rows[axis], rows[name] = points[:, k], colours[:, k]
    head = f"FIELDS x y z {' '.join(names)}\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nWIDTH {NUM}\nHEIGHT 1\nPOINTS {NUM}\n"
    text = "".join(f"{' '.join(repr(value.item()) for value in row)}\n" for row in rows)
    body = text.encode() if data == "ascii" else rows.tobytes()
    (tmp_path / "a.pcd").write_bytes(f"{head}DATA {data}\n".encode() + body)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pcd").colours, colours)


def test_a_number_of_windows_is_not_cut_at_its_sign(tmp_path):
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(f"{head}0.5 0.5 1.#QNAN\n")
    with refused("could not convert string '1.#QNAN'", CloudError):
        read_cloud(tmp_path / "a.pcd")


def npz_of_colours(path: Path, rgb: np.ndarray) -> None:
    np.savez(path, depth_m=np.ones((ROWS, COLUMNS)), K=K, rgb=rgb)


def pcd_of_a_byte(path: Path) -> None:
    kinds = (np.float32, np.float32, np.float32, np.uint8)
    PointCloud.from_points([np.ones(NUM, kind) for kind in kinds], ("x", "y", "z", "rgb"), kinds).save(path)


def pcd_of_a_number(path: Path, data: str, value: str) -> None:
    body = pcd_body(np.array([[1.0, 1.0, 1.0, float(value)]]), data)
    path.write_bytes(pcd_header(1, 1, data, "x y z rgb") + body)


def pcd_of_text(path: Path, value: str) -> None:
    head = "FIELDS x y z r g b\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
    path.write_text(f"{head}1 1 1 0 0 {value}\n")


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("a.npz", lambda p: npz_of_colours(p, np.ones((ROWS, COLUMNS, 3))), r"rgb is float64 of shape \(4, 5, 3\)"),
        ("b.npz", lambda p: npz_of_colours(p, np.ones((ROWS, 3), np.uint8)), r"uint8 of shape \(4, 5, 3\), a colour"),
        (
            "c.ply",
            lambda p: write_ply(p, vertices(("x", "y", "z", "red", "green", "blue"), "f4")),
            "red, green and blue are float32, float32, float32",
        ),
        ("d.pcd", pcd_of_a_byte, "field rgb has TYPE U, SIZE 1 and COUNT 1"),
        *(
            (f"{data}{value}.pcd", partial(pcd_of_a_number, data=data, value=value), f"field rgb is {value} in a point")
            for data, value in (("ascii", "0.5"), ("ascii", "128"), ("binary", "0.5"))
        ),
        *(
            (f"apart{value}.pcd", partial(pcd_of_text, value=value), "red, green and blue are uint8, uint8, float64")
            for value in ("0.5", "300")
        ),
    ],
)
def test_colours_of_another_kind_are_refused_in_one_line(tmp_path, name, write, message):
    write(tmp_path / name)
    with refused(f"{name}.*{message}.*leave it out", CloudError):
        read_cloud(tmp_path / name)


def test_a_colour_for_each_point_and_not_to_be_changed(points, colours):
    # Where shapes are executed, they are refused before the cloud is made.
    with pytest.raises((CloudError, TypeCheckError), match=r"of shape \(19, 3\), beside 20 points|u8\[19,3\]"):
        Cloud(points, colours=colours[1:])
    cloud = Cloud(points, colours=colours)
    colours[0] = 9
    assert not cloud.colours[0].any()
    with pytest.raises(ValueError, match="read-only"):
        cloud.colours[0] = 1
