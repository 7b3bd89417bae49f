"""PCD files: points, packed colours if present, and the pinhole camera in a comment."""

import io
import os
from io import BufferedReader
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.arrays import Intrinsics, Points
from halfseen.errors import CloudError
from halfseen.perception.clouds import COLOURS, Cloud, Colours, check_num_points, colours_of
from halfseen.perception.frames import FRAME_COMMENT, VIEWPOINT, camera_of, quaternion_of, viewpoint_of
from halfseen.reading import CLOUD, check_unpacked, opened
from halfseen.shapes import Float, Shaped
from halfseen.writing import write_file

# Header comment for the pinhole camera [px]: PCD has no field for it, and readers skip comments.
INTRINSICS_COMMENT = "# intrinsics"
COMMENTS = (INTRINSICS_COMMENT, f"# {FRAME_COMMENT}")


KINDS_OF_DATA = ("ascii", "binary", "binary_compressed")

# Limits of a header, which has a dozen lines.
MOST_HEADER_LINES, MOST_LINE_BYTES = 1000, 65_536
# Largest number of values in one field; the longest point descriptors have a few hundred.
MOST_COUNT = 4096
_KINDS = {*(kind + size for kind in "UI" for size in "1248"), "F4", "F8"}

# Fields that hold a colour as 0x00RRGGBB in the four bytes of an integer or a float.
PACKED_COLOURS = ("rgb", "rgba")
# Least size of a share; without opacity, the floats of packed colours are smaller.
LEAST_PLAIN = 1e-6
# The float with the bits 1, and the least number of whole numbers that show a multiple.
SMALLEST, FEWEST_ROUNDED = 2.0**-149, 10

Columns: TypeAlias = dict[str, Shaped[np.ndarray, " n"]]


class Field(NamedTuple):
    """A column of the points: its TYPE, SIZE [B] and COUNT."""

    name: str
    kind: str
    size: int
    count: int

    @property
    def num_bytes(self) -> int:
        """Size of the field in one point [B]."""
        return self.size * self.count


def read_pcd(path: Path) -> Cloud:
    """Read a file with any of the three kinds of DATA; the cloud is organised if HEIGHT is greater than 1.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    CloudError
        The file is truncated, lacks coordinates, or has colours or intrinsics of the wrong type.
    """
    with opened(path, CLOUD) as file:
        header = _header(file, path)
        names = header.get("FIELDS", "").split()
        if not {"x", "y", "z"} <= set(names):
            raise CloudError(f"{path}: has fields {names}, but needs x, y and z; export it with coordinates in metres")
        num_points, width, height = (_whole(header, key, path) for key in ("POINTS", "WIDTH", "HEIGHT"))
        fields = _fields(header, num_points, path)
        check_num_points(num_points, str(path))
        packed = next((name for name in PACKED_COLOURS if name in names), None)
        apart = next((each for each in COLOURS if packed is None and {*each} <= {*names}), ())
        wanted = ["x", "y", "z", *([] if packed is None else [packed]), *apart]
        if header["DATA"] == "ascii":
            columns = _text_columns(file, fields, wanted)
        else:
            columns = _binary_columns(file, fields, wanted, num_points, header["DATA"] == "binary", path)
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if len(points) != num_points:
        raise CloudError(
            f"{path}: holds {len(points)} points, but announces {num_points}; it was cut short: export it again"
        )
    colours = None
    if packed is not None:
        kind = _packed_kind(fields[names.index(packed)], path)
        if kind == "F":
            _refuse_plain(columns[packed], packed, path)
        colours = _unpacked(columns[packed], points, kind)
    elif apart:
        kinds = [
            np.dtype(f"{kind.lower()}{size}") for _, kind, size, _ in (fields[names.index(each)] for each in apart)
        ]
        values = [_whole_of(columns[each], kind) for each, kind in zip(apart, kinds, strict=True)]
        colours = colours_of(values, str(path))
    shape = (height, width) if height > 1 else None
    pose = _numbers((header.get("VIEWPOINT") or "0 0 0").split(), "VIEWPOINT", path)
    viewpoint, frame = viewpoint_of(pose, str(path)), header.get(f"# {FRAME_COMMENT}")
    camera = camera_of(points, shape, viewpoint, str(path), frame)
    return Cloud(points, shape, _intrinsics(header, path), path.name, camera.eye_m, colours, camera.axes)


def _header(file: BufferedReader, path: Path) -> dict[str, str]:
    """Header entries, including our comments; the file is then at the first point."""
    header: dict[str, str] = {}
    for _ in range(1, MOST_HEADER_LINES):
        line = file.readline(MOST_LINE_BYTES)
        text = line.decode("ascii", errors="replace").strip()
        comment = next((each for each in COMMENTS if text.startswith(each)), None)
        if comment is not None:
            header[comment] = text.removeprefix(comment).strip()
        elif text and not text.startswith("#"):
            key, *value = text.split(maxsplit=1)
            header[key] = value[0] if value else ""
        if "DATA" in header:
            return _checked_data(header, path)
        if not line:
            break
    raise CloudError(f"{path}: has no DATA line; it is not a PCD file, or its header was cut short")


def _checked_data(header: dict[str, str], path: Path) -> dict[str, str]:
    if header["DATA"] not in KINDS_OF_DATA:
        raise CloudError(f"{path}: DATA is {header['DATA'][:40]!r}; choose among {', '.join(KINDS_OF_DATA)}")
    return header


def _whole(header: dict[str, str], key: str, path: Path) -> int:
    digits = header.get(key, "1" if key == "HEIGHT" else "nothing")
    if not (digits.isascii() and digits.isdigit() and len(digits) < 16):
        raise CloudError(f"{path}: {key} is {digits[:40]!r}; give a whole number from 0 on: export it again")
    return int(digits)


def _fields(header: dict[str, str], num_points: int, path: Path) -> list[Field]:
    """Fields of a header; refuse inconsistent fields, and a header that declares more data than the file has."""
    names = header["FIELDS"].split()
    kinds, sizes, counts = (header.get(key, "").split() for key in ("TYPE", "SIZE", "COUNT"))
    counts = counts or ["1"] * len(names)
    if len(set(names) - {"_"}) < len(names) - names.count("_"):
        raise CloudError(f"{path}: two FIELDS have the same name ({header['FIELDS'][:80]}); give each its own")
    if not len(names) == len(kinds) == len(sizes) == len(counts):
        raise CloudError(
            f"{path}: there are {len(names)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE and {len(counts)} COUNT; "
            "give one of each for every field"
        )
    for name, kind, size, count in zip(names, kinds, sizes, counts, strict=True):
        if kind + size not in _KINDS or not (count.isascii() and count.isdigit() and 0 < int(count[:9]) <= MOST_COUNT):
            raise CloudError(
                f"{path}: field {name[:40]} has TYPE {kind[:9]}, SIZE {size[:9]} and COUNT {count[:12]}; a TYPE is F, "
                f"U or I of 1, 2, 4 or 8 bytes (F: 4 or 8), a COUNT from 1 to {MOST_COUNT}"
            )
    fields = [
        Field(name, kind, int(size), int(n)) for name, kind, size, n in zip(names, kinds, sizes, counts, strict=True)
    ]
    num_bytes, of_point = path.stat().st_size, sum(field.num_bytes for field in fields)
    at_least = {"ascii": 2 * len(names) - 1, "binary": of_point}.get(header["DATA"], 0) * num_points
    if at_least > num_bytes:
        raise CloudError(
            f"{path}: {num_points} points are announced, which take {at_least} bytes, but the file has {num_bytes}; it "
            "was cut short: export it again"
        )
    check_unpacked(num_bytes, of_point * num_points)
    return fields


def _text_columns(file: BufferedReader, fields: list[Field], wanted: list[str]) -> Columns:
    """Columns of a text body; values may be separated by several spaces."""
    names, starts = [field.name for field in fields], np.cumsum([0, *(field.count for field in fields)])
    places = starts[[names.index(name) for name in wanted]].tolist()
    rows = np.loadtxt(file, usecols=places, ndmin=2, dtype=np.float64, comments=None)
    return dict(zip(wanted, rows.T, strict=True))


def _binary_columns(
    file: BufferedReader, fields: list[Field], wanted: list[str], num_points: int, is_plain: bool, path: Path
) -> Columns:
    """Columns of a binary body, by point if plain, by field if compressed; importing pypcd4 would take longer."""
    of_field = [field.num_bytes for field in fields]
    if is_plain:
        points = np.frombuffer(file.read(), np.uint8, num_points * sum(of_field)).reshape(num_points, -1)
        columns = np.split(points, np.cumsum(of_field)[:-1], axis=1)
    else:
        packed = np.frombuffer(_decompressed(file, num_points * sum(of_field), path), np.uint8)
        columns = np.split(packed, np.cumsum(of_field)[:-1] * num_points)
    found = {field.name: (field, column) for field, column in zip(fields, columns, strict=True)}
    return {
        name: np.ascontiguousarray(column).ravel().view(f"<{field.kind.lower()}{field.size}")
        for name, (field, column) in ((name, found[name]) for name in wanted)
    }


def _decompressed(file: BufferedReader, num_bytes: int, path: Path) -> bytes:
    """Decompress points; refuse a wrong declared size, as memory would be allocated for it."""
    import lzf

    start = file.read(8)
    num_packed, announced = (int.from_bytes(start[k : k + 4], "little") for k in (0, 4))
    if announced != num_bytes:
        raise CloudError(
            f"{path}: its compressed points announce {announced} bytes, but its header {num_bytes}; it was cut short "
            "or changed: export it again"
        )
    try:
        found = lzf.decompress(file.read()[:num_packed], num_bytes)
    except ValueError:
        found = None
    if found is None or len(found) != num_bytes:
        raise CloudError(
            f"{path}: its compressed points cannot be decompressed; it was cut short or changed: export it again"
        )
    return found


def _packed_kind(field: Field, path: Path) -> str:
    """TYPE of a packed colour: F, U or I."""
    name, kind, size, count = field
    if (size, count) != (4, 1):
        raise CloudError(
            f"{path}: field {name} has TYPE {kind}, SIZE {size} and COUNT {count}; a colour takes 4 bytes, "
            "TYPE F or U, COUNT 1: export it so, or leave it out"
        )
    return kind


def _refuse_plain(column: Shaped[np.ndarray, " n"], name: str, path: Path) -> None:
    """Refuse shares or greys in a field of packed colours, whose bits are no float between these (`CloudError`)."""
    sizes = np.abs(column[np.isfinite(column) & (column != 0)])
    if len(sizes) and sizes.min() > LEAST_PLAIN and sizes.max() < 256:
        raise CloudError(
            f"{path}: field {name} is {sizes[0]:g} in a point, not a colour whose bytes are those of a float; pack "
            "red, green and blue from 0 to 255 into it, or leave it out"
        )


def _whole_of(column: Shaped[np.ndarray, " n"], kind: np.dtype) -> Shaped[np.ndarray, " n"]:
    """Numbers from text in their type; unchanged if one of them does not fit it."""
    with np.errstate(invalid="ignore"):
        values = column.astype(kind)
    return values if (values == column).all() else column


def _unpacked(column: Shaped[np.ndarray, " n"], points_m: Points, kind: str) -> Colours | None:
    """Colours of a column as it was stored, or None if text has lost them."""
    if column.dtype.itemsize != 4:
        # From text. The bits of a colour are a tiny float or, if opaque, NaN; writers print "0.0000000000" or "nan".
        if not column.any() or np.isnan(column[np.isfinite(points_m).all(axis=1)]).any():
            return None
        is_float = kind == "F" and not _is_whole(column)
        if _is_rounded(column, is_float):
            return None
        column = column.astype(np.float32) if is_float else np.nan_to_num(column).astype(np.int64).astype(np.uint32)
    bits = column.view(np.uint32)
    return np.stack([bits >> shift & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)


def _is_whole(column: Float[np.ndarray, " n"]) -> bool:
    """Whether text of TYPE F holds bits of colours as whole numbers, as some writers do; as fractions they are tiny."""
    there = column[~np.isnan(column)]
    return bool((there == np.floor(there)).all() and (there >= 0.0).all() and 1.0 <= there.max(initial=0.0) < 2**32)


def _is_rounded(column: Float[np.ndarray, " n"], is_float: bool) -> bool:
    """Whether text has too few digits for the last bits of colours, such as 4.2108e+06 or 1.79767e-38."""
    if is_float:
        bits = column[np.abs(column) < 2**24 * SMALLEST] / SMALLEST
        return bool((np.abs(bits - np.round(bits)) > 0.45).any())
    different = np.unique(column[~np.isnan(column)])
    return len(different) >= FEWEST_ROUNDED and bool((different % 10 == 0).all())


def _intrinsics(header: dict[str, str], path: Path) -> Intrinsics | None:
    if INTRINSICS_COMMENT not in header:
        return None
    values = header[INTRINSICS_COMMENT].split()
    if len(values) != 4:
        raise CloudError(f"{path}: the intrinsics comment is {values}; it must be 'fx fy cx cy' in pixels")
    fx, fy, cx, cy = _numbers(values, "the intrinsics comment", path)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _numbers(values: list[str], what: str, path: Path) -> list[float]:
    try:
        return [float(value) for value in values]
    except ValueError:
        raise CloudError(f"{path}: {what} is {' '.join(values)[:80]!r}; give numbers") from None


def write_pcd(cloud: Cloud, path: str | os.PathLike[str]) -> None:
    """Write a cloud as a compressed binary PCD file with float32 coordinates, and packed ``rgb`` if it has colour.

    Parameters
    ----------
    cloud
        Cloud to write. The file keeps the width and height of an organised cloud; a header comment has the intrinsics.
    path
        Output file, written atomically; missing parents are created.

    Raises
    ------
    ArgumentError
        The file cannot be written there.
    """
    from pypcd4.pypcd4 import Encoding, PointCloud

    columns = [*cloud.points_m.astype(np.float32).T]
    names = ["x", "y", "z"]
    if cloud.colours is not None:
        red, green, blue = cloud.colours.astype(np.uint32).T
        columns, names = [*columns, (red << 16 | green << 8 | blue).view(np.float32)], [*names, "rgb"]
    parsed = PointCloud.from_points(columns, names, [np.float32] * len(names))
    num_rows, num_columns = cloud.shape or (1, len(cloud.points_m))
    viewpoint = (*cloud.eye_m.tolist(), *quaternion_of(cloud.camera_axes))
    parsed.metadata = parsed.metadata.derive(width=num_columns, height=num_rows, viewpoint=viewpoint)
    # Write to memory first: if points do not compress, pypcd4 rewinds the file and overwrites our comments.
    body = io.BytesIO()
    parsed.save(body, Encoding.BINARY_COMPRESSED)
    write_file(Path(path), _comments(cloud).encode() + body.getvalue())


def _comments(cloud: Cloud) -> str:
    comments = ["# .PCD v0.7 - Point Cloud Data file format"]
    if cloud.intrinsics is not None:
        K = cloud.intrinsics
        numbers = " ".join(repr(float(value)) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        comments.append(f"{INTRINSICS_COMMENT} {numbers}")
    if cloud.eye_m.any() or not np.array_equal(cloud.camera_axes, np.eye(3)):
        comments.append(f"# {FRAME_COMMENT} {VIEWPOINT}")
    return "\n".join([*comments, ""])
