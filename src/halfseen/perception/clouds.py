"""Point clouds: what a depth camera returned, and the files that hold it (PCD, PLY, NPZ)."""

import io
import os
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Shaped

from halfseen.arrays import Image, Intrinsics, Points
from halfseen.errors import CloudError
from halfseen.writing import write_file

# Comment of a PCD header that carries the pinhole camera [px]: PCD has no field for it, and readers skip comments.
INTRINSICS_COMMENT = "# intrinsics"
# Depths of a table-top camera are below a dozen metres [m]: a median above this was stored in millimetres.
LARGEST_MEDIAN_DEPTH_M = 50.0

Vector: TypeAlias = Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points that one depth camera returned.

    Parameters
    ----------
    points_m
        Points in the camera frame, x right, y down, z forward [m]. A ray without return is a row of NaN, so that
        unknown stays apart from absent. Rows that are not finite, or exactly at the origin, count as no return.
    shape
        Rows and columns of the image [px] when the points are organised row by row, else None.
    intrinsics
        Pinhole matrix [px], or None if not known.
    name
        Where the cloud comes from, for reports.
    eye_m
        Where the camera stands in the frame of the points [m]; the origin in a camera frame.

    Raises
    ------
    CloudError
        Shape and number of points disagree, or the pinhole matrix is not finite or has no positive focal lengths.
    """

    points_m: Points
    shape: tuple[int, int] | None = None
    intrinsics: Intrinsics | None = None
    name: str = "cloud"
    eye_m: Vector = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        points = np.array(self.points_m, dtype=np.float64)
        points[~np.isfinite(points).all(axis=1) | ~points.any(axis=1)] = np.nan
        if self.shape is not None and self.shape[0] * self.shape[1] != len(points):
            raise CloudError(
                f"{self.name}: {len(points)} points do not fill {self.shape[0]} rows of {self.shape[1]}; "
                "mend WIDTH and HEIGHT or give shape=None"
            )
        eye = np.array(self.eye_m, dtype=np.float64)
        if not np.isfinite(eye).all():
            raise CloudError(f"{self.name}: the viewpoint is {eye.tolist()}; it must be finite, in metres")
        K = self.intrinsics
        if K is not None:
            _check_intrinsics(K, self.name)
            K = np.array(K, dtype=np.float64)
        for name, value in (("points_m", points), ("eye_m", eye), ("intrinsics", K)):
            if value is not None:
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def from_depth(cls, depth_m: Image, K: Intrinsics, name: str = "depth image") -> "Cloud":
        """Lift a depth image through a pinhole camera.

        Parameters
        ----------
        depth_m
            Distance along the optical axis of each pixel [m]; 0, negative or not finite where nothing returned.
        K
            Pinhole matrix [px].
        name
            Where the image comes from.

        Raises
        ------
        CloudError
            The matrix is not finite or has no positive focal lengths.
        """
        _check_intrinsics(K, name)
        num_rows, num_columns = depth_m.shape
        depth = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.nan).astype(np.float64)
        row, column = np.mgrid[:num_rows, :num_columns].astype(np.float64)
        x = (column - K[0, 2]) / K[0, 0] * depth
        y = (row - K[1, 2]) / K[1, 1] * depth
        points = np.stack([x, y, depth], axis=-1).reshape(-1, 3)
        return cls(points, (num_rows, num_columns), np.asarray(K, dtype=np.float64), name)

    @property
    def num_returns(self) -> int:
        """Number of rays that returned a point."""
        return int(np.isfinite(self.points_m[:, 2]).sum())


def _check_intrinsics(K: Shaped[np.ndarray, "..."], name: str) -> None:
    if K.shape != (3, 3) or K.dtype.kind not in "fiu" or not np.isfinite(K).all():
        raise CloudError(f"{name}: the pinhole matrix K is {K.tolist()}; it must be 3 by 3 and finite, in pixels")
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CloudError(f"{name}: K has focal lengths {K[0, 0]} and {K[1, 1]} px; they must be positive")


def read_cloud(path: str | os.PathLike[str]) -> Cloud:
    """Read a point cloud from a file.

    Parameters
    ----------
    path
        ``.pcd`` (ascii, binary or binary_compressed), ``.ply`` (ascii or binary), or ``.npz`` with a depth image
        ``depth_m`` [m] and a pinhole matrix ``K`` [px].

    Returns
    -------
    Cloud
        Organised if the file is.

    Raises
    ------
    CloudError
        The file is missing, of another kind, cut short or broken, or holds not one point.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path}: files ending in {path.suffix!r} are not read; use one of {', '.join(_READERS)}")
    if not path.is_file():
        raise CloudError(f"{path}: no such file")
    try:
        cloud = reader(path)
    except CloudError:
        raise
    except OSError as error:
        raise CloudError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # parsers of broken files raise nearly anything
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise CloudError(
            f"{path}: not a whole {path.suffix.lower()} file: {reason}; record or export it again"
        ) from error
    if not cloud.num_returns:
        raise CloudError(f"{path}: not one of {len(cloud.points_m)} points is finite; nothing returned to the camera")
    return cloud


def _read_npz(path: Path) -> Cloud:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            missing = {"depth_m", "K"} - set(arrays.files)
            if missing:
                raise CloudError(
                    f"{path}: has {sorted(arrays.files)} and lacks {sorted(missing)}; "
                    "store the depth image as depth_m [m] and the pinhole matrix as K [px]"
                )
            depth, K = arrays["depth_m"], arrays["K"]
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise CloudError(f"{path}: cut short or no .npz file ({error}); record or export it again") from error
    except ValueError as error:
        raise CloudError(f"{path}: {error}; only plain arrays are read, never pickled objects") from error
    _check_intrinsics(K, str(path))
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise CloudError(
            f"{path}: depth_m is {depth.dtype} of shape {depth.shape}; it must be an image of floats in metres"
        )
    is_return = np.isfinite(depth) & (depth > 0)
    if is_return.any() and np.median(depth[is_return]) > LARGEST_MEDIAN_DEPTH_M:
        raise CloudError(
            f"{path}: the median of depth_m is {np.median(depth[is_return]):g}; "
            "depths are in metres: divide millimetres by 1000"
        )
    return Cloud.from_depth(depth.astype(np.float64), K.astype(np.float64), path.name)


def _read_ply(path: Path) -> Cloud:
    from plyfile import PlyData

    # From memory: plyfile maps files that it opens itself, and keeps them open.
    ply = PlyData.read(io.BytesIO(path.read_bytes()))
    if "vertex" not in ply or not {"x", "y", "z"} <= set(ply["vertex"].data.dtype.names):
        raise CloudError(f"{path}: has no element 'vertex' with x, y and z; export it as a point cloud in metres")
    vertex = ply["vertex"]
    return Cloud(np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1), name=path.name)


def _read_pcd(path: Path) -> Cloud:
    from pypcd4.pypcd4 import PointCloud

    # pypcd4 drops the comments, where the intrinsics are, and splits ASCII rows at single spaces only; the rest is its.
    header, num_header_lines = _pcd_header(path)
    with path.open("rb") as file:
        parsed = PointCloud.from_fileobj(file) if header.get("DATA") != "ascii" else None
    fields = header.get("FIELDS", "").split()
    if not {"x", "y", "z"} <= set(fields):
        raise CloudError(f"{path}: has fields {fields} and needs x, y and z; export it with coordinates in metres")
    if parsed is None:
        columns = _ascii_columns(header, fields)
        points = np.loadtxt(path, skiprows=num_header_lines, usecols=columns, ndmin=2, dtype=np.float64)
    else:
        points = np.stack([parsed.pc_data[axis].astype(np.float64) for axis in "xyz"], axis=1)
    num_points, width, height = (int(header[key]) for key in ("POINTS", "WIDTH", "HEIGHT"))
    if len(points) != num_points:
        raise CloudError(
            f"{path}: holds {len(points)} points and announces {num_points}; it was cut short: export it again"
        )
    shape = (height, width) if height > 1 else None
    return Cloud(points, shape, _pcd_intrinsics(header, path), path.name, _pcd_eye(header))


def _pcd_header(path: Path) -> tuple[dict[str, str], int]:
    """Header entries of a PCD file, the comment with the intrinsics among them, and how many lines they take."""
    header: dict[str, str] = {}
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            text = line.decode("ascii", errors="replace").strip()
            if text.startswith(INTRINSICS_COMMENT):
                header[INTRINSICS_COMMENT] = text.removeprefix(INTRINSICS_COMMENT)
            elif not text.startswith("#"):
                key, _, value = text.partition(" ")
                header[key] = value.strip()
            if text.startswith("DATA"):
                return header, number
    raise CloudError(f"{path}: has no DATA line; it is no PCD file or was cut short in the header")


def _ascii_columns(header: dict[str, str], fields: list[str]) -> list[int]:
    counts = [int(count) for count in header.get("COUNT", "1 " * len(fields)).split()]
    return [sum(counts[: fields.index(axis)]) for axis in "xyz"]


def _pcd_intrinsics(header: dict[str, str], path: Path) -> Intrinsics | None:
    if INTRINSICS_COMMENT not in header:
        return None
    values = header[INTRINSICS_COMMENT].split()
    if len(values) != 4:
        raise CloudError(f"{path}: the intrinsics comment is {values}; it must be 'fx fy cx cy' in pixels")
    fx, fy, cx, cy = (float(value) for value in values)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _pcd_eye(header: dict[str, str]) -> Vector:
    # Only the position of VIEWPOINT is used: recorders disagree about whether its rotation was applied to the points.
    values = header.get("VIEWPOINT", "0 0 0").split()[:3]
    return np.array([float(value) for value in values])


_READERS: dict[str, Callable[[Path], Cloud]] = {".pcd": _read_pcd, ".ply": _read_ply, ".npz": _read_npz}


def write_pcd(cloud: Cloud, path: str | os.PathLike[str]) -> None:
    """Write a cloud as a compressed binary PCD file with float32 coordinates.

    Parameters
    ----------
    cloud
        What to write. If organised, the file keeps its width and height; the intrinsics go into a header comment.
    path
        Where to; it appears whole or not at all, and missing parents are made.

    Raises
    ------
    ArgumentError
        The file cannot be written there.
    """
    from pypcd4.pypcd4 import Encoding, PointCloud

    parsed = PointCloud.from_xyz_points(cloud.points_m.astype(np.float32))
    num_rows, num_columns = cloud.shape or (1, len(cloud.points_m))
    viewpoint = (*cloud.eye_m.tolist(), 1.0, 0.0, 0.0, 0.0)
    parsed.metadata = parsed.metadata.derive(width=num_columns, height=num_rows, viewpoint=viewpoint)
    # Into memory first: pypcd4 rewinds the file, over our comments, when points do not compress and stay binary.
    body = io.BytesIO()
    parsed.save(body, Encoding.BINARY_COMPRESSED)
    write_file(Path(path), _comments(cloud).encode() + body.getvalue())


def _comments(cloud: Cloud) -> str:
    title = "# .PCD v0.7 - Point Cloud Data file format\n"
    if cloud.intrinsics is None:
        return title
    K = cloud.intrinsics
    numbers = " ".join(repr(float(value)) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    return f"{title}{INTRINSICS_COMMENT} {numbers}\n"
