"""From a log to the transitions of eq. 3: dense arrays, one row a trajectory, padded to T stages.

`TrajectoryArrays` hold a log as it is. `Transitions` add what each stage weighs and what its target is; `sums` packs
them.

What a log has seen completed: an action of which it never saw a completed stage has no value, which is not 0.

Such an action is impossible for the maximum in eq. 3 and for the policy. Only where a state allows nothing that was
seen do all actions stay that it allows (`behaviour.seen_among`).
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfseen.arrays import library_of, mapped
from halfseen.censoring import StageClocks
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.lazy import Frame
from halfseen.learning.q_space import StageMode
from halfseen.learning.task import Encoded
from halfseen.logs.checks import LARGEST
from halfseen.shapes import Bool, Float, Int

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # What a policy needs of this module loads no log.


class TrajectoryArrays(NamedTuple):
    """Trajectories and their stages; what a trajectory has no stage for holds 0, False or NaN."""

    clocks: StageClocks
    """When each stage began and ended, who was cut, and what cuts may depend on."""
    encoded: Encoded
    has_action: Bool[np.ndarray, "n T"]
    """Stages whose action is known; that of the stage in which a trajectory was cut need not be."""
    probability: Float[np.ndarray, "n T"]
    """Of the logged action under the logging policy; NaN where it was not logged."""
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""

    @property
    def num_trajectories(self) -> int:
        """Number n of trajectories."""
        return self.clocks.num_trajectories

    @property
    def trajectory_ids(self) -> np.ndarray:
        """Names of the trajectories."""
        return self.clocks.trajectory_ids

    @property
    def features(self) -> Float[np.ndarray, "n T A F"]:
        """φ(S_t, a)."""
        return self.encoded.features

    @property
    def is_possible(self) -> Bool[np.ndarray, "n T A"]:
        """Which actions each state allows."""
        return self.encoded.is_possible

    @property
    def action(self) -> Int[np.ndarray, "n T"]:
        """A_t."""
        return self.encoded.action

    @property
    def is_begun(self) -> Bool[np.ndarray, "n T"]:
        """Stages whose S_t was seen."""
        return self.clocks.is_begun

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return self.clocks.is_completed

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages after which a trajectory had come to its own end."""
        return self.clocks.is_last

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "TrajectoryArrays":
        """Keep these trajectories, which may repeat, in this order; a slice of them copies nothing."""
        rest: Any = mapped(lambda leaf: leaf[rows], tuple(self[1:]))
        return TrajectoryArrays(self.clocks.take(rows), *rest)


def trajectory_arrays(logs: Logs, encoded: Encoded, covariates: Frame | None) -> TrajectoryArrays:
    """Lay out a log, given its features and actions, padded to T, and what cuts may depend on, a row a stage."""
    horizon = encoded.action.shape[1]
    at = stage_places(logs)

    def spread(values: np.ndarray, empty: float | bool) -> np.ndarray:
        filled = np.full((logs.num_trajectories, horizon, *values.shape[1:]), empty, dtype=values.dtype)
        filled[at] = values
        return filled

    def numbers(column: str) -> Float[np.ndarray, " rows"]:
        if column not in logs.stages.columns:
            return np.full(logs.num_stages, np.nan)
        return logs.stages[column].to_numpy(dtype=np.float64, na_value=np.nan)

    known = np.zeros((logs.num_stages, 0)) if covariates is None else covariates.to_numpy(dtype=np.float64)
    clocks = StageClocks(
        trajectory_ids=logs.trajectory_ids,
        elapsed_s=spread(numbers("elapsed_s"), np.nan),
        end_s=logs.end_s,
        is_finished=logs.is_finished,
        is_begun=spread(np.ones(logs.num_stages, dtype=bool), False),
        covariates=spread(known, 0.0),
        covariate_names=() if covariates is None else tuple(map(str, covariates.columns)),
    )
    return TrajectoryArrays(
        clocks=clocks,
        encoded=encoded,
        has_action=spread(logs.stages["action"].notna().to_numpy(), False),
        probability=spread(numbers("probability"), np.nan),
        reward=np.nan_to_num(spread(numbers("reward"), 0.0)),
    )


def stage_places(logs: Logs) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """Row of each stage's trajectory in dense arrays, and its column."""
    import pandas as pd

    return pd.Index(logs.trajectory_ids).get_indexer(logs.stages["trajectory"]), logs.stages["stage"].to_numpy() - 1


class Imputation(NamedTuple):
    """How a begun stage gets a target Y whether or not its end was seen (see the module `imputation`).

    With X = R_t + V̂(S_{t+1}) and its regression α + βᵀφ + γᵀg on the completed stages, g terms of the duration,

        Y = share·X + (1 − share)·(α + βᵀφ) + γᵀexpected.
    """

    share: Float[np.ndarray, "n T"]
    """Of X; 0 where the stage was not completed."""
    terms: Float[np.ndarray, "n T G"]
    """g of each completed stage."""
    expected: Float[np.ndarray, "n T G"]
    """What stands for g·(1 − share)."""
    outcome_weight: Float[np.ndarray, "n T"]
    """Weight of each stage in the regression of X: 0 where cut; where completed δ/K̂, truncated, or 1 without K̂."""
    is_used: Float[np.ndarray, " F"]
    """1 for each feature that this regression looks at, 0 for the others."""


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages."""

    features: Float[np.ndarray, "n T E F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not seen. E is A, or 1 where all actions
    have the same features."""
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""
    weight: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻): 0 where the stage was not completed. Where targets are imputed, that of a begun stage."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the trajectory had come to its own end."""
    fold: Int[np.ndarray, " n"]
    """Fold of each trajectory for cross-validation, from 0, below the number of folds."""
    control_variates: Float[np.ndarray, "n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; what they hold at a trajectory's end does not count."""
    policy: Float[np.ndarray, "n T A"] | None = None
    """π(a | S_t), where Q of a given policy is wanted and not that of the best one."""
    imputation: Imputation | None = None

    def counted(self, counts: Float[np.ndarray, " n"]) -> "Transitions":
        """Let each trajectory count so often."""
        imputed = self.imputation
        if imputed is not None:
            imputed = imputed._replace(outcome_weight=imputed.outcome_weight * counts[:, None])
        return self._replace(weight=self.weight * counts[:, None], imputation=imputed)


def q_values(
    coefficients: Float[Any, "*#S K F"], features: Float[Any, "*S E F1"], block_of_action: Int[np.ndarray, " A"]
) -> Float[Any, "*S A"]:
    """Q of every action: the offset of its block plus βᵀφ, of features of its own or of those that all share."""
    each = coefficients[..., block_of_action, :]
    if features.shape[-2] == 1:
        # A product of matrices, where there are many rows.
        xp = library_of(features, coefficients)
        return each[..., 0] + (features @ xp.swapaxes(each[..., 1:], -1, -2))[..., 0, :]
    return each[..., 0] + library_of(features, coefficients).sum(features * each[..., 1:], axis=-1)


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
    findings = []
    for kind in np.flatnonzero(lacking.any(axis=0)):
        rows = np.flatnonzero(lacking[:, kind])
        begun = int(support.num_begun[rows, kind].sum())
        where = "" if stages == "pooled" else f" in stage {', '.join(str(row + 1) for row in rows)}"
        cut = f"begun {begun} times and cut each time" if begun else "never taken"
        findings.append(
            f"{names[kind]} was never seen completed{where} ({cut}), so its value is not known and the policy never "
            "takes it there; to learn it, log it uniformly at random now and then"
        )
    return findings


def refuse_all_cut(is_finished: Bool[np.ndarray, " n"]) -> None:
    """Refuse a log in which no trajectory came to its own end."""
    if not is_finished.any():
        raise PositivityError(
            f"all {len(is_finished)} trajectories were cut, so how a trajectory ends was never seen; record until some "
            "finish, or shorten the horizon so that reaching it counts as finished"
        )


LEAST_SPREAD = 3e-7
"""Standard deviation of rewards by the largest: sums of squares keep some three digits of it."""


def refuse_vanishing(reward: Float[np.ndarray, " m"]) -> None:
    """Refuse rewards so small that their squares cannot be squared, or whose differences rounding would take away."""
    largest = float(np.max(np.abs(reward), initial=0.0))
    if 0.0 < largest < 1 / LARGEST:
        raise LogError(f"the largest reward is {largest:g}, whose fourth power is 0; give rewards in another unit")
    spread = float(np.std(reward)) if len(reward) else 0.0
    if 0.0 < spread < LEAST_SPREAD * largest:
        raise LogError(
            f"rewards are about {np.mean(reward):.3g} and differ by {spread:.2g}, which rounding would take away; "
            "subtract what they have in common"
        )


def refuse_too_few(num_seen: int, num_trajectories: int) -> None:
    """Refuse to hold out trajectories where fewer than two completed a stage."""
    if num_seen < 2:
        raise ArgumentError(
            f"reg is 'cv', which holds out trajectories, but {num_seen} of {num_trajectories} completed a stage; give "
            "a number for reg, or record more trajectories"
        )
