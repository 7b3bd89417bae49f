"""The state that a policy decides in, from the camera's current view and the prior of the log."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import LogError

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Reading a policy loads no log.
from dataclasses import dataclass, replace

from halfseen.arrays import Hides, PerObject
from halfseen.errors import PolicyError
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, label_evidence
from halfseen.world.state import NO_ATTEMPT, TableState, occlusion

PRIOR_COLUMN = "dirty_share"


class PriorFacts(NamedTuple):
    """Facts of a log, or of a part of it, about the prior P(DIRTY)."""

    stated: tuple[float, float] | None
    """Smallest and largest prior stated by its trajectories; None if one states none."""
    total: float
    """Sum of P(DIRTY) over the objects of all first stages."""
    count: int


def logged_dirty_share(logs: Logs) -> float:
    """Read the prior of the log-odds of a log.

    It is the column ``dirty_share`` of the trajectories if there is one. Otherwise it is the mean of P(DIRTY) over the
    objects of all first stages: with calibrated labels, E[P(DIRTY | label)] is the prior.

    Raises
    ------
    LogError
        The log has no objects, or its trajectories had different priors.
    """
    return dirty_share([prior_facts(logs)])


def prior_facts(logs: Logs) -> PriorFacts:
    """Collect the facts from a log, or from a part of it.

    Raises
    ------
    LogError
        The log has no objects.
    """
    from halfseen.logs.columns import as_floats, require_columns

    stated = None
    if PRIOR_COLUMN in logs.trajectories.columns and not logs.trajectories[PRIOR_COLUMN].isna().to_numpy().any():
        values = as_floats("trajectories", logs.trajectories, PRIOR_COLUMN)
        stated = float(values.min()), float(values.max())
    if logs.objects is None:
        if stated is not None:
            return PriorFacts(stated, 0.0, 0)
        raise LogError("objects: the log has no objects table, which learning a table needs; add it")
    require_columns("objects", logs.objects, ("stage", "log_odds"))
    log_odds = as_floats("objects", logs.objects, "log_odds").to_numpy()
    at_first = expit(log_odds[logs.objects["stage"].to_numpy() == 1])
    return PriorFacts(stated, float(at_first.sum()), len(at_first))


def dirty_share(parts: Sequence[PriorFacts]) -> float:
    """Compute the prior from the facts of the parts of a log.

    Raises
    ------
    LogError
        Trajectories had different priors.
    """
    stated = [part.stated for part in parts if part.stated is not None]
    if len(stated) < len(parts):
        return sum(part.total for part in parts) / sum(part.count for part in parts)
    least, largest = min(low for low, _ in stated), max(high for _, high in stated)
    if largest > least or not 0.0 < least < 1.0:
        raise LogError(
            f"trajectories: {PRIOR_COLUMN} goes from {least:g} to {largest:g}; a policy has one prior, between "
            "0 and 1: select trajectories that share one"
        )
    return least


@dataclass(frozen=True)
class Present:
    """The current stage of a trajectory.

    Parameters
    ----------
    state
        State of one table: the objects of the cloud, in its order, then objects on the table that are not seen.
    stage
        The stage to decide, from 1.
    notes
        Warnings about doubtful facts.
    is_labelled
        True if the log-odds already include this look: its labels must not be added again.
    new
        Numbers of the objects that are not in the history: their labels are added nevertheless.
    was
        Number of each object in the history's last stage; −1 for an object that is not in it. Empty without a history.
    seen
        The labels in one sentence.
    dirty_share
        P(DIRTY) of an object before any label; None if unknown.
    """

    state: TableState
    stage: int
    notes: tuple[str, ...] = ()
    is_labelled: bool = False
    new: tuple[int, ...] = ()
    was: tuple[int, ...] = ()
    seen: str = ""
    dirty_share: float | None = None


class KnownObjects(NamedTuple):
    """Knowledge of each object, apart from past attempts."""

    log_odds: PerObject
    seen: PerObject
    """Share of its surface that labels cover."""
    lifts: PerObject
    grip: PerObject


class PastAttempt(NamedTuple):
    """A past attempt."""

    target: int
    occlusion: float
    is_held: bool


def first_state(scene: Scene, horizon: int, dirty_share: float, stage: int = 1) -> Present:
    """State of a table known only from a view: log-odds at the prior, no attempts.

    `horizon` is T of the policy, and `dirty_share` is P(DIRTY) of an object before any label, as in the logs that it
    learned from, in (0, 1). Stages count from 1.

    Raises
    ------
    PolicyError
        There is no such stage, or `dirty_share` is not in (0, 1).
    """
    state = state_now(scene.hides, unknown(scene, dirty_share), [], horizon, stage)
    return Present(state, stage, dirty_share=dirty_share)


def unknown(scene: Scene, dirty_share: float) -> KnownObjects:
    """Knowledge of objects that were never seen before.

    `dirty_share` is P(DIRTY) of an object before any label, in (0, 1).

    Raises
    ------
    PolicyError
        `dirty_share` is not in (0, 1).
    """
    if not 0.0 < dirty_share < 1.0:
        raise PolicyError(f"dirty_share is {dirty_share}; give P(DIRTY) before any label, between 0 and 1")
    none, prior = np.zeros(scene.num_objects), np.log(dirty_share) - np.log1p(-dirty_share)
    return KnownObjects(np.full(scene.num_objects, prior), none, none, np.asarray(scene.grip, dtype=np.float64))


def state_now(hides: Hides, known: KnownObjects, tried: Sequence[PastAttempt], horizon: int, stage: int) -> TableState:
    """State of a table with all known objects on it.

    `horizon` is T of the policy, and stages count from 1.

    Raises
    ------
    PolicyError
        There is no such stage, or there were more attempts than stages.
    """
    if not 1 <= stage <= horizon or len(tried) > horizon:
        raise PolicyError(
            f"stage {stage} with {len(tried)} past attempts is beyond the policy's horizon of {horizon} stages; "
            "end the trajectory, or learn with a longer horizon"
        )
    empty = [PastAttempt(NO_ATTEMPT, 0.0, False)] * (horizon - len(tried))
    target, occluded, succeeded = (np.array(column) for column in zip(*tried, *empty, strict=True))
    there = np.ones(len(hides), dtype=bool)
    leaves = {
        "hides": hides.astype(np.float32),
        "is_object": there,
        "is_on_table": there,
        "grip": known.grip.astype(np.float32),
        "log_odds": known.log_odds.astype(np.float32),
        "seen": known.seen.astype(np.float32),
        "lifts": known.lifts.astype(np.int32),
        "attempt_object": target.astype(np.int32),
        "attempt_occlusion": occluded.astype(np.float32),
        "attempt_succeeded": succeeded.astype(bool),
        "steps_to_go": np.int32(horizon - stage + 1),
    }
    return TableState(**leaves)


def labelled(present: Present, is_dirty: Sequence[bool | None], seeing: KnownSeeing) -> Present:
    """Update the log-odds of DIRTY by a label of each object, with the accuracy of a law at its occlusion.

    If the log-odds already include this look, only objects new to the history are labelled. `is_dirty` holds the label
    of each object of the cloud; None for no label.
    """
    occluded = np.asarray(occlusion(present.state), dtype=np.float64)
    log_odds, seen = (np.asarray(leaf, dtype=np.float64) for leaf in (present.state.log_odds, present.state.seen))
    says = np.array([*is_dirty, *[None] * (len(occluded) - len(is_dirty))], dtype=object)
    counts = np.isin(np.arange(len(says)), present.new) | (not present.is_labelled)
    is_labelled_now, says_dirty = np.array([dirty is not None for dirty in says]) & counts, says.astype(bool)
    evidence = label_evidence(*seeing.positive(occluded, seen), says_dirty)
    state = replace(
        present.state,
        log_odds=(log_odds + np.where(is_labelled_now, evidence, 0.0)).astype(np.float32),
        seen=np.where(is_labelled_now, seeing.after(occluded, seen, says_dirty), seen).astype(np.float32),
    )
    return replace(present, state=state, is_labelled=True, new=())
