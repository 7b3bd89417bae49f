"""The ten tables that come with the package: clouds for all users, truth for tests.

A cloud is an organised PCD file in the camera's frame, with its intrinsics in the header. To keep the files small,
they omit returns beyond 1.8 m (the room behind the table); `capture` keeps them. The truth of each table is a JSON
file: cups, poses, camera, labels (as run lengths), occlusion.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, SceneError
from halfseen.perception.clouds import Cloud
from halfseen.perception.pcd import write_pcd
from halfseen.scene.cups import Cup
from halfseen.scene.poses import pose_of
from halfseen.scene.table import Camera, Table, Truth
from halfseen.shapes import Int
from halfseen.writing import write_file

# Table k and its noise are drawn with seed SEEDS[k]; the seeds cover numbers of cups from 5 to 10.
SEEDS = (0, 3, 7, 8, 9, 11, 12, 14, 19, 21)
KEPT_WITHIN_M = 1.8
NUM_TABLES = len(SEEDS)


def table_paths() -> list[Path]:
    """Find the files of the ten clouds, in order.

    Returns
    -------
    list of Path
        ``table_00.pcd`` … ``table_09.pcd``, to be read with `halfseen.perception.read_cloud`.
    """
    return [cloud_path(_package_folder(), k) for k in range(NUM_TABLES)]


def read_truth(k: int) -> Truth:
    """Read the truth of a table that comes with the package.

    Parameters
    ----------
    k
        Which table, from 0 to 9.

    Returns
    -------
    Truth
        Ground truth; perception must not use it.

    Raises
    ------
    ArgumentError
        There is no such table.
    """
    content = _read_json(k)["truth"]
    num_rows, num_columns = content.pop("shape")
    labels = labels_of(content.pop("label_runs"), (num_rows, num_columns))
    return Truth(labels, **{name: np.array(values) for name, values in content.items()})


def read_table(k: int) -> Table:
    """Read a table that comes with the package: cups, poses and camera.

    Parameters
    ----------
    k
        Which table, from 0 to 9.

    Returns
    -------
    Table
        The table; `capture` with the seed ``SEEDS[k]`` takes its picture again.

    Raises
    ------
    ArgumentError
        There is no such table.
    """
    content = _read_json(k)["table"]
    camera = content["camera"]
    lens = tuple(camera["focal_px"]), tuple(camera["centre_px"]), camera["num_rows"], camera["num_columns"]
    return Table(
        cups=tuple(Cup(**cup) for cup in content["cups"]),
        world_from_cup=tuple(pose_of(**pose) for pose in content["world_from_cup"]),
        camera=Camera(pose_of(**camera["world_from_camera"]), *lens),
        name=content["name"],
    )


def write_shipped(folder: Path, which: Iterable[int]) -> None:
    """Regenerate tables, cloud and truth; each file is written completely or not at all.

    Files go to ``tables`` and ``truth`` in the folder.

    Raises
    ------
    ArgumentError
        A file cannot be written there.
    """
    # Only making tables needs MuJoCo; reading them does not.
    from halfseen.scene.draw import random_table
    from halfseen.scene.record import capture

    for k in which:
        table = random_table(SEEDS[_checked(k)])
        picture = capture(table, SEEDS[k])
        write_pcd(within(picture.cloud, KEPT_WITHIN_M), cloud_path(folder, k))
        labels = picture.truth.labels
        truth = {"shape": list(labels.shape), "label_runs": run_lengths(labels)}
        truth |= {name: values.tolist() for name, values in vars(picture.truth).items() if name != "labels"}
        content = {"made_with": versions(), "table": asdict(table), "truth": truth}
        write_file(truth_path(folder, k), json.dumps(content, separators=(",", ":")) + "\n")


def versions() -> dict[str, str]:
    """Installed versions of the packages on which the bytes of a table depend."""
    return {name: version(name) for name in ("mujoco", "numpy", "scipy")}


def made_with(k: int) -> dict[str, str]:
    """Read the versions of those packages with which shipped table k, from 0 to 9, was made."""
    return _read_json(k)["made_with"]


def within(cloud: Cloud, reach_m: float) -> Cloud:
    """Replace the returns beyond a depth by NaN [m]."""
    points_m = np.where(cloud.points_m[:, 2:] <= reach_m, cloud.points_m, np.nan)
    return replace(cloud, points_m=points_m)


def cloud_path(folder: Path, k: int) -> Path:
    """Path of the cloud of table k."""
    return folder / "tables" / f"table_{k:02d}.pcd"


def truth_path(folder: Path, k: int) -> Path:
    """Path of the truth of table k."""
    return folder / "truth" / f"table_{k:02d}.json"


def run_lengths(labels: Int[np.ndarray, "H W"]) -> list[list[int]]:
    """Encode labels row by row as pairs [label, number of pixels]."""
    flat = labels.ravel()
    starts = np.concatenate([[0], np.flatnonzero(np.diff(flat)) + 1])
    counts = np.diff(np.concatenate([starts, [len(flat)]]))
    return [[int(label), int(count)] for label, count in zip(flat[starts], counts, strict=True)]


def labels_of(runs: list[list[int]], shape: tuple[int, int]) -> Int[np.ndarray, "H W"]:
    """Decode labels from run lengths; the inverse of `run_lengths`."""
    label, count = np.array(runs, dtype=np.int64).T
    return np.repeat(label, count).reshape(shape)


def _package_folder() -> Path:
    return Path(str(files("halfseen.scene")))


def _checked(k: int) -> int:
    if not 0 <= k < NUM_TABLES:
        raise ArgumentError(f"table {k}: there are {NUM_TABLES} tables, numbered from 0 to {NUM_TABLES - 1}")
    return k


def _read_json(k: int) -> dict[str, Any]:
    path = truth_path(_package_folder(), _checked(k))
    if not path.is_file():
        raise SceneError(f"{path}: no such file; make it with `python -m halfseen.scene`")
    return json.loads(path.read_text(encoding="utf-8"))
