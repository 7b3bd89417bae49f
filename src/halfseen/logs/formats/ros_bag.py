"""Logs from ROS 2 bags (SQLite or MCAP storage) and ROS 1 bags, by a mapping file.

Read down: `ros_mapping` (which topic carries what) → `ros_messages` (values in the order of time) → `ros_trajectories`
(trajectories and stages) → here. Messages of standard types are enough: ``std_msgs`` for actions, rewards and endings,
``sensor_msgs/PointCloud2`` for clouds.

How messages become stages:

- A trajectory begins with the message that ``[trajectory]`` maps, or, without that, with the first mapped message of
the bag. Its
  clock is 0 then.
- An action message begins the attempt of a stage. The covariates and the cloud are those that had come last: what the
  policy saw. A reward message completes the stage.
- An ending message finishes the trajectory or names the cause of its cut. A trajectory without one was cut by ``crash``
at its
  last message. A cut trajectory keeps the stage in which it was cut, with what had been seen.
- Every topic of the mapping must be in one of the bags that are read together; one that broke off early may lack some.
- A trajectory that was cut before anything of it was seen has no stage; it is left out with a warning.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, HalfseenWarning, LogError, within
from halfseen.logs.columns import shown
from halfseen.logs.formats.ros_mapping import BagMapping, read_mapping
from halfseen.logs.formats.ros_messages import check_topics, points_of, read_clouds, read_events
from halfseen.logs.formats.ros_trajectories import BagTrajectory, follow, missing, split
from halfseen.logs.logs import Logs

See: TypeAlias = Callable[[np.ndarray, tuple[int, int], str], Mapping[str, Any]]
"""From points, shape (n, 3) [m], the rows and columns of the image, and a name, to columns of `objects`."""

Keep: TypeAlias = Callable[[np.ndarray, tuple[int, int], str], str]
"""From the same, to what stands in the stage's column ``cloud``: the name of the file that was written."""


def read_bag(
    bags: str | Path | Sequence[str | Path],
    mapping: str | Path | BagMapping,
    *,
    see: See | None = None,
    keep: Keep | None = None,
) -> Logs:
    """Read ROS bags as one log.

    Parameters
    ----------
    bags
        Folder or storage file of a bag, or several of them.
    mapping
        Which topic carries what: a file, as in `MAPPING_TEMPLATE`, or what `read_mapping` made of one.
    see
        Turns the cloud of a stage into its objects; without it the logs have none.
    keep
        Writes the cloud of a stage to a file, whose name goes into the stage's column ``cloud``.

    Returns
    -------
    Logs
        Trajectories carry the name of their bag in the column ``bag``; without a name of their own they are numbered.

    Raises
    ------
    ArgumentError
        rosbags is not installed, or the mapping does not fit the bag; its file and key are named.
    LogError
        A bag is missing or broken, or its messages make no stages.
    """
    mapping = mapping if isinstance(mapping, BagMapping) else read_mapping(mapping)
    if mapping.cloud is None and (see is not None or keep is not None):
        raise ArgumentError(f"{mapping.file}, cloud: it is missing, so that no cloud is seen or kept; name its topic")
    files = [Path(bags)] if isinstance(bags, str | Path) else [Path(bag) for bag in bags]
    trajectories: list[dict[str, Any]] = []
    stages: list[dict[str, Any]] = []
    objects: list[pd.DataFrame] = []
    num_begun = 0
    check_topics(files, mapping)
    for bag in files:
        found = []
        for name, events in split(read_events(bag, mapping), mapping):
            num_begun += 1
            found.append(follow(num_begun if name is None else name, events, mapping))
        found = [trajectory for trajectory in found if _is_seen(bag, trajectory, mapping)]
        _add_clouds(bag, found, mapping, see, keep, objects)
        for trajectory in found:
            row = {
                "trajectory": trajectory.name,
                "end_s": trajectory.end_s,
                "ending": trajectory.ending,
                "cause": trajectory.cause,
            }
            trajectories.append({**row, "bag": bag.name})
            stages += [
                {"trajectory": trajectory.name, "stage": t, **stage}
                for t, stage in enumerate(trajectory.stages, start=1)
            ]
    if not trajectories:
        raise LogError(
            f"{', '.join(map(str, files))}: no trajectory with a stage was found; look at [trajectory] in "
            f"{mapping.file}"
        )
    return _checked(files, stages, trajectories, objects)


def _is_seen(bag: Path, trajectory: BagTrajectory, mapping: BagMapping) -> bool:
    topics = missing(trajectory, mapping)
    if topics or trajectory.end_s == 0:
        trouble = f"before any message of {', '.join(topics)} came" if topics else "as it began"
        warnings.warn(
            f"{bag}: trajectory {shown(trajectory.name)} was cut {trouble}; it is left out",
            HalfseenWarning,
            stacklevel=3,
        )
        return False
    return True


def _add_clouds(
    bag: Path,
    trajectories: list[BagTrajectory],
    mapping: BagMapping,
    see: See | None,
    keep: Keep | None,
    objects: list[pd.DataFrame],
) -> None:
    """Hand the cloud of each stage to `see` and `keep`; only those that belong to a stage are read."""
    if mapping.cloud is None or (see is None and keep is None):
        return
    stages_of: dict[int, list[tuple[BagTrajectory, int]]] = {}
    for trajectory in trajectories:
        for t, number in enumerate(trajectory.clouds):
            if number is not None:
                stages_of.setdefault(number, []).append((trajectory, t))
    for number, message in read_clouds(bag, mapping.cloud.topic, set(stages_of)):
        name = f"{bag.stem}-{number}"
        points, shape = points_of(message, f"{bag}, {mapping.cloud.topic}, cloud {number}")
        columns = None if see is None else see(points, shape, name)
        file = None if keep is None else keep(points, shape, name)
        for trajectory, t in stages_of[number]:
            if file is not None:
                trajectory.stages[t]["cloud"] = file
            if columns is not None:
                objects.append(pd.DataFrame({"trajectory": trajectory.name, "stage": t + 1, **columns}))


def _checked(
    files: list[Path], stages: list[dict[str, Any]], trajectories: list[dict[str, Any]], objects: list[pd.DataFrame]
) -> Logs:
    with within(", ".join(map(str, files))):
        return Logs(
            stages=pd.DataFrame(stages),
            trajectories=pd.DataFrame(trajectories),
            objects=pd.concat(objects, ignore_index=True) if objects else None,
        )
