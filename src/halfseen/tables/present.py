"""From what a camera sees now, and what was logged of the path so far, to the state that a policy decides in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.errors import LogError, PolicyError
from halfseen.logs import Logs
from halfseen.logs.refusal import place, shown, value_at
from halfseen.world.action_space import TARGETED, Verb
from halfseen.world.recording import states_of
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, label_evidence
from halfseen.world.state import NO_ATTEMPT, TableState, occlusion

DIFFERS = 0.3
"""If who hides whom changes by this much, objects may stand in another order than before."""


@dataclass(frozen=True)
class Present:
    """Where a path stands.

    Parameters
    ----------
    state
        One table: what is on it, in the order of the cloud.
    stage
        The stage to decide, from 1.
    notes
        What is doubtful.
    is_labelled
        True if the log-odds hold what this look told: labels of it must not be added again.
    seen
        What labels told, in one sentence.
    """

    state: TableState
    stage: int
    notes: tuple[str, ...] = ()
    is_labelled: bool = False
    seen: str = ""


def first_state(scene: Scene, horizon: int, dirty_share: float, stage: int = 1) -> Present:
    """State of a table of which nothing is known but a view: labels at the prior, no attempts.

    Parameters
    ----------
    scene
        What the cloud shows.
    horizon
        T of the policy.
    dirty_share
        P(DIRTY) of an object before any label, as in the logs that the policy learned from; in (0, 1).
    stage
        The stage to decide, from 1.

    Raises
    ------
    PolicyError
        There is no such stage, or `dirty_share` leaves nothing in doubt.
    """
    num_objects = scene.num_objects
    if not 0.0 < dirty_share < 1.0:
        raise PolicyError(f"dirty_share is {dirty_share}; P(DIRTY) before any label lies between 0 and 1")
    prior = np.log(dirty_share) - np.log1p(-dirty_share)
    known = _Known(np.full(num_objects, prior), np.zeros(num_objects), np.zeros(num_objects))
    return Present(_state(scene, known, [], horizon, stage), stage)


def present_state(scene: Scene, horizon: int, history: Logs) -> Present:
    """State of a table whose path is the last of a log.

    The log knows a table as it was when its last stage began. Where that stage has an action, it is taken as carried
    out: a WASH succeeded if the cloud shows one object less. Objects are matched by their order.

    Parameters
    ----------
    scene
        What the cloud shows now.
    horizon
        T of the policy.
    history
        The path so far is its last one.

    Raises
    ------
    LogError
        The log breaks a rule of tables, or its last path is over.
    PolicyError
        The cloud shows another number of objects than the history, or no step is left.
    """
    path = history.select(history.path_ids[-1:])
    last, done = _last_table(path, horizon), _last_action(path)
    kept = np.flatnonzero(last.is_on_table)
    is_washed = done is not None and done.verb == Verb.WASH.name and len(kept) == scene.num_objects + 1
    if done is not None and is_washed:
        kept = kept[kept != done.target]
    if len(kept) != scene.num_objects:
        raise PolicyError(
            f"{place(path.stages, -1)}: {len(kept)} objects are on the table, and the cloud shows "
            f"{scene.num_objects}: the history is of other objects than the cloud shows; give the log of this table"
        )
    tried, notes = _attempts(last, kept), _order_notes(last, kept, scene)
    if done is not None and not is_washed and done.verb == Verb.WASH.name:
        occluded = 1.0 - np.prod(1.0 - last.hides[done.target][last.is_on_table])
        tried.append((int(np.searchsorted(kept, done.target)), float(occluded), False))
    elif done is not None and not is_washed:
        notes.append(f"whether {done.verb} {done.target} of stage {path.horizon} held is not known; it is not counted")
    stage = path.horizon + (done is not None)
    known = _Known(last.log_odds[kept], last.seen[kept], last.lifts[kept])
    state = _state(scene, known, tried, horizon, stage)
    return Present(state, stage, tuple(notes), is_labelled=done is None)


def labelled(present: Present, is_dirty: Sequence[bool | None], seeing: KnownSeeing) -> Present:
    """Move the log-odds of DIRTY by a label of each object, as right as a law says at its occlusion.

    Parameters
    ----------
    present
        Where the path stands; returned as it is where its log-odds hold this look.
    is_dirty
        What each object looks like; None where nothing can be said.
    seeing
        What labels tell.
    """
    if present.is_labelled:
        return present
    occluded = np.asarray(occlusion(present.state), dtype=np.float64)
    log_odds, seen = (np.asarray(leaf, dtype=np.float64) for leaf in (present.state.log_odds, present.state.seen))
    is_told, says_dirty = np.array([dirty is not None for dirty in is_dirty]), np.array(is_dirty, dtype=bool)
    evidence = label_evidence(*seeing.positive(occluded, seen), says_dirty)
    state = replace(
        present.state,
        log_odds=jnp.asarray((log_odds + np.where(is_told, evidence, 0.0)).astype(np.float32)),
        seen=jnp.asarray(np.where(is_told, seeing.after(occluded, seen, says_dirty), seen).astype(np.float32)),
    )
    return replace(present, state=state, is_labelled=True)


class _Known(NamedTuple):
    """What is known of each object, besides its past attempts."""

    log_odds: np.ndarray
    seen: np.ndarray
    lifts: np.ndarray


class _Done(NamedTuple):
    """The last action of a path, and the rank of its object in its stage."""

    verb: str
    target: int


def _last_table(path: Logs, horizon: int) -> Any:
    """The fields of the last state of a path, as NumPy arrays."""
    states = vars(states_of(path, max(horizon, path.horizon)))
    return SimpleNamespace(**{name: np.asarray(leaf)[0, path.horizon - 1] for name, leaf in states.items()})


def _last_action(path: Logs) -> _Done | None:
    verb, name = (value_at(path.stages, column, -1) for column in ("action", "object"))
    if path.is_finished[0] or (not pd.isna(verb) and verb == Verb.FINISH.name):
        raise LogError(
            f"{place(path.stages, -1)}: the path came to its own end, so nothing is left to decide; without a history "
            "the cloud is the first of a new path"
        )
    if pd.isna(verb):
        return None
    objects: Any = path.objects
    listed = objects[objects["stage"] == path.horizon]["object"].tolist()
    if verb not in Verb.__members__ or pd.isna(name) or name not in listed:
        raise LogError(
            f"{place(path.stages, -1)}: action {shown(verb)} of object {shown(name)} is none that the table knows; "
            f"give {' or '.join(verb.name for verb in TARGETED)} with an object of the stage, or null where nothing "
            "was done yet"
        )
    return _Done(verb, listed.index(name))


def _state(scene: Scene, known: _Known, tried: list[tuple[int, float, bool]], horizon: int, stage: int) -> TableState:
    if not 1 <= stage <= horizon or len(tried) > horizon:
        raise PolicyError(
            f"stage {stage} with {len(tried)} past attempts lies beyond the policy's horizon of {horizon} stages; the "
            "path is over, or learn with a longer horizon"
        )
    empty = [(NO_ATTEMPT, 0.0, False)] * (horizon - len(tried))
    target, occluded, succeeded = (np.array(column) for column in zip(*tried, *empty, strict=True))
    there = np.ones(scene.num_objects, dtype=bool)
    return TableState(
        hides=jnp.asarray(scene.hides.astype(np.float32)),
        is_object=jnp.asarray(there),
        is_on_table=jnp.asarray(there),
        grip=jnp.asarray(np.asarray(scene.grip, dtype=np.float32)),
        log_odds=jnp.asarray(known.log_odds.astype(np.float32)),
        seen=jnp.asarray(known.seen.astype(np.float32)),
        lifts=jnp.asarray(known.lifts.astype(np.int32)),
        attempt_object=jnp.asarray(target.astype(np.int32)),
        attempt_occlusion=jnp.asarray(occluded.astype(np.float32)),
        attempt_succeeded=jnp.asarray(succeeded.astype(bool)),
        steps_to_go=jnp.asarray(np.int32(horizon - stage + 1)),
    )


def _attempts(last: Any, kept: Int[np.ndarray, " k"]) -> list[tuple[int, float, bool]]:
    """Past attempts on the objects that are still there: which, its occlusion then, whether it held."""
    columns = last.attempt_object.tolist(), last.attempt_occlusion.tolist(), last.attempt_succeeded.tolist()
    order = {target: rank for rank, target in enumerate(kept.tolist())}
    rows = zip(*columns, strict=True)
    return [(order[target], occluded, held) for target, occluded, held in rows if target in order]


def _order_notes(last: Any, kept: Int[np.ndarray, " k"], scene: Scene) -> list[str]:
    before = last.hides[np.ix_(kept, kept)]
    change = np.abs(before - scene.hides)
    if change.max(initial=0.0) < DIFFERS:
        return []
    i, j = np.unravel_index(int(change.argmax()), change.shape)
    return [
        f"object {i} was hidden by object {j} to {before[i, j]:.2f} and is to {scene.hides[i, j]:.2f} now; objects of "
        "the history are matched by their order: is it the same?"
    ]
