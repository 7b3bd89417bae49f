"""What a log has seen completed: an action of which it never saw a completed stage has no value, which is not 0.

Such an action is impossible for the maximum in eq. 3 and for the policy. Only where a state allows nothing that was
seen do all actions stay that it allows (`behaviour.seen_among`).
"""

from typing import NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, PositivityError
from halfseen.learning.q_space import StageMode
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Int


class Support(NamedTuple):
    """How often each kind of action was begun and completed in each stage; support of parts of a log adds up."""

    num_begun: Int[np.ndarray, "T K"]
    num_completed: Int[np.ndarray, "T K"]
    is_allowed: Bool[np.ndarray, "T K"]
    """Kinds that some state of the stage allowed."""

    def plus(self, other: "Support") -> "Support":
        """Join what another part of the log has seen."""
        begun, completed = self.num_begun + other.num_begun, self.num_completed + other.num_completed
        return Support(begun, completed, self.is_allowed | other.is_allowed)

    def is_seen(self, stages: StageMode) -> Bool[np.ndarray, "T K"]:
        """Kinds that have a value: seen completed in the stage, or anywhere where stages are pooled."""
        seen = self.num_completed > 0
        return np.broadcast_to(seen.any(axis=0), seen.shape) if stages == "pooled" else seen


def support_of(trajectories: TrajectoryArrays, kinds: Int[np.ndarray, " A"], num_kinds: int) -> Support:
    """Count what a log has seen; `kinds` are those of its actions."""
    known, each = trajectories.is_begun & trajectories.has_action, np.arange(num_kinds)
    is_kind = (kinds[trajectories.action][..., None] == each) & known[..., None]
    return Support(
        num_begun=is_kind.sum(axis=0),
        num_completed=(is_kind & trajectories.is_completed[..., None]).sum(axis=0),
        is_allowed=(trajectories.is_possible & trajectories.is_begun[..., None]).any(axis=0) @ (kinds[:, None] == each),
    )


def unseen_in_words(support: Support, names: tuple[str, ...], stages: StageMode) -> list[str]:
    """Say of each kind that was allowed and never seen completed where that was, and how often it was begun."""
    reached: Bool[np.ndarray, "T 1"] = np.any(support.num_completed > 0, axis=1, keepdims=True)
    lacking = support.is_allowed & ~support.is_seen(stages) & reached
    told = []
    for kind in np.flatnonzero(lacking.any(axis=0)):
        rows = np.flatnonzero(lacking[:, kind])
        begun = int(support.num_begun[rows, kind].sum())
        where = "" if stages == "pooled" else f" in stage {', '.join(str(row + 1) for row in rows)}"
        cut = f"begun {begun} times and cut each time" if begun else "never taken"
        told.append(
            f"{names[kind]} was never seen completed{where} ({cut}), so its value is not known and the policy never "
            "takes it there; to learn it, log it uniformly at random now and then"
        )
    return told


def refuse_all_cut(is_finished: Bool[np.ndarray, " n"]) -> None:
    """Refuse a log in which no trajectory came to its own end.

    Raises
    ------
    PositivityError
        All were cut.
    """
    if not is_finished.any():
        raise PositivityError(
            f"all {len(is_finished)} trajectories were cut, so how a trajectory ends was never seen; record until some "
            "finish, or shorten the horizon so that reaching it counts as finished"
        )


def refuse_too_few(num_seen: int, num_trajectories: int) -> None:
    """Refuse to hold out trajectories where fewer than two completed a stage.

    Raises
    ------
    ArgumentError
        The message says how many did.
    """
    if num_seen < 2:
        raise ArgumentError(
            f"reg is 'cv', which holds out trajectories, but {num_seen} of {num_trajectories} completed a stage; give "
            "a number for reg, or record more trajectories"
        )
