"""From a log to the transitions of eq. 3: dense arrays, one row per trajectory, padded to T stages.

`TrajectoryArrays` hold a log as it is. `Transitions` add the weight and the target of each stage; `sums` packs them.

Support: an action without a completed stage in the log has no value, which is not the value 0. It is impossible for the
maximum in eq. 3 and for the policy. Only where a state allows no supported action do all its actions remain
(`behaviour.seen_among`).
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfseen.arrays import LEAST_RANGE, library_of, mapped
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
    Logs = Any  # Policies need parts of this module but load no log.


class TrajectoryArrays(NamedTuple):
    """Trajectories and their stages; 0, False or NaN where a trajectory has no stage."""

    clocks: StageClocks
    """Beginning and end of each stage, the cuts, and their covariates."""
    encoded: Encoded
    has_action: Bool[np.ndarray, "n T"]
    """Stages whose action is known; it may be unknown in the stage in which a trajectory was cut."""
    probability: Float[np.ndarray, "n T"]
    """Of the logged action under the logging policy; NaN if it was not logged."""
    reward: Float[np.ndarray, "n T"]
    """0 if not completed."""

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
        """The possible actions of each state."""
        return self.encoded.is_possible

    @property
    def action(self) -> Int[np.ndarray, "n T"]:
        """A_t."""
        return self.encoded.action

    @property
    def is_begun(self) -> Bool[np.ndarray, "n T"]:
        """Stages whose S_t was observed."""
        return self.clocks.is_begun

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return self.clocks.is_completed

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages with which a trajectory finished."""
        return self.clocks.is_last

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "TrajectoryArrays":
        """Select trajectories, with repetition and in this order; a slice is a view."""
        rest: Any = mapped(lambda leaf: leaf[rows], tuple(self[1:]))
        return TrajectoryArrays(self.clocks.take(rows), *rest)


def trajectory_arrays(logs: Logs, encoded: Encoded, covariates: Frame | None) -> TrajectoryArrays:
    """Arrange a log as arrays padded to T, given its features and actions, and the covariates of cuts by stage."""
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
    """How a stage that began gets a target Y even if its end was not observed (see the module `imputation`).

    With X = R_t + V̂(S_{t+1}), its regression α + βᵀφ + γᵀg on the completed stages, and g terms of the duration,

        Y = share·X + (1 − share)·(α + βᵀφ) + γᵀexpected.
    """

    share: Float[np.ndarray, "n T"]
    """Of X; 0 if the stage was not completed."""
    terms: Float[np.ndarray, "n T G"]
    """g of each completed stage."""
    expected: Float[np.ndarray, "n T G"]
    """Replaces g·(1 − share)."""
    outcome_weight: Float[np.ndarray, "n T"]
    """Weight of each stage in the regression of X: 0 if cut; if completed, δ/K̂, truncated, or 1 without K̂."""
    is_used: Float[np.ndarray, " F"]
    """1 for each feature that this regression uses, 0 for the others."""


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages."""

    features: Float[np.ndarray, "n T E F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not observed. E is A, or 1 if all actions
    have the same features."""
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    reward: Float[np.ndarray, "n T"]
    """0 if not completed."""
    weight: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻): 0 if the stage was not completed. For imputed targets, the weight of a stage that began."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages with which the trajectory finished."""
    fold: Int[np.ndarray, " n"]
    """Fold of each trajectory for cross-validation, from 0, below the number of folds."""
    control_variates: Float[np.ndarray, "n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; values at the last stage of a finished trajectory are ignored."""
    policy: Float[np.ndarray, "n T A"] | None = None
    """π(a | S_t), if Q of a given policy is estimated rather than of the optimal one."""
    imputation: Imputation | None = None

    def counted(self, counts: Float[np.ndarray, " n"]) -> "Transitions":
        """Multiply the weight of each trajectory by its count."""
        imputed = self.imputation
        if imputed is not None:
            imputed = imputed._replace(outcome_weight=imputed.outcome_weight * counts[:, None])
        return self._replace(weight=self.weight * counts[:, None], imputation=imputed)


def q_values(
    coefficients: Float[Any, "*#S K F"], features: Float[Any, "*S E F1"], block_of_action: Int[np.ndarray, " A"]
) -> Float[Any, "*S A"]:
    """Q of every action: the intercept of its block plus βᵀφ, with its own or shared features."""
    each = coefficients[..., block_of_action, :]
    if features.shape[-2] == 1:
        # A matrix product is faster for many rows.
        xp = library_of(features, coefficients)
        return each[..., 0] + (features @ xp.swapaxes(each[..., 1:], -1, -2))[..., 0, :]
    return each[..., 0] + library_of(features, coefficients).sum(features * each[..., 1:], axis=-1)


class Support(NamedTuple):
    """How often each kind of action began and was completed in each stage; the support of parts of a log adds up."""

    num_begun: Int[np.ndarray, "T K"]
    num_completed: Int[np.ndarray, "T K"]
    is_allowed: Bool[np.ndarray, "T K"]
    """Kinds that some state of the stage allows."""

    def plus(self, other: "Support") -> "Support":
        """Add the support of another part of the log."""
        begun, completed = self.num_begun + other.num_begun, self.num_completed + other.num_completed
        return Support(begun, completed, self.is_allowed | other.is_allowed)

    def is_seen(self, stages: StageMode) -> Bool[np.ndarray, "T K"]:
        """Kinds that have a value: completed in the stage, or in any stage if stages are pooled."""
        seen = self.num_completed > 0
        return np.broadcast_to(seen.any(axis=0), seen.shape) if stages == "pooled" else seen


def support_of(trajectories: TrajectoryArrays, kinds: Int[np.ndarray, " A"], num_kinds: int) -> Support:
    """Count the support of a log; `kinds` are those of its actions."""
    known, each = trajectories.is_begun & trajectories.has_action, np.arange(num_kinds)
    is_kind = (kinds[trajectories.action][..., None] == each) & known[..., None]
    return Support(
        num_begun=is_kind.sum(axis=0),
        num_completed=(is_kind & trajectories.is_completed[..., None]).sum(axis=0),
        is_allowed=(trajectories.is_possible & trajectories.is_begun[..., None]).any(axis=0) @ (kinds[:, None] == each),
    )


def unseen_in_words(support: Support, names: tuple[str, ...], stages: StageMode) -> list[str]:
    """Describe each kind that was possible but never completed, where and how often it began; and empty stages."""
    reached: Bool[np.ndarray, "T 1"] = np.any(support.num_completed > 0, axis=1, keepdims=True)
    lacking = support.is_allowed & ~support.is_seen(stages) & reached
    findings = []
    for kind in np.flatnonzero(lacking.any(axis=0)):
        rows = np.flatnonzero(lacking[:, kind])
        begun = int(support.num_begun[rows, kind].sum())
        where = "" if stages == "pooled" else f" in stage {', '.join(str(row + 1) for row in rows)}"
        cut = f"begun {begun} times and cut each time" if begun else "never taken"
        findings.append(
            f"{names[kind]} was never completed{where} ({cut}), so its value is unknown and the policy never "
            "takes it there; to learn it, log it uniformly at random now and then"
        )
    empty = [str(row + 1) for row in np.flatnonzero(~reached)] if stages == "separate" else []
    if empty:
        findings.append(
            f"no trajectory completed stage {', '.join(empty)}, so no action has a value there, and the policy takes "
            "the first; lower the horizon, or pool the stages"
        )
    return findings


def refuse_all_cut(is_finished: Bool[np.ndarray, " n"]) -> None:
    """Refuse a log in which no trajectory finished."""
    if not is_finished.any():
        raise PositivityError(
            f"all {len(is_finished)} trajectories were cut, so no end of a trajectory was observed; record "
            "until some finish, or shorten the horizon so that reaching it counts as finished"
        )


LEAST_SPREAD = 3e-7
"""Smallest standard deviation of rewards relative to their mean: sums of squares keep about three digits of it."""


def refuse_vanishing(reward: Float[np.ndarray, " m"]) -> None:
    """Refuse rewards whose squares underflow when squared, or whose differences are lost to rounding."""
    largest = float(np.max(np.abs(reward), initial=0.0))
    if 0.0 < largest < 1 / LARGEST:
        raise LogError(
            f"the largest reward is {largest:g}, whose fourth power underflows to 0; give rewards in another unit"
        )
    if is_far(reward, 1.0 / LEAST_SPREAD):
        raise LogError(
            f"rewards are about {np.mean(reward):.3g} and differ by {np.std(reward):.2g}, which rounding would erase; "
            "subtract their common part"
        )


LARGEST_MEAN = 3e5
"""Mean in standard deviations from which on the sums of a linear Q lose a feature (`ridge.RANK_TOLERANCE`)."""


def is_far(values: Float[np.ndarray, " m"], most: float | int = LARGEST_MEAN) -> bool:
    """Whether values that differ have a mean of more standard deviations than `most`."""
    mean = abs(float(np.mean(values))) if len(values) else 0.0
    return bool(len(values) and np.ptp(values) > LEAST_RANGE * mean and np.std(values) * most < mean)


def refuse_far(values: Float[np.ndarray, "m F"], names: tuple[str, ...]) -> None:
    """Refuse covariates of a linear Q that are so far from 0 that their squares leave nothing of their differences."""
    for name, column in zip(names, values.T, strict=True):
        if is_far(column):
            raise LogError(
                f"covariate {name!r} is about {np.mean(column):.3g} and differs by {np.std(column):.2g}, which "
                "rounding would erase from a linear Q; subtract its common part, or choose q_function 'quadratic'"
            )


def refuse_too_few(num_seen: int, num_trajectories: int) -> None:
    """Refuse cross-validation if fewer than two trajectories completed a stage."""
    if num_seen < 2:
        raise ArgumentError(
            f"reg is 'cv', which holds out trajectories, but only {num_seen} of {num_trajectories} completed a "
            "stage; give a number for reg, or record more trajectories"
        )
