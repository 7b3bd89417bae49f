"""Clouds from files of any kind."""

import os
from collections.abc import Callable
from pathlib import Path

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud
from halfseen.perception.formats.npz import read_npz
from halfseen.perception.formats.pcd import read_pcd
from halfseen.perception.formats.ply import read_ply
from halfseen.reading import reason_of

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
        Organised if the file is. Points stay in the frame of the file. Where it says a viewpoint, which is the pose of
        the camera, points may be in its frame or in the camera's: the pixel grid tells which, and of points without
        one, from where a camera could see them all. A comment ``points_frame camera`` or ``points_frame viewpoint``
        in the header settles it.

    Raises
    ------
    CloudError
        It is in doubt which frame the points are in; or the file is missing, of another kind, cut short or broken, or
        holds not one point.
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
    except Exception as error:  # parsers of broken files raise nearly anything
        raise CloudError(
            f"{path}: not a whole {path.suffix.lower()} file: {reason_of(error)}; record or export it again"
        ) from error
    if not cloud.num_returns:
        raise CloudError(f"{path}: not one of {len(cloud.points_m)} points is finite; nothing returned to the camera")
    return cloud
