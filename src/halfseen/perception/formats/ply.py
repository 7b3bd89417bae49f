"""PLY files: points, and their colours if they have some."""

import io
from pathlib import Path

import numpy as np

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, Colours, check_num_points
from halfseen.reading import CLOUD, read_bytes
from halfseen.shapes import Shaped

# A header has a few dozen lines.
MOST_HEADER_BYTES = 10**6
COLOURS = ("red", "green", "blue")


def read_ply(path: Path) -> Cloud:
    """Read the vertices, and their red, green and blue if they have all three.

    Parameters
    ----------
    path
        The file, ascii or binary.

    Raises
    ------
    CloudError
        There are no vertices with coordinates, or their colours are of another kind than uchar.
    """
    from plyfile import PlyData

    # From memory: plyfile maps files that it opens itself, and keeps them open.
    content = read_bytes(path, CLOUD)
    _check_counts(content, path)
    ply = PlyData.read(io.BytesIO(content))
    if "vertex" not in ply or not {"x", "y", "z"} <= set(ply["vertex"].data.dtype.names):
        raise CloudError(f"{path}: has no element 'vertex' with x, y and z; export it as a point cloud in metres")
    vertex = ply["vertex"].data
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return Cloud(points, name=path.name, colours=_colours(vertex, path))


def _check_counts(content: bytes, path: Path) -> None:
    """Refuse a header that announces more rows than there are bytes: memory would be asked for all of them."""
    header = content[: content.find(b"end_header")][:MOST_HEADER_BYTES].decode("ascii", errors="replace")
    for line in header.splitlines():
        word, _, rest = line.strip().partition(" ")
        count = rest.rpartition(" ")[2]
        if word == "element" and count.isascii() and count.isdigit() and int(count[:18]) > len(content):
            raise CloudError(
                f"{path}: {rest.strip()[:60]} are announced, and the file has {len(content)} bytes; it was cut short: "
                "export it again"
            )
        if word == "element" and rest.startswith("vertex ") and count.isascii() and count.isdigit():
            check_num_points(int(count[:18]), str(path))


def _colours(vertex: Shaped[np.ndarray, " n"], path: Path) -> Colours | None:
    if not set(COLOURS) <= set(vertex.dtype.names or ()):
        return None
    kinds = [vertex.dtype[name] for name in COLOURS]
    if any(kind != np.uint8 for kind in kinds):
        raise CloudError(
            f"{path}: red, green and blue are {', '.join(map(str, kinds))}; a colour is three uchar from 0 to 255: "
            "export it so, or leave it out"
        )
    return np.stack([vertex[name] for name in COLOURS], axis=1)
