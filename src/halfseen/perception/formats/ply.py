"""PLY files: points, and their colours if they have some."""

import io
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, Colours

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
    ply = PlyData.read(io.BytesIO(path.read_bytes()))
    if "vertex" not in ply or not {"x", "y", "z"} <= set(ply["vertex"].data.dtype.names):
        raise CloudError(f"{path}: has no element 'vertex' with x, y and z; export it as a point cloud in metres")
    vertex = ply["vertex"].data
    points = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return Cloud(points, name=path.name, colours=_colours(vertex, path))


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
