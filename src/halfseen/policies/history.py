"""From what a camera sees now, and what was logged of the trajectory so far, to the state that a policy decides in."""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import Hides, ObjectMask, PerObject, Points
from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, place, shown, value_at
from halfseen.policies.identity import Identities, by_order, by_place
from halfseen.shapes import Int
from halfseen.tables.present import Known, Present, Tried, state_now, unknown
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.log_checks import PLACE_COLUMNS
from halfseen.world.logs import states_of
from halfseen.world.scene import Scene


def present_state(
    scene: Scene,
    horizon: int,
    history: Logs,
    *,
    dirty_share: float,
    places_m: Points | None = None,
    held: bool | None = None,
) -> Present:
    """State of a table whose trajectory is the last of a log.

    The log knows a table as it was when its last stage began. Where that stage has an action, it is taken as carried
    out. Where nobody knows whether it held, a WASH did if its object is gone, and a LIFT is not counted.

    Parameters
    ----------
    scene
        What the cloud shows now.
    horizon
        T of the policy.
    history
        The trajectory so far is its last one. Where its objects have `PLACE_COLUMNS`, they are found again by where
        they were; else they are taken in their order, and a note says so.
    dirty_share
        P(DIRTY) of an object before any label; in (0, 1).
    places_m
        Where the objects of the scene are, in the frame of the history's places [m]; None if nobody knows.
    held
        Whether the last action held; None if nobody knows, or nothing was done.

    Raises
    ------
    LogError
        The log breaks a rule of tables, or its last trajectory is over.
    PolicyError
        The cloud shows other objects than the history, or no step is left.
    """
    trajectory = history if history.num_trajectories == 1 else history.select(history.trajectory_ids[-1:])
    last, done = _last_table(trajectory, horizon), _last_action(trajectory)
    same = _identities(trajectory, last, done, held, scene, places_m)
    tried, notes = _attempts(last, same.was), [*same.notes]
    known = _known(last, same.was, unknown(scene, dirty_share))
    if done is not None:
        is_wash = done.verb == Verb.WASH.name
        is_held = same.is_washed if held is None and is_wash else held
        if is_held is None:
            whether = (
                f"whether {done.verb} of {shown(_names(trajectory)[done.target])} in stage {trajectory.horizon} held"
            )
            notes.append(f"{whether} is not known; it is not counted")
        elif not (is_held and is_wash):
            target = int(np.flatnonzero(same.was == done.target)[0])
            occluded = 1.0 - np.prod(1.0 - last.hides[done.target][last.is_on_table])
            tried.append(Tried(target, float(occluded), is_held))
            known.lifts[target] += is_held and done.verb == Verb.LIFT.name
    stage = trajectory.horizon + (done is not None)
    state = state_now(_hides(last, same.was, scene), known, tried, horizon, stage)
    new, was = tuple(np.flatnonzero(same.was < 0).tolist()), tuple(same.was.tolist())
    return Present(state, stage, tuple(notes), done is None, new, was, dirty_share=dirty_share)


class _Done(NamedTuple):
    """The last action of a trajectory, and the rank of its object in its stage."""

    verb: str
    target: int


def _last_table(trajectory: Logs, horizon: int) -> Any:
    """The fields of the last state of a trajectory, as NumPy arrays."""
    states = vars(states_of(trajectory, max(horizon, trajectory.horizon)))
    known = {name: leaf for name, leaf in states.items() if isinstance(leaf, np.ndarray)}
    return SimpleNamespace(**{name: leaf[0, trajectory.horizon - 1] for name, leaf in known.items()})


def _last_rows(trajectory: Logs) -> pd.DataFrame:
    assert trajectory.objects is not None, "a history is of tables"
    return pd.DataFrame(trajectory.objects[trajectory.objects["stage"] == trajectory.horizon])


def _names(trajectory: Logs) -> list[Any]:
    return _last_rows(trajectory)["object"].tolist()


def _last_action(trajectory: Logs) -> _Done | None:
    verb, name = (value_at(trajectory.stages, column, -1) for column in ("action", "object"))
    if trajectory.is_finished[0] or (not pd.isna(verb) and verb == Verb.FINISH.name):
        raise LogError(
            f"{place(trajectory.stages, -1)}: the trajectory came to its own end, so nothing is left to decide; "
            "without a history the cloud is the first of a new trajectory"
        )
    if pd.isna(verb):
        return None
    listed = _names(trajectory)
    if verb not in Verb.__members__ or pd.isna(name) or name not in listed:
        raise LogError(
            f"{place(trajectory.stages, -1)}: action {shown(verb)} of object {shown(name)} is none that the table "
            f"knows; give {' or '.join(verb.name for verb in TARGETED)} with an object of the stage, or null where "
            "nothing was done yet"
        )
    return _Done(verb, listed.index(name))


def _identities(
    trajectory: Logs, last: Any, done: _Done | None, held: bool | None, scene: Scene, places_m: Points | None
) -> Identities:
    kept, rows = np.flatnonzero(last.is_on_table), _last_rows(trajectory)
    washed = done.target if done is not None and done.verb == Verb.WASH.name else None
    racked = washed if held else None
    kept, washed = kept[kept != racked], washed if held is None else None
    try:
        if places_m is None or not set(PLACE_COLUMNS) <= set(rows.columns):
            return by_order(kept, last.hides, scene.hides, washed)
        was_m = np.stack([as_floats("objects", rows, column).to_numpy() for column in PLACE_COLUMNS], axis=1)
        return by_place(kept, rows["object"].tolist(), was_m, places_m, washed, racked)
    except PolicyError as error:
        raise PolicyError(f"{place(trajectory.stages, -1)}: {error}") from error


def _attempts(last: Any, was: Int[np.ndarray, " k"]) -> list[Tried]:
    """Past attempts on the objects that are still there."""
    columns = last.attempt_object.tolist(), last.attempt_occlusion.tolist(), last.attempt_succeeded.tolist()
    number = {rank: now for now, rank in enumerate(was.tolist()) if rank >= 0}
    rows = zip(*columns, strict=True)
    return [Tried(number[target], occluded, held) for target, occluded, held in rows if target in number]


def _hides(last: Any, was: Int[np.ndarray, " k"], scene: Scene) -> Hides:
    """Who hides whom: as the cloud shows it, and where it does not show both, as it was."""
    both = (was >= 0)[:, None] & (was >= 0)
    hides = np.where(both, last.hides[np.ix_(was, was)], 0.0).astype(np.float64)
    hides[: scene.num_objects, : scene.num_objects] = scene.hides
    return hides


def _known(last: Any, was: Int[np.ndarray, " k"], fresh: Known) -> Known:
    """What the history knows of each object; of those that it lacks, what is known at first.

    How well an object can be gripped is told by the cloud where it shows it.
    """
    is_new, is_seen = was < 0, np.arange(len(was)) < len(fresh.grip)

    def of(name: str, is_fresh: ObjectMask) -> PerObject:
        first = np.zeros(len(was))
        first[is_seen] = getattr(fresh, name)
        return np.where(is_fresh, first, getattr(last, name)[was])

    return Known(*(of(name, is_seen if name == "grip" else is_new) for name in Known._fields))
