"""Point-cloud files: NPZ with a depth image, PLY, and PCD (`halfseen.perception.pcd`), chosen by the file extension.

From PLY, colours are read if present, and the camera's pose and pixel grid if PCL wrote them.
"""

import io
import os
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from halfseen.arrays import Image, Intrinsics
from halfseen.errors import CloudError, warn
from halfseen.perception.clouds import COLOURS, Cloud, check_intrinsics, check_num_points, colours_of, is_rotation
from halfseen.perception.frames import FRAME_COMMENT, OWN, Viewpoint, camera_of
from halfseen.perception.pcd import read_pcd
from halfseen.reading import CLOUD, names_in_archive, read_arrays, read_bytes, reason_of
from halfseen.shapes import Shaped


def read_npz(path: Path) -> Cloud:
    """Read ``depth_m`` [m] and ``K`` [px], and ``rgb`` (uint8) if present.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    CloudError
        The file is truncated, lacks an array, or has one of the wrong type or shape.
    """
    try:
        there = names_in_archive(path, CLOUD)
        missing = {"depth_m", "K"} - set(there)
        if missing:
            raise CloudError(
                f"{path}: has {sorted(there)[:20]}, but lacks {sorted(missing)}; store the depth image as depth_m "
                "[m] and the pinhole matrix as K [px]"
            )
        arrays = read_arrays(path, ("depth_m", "K", "rgb"), CLOUD)
    except ValueError as error:
        raise CloudError(f"{path}: {error}; record or export it again") from error
    depth, K, picture = arrays["depth_m"], arrays["K"], arrays.get("rgb")
    check_intrinsics(K, str(path))
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise CloudError(
            f"{path}: depth_m is {depth.dtype} of shape {depth.shape}; it must be an image of floats in metres"
        )
    check_num_points(depth.size, str(path))
    _warn_of_scale(K.astype(np.float64), depth.shape, path)
    _warn_of_ranges(depth.astype(np.float64), K.astype(np.float64), path)
    if picture is not None and (picture.shape != (*depth.shape, 3) or picture.dtype != np.uint8):
        raise CloudError(
            f"{path}: rgb is {picture.dtype} of shape {picture.shape}; it must be uint8 of shape {(*depth.shape, 3)}, "
            "a colour for each pixel of depth_m: register it to the depth image, or leave it out"
        )
    return Cloud.from_depth(depth.astype(np.float64), K.astype(np.float64), path.name, picture)


# Images are scaled alike along both axes, to this share, by this factor at least; captures are larger than this [px].
SAME_RATIO, LEAST_SCALE, SMALLEST_SIDE_PX = 0.08, 1.4, 64


def _warn_of_scale(K: Intrinsics, shape: tuple[int, ...], path: Path) -> None:
    """Warn of a pinhole matrix whose centre is that of an image of another size: it is of another resolution."""
    size_px = 2.0 * K[[1, 0], 2] + 1.0
    scale = size_px / shape
    low, high = scale.min(), scale.max()
    is_scaled = low > 0.0 and high < low * (1.0 + SAME_RATIO) and max(high, 1.0 / low) > LEAST_SCALE
    if is_scaled and min(shape) >= SMALLEST_SIDE_PX:
        warn(
            path,
            f"the centre of K is ({K[0, 2]:g}, {K[1, 2]:g}) px, as of an image of {size_px[0]:.0f} rows by "
            f"{size_px[1]:.0f}, but depth_m has {shape[0]} by {shape[1]}; scale K as the image was scaled, unless "
            "depth_m is cut out of a larger one",
        )


# Bends of the inverse of distances along rays, by `_bend`, and of depths made of them; that of depths is about 0.
MOST_OF_RANGES, MOST_OF_DEPTHS = -0.5, 0.35
FEWEST_BENDS = 1000


def _warn_of_ranges(depth_m: Image, K: Intrinsics, path: Path) -> None:
    """Warn of distances along the rays in place of depths, of which alone the inverse is linear on a plane."""
    row, column = np.indices(depth_m.shape)
    ray = np.sqrt(1.0 + ((column - K[0, 2]) / K[0, 0]) ** 2 + ((row - K[1, 2]) / K[1, 1]) ** 2)
    with np.errstate(all="ignore"):
        inverse = 1.0 / np.where(depth_m > 0.0, depth_m, np.nan)
        is_bent = min(depth_m.shape) >= SMALLEST_SIDE_PX and _bend(inverse, K) < MOST_OF_RANGES
        is_range = is_bent and abs(_bend(inverse * ray, K)) < MOST_OF_DEPTHS
    if is_range:
        warn(
            path,
            "depth_m seems to hold distances along the rays of the pixels, as some simulators give them; give those "
            "along the optical axis: divide by the length of ((u − cx) / fx, (v − cy) / fy, 1)",
        )


def _bend(values: Image, K: Intrinsics) -> float:
    """Median second difference over an eighth of the image, as a share of the value by the square of the angle."""
    bends = []
    for axis in (0, 1):
        step, along = values.shape[axis] // 8, np.moveaxis(values, axis, 0)
        middle = along[step:-step]
        bends.append(((along[: -2 * step] + along[2 * step :]) / middle - 2.0) * (K[1 - axis, 1 - axis] / step) ** 2)
    there = np.concatenate([bend[np.isfinite(bend)] for bend in bends])
    return float(np.median(there)) if len(there) >= FEWEST_BENDS else 0.0


_AS_ASCII = bytes(range(128)) + b"?" * 128
# A header has a few dozen lines.
MOST_HEADER_BYTES = 10**6
# Properties of an element ``camera``: its position, and the rows of the matrix from its axes to the position's frame.
EYE = ("view_px", "view_py", "view_pz")
AXES = tuple(f"{row}_axis{column}" for row in "xyz" for column in "xyz")
VIEWPORT = ("viewporty", "viewportx")
SAME_AXES = 1e-3


def read_ply(path: Path) -> Cloud:
    """Read the vertices, their colours if red, green and blue are present, and an element ``camera`` if present.

    Parameters
    ----------
    path
        The file, ascii or binary.

    Raises
    ------
    CloudError
        There are no vertices with coordinates, their colours are not uchar, or the camera's pose is invalid.
    """
    from plyfile import PlyData

    # Read from memory: plyfile maps files that it opens itself and keeps them open.
    content = read_bytes(path, CLOUD)
    _check_counts(content, path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about empty lists in text files
        ply = PlyData.read(io.BytesIO(_in_ascii(content)))
    if "vertex" not in ply or not {"x", "y", "z"} <= set(ply["vertex"].data.dtype.names):
        raise CloudError(f"{path}: has no element 'vertex' with x, y and z; export it as a point cloud in metres")
    vertex = ply["vertex"].data
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    shape, viewpoint = _camera(ply["camera"].data, len(points), path) if "camera" in ply else (None, OWN)
    comments = [comment.split() for comment in ply.comments]
    frame = next((words[1] for words in comments if len(words) > 1 and words[0] == FRAME_COMMENT), None)
    camera = camera_of(points, shape, viewpoint, str(path), frame)
    found = next((names for names in COLOURS if {*names} <= {*vertex.dtype.names}), None)
    colours = None if found is None else colours_of([vertex[name] for name in found], str(path))
    return Cloud(points, shape, None, path.name, camera.eye_m, colours, camera.axes)


def _camera(
    element: Shaped[np.ndarray, " cameras"], num_points: int, path: Path
) -> tuple[tuple[int, int] | None, Viewpoint]:
    """Rows and columns of the pixel grid, if it is complete, and the pose."""
    names = element.dtype.names or ()
    if len(element) != 1 or not {*EYE, *AXES} <= set(names):
        return None, OWN
    eye, axes = (np.array([element[0][name] for name in each], dtype=np.float64) for each in (EYE, AXES))
    if not np.isfinite([*eye, *axes]).all() or not is_rotation(axes.reshape(3, 3), SAME_AXES):
        raise CloudError(
            f"{path}: its camera is at {eye.tolist()} with axes {axes.tolist()}; give a position [m] and the rows of "
            "a rotation, or leave it out"
        )
    left, _, right = np.linalg.svd(axes.reshape(3, 3))
    grid = [int(element[0][name]) for name in VIEWPORT if name in names]
    is_grid = len(grid) == 2 and grid[0] > 1 and grid[0] * grid[1] == num_points
    return ((grid[0], grid[1]) if is_grid else None), Viewpoint(eye, left @ right)


def _in_ascii(content: bytes) -> bytes:
    """The file with a question mark for each byte of a comment that is not ASCII, which its reader refuses."""
    end = content.find(b"end_header")
    return content[:end].translate(_AS_ASCII) + content[end:]


def _check_counts(content: bytes, path: Path) -> None:
    """Refuse a header that declares more rows than the file has bytes, as memory would be allocated for all of them."""
    header = content[: content.find(b"end_header")][:MOST_HEADER_BYTES].decode("ascii", errors="replace")
    for line in header.splitlines():
        word, _, rest = line.strip().partition(" ")
        count = rest.rpartition(" ")[2]
        if word == "element" and count.isascii() and count.isdigit() and int(count[:18]) > len(content):
            raise CloudError(
                f"{path}: {rest.strip()[:60]} are announced, but the file has {len(content)} bytes; it was cut short: "
                "export it again"
            )
        if word == "element" and rest.startswith("vertex ") and count.isascii() and count.isdigit():
            check_num_points(int(count[:18]), str(path))


_READERS: dict[str, Callable[[Path], Cloud]] = {".pcd": read_pcd, ".ply": read_ply, ".npz": read_npz}


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
        Organised if the file is. Points stay in the frame of the file. If it has a viewpoint, that is the pose of the
        camera, and points may be in the viewpoint's frame or in the camera's. The pixel grid decides, or, without one,
        from which pose a camera could see all points. A header comment ``points_frame camera`` or ``points_frame
        viewpoint`` overrides this.

    Raises
    ------
    CloudError
        The frame of the points is ambiguous; or the file is missing, of an unknown type, truncated or corrupt, or has
        no finite point.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path}: files ending in {path.suffix!r} are not read; use one of {', '.join(_READERS)}")
    if not path.exists():
        raise CloudError(f"{path}: no such file")
    try:
        cloud = reader(path)
    except CloudError:
        raise
    except OSError as error:
        raise CloudError(f"{path}: cannot be read: {reason_of(error)}") from error
    except Exception as error:  # parsers raise almost any exception on corrupt files
        raise CloudError(
            f"{path}: not a whole {path.suffix.lower()} file: {reason_of(error)}; record or export it again"
        ) from error
    if not cloud.num_returns:
        raise CloudError(
            f"{path}: not one of {len(cloud.points_m)} points is finite: the camera received no returns; check its "
            "range and exposure"
        )
    return cloud
