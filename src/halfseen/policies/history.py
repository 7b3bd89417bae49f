"""The present state of a trajectory, from the camera's view and the log of the trajectory so far."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import Hides, ObjectMask, PerObject, Points
from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, place, shown, value_at
from halfseen.perception.tracking import FARTHEST_M, NEARLY_AS_NEAR_M, matched
from halfseen.shapes import Float, Int
from halfseen.tables.present import KnownObjects, PastAttempt, Present, state_now, unknown
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.log_checks import PLACE_COLUMNS
from halfseen.world.logs import states_of
from halfseen.world.scene import Scene

DIFFERS = 0.3
"""Change in occlusion between objects from which their order may have changed."""


class Identities(NamedTuple):
    """Matches the objects on the table now to those of the history.

    The objects of the cloud come first, in its order, followed by those that the cloud does not show.
    """

    was: Int[np.ndarray, " k"]
    """Rank of each in the history; −1 if it is new."""
    is_washed: bool
    """Whether the object of a last WASH is gone."""
    notes: tuple[str, ...]
    """Doubts about the match."""


def by_place(
    kept: Int[np.ndarray, " k"],
    names: Sequence[object],
    was_m: Float[np.ndarray, "n 3"],
    now_m: Float[np.ndarray, "m 3"],
    washed: int | None,
    racked: int | None = None,
) -> Identities:
    """Match the objects of a history to those of the cloud by position.

    As in a robot's memory (`halfseen.cell.memory`), an object that is no longer visible stays on the table, hidden,
    unless it was washed. A visible object at a new position is new.

    Parameters
    ----------
    kept
        Ranks of the objects of the history that are on the table.
    names, was_m
        For all objects of the history: their names and positions [m].
    now_m
        Positions of the objects of the cloud, in the same frame [m].
    washed
        Rank of the object of a WASH with unknown outcome; None if there was none.
    racked
        Rank of the object of a WASH that has just held, not among those kept; None if there was none.

    Raises
    ------
    PolicyError
        No object is at a known position.
    """
    found = matched(was_m[kept], now_m)
    number_of = dict(zip(kept.tolist(), found.now.tolist(), strict=True))
    is_washed = washed is not None and number_of[washed] < 0
    hidden = [rank for rank, now in number_of.items() if now < 0 and not (is_washed and rank == washed)]
    if len(hidden) == len(kept) > 0 and len(now_m):
        raise PolicyError(
            f"none of the {len(now_m)} objects that the cloud shows is within {FARTHEST_M:.2f} m of where one of the "
            f"{len(kept)} objects on the table was: the history is of another table, or its camera was moved; give "
            "the log of this table, or begin a new trajectory"
        )
    was = np.full(len(now_m), -1)
    for rank, now in number_of.items():
        if now >= 0:
            was[now] = rank
    notes = [
        f"object {now} is taken to be {shown(names[rank])} of the history, but another is nearly as near"
        for (rank, now), is_doubtful in zip(number_of.items(), found.is_doubtful.tolist(), strict=True)
        if is_doubtful and now >= 0
    ]
    if washed is not None and not is_washed:
        away_m = float(np.linalg.norm(now_m[number_of[washed]] - was_m[washed]))
        if away_m > NEARLY_AS_NEAR_M:
            notes.append(
                f"WASH of {shown(names[washed])} is taken to have failed: object {number_of[washed]}, {away_m:.2f} m "
                "from where it was, is taken to be the same"
            )
    if racked is not None:
        stands = (was < 0) & (np.linalg.norm(now_m - was_m[racked], axis=1) < NEARLY_AS_NEAR_M)
        notes += [
            f"WASH of {shown(names[racked])} held, but object {now} stands where it was: it is taken to be another"
            for now in np.flatnonzero(stands).tolist()
        ]
    notes += [
        f"object {len(now_m) + k} is {shown(names[rank])} of the history, which the cloud does not show: it is taken "
        "to be hidden where it was"
        for k, rank in enumerate(hidden)
    ]
    return Identities(np.concatenate([was, np.array(hidden, dtype=was.dtype)]), is_washed, tuple(notes))


def by_order(
    kept: Int[np.ndarray, " k"], hides_before: Float[np.ndarray, "n n"], hides_now: Hides, washed: int | None
) -> Identities:
    """Match the objects of a history to those of the cloud by order, as the history has no positions.

    Parameters
    ----------
    kept
        Ranks of the objects of the history that are on the table.
    hides_before, hides_now
        Occlusion between objects in the history, for all of its objects, and in the cloud.
    washed
        Rank of the object of a WASH with unknown outcome: it held if the cloud shows one object less. None if there
        was none.

    Raises
    ------
    PolicyError
        The cloud shows another number of objects.
    """
    is_washed = washed is not None and len(kept) == len(hides_now) + 1
    was = kept[kept != washed] if is_washed else kept
    if len(was) != len(hides_now):
        raise PolicyError(
            f"{len(kept)} objects are on the table by the history, but the cloud shows {len(hides_now)}: these are "
            "other objects; give the log of this table, or one with the places of its objects"
        )
    note = "objects of the history have no places (x_m, y_m, z_m): they are matched by order"
    return Identities(was, is_washed, (note, *_other_order(hides_before[np.ix_(was, was)], hides_now)))


def _other_order(before: Hides, now: Hides) -> list[str]:
    change = np.abs(before - now)
    if change.max(initial=0.0) < DIFFERS:
        return []
    i, j = np.unravel_index(int(change.argmax()), change.shape)
    return [f"object {i} was hidden by object {j} to {before[i, j]:.2f} and is to {now[i, j]:.2f} now: is it the same?"]


def present_state(
    scene: Scene,
    horizon: int,
    history: Logs,
    *,
    dirty_share: float,
    places_m: Points | None = None,
    held: bool | None = None,
) -> Present:
    """State of a table in the last trajectory of a log.

    The log describes the table at the beginning of its last stage. If that stage has an action, it is taken as carried
    out. If its outcome is unknown, a WASH held if its object is gone, and a LIFT is not counted.

    Parameters
    ----------
    scene
        The scene in the cloud now.
    horizon
        T of the policy.
    history
        Log whose last trajectory is the one so far. Objects with `PLACE_COLUMNS` are matched by position; otherwise
        they are matched by order, and a note says so.
    dirty_share
        P(DIRTY) of an object before any label; in (0, 1).
    places_m
        Positions of the objects of the scene, in the frame of the history's positions [m]; None if unknown.
    held
        Whether the last action held; None if unknown, or if there was none.

    Raises
    ------
    LogError
        The log breaks a rule of tables, or its last trajectory has ended.
    PolicyError
        The objects of the cloud do not match the history, or no step is left.
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
            notes.append(f"{whether} is unknown; the attempt is not counted")
        elif not (is_held and is_wash):
            target = int(np.flatnonzero(same.was == done.target)[0])
            occluded = 1.0 - np.prod(1.0 - last.hides[done.target][last.is_on_table])
            tried.append(PastAttempt(target, float(occluded), is_held))
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
            f"{place(trajectory.stages, -1)}: the trajectory has finished, so nothing is left to decide; to begin a "
            "new one with this cloud, leave the history out"
        )
    if pd.isna(verb):
        return None
    listed = _names(trajectory)
    if verb not in Verb.__members__ or pd.isna(name) or name not in listed:
        raise LogError(
            f"{place(trajectory.stages, -1)}: action {shown(verb)} of object {shown(name)} is unknown to a table; "
            f"give {' or '.join(verb.name for verb in TARGETED)} with an object of the stage, or null where nothing "
            "was done yet"
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


def _attempts(last: Any, was: Int[np.ndarray, " k"]) -> list[PastAttempt]:
    """Past attempts on the objects that are still there."""
    columns = last.attempt_object.tolist(), last.attempt_occlusion.tolist(), last.attempt_succeeded.tolist()
    number = {rank: now for now, rank in enumerate(was.tolist()) if rank >= 0}
    rows = zip(*columns, strict=True)
    return [PastAttempt(number[target], occluded, held) for target, occluded, held in rows if target in number]


def _hides(last: Any, was: Int[np.ndarray, " k"], scene: Scene) -> Hides:
    """Occlusion between objects: from the cloud if it shows both, otherwise from the history."""
    both = (was >= 0)[:, None] & (was >= 0)
    hides = np.where(both, last.hides[np.ix_(was, was)], 0.0).astype(np.float64)
    hides[: scene.num_objects, : scene.num_objects] = scene.hides
    return hides


def _known(last: Any, was: Int[np.ndarray, " k"], fresh: KnownObjects) -> KnownObjects:
    """What the history knows of each object; for objects not in it, the initial knowledge.

    Ease of grip comes from the cloud for objects that it shows.
    """
    is_new, is_seen = was < 0, np.arange(len(was)) < len(fresh.grip)

    def of(name: str, is_fresh: ObjectMask) -> PerObject:
        first = np.zeros(len(was))
        first[is_seen] = getattr(fresh, name)
        return np.where(is_fresh, first, getattr(last, name)[was])

    return KnownObjects(*(of(name, is_seen if name == "grip" else is_new) for name in KnownObjects._fields))
