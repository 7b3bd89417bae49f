"""Bags as logs, and the clouds in them: kept as files, or seen as objects."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from halfseen.progress import Progress

if TYPE_CHECKING:
    import numpy as np

    from halfseen.logs import Logs


def read_bags(bags: list[Path], mapping: Path, see: bool, clouds: Path | None) -> "Logs":
    """Read bags with the clouds of their stages.

    Parameters
    ----------
    bags
        Side by side.
    mapping
        File that says which topic carries what.
    see
        Whether what a cloud shows becomes the objects of its stage.
    clouds
        Folder to write each cloud to; None for nowhere.
    """
    from halfseen.logs.formats import read_bag

    with Progress(None, "convert", "clouds") as bar:

        def counted(work: Callable[..., Any]) -> Callable[..., Any]:
            def count(*cloud: Any) -> Any:
                bar.update()
                return work(*cloud)

            return count

        keep = None if clouds is None else counted(partial(_kept, clouds))
        return read_bag(bags, mapping, see=counted(_see) if see else None, keep=keep)


def _kept(folder: Path, points_m: "np.ndarray", shape: tuple[int, int], name: str) -> str:
    """Write a cloud; its file is called like it."""
    from halfseen.perception import Cloud, write_pcd

    write_pcd(Cloud(points_m, _image_shape(shape), name=name), folder / f"{name}.pcd")
    return f"{name}.pcd"


def _see(points_m: "np.ndarray", shape: tuple[int, int], name: str) -> dict[str, list[Any]]:
    """Objects that a cloud shows, as columns; numbered anew in each cloud, the largest first."""
    import numpy as np

    from halfseen.perception import Cloud, perceive

    view = perceive(Cloud(points_m, _image_shape(shape), name=name))
    centroids = np.array([seen.centroid_m for seen in view.objects]).reshape(-1, 3)
    return {
        "object": [seen.id for seen in view.objects],
        "occlusion": [seen.occlusion for seen in view.objects],
        **{f"{axis}_m": centroids[:, k].tolist() for k, axis in enumerate("xyz")},
        "height_m": [seen.height_m for seen in view.objects],
        "is_upright": [seen.is_upright for seen in view.objects],
        "num_points": [seen.num_points for seen in view.objects],
        "hidden_by": view.hides.tolist(),
    }


def _image_shape(shape: tuple[int, int]) -> tuple[int, int] | None:
    return shape if shape[0] > 1 else None
