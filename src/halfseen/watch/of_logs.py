"""A trajectory of a log with the cloud of each stage, as `halfseen convert --clouds` keeps them beside a bag."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, PolicyError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats
from halfseen.perception import View, perceive, read_cloud
from halfseen.perception.tracking import matched
from halfseen.policies import Decision, StoredPolicy, decider_of
from halfseen.policies.folder.stored import refuse_log_of_team, refuse_team
from halfseen.tables.present import Present
from halfseen.watch.of_cloud import seen_stage
from halfseen.watch.stage_view import StageView, Watched
from halfseen.world.log_checks import PLACE_COLUMNS
from halfseen.world.logs import states_of

CLOUD = "cloud"
"""Column of a log's stages: the file of each stage's cloud."""
_UNKNOWN = 0.5


def watched_logs(logs: Logs, clouds: Path, number: int, stored: StoredPolicy | None = None) -> Watched:
    """Show a trajectory of a log.

    Parameters
    ----------
    logs
        The log; its stages name the files of their clouds.
    clouds
        Folder with these files.
    number
        Which trajectory, from 1.
    stored
        A policy of tables, to be asked at each stage; None for what the log says alone.

    Raises
    ------
    HalfseenError
        There is no such trajectory, no cloud of a stage, or the policy is of other things.
    """
    if not 1 <= number <= logs.num_trajectories:
        raise ArgumentError(
            f"--trajectory is {number}, and the log has {logs.num_trajectories} trajectories; count from 1"
        )
    if CLOUD not in logs.stages.columns:
        raise ArgumentError(
            f"stages: no column {CLOUD!r} says which file holds the cloud of each stage; write it with "
            "`halfseen convert BAG --clouds FOLDER`"
        )
    name = logs.trajectory_ids[number - 1]
    trajectory = logs.select(logs.trajectory_ids[number - 1 : number])
    decisions = _decisions(trajectory, stored)
    stages, events = [], []
    for t, row in enumerate(trajectory.stages.to_dict("records")):
        stage = _stage(
            trajectory, row, clouds, f"trajectory {name}, stage {t + 1} of {trajectory.horizon}", decisions[t], events
        )
        stages.append(stage)
        events.append(_done(row))
    ending = (
        "came to its own end" if trajectory.is_finished[0] else f"was cut: {trajectory.trajectories['cause'].iloc[0]}"
    )
    stages[-1] = replace(stages[-1], events=(*stages[-1].events, events[-1], f"the trajectory {ending}"))
    return Watched(f"trajectory {name}", tuple(stages))


def _stage(
    trajectory: Logs, row: dict[str, Any], clouds: Path, title: str, decision: Decision | None, events: list[str]
) -> StageView:
    file = row[CLOUD]
    if not isinstance(file, str):
        raise ArgumentError(f"{title}: no cloud was kept of it; choose another trajectory")
    if "\0" in file or not Path(os.path.realpath(clouds / file)).is_relative_to(os.path.realpath(clouds)):
        raise ArgumentError(f"{title}: its cloud {file!r} is not in {clouds}; give the folder that holds it")
    cloud = read_cloud(clouds / file)
    view = perceive(cloud)
    stage = seen_stage(cloud, view, title, _chances(trajectory, row["stage"], view), decision, events)
    action = _action(row)
    if decision is None or stage.action == action:
        said = stage.reason or (f"{action}: what the log says was done" if action else "")
    else:
        said = f"the log says {action or 'nothing'} was done; the policy: {stage.reason}"
    return replace(stage, action=action, reason=said)


def _action(row: dict[str, Any]) -> str:
    if pd.isna(row["action"]):
        return ""
    has_object = "object" in row and not pd.isna(row["object"])
    return f"{row['action']} {row['object']}" if has_object else str(row["action"])


def _done(row: dict[str, Any]) -> str:
    if pd.isna(row["reward"]):
        return f"tried: {_action(row) or 'nothing'}, not completed"
    return f"tried: {_action(row)}, reward {row['reward']:+.2f}, at {row['elapsed_s']:.1f} s"


def _chances(trajectory: Logs, stage: Any, view: View) -> list[float]:
    """P(DIRTY) of each object of a view, as the log has it; one half where it says nothing."""
    chances = [_UNKNOWN] * len(view.objects)
    if trajectory.objects is None or "log_odds" not in trajectory.objects.columns:
        return chances
    rows = pd.DataFrame(trajectory.objects[trajectory.objects["stage"] == stage])
    told = 1.0 / (1.0 + np.exp(-as_floats("objects", rows, "log_odds").to_numpy()))
    if set(PLACE_COLUMNS) <= set(rows.columns):
        places_m = np.stack([as_floats("objects", rows, column).to_numpy() for column in PLACE_COLUMNS], axis=1)
        now = matched(places_m, view.places_m).now
    else:
        now = np.arange(len(rows))
    for chance, number in zip(told.tolist(), now.tolist(), strict=True):
        if 0 <= number < len(chances):
            chances[number] = chance
    return chances


def _decisions(trajectory: Logs, stored: StoredPolicy | None) -> list[Decision | None]:
    """What a policy would do at each stage."""
    if stored is None:
        return [None] * trajectory.horizon
    refuse_team(stored, "and a log is shown with what one robot would do; leave the policy out")
    if not stored.is_table:
        raise PolicyError("the policy is of named actions, and shows nothing at a table; give one of tables")
    refuse_log_of_team(stored, trajectory)
    states = states_of(trajectory, stored.horizon)
    decider = decider_of(stored, extrapolates=True)
    return [
        decider.decide(Present(mapped(lambda leaf, t=t: leaf[0, t], states), t + 1)) for t in range(trajectory.horizon)
    ]
