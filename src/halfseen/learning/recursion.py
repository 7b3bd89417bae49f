"""Censored Q-learning, backwards over the stages (paper, eq. 3), for linear 𝒬.

    Q̂_{T+1} ≡ 0;  Q̂_t = argmin E_n[ (R_t + max_a' Q̂_{t+1}(S_{t+1}, a') − Q_t(S_t, A_t))² · δ_t / Ĝ(U_t⁻) ]

A linear Q is α_k + β_kᵀ φ(S, a) with k the block of the action, fitted by `ridge`. Every fit runs on sums over rows
(`sums`), so a log in memory is one part, and a log that does not fit in memory is many (`passes`).

*Separate* stages: each stage has its own Q_t, fitted on its own rows and shrunk towards 0.

*Pooled* stages, for worlds whose dynamics do not depend on t: Q_h is indexed by the steps to go, h = 1..T, and fitted
on the rows of all stages. A row that the horizon ended carries no information about a longer future, so it is used for
Q_1 only. One more step to go changes little, so Q_h is shrunk towards Q_{h−1}. With λ = 0 nothing is shrunk, and eq. 3
is exact.

*Partial pooling* [GelmanHill2007]_: a state's value is mostly shared by all actions, and few rows show what one action
adds. So Q may be the sum of a common fit to the rows of all blocks, and of the deviation of each block from it,
including its mean, which is shrunk towards the deviation at one step less to go. λ of the blocks is then chosen
jointly.

*Control variates* [Glasserman2003]_ are functions of S_{t+1} whose mean given (S_t, A_t) is 0. Each regression includes
them, and Q omits them: what they explain of the target is noise that Q avoids.

If a policy is *given*, Σ_a π(a | S_{t+1}) Q̂_{t+1}(S_{t+1}, a) replaces the maximum: Q̂ is then that of the policy
(fitted Q evaluation).

If targets are *imputed*, the stage in which a trajectory was right-censored has one, too; see `imputation`.

*Pessimism*: V̂ is the largest lower confidence bound. Imputed targets of cut stages do not count as observations.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.learning.ridge import Errors, Ridge, ridge_of, solve, standard_errors, with_prior
from halfseen.learning.rows import Transitions
from halfseen.learning.sums import (
    ENDED,
    GOING_ON,
    OUTCOME,
    SEEN,
    SHARE,
    WHOLE,
    Columns,
    Crosses,
    Moments,
    Norms,
    Regression,
    Rows,
    Successor,
    crosses_of,
    moments_of,
    packed,
    values_of,
)
from halfseen.shapes import Float


class QFunctions(NamedTuple):
    """Q of every stage (separate) or number of steps to go (pooled); index 0 is stage 1, or one step to go."""

    coefficients: Float[np.ndarray, "*B T K F"]
    """The intercept first."""
    reg: Float[np.ndarray, "*B T K"]
    """The λ used."""
    outcome: Float[np.ndarray, "*B T K M"] | None = None
    """For imputed targets, the regression of X on the features that it uses and the terms, the intercept first."""
    root: Float[np.ndarray, "*B T K F F"] | None = None
    """With pessimism, R: the standard error of Q is ‖Rᵀ (1, φ)‖."""


def stack_q(each: Sequence[QFunctions]) -> QFunctions:
    """Stack Q-functions along a new first axis."""
    columns: list[Any] = list(zip(*each, strict=True))
    stacked: list[Any] = [None if leaves[0] is None else np.stack(leaves) for leaves in columns]
    return QFunctions(*stacked)


SHRUNK_MEANS = 0.05
"""Fraction of λ that penalises the deviation of a block's mean from the common fit."""


class Step(NamedTuple):
    """One backward step."""

    slices: tuple[int, ...]
    """The slices of rows fitted."""
    successor: Successor | None = None
    """None at the last step."""
    centre: Float[np.ndarray, "K F"] | None = None
    """Coefficients to shrink towards, including those of control variates; None for 0."""
    new: tuple[int, ...] = ()
    """Slices whose moments have not been summed yet."""


class StepSums(NamedTuple):
    """Sums of rows for one step."""

    moments: tuple[Moments, ...]
    """Of the new slices."""
    crosses: Crosses
    columns: Columns
    norms: Norms | None = None
    """For the next step, if it uses the same states."""


def sums_of_step(rows: Rows, step: Step, regression: Regression, norms: Norms | None = None) -> StepSums:
    """Sum rows for one step, given norms of an earlier one."""
    values, norms = values_of(rows, step.successor, norms if regression.stages == "pooled" else None)
    moments = tuple(moments_of(rows, which, regression) for which in step.new)
    return StepSums(moments, crosses_of(rows, step.slices, values, regression), rows.columns, norms)


def fit_q(log: Transitions, regression: Regression) -> QFunctions:
    """Fit all Q-functions of a log in memory.

    Raises
    ------
    ArgumentError
        A trajectory is in a fold that does not exist, so it would be ignored.
    """
    return backward(_in_memory(log, regression), log.action.shape, regression)


def fit_each_stage(log: Transitions, regression: Regression) -> QFunctions:
    """Fit Q of each stage to its rewards alone, with no successor."""
    separate = regression._replace(stages="separate")
    steps = _Steps(_in_memory(log, separate), len(log.action), separate)
    return stack_q([steps.fit(Step((stage,)))[0] for stage in range(log.action.shape[1])])


def fit_to_values(log: Transitions, regression: Regression, others: QFunctions) -> QFunctions:
    """Fit pooled Q to targets with V̂ of other Q-functions, whose features are the first of those of the log."""
    steps = _Steps(_in_memory(log, regression), len(log.action), regression)
    lacking = log.features.shape[-1] + 1 - others.coefficients.shape[-1]
    padded = np.pad(others.coefficients, [(0, 0), (0, 0), (0, lacking)])
    return stack_q(_pooled(steps, log.action.shape[1], padded))


def _in_memory(log: Transitions, regression: Regression) -> Callable[[Step], StepSums]:
    largest = int(np.asarray(log.fold).max())
    if largest >= regression.num_folds:
        raise ArgumentError(
            f"fold {largest} of {regression.num_folds}: folds are 0 to {regression.num_folds - 1}; assign the "
            "trajectories to folds again"
        )
    rows, norms = packed(log, regression), None

    def ask(step: Step) -> StepSums:
        nonlocal norms
        sums = sums_of_step(rows, step, regression, norms)
        norms = sums.norms
        return sums

    return ask


def backward(ask: Callable[[Step], StepSums], shape: tuple[int, int], regression: Regression) -> QFunctions:
    """Run eq. 3.

    Parameters
    ----------
    ask
        Sums over all rows of the log.
    shape
        n and T.
    regression
        How each step is fitted.
    """
    num_trajectories, horizon = shape
    steps = _Steps(ask, num_trajectories, regression)
    return stack_q(_separate(steps, horizon) if regression.stages == "separate" else _pooled(steps, horizon))


def _separate(steps: "_Steps", horizon: int) -> list[QFunctions]:
    """Fit each stage on its own rows, the last one first."""
    fits, successor = [], None
    for stage in reversed(range(horizon)):
        q, _, errors = steps.fit(Step((stage,), successor))
        fits.insert(0, q)
        successor = Successor((stage,), q.coefficients, errors)
    return fits


def _pooled(steps: "_Steps", horizon: int, others: Float[np.ndarray, "T K F"] | None = None) -> list[QFunctions]:
    """Fit all stages' rows for each number of steps to go, from 0 if the horizon forces an action, else from 1.

    With coefficients of others, V̂ is theirs.
    """
    every, end_action = (GOING_ON, ENDED), steps.regression.end_action
    step = Step(every)
    if end_action is not None:
        q, coefficients, _ = steps.fit(step)
        block = int(steps.regression.block_of_action[end_action])
        centre = np.broadcast_to(coefficients[block], coefficients.shape)
        step = Step(every, Successor(every, q.coefficients, None, end_action), centre)
    fits = []
    for h in range(horizon):
        q, coefficients, errors = steps.fit(step)
        fits.append(q)
        following = Successor(every, q.coefficients, errors) if others is None else Successor(every, others[h], None)
        step = Step((GOING_ON,), following, coefficients)
    return fits


class _Equations(NamedTuple):
    """The normal equations of a step, factorised once for all targets."""

    moments: Moments
    main: Ridge
    common: Ridge | None
    """Of all blocks as one."""
    outcome: Ridge | None
    """Of X, where targets are imputed."""
    seen: Ridge | None
    """Of the completed stages, without folds, for pessimism."""


class _Steps:
    """The backward steps, one after the other."""

    def __init__(self, ask: Callable[[Step], StepSums], num_trajectories: int, regression: Regression) -> None:
        self.regression, self._ask, self._num_trajectories = regression, ask, num_trajectories
        self._moments: dict[int, Moments] = {}
        self._equations: dict[tuple[int, ...], _Equations] = {}
        self._common: Any = None
        self._offset = SHRUNK_MEANS if regression.is_partially_pooled else 0.0

    def fit(self, step: Step) -> tuple[QFunctions, Float[np.ndarray, "K F"], Errors | None]:
        """Fit Q of one step; also return all coefficients, control variates last, and the errors for pessimism."""
        new = tuple(which for which in step.slices if which not in self._moments)
        sums = self._ask(step._replace(new=new))
        if self.regression.stages == "separate":
            self._moments, self._equations = {}, {}
        self._moments |= dict(zip(new, sums.moments, strict=True))
        if step.slices not in self._equations:
            each = [self._moments[which] for which in step.slices]
            moments = reduce(partial(mapped, np.add), each)
            self._equations[step.slices] = self._factorised(moments, sums.columns)
        return self._solved(self._equations[step.slices], sums, step.centre)

    def _factorised(self, moments: Moments, columns: Columns) -> _Equations:
        regs, num_trajectories, is_scaled = self.regression.regs, self._num_trajectories, self.regression.is_scaled
        num_features, num_design, outcome, seen = columns.num_features, columns.num_design, None, None
        main = moments.of_matrix[WHOLE, :, :, :num_design, :num_design]
        if columns.is_used is not None:
            kept, used = _of_outcome(columns)
            gram = moments.of_matrix[OUTCOME][:, :, kept[:, None], kept] * used[:, None] * used
            outcome = ridge_of(with_prior(gram, columns.num_terms), regs, num_trajectories, is_scaled)
        if self.regression.pessimism > 0:
            gram = moments.of_matrix[SEEN, :, :, :num_features, :num_features]
            seen = ridge_of(gram.sum(axis=0, keepdims=True), regs, num_trajectories, is_scaled)
        common = None
        if self.regression.is_partially_pooled:
            common = ridge_of(main.sum(axis=1, keepdims=True), regs, num_trajectories, is_scaled)
        own = ridge_of(main, regs, num_trajectories, is_scaled, self._offset)
        return _Equations(moments, own, common, outcome, seen)

    def _solved(
        self, equations: _Equations, sums: StepSums, centre: Float[np.ndarray, "K F"] | None
    ) -> tuple[QFunctions, Float[np.ndarray, "K F"], Errors | None]:
        columns, crosses, moments = sums.columns, sums.crosses.of_matrix, equations.moments.of_matrix
        design, outcome = slice(columns.num_design), None
        cross = crosses[SHARE - 1][..., design]
        if equations.outcome is not None:
            kept, used = _of_outcome(columns)
            of_outcome = moments[OUTCOME][..., kept[:, None], kept] * used[:, None] * used
            outcome, _ = _around(equations.outcome, of_outcome, crosses[OUTCOME - 1][..., kept] * used, None)
            cross = cross + _of_imputed(moments, columns, outcome)
        gram = moments[WHOLE][..., design, design]
        if equations.common is not None:
            centre = self._centre_of(equations.common, gram, cross, centre)
        coefficients, reg = _around(equations.main, gram, cross, centre, self.regression.is_partially_pooled)
        q = QFunctions(coefficients[:, : columns.num_features], reg, outcome)
        if equations.seen is None:
            return q, coefficients, None
        gram = moments[SEEN][..., design, design].sum(axis=0)
        # Σ w (X − βᵀx)² of the completed stages.
        explained = 2.0 * crosses[SEEN - 1][..., design].sum(axis=0) - np.einsum("kfg,kg->kf", gram, coefficients)
        squares = np.maximum(sums.crosses.squares - np.sum(coefficients * explained, axis=-1), 0.0)
        penalty, counts = reg * self._num_trajectories, equations.moments.counts
        errors = standard_errors(equations.seen, penalty, squares, counts, self._offset)
        root = errors.root * errors.deviation[:, None, None]
        lowered = errors._replace(deviation=self.regression.pessimism * errors.deviation)
        return q._replace(root=root), coefficients, lowered

    def _centre_of(
        self,
        equations: Ridge,
        gram: Float[np.ndarray, "V K F F"],
        cross: Float[np.ndarray, "V K F"],
        centre: Float[np.ndarray, "K F"] | None,
    ) -> Float[np.ndarray, "K F"]:
        """The common fit of all blocks now, plus the deviation of each block in the step before."""
        of_all, together, before = gram.sum(axis=1, keepdims=True), cross.sum(axis=1, keepdims=True), self._common
        self._common, _ = _around(equations, of_all, together, None if centre is None else before)
        apart = np.zeros(cross.shape[1:]) if centre is None else centre - before
        return self._common + apart


def _around(
    ridge: Ridge,
    gram: Float[np.ndarray, "V K F F"],
    cross: Float[np.ndarray, "V K F"],
    centre: Float[np.ndarray, "K F"] | None,
    is_joint: bool = False,
) -> tuple[Float[np.ndarray, "K F"], Float[np.ndarray, " K"]]:
    """Regress, shrunk towards a centre; None for the mean, so that a constant in all rewards does not affect λ."""
    if centre is None:
        mass = gram[..., 0, 0].sum(axis=0)
        centre = np.zeros(cross.shape[1:])
        centre[:, 0] = cross[..., 0].sum(axis=0) / np.where(mass > 0, mass, 1.0)
    found, reg = solve(ridge, cross - np.einsum("vkfg,kg->vkf", gram, centre), is_joint)
    return centre + found, reg


def _of_outcome(columns: Columns) -> tuple[np.ndarray, Float[np.ndarray, " M"]]:
    """Columns of the regression of X, and 1 for each that it uses."""
    terms = np.arange(columns.num_design, columns.num_design + columns.num_terms)
    kept = np.concatenate([np.arange(columns.num_features), terms])
    return kept, np.concatenate([np.asarray(columns.is_used), np.ones(columns.num_terms)])


def _of_imputed(
    moments: Float[np.ndarray, "4 V K M M"], columns: Columns, outcome: Float[np.ndarray, "K O"]
) -> Float[np.ndarray, "V K F"]:
    """Σ w x Y − Σ w x share·X: the contribution of the regression of X to the targets, from state and time."""
    num_features, design = columns.num_features, slice(columns.num_design)
    of_state = (moments[WHOLE] - moments[SHARE])[..., design, :num_features]
    of_time = moments[WHOLE][..., design, columns.num_design + columns.num_terms :]
    by_state = np.einsum("vkfm,km->vkf", of_state, outcome[:, :num_features] * columns.is_used)
    return by_state + np.einsum("vkfg,kg->vkf", of_time, outcome[:, num_features:])
