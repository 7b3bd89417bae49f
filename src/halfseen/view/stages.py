"""Sources of stages: one cloud with a policy, or a trajectory of a log with the cloud of each stage.

`halfseen convert --clouds` saves the clouds of a bag for this purpose.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import Points, expit, mapped
from halfseen.errors import ArgumentError, PolicyError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats
from halfseen.perception import View, perceive, read_cloud
from halfseen.perception.clouds import Cloud, Colours, Vector
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.tracking import matched
from halfseen.policies import Decision, StoredPolicy, decider_of
from halfseen.policies.folder.stored import refuse_log_of_team, refuse_team
from halfseen.shapes import Float
from halfseen.tables.first_look import FirstLook, chances_of, first_look
from halfseen.tables.present import Present
from halfseen.view.shapes import Mesh, convex_mesh, moved, revealed_by, shadow
from halfseen.view.stage_view import Option, Shown, StageView, Watched
from halfseen.world.log_checks import PLACE_COLUMNS
from halfseen.world.logs import states_of

Transform = Float[np.ndarray, "4 4"]

CLOUD = "cloud"  # column of a log's stages: the file of each stage's cloud
_DARKEST, _LIGHTEST = 70, 200
_SPREAD_PERCENT = 2.0


def watched_cloud(
    cloud: Cloud,
    view: View,
    now: Present | None,
    decision: Decision | None,
    horizon: int,
    look: FirstLook | None = None,
) -> Watched:
    """Show the camera's view and the policy's decision on it.

    Parameters
    ----------
    cloud, view
        The camera's point cloud, and the objects perceived in it.
    now
        Present state of the trajectory, whose first objects are those of the view; None without a policy.
    decision
        The decision; None without a policy.
    horizon
        Horizon T of the policy [stages].
    look
        Without a policy: the evidence of dirt in this look; None for that of the colours.
    """
    title = "what is seen" if now is None else f"stage {now.stage} of {horizon}"
    if now is None or decision is None:
        look = look or first_look(view, cloud)
        stage = _seen_stage(cloud, view, title, look.chances, None, [look.words] if look.words else [])
    else:
        stage = _seen_stage(cloud, view, title, chances_of(now), decision, [now.seen] if now.seen else [])
    return Watched(cloud.name, (stage,))


def watched_logs(logs: Logs, clouds: Path, number: int, stored: StoredPolicy | None = None) -> Watched:
    """Show a trajectory of a log.

    Parameters
    ----------
    logs
        The log; its stages name their cloud files.
    clouds
        Folder of these files.
    number
        Number of the trajectory, from 1.
    stored
        A table policy, to decide at each stage; None to show the log only.

    Raises
    ------
    HalfseenError
        There is no such trajectory, a stage has no cloud, or the policy has no tables.
    """
    if not 1 <= number <= logs.num_trajectories:
        raise ArgumentError(
            f"--trajectory is {number}, but the log has {logs.num_trajectories} trajectories; count from 1"
        )
    if CLOUD not in logs.stages.columns:
        raise ArgumentError(
            f"stages: no column {CLOUD!r} says which file holds the cloud of each stage; write it with "
            "`halfseen convert BAG --clouds FOLDER`"
        )
    name = f"trajectory {logs.trajectory_ids[number - 1]}"
    trajectory = logs.select(logs.trajectory_ids[number - 1 : number])
    decisions = _decisions(trajectory, stored)
    stages, events = [], []
    for t, row in enumerate(trajectory.stages.to_dict("records")):
        title = f"{name}, stage {t + 1} of {trajectory.horizon}"
        stages.append(_logged_stage(trajectory, row, clouds, title, decisions[t], events))
        events.append(_done(row))
    cause = trajectory.trajectories["cause"].iloc[0]
    ending = "finished" if trajectory.is_finished[0] else f"was cut: {cause}"
    stages[-1] = replace(stages[-1], events=(*stages[-1].events, events[-1], f"the trajectory {ending}"))
    return Watched(name, tuple(stages))


def _logged_stage(
    trajectory: Logs, row: dict[str, Any], clouds: Path, title: str, decision: Decision | None, events: list[str]
) -> StageView:
    file = row[CLOUD]
    if not isinstance(file, str):
        raise ArgumentError(f"{title}: no cloud is stored for this stage; choose another trajectory")
    if "\0" in file or not Path(os.path.realpath(clouds / file)).is_relative_to(os.path.realpath(clouds)):
        raise ArgumentError(f"{title}: its cloud {file!r} is not in {clouds}; give the folder that holds it")
    cloud = read_cloud(clouds / file)
    view = perceive(cloud)
    stage = _seen_stage(cloud, view, title, _chances(trajectory, row["stage"], view, cloud), decision, events)
    action = _action(row)
    if decision is None or stage.action == action:
        said = stage.reason or (f"{action}: the logged action" if action else "")
    else:
        said = f"logged: {action or 'nothing'}; the policy: {stage.reason}"
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


def _chances(trajectory: Logs, stage: Any, view: View, cloud: Cloud) -> list[float]:
    """P(DIRTY) of each object of a view, from the log; without an entry there, from the colours of this look."""
    chances = first_look(view, cloud).chances
    if trajectory.objects is None or "log_odds" not in trajectory.objects.columns:
        return chances
    rows = pd.DataFrame(trajectory.objects[trajectory.objects["stage"] == stage])
    logged = expit(as_floats("objects", rows, "log_odds").to_numpy())
    now = np.arange(len(rows))
    if set(PLACE_COLUMNS) <= set(rows.columns):
        places_m = np.stack([as_floats("objects", rows, column).to_numpy() for column in PLACE_COLUMNS], axis=1)
        now = matched(places_m, view.places_m).now
    for chance, number in zip(logged.tolist(), now.tolist(), strict=True):
        if 0 <= number < len(chances):
            chances[number] = chance
    return chances


def _decisions(trajectory: Logs, stored: StoredPolicy | None) -> Sequence[Decision | None]:
    """Decisions of a policy at each stage."""
    stages = range(trajectory.horizon)
    if stored is None:
        return [None for _ in stages]
    refuse_team(stored, "but a log is shown with the decisions of one robot; leave the policy out")
    if not stored.is_table:
        raise PolicyError("the policy is of named actions, which a table cannot show; give a policy of tables")
    refuse_log_of_team(stored, trajectory)
    states, decider = states_of(trajectory, stored.horizon), decider_of(stored, extrapolates=True)
    return [decider.decide(Present(mapped(lambda leaf, t=t: leaf[0, t], states), t + 1)) for t in stages]


def _seen_stage(
    cloud: Cloud,
    view: View,
    title: str,
    is_dirty: Sequence[float],
    decision: Decision | None = None,
    events: Sequence[str] = (),
) -> StageView:
    """Show one look, in coordinates of its table; `is_dirty` may include objects beyond those of the view."""
    known = [
        Shown(seen.id, float(is_dirty[seen.id]), seen.occlusion, seen.solid.middle_m, mesh_of(seen.solid))
        for seen in view.objects
    ]
    num, eye_m = len(known), eye_over_table(view, cloud)
    cut = f", {view.num_cut} more cut by the border of the image" if view.num_cut else ""
    decided: dict[str, Any] = {}
    if decision is not None:
        decided = {"options": options_of(decision), "action": str(decision.action), "reason": decision.reason}
        decided["notes"] = tuple(decision.warnings)
    return StageView(
        title,
        *coloured_points(cloud, np.linalg.inv(view.cloud_from_table)),
        eye_m,
        with_shadows(known, eye_m, np.eye(4)),
        view.hides,
        events=(f"seen: {num} object{'' if num == 1 else 's'}{cut}", *events),
        **decided,
    )


def options_of(decision: Decision) -> tuple[Option, ...]:
    """Actions with a value, best first, with their certainty if known."""
    known = [
        Option(name, q, *decision.intervals.get(name, (None, None)), decision.chance_best.get(name))
        for name, q in decision.q_values.items()
        if q is not None
    ]
    return tuple(sorted(known, key=lambda option: -option.value))


def mesh_of(solid: Vessel | Hull) -> Mesh:
    """Displayed shape of a solid."""
    return convex_mesh(solid.outline_m())


def with_shadows(known: Sequence[Shown], eye_m: Vector, frame_from_table: Transform) -> tuple[Shown, ...]:
    """Add to objects, in coordinates of the table, what they hide, and move them to the display frame.

    Parameters
    ----------
    eye_m
        Position of the camera, in coordinates of the table [m].
    frame_from_table
        Transform of homogeneous points from the table's frame to the display frame.
    """
    solids, shown = [each.solid for each in known if each.solid is not None], []
    for each in known:
        middle_m = moved(np.asarray(each.middle_m, dtype=np.float64)[None], frame_from_table)[0]
        solid, behind, revealed_m = each.solid, each.shadow, each.revealed_m
        if solid is not None:
            number = next(k for k, one in enumerate(solids) if one is solid)
            revealed_m = moved(revealed_by(number, solids, eye_m), frame_from_table)
            behind, solid = shadow(solid, eye_m).moved(frame_from_table), solid.moved(frame_from_table)
        shown.append(replace(each, middle_m=middle_m, solid=solid, shadow=behind, revealed_m=revealed_m))
    return tuple(shown)


def eye_over_table(view: View, cloud: Cloud) -> Vector:
    """Position of the camera, in coordinates of the table [m]."""
    return moved(np.asarray(cloud.eye_m, dtype=np.float64)[None], np.linalg.inv(view.cloud_from_table))[0]


def coloured_points(cloud: Cloud, frame_from_cloud: Transform) -> tuple[Points, Colours]:
    """Return the points of a cloud and their colours; grey by height for a cloud without colours.

    Parameters
    ----------
    frame_from_cloud
        Transform of homogeneous points from the cloud's frame to the display frame.
    """
    is_return = np.isfinite(cloud.points_m).all(axis=1)
    points_m = moved(cloud.points_m[is_return], frame_from_cloud).astype(np.float32)
    if cloud.colours is not None:
        return points_m, cloud.colours[is_return]
    low_m, high_m = np.percentile(points_m[:, 2], [_SPREAD_PERCENT, 100 - _SPREAD_PERCENT])
    share = np.clip((points_m[:, 2] - low_m) / max(high_m - low_m, 1e-6), 0.0, 1.0)
    grey = (_DARKEST + share * (_LIGHTEST - _DARKEST)).astype(np.uint8)
    return points_m, np.repeat(grey[:, None], 3, axis=1)
