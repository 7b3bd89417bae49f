"""NPZ files: a depth image, its pinhole matrix, and the colour picture if there is one."""

from pathlib import Path

import numpy as np

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, check_intrinsics, check_num_points
from halfseen.reading import CLOUD, names_in_archive, read_arrays


def read_npz(path: Path) -> Cloud:
    """Read ``depth_m`` [m] and ``K`` [px], and ``rgb``, uint8, if it is there.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    CloudError
        The file is cut short, lacks an array, or holds one of another kind.
    """
    arrays = _arrays(path)
    depth, K, picture = arrays["depth_m"], arrays["K"], arrays.get("rgb")
    check_intrinsics(K, str(path))
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise CloudError(
            f"{path}: depth_m is {depth.dtype} of shape {depth.shape}; it must be an image of floats in metres"
        )
    check_num_points(depth.size, str(path))
    if picture is not None and (picture.shape != (*depth.shape, 3) or picture.dtype != np.uint8):
        raise CloudError(
            f"{path}: rgb is {picture.dtype} of shape {picture.shape}; it must be uint8 of shape {(*depth.shape, 3)}, "
            "a colour for each pixel of depth_m: register it to the depth image, or leave it out"
        )
    return Cloud.from_depth(depth.astype(np.float64), K.astype(np.float64), path.name, picture)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        there = names_in_archive(path, CLOUD)
        missing = {"depth_m", "K"} - set(there)
        if missing:
            raise CloudError(
                f"{path}: has {sorted(there)[:20]} and lacks {sorted(missing)}; "
                "store the depth image as depth_m [m] and the pinhole matrix as K [px]"
            )
        return read_arrays(path, ("depth_m", "K", "rgb"), CLOUD)
    except ValueError as error:
        raise CloudError(f"{path}: {error}; record or export it again") from error
