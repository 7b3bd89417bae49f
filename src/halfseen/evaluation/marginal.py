"""Marginal importance weights: how much more often the policy visits a state than the log does.

Products of ratios over stages accumulate the noise of the history. If the future depends on the past through S_t alone,
only their mean given S_t matters, the ratio of the state distributions of policy and log [XieMaWang2019]_
[KallusUehara2020]_. Computing each stage's weight from the one before,

    w_t = min(ρ̄_t(S_t) π(A_t | S_t) / b(A_t | S_t), √n),
    ρ̄_1 = 1,  ρ̄_{t+1}(s) = E[w_t δ_t / K̂_t | S_{t+1} = s],  K̂_t = Ĝ(U_t⁻) / Ĝ(U_{t−1}⁻),

avoids such products. S_t contains all that the log records of a stage, whether or not Q̂ uses it, so weights may be
right where Q̂ is not. In the doubly robust value an error of ρ̄ is multiplied by one of Q̂. With products of ratios any
Q̂ is valid, and the history may matter beyond S_t. So if a log shows that it does, products are used without
truncation: Q̂ is then wrong, too, and truncation would leave its error uncorrected.

A weight above √n occurs for fewer than √n of n trajectories and is truncated there [Ionides2008]_: the resulting bias
is at most an error of Q̂ times the truncated weight, `Marginal.lost`.

*The mean weight in a state*, E[ω | S], is computed for several weightings of a log at once, each without a fold of its
own:

    m(s) = f(s) + Σ_c K_h(s − c) Σ_{i at c} (ω_i − f(S_i)) / Σ_c K_h(s − c) n_c,

a kernel regression [Nadaraya1964]_ [Watson1964]_ of the residuals of a first guess f, which is 0 or a linear ridge
regression. Rows are assigned to the nearest of a few places c, so the cost is linear in the length of a log. Among the
two guesses and several bandwidths h, up to one that includes all rows, the combination that best predicts the weights
of held-out trajectories is chosen. Weights are non-negative, and their mean is preserved: m is scaled to the sum of ω.

*Whether the history predicts the outcome of a stage* beyond its state and action: the residuals Y_t − Q̂_t of stages
from the second on, by a Q̂ fitted without the trajectory, and the history h_t = (A_{t−1}, φ(S_{t−1}), R_{t−1}) are both
made orthogonal to φ(S_t) and A_t, and should then be uncorrelated. With U_i = Σ_t h̃_it r̃_it,

    W = (Σ_i U_i)ᵀ (Σ_i U_i U_iᵀ)⁻¹ (Σ_i U_i)

is χ² with as many degrees of freedom as h has columns, whatever the dependence within a trajectory [LiangZeger1986]_.
It is converted to a normal deviate of equal probability [WilsonHilferty1931]_. This test needs far shorter logs than
the weights of the policy do, because every stage counts equally.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from halfseen.arrays import LEAST_RANGE
from halfseen.evaluation.weights import StageWeights, uncut_before
from halfseen.learning.covariates import Categories, Covariates, fit_covariates, learned_categories
from halfseen.learning.rows import TrajectoryArrays, stage_places
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int


def states_of(
    logs: Logs,
    trajectories: TrajectoryArrays,
    known: Categories,
    left_out: Sequence[str] = (),
    added: Sequence[str] = (),
) -> Float[np.ndarray, "n T F"]:
    """Arrange the usable covariates, less some and plus other columns, by stage; zeros where no stage began."""
    names = [name for name in fit_covariates(logs) if name not in left_out]
    looked_at = Covariates((*names, *added), learned_categories([logs], names, known))
    return laid_out(looked_at.encode(logs.stages), logs, trajectories)


def laid_out(rows: Float[np.ndarray, "m F"], logs: Logs, trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T F"]:
    """Arrange values of the rows of a log by stage; zeros elsewhere."""
    found = np.zeros((*trajectories.is_begun.shape, rows.shape[1]))
    found[stage_places(logs)] = rows
    return found


WIDTHS = (0.15, 0.3, 0.6, 1.2, np.inf)
"""Bandwidths h, in standard deviations of a covariate."""

MOST_PLACES = 200
"""If there are more distinct states, this number of them represents all."""

RIDGE = 1.0
"""Of the linear guess on standardised covariates: a prior worth one row."""


def mean_by_state(
    weight: Float[np.ndarray, "B m"], states: Sequence[Float[np.ndarray, "m _"]], is_fitted: Bool[np.ndarray, "B m"]
) -> Float[np.ndarray, "B m"]:
    """Compute m of every row, for each of B weightings.

    Parameters
    ----------
    weight
        ω of each row.
    states
        Covariates; of several sets of them, the one that best predicts the weights is chosen.
    is_fitted
        Rows to fit each weighting to; the form is chosen on the others.
    """
    each = [found for some in states for found in _forms(weight, standardised(some), is_fitted)]
    errors = [float(np.sum(np.where(is_fitted, 0.0, weight - found) ** 2)) for found in each]
    best = each[int(np.argmin(errors))]
    has, wanted = (np.where(is_fitted, one, 0.0).sum(axis=1, keepdims=True) for one in (best, weight))
    return np.where(has > 0, best * wanted / np.where(has > 0, has, 1.0), weight)


def standardised(states: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "m G"]:
    """Covariates that vary, with mean 0 and standard deviation 1."""
    spread = states.std(axis=0)
    differs = spread > LEAST_RANGE * np.abs(states).max(axis=0, initial=0.0)
    return (states[:, differs] - states[:, differs].mean(axis=0)) / spread[differs]


def _forms(
    weight: Float[np.ndarray, "B m"], scaled: Float[np.ndarray, "m F"], is_fitted: Bool[np.ndarray, "B m"]
) -> Iterator[Float[np.ndarray, "B m"]]:
    """Compute m for each guess and bandwidth, around all distinct places or a random sample of them."""
    places = np.unique(scaled, axis=0)
    if len(places) > MOST_PLACES:
        places = places[np.random.default_rng(0).choice(len(places), MOST_PLACES, replace=False)]
    lengths = (scaled**2).sum(axis=1)[:, None] + (places**2).sum(axis=1) - 2.0 * scaled @ places.T
    # Mean squared difference from each place, over covariates.
    squared = np.maximum(lengths, 0.0) / max(scaled.shape[1], 1)
    is_at = np.zeros(squared.shape)
    is_at[np.arange(len(is_at)), squared.argmin(axis=1)] = 1.0
    counts = is_fitted @ is_at
    for guess in (np.zeros_like(weight), linear(weight, scaled, is_fitted)):
        sums = np.where(is_fitted, weight - guess, 0.0) @ is_at
        mean = sums.sum(axis=1, keepdims=True) / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        for width in WIDTHS:
            kernel = np.exp(-squared / (2.0 * width**2))
            mass = counts @ kernel.T
            is_near = mass > 1e-9
            local = np.where(is_near, sums @ kernel.T / np.where(is_near, mass, 1.0), mean)
            yield np.maximum(guess + local, 0.0)


def linear(
    weight: Float[np.ndarray, "B m"], scaled: Float[np.ndarray, "m F"], is_fitted: Bool[np.ndarray, "B m"]
) -> Float[np.ndarray, "B m"]:
    """Predict weights by a linear function of covariates, with a ridge penalty on all but the constant."""
    design = np.column_stack([np.ones(len(scaled)), scaled])
    penalty = np.diag([1e-9, *[RIDGE] * scaled.shape[1]])
    gram = np.stack([design[fits].T @ design[fits] for fits in is_fitted]) + penalty
    cross = np.where(is_fitted, weight, 0.0) @ design
    return np.linalg.solve(gram, cross[..., None])[..., 0] @ design.T


CLEARLY = 3.72
"""Deviate above which states count as incomplete; chance exceeds it once in 10,000 logs."""

ROWS_PER_COLUMN = 5
"""With fewer stages per column, the effect of φ(S_t) is the same for all actions."""


def history_deviate(
    residual: Float[np.ndarray, "n T"],
    has_target: Bool[np.ndarray, "n T"],
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
) -> float:
    """W as a normal deviate; −∞ if no stage has a predecessor.

    Parameters
    ----------
    residual
        Y_t − Q̂_t, held out.
    has_target
        Stages that have one.
    trajectories
        The log.
    beyond
        Covariates of each stage that Q does not use.
    """
    trajectory, before = np.nonzero(has_target[:, 1:])
    if not len(trajectory):
        return -np.inf
    now, taken = before + 1, np.eye(trajectories.is_possible.shape[-1])
    states = np.concatenate([trajectories.features[:, :, 0], beyond], axis=2)
    known = _known(standardised(states[trajectory, now]), taken[trajectories.action[trajectory, now]])
    history = np.column_stack(
        [
            taken[trajectories.action[trajectory, before]][:, 1:],
            states[trajectory, before],
            trajectories.reward[trajectory, before],
        ]
    )
    columns = np.column_stack([history, residual[trajectory, now]])
    freed = columns - known @ np.linalg.lstsq(known, columns, rcond=1e-9)[0]
    # The columns of the history with remaining variance, scaled to standard deviation 1.
    spread, left = freed[:, :-1].std(axis=0), freed[:, -1]
    kept = spread > 1e-3 * np.maximum(history.std(axis=0), 1e-12)
    history = freed[:, :-1][:, kept] / spread[kept]
    score = np.zeros((trajectories.num_trajectories, history.shape[1]))
    np.add.at(score, trajectory, history * left[:, None])
    squared, freedom = wald(score)
    if freedom == 0:
        return -np.inf
    part = 2.0 / (9.0 * freedom)
    return float(((squared / freedom) ** (1.0 / 3.0) - (1.0 - part)) / np.sqrt(part))


def wald(score: Float[np.ndarray, "n H"]) -> tuple[float, int]:
    """W and its degrees of freedom: the number of directions in which scores vary."""
    if not score.shape[1]:
        return 0.0, 0
    spread, directions = np.linalg.eigh(score.T @ score)
    kept = spread > 1e-8 * spread.max()
    along = directions[:, kept].T @ score.sum(axis=0)
    return float(np.sum(along**2 / spread[kept])), int(kept.sum())


def _known(features: Float[np.ndarray, "m F"], taken: Float[np.ndarray, "m A"]) -> Float[np.ndarray, "m C"]:
    """A constant and φ(S_t) for each action, or φ(S_t) for all of them if there are few stages."""
    wide = np.column_stack([np.ones(len(features)), features])
    if taken.shape[1] * wide.shape[1] * ROWS_PER_COLUMN > len(features):
        return np.column_stack([taken, features])
    return (taken[:, :, None] * wide[:, None, :]).reshape(len(features), -1)


class Marginal(NamedTuple):
    """Marginal importance weights."""

    by_fold: tuple[StageWeights, ...]
    """Fitted without each fold, and last to all trajectories."""
    lost: float
    """Truncated weight in stages per trajectory, weighted as under the policy."""


def marginal_weights(
    single: Float[np.ndarray, "n T"],
    uncut: Float[np.ndarray, "B n T"],
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
    fold: Int[np.ndarray, " n"],
    is_imputed: bool,
) -> Marginal:
    """Compute w_t of the stages of a log.

    Parameters
    ----------
    single
        π/b of each stage alone; values for unknown actions are ignored.
    uncut
        δ_t / Ĝ(U_t⁻), fitted without each fold, and last to all trajectories.
    trajectories
        The log.
    beyond
        Covariates of each stage that Q does not use.
    fold
        Of each trajectory.
    is_imputed
        Whether stages that began have a target; otherwise completed ones, which weigh w_t / K̂_t.
    """
    known = trajectories.is_begun & trajectories.has_action
    is_fitted = fold != np.arange(len(uncut))[:, None]
    last, is_finished = trajectories.is_begun.sum(axis=1) - 1, trajectories.clocks.is_finished
    passed = _passed(uncut)
    weight, standing = np.zeros_like(uncut), np.zeros_like(uncut)
    by_state, ended, lost = np.ones(uncut.shape[:2]), np.zeros(uncut.shape[:2]), 0.0
    for t in range(single.shape[1]):
        whole = np.where(known[:, t], by_state * single[:, t], 0.0)
        begun = np.minimum(whole, np.sqrt(len(single)))
        completed = begun * passed[..., t]
        lost += float((whole - begun)[-1].mean())
        weight[..., t] = begun if is_imputed else completed
        standing[..., t] = np.where(trajectories.is_begun[:, t], weight[..., t], ended)
        ended = np.where(is_finished & (last == t), completed, ended)
        by_state = _next_by_state(completed, t + 1, trajectories, beyond, is_fitted)
    return Marginal(tuple(StageWeights(*each) for each in zip(weight, standing, strict=True)), lost)


def _next_by_state(
    completed: Float[np.ndarray, "B n"],
    stage: int,
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
    is_fitted: Bool[np.ndarray, "B n"],
) -> Float[np.ndarray, "B n"]:
    """ρ̄ of the states of a stage (from 0); 0 where it did not begin."""
    answer = np.zeros_like(completed)
    if stage < trajectories.action.shape[1] and trajectories.is_begun[:, stage].any():
        rows = np.flatnonzero(trajectories.is_begun[:, stage])
        looked_at, others = trajectories.features[rows, stage, 0], beyond[rows, stage]
        sets = [looked_at, np.column_stack([looked_at, others])] if others.shape[1] else [looked_at]
        answer[:, rows] = mean_by_state(completed[:, rows], sets, is_fitted[:, rows])
    return answer


def _passed(uncut: Float[np.ndarray, "B n T"]) -> Float[np.ndarray, "B n T"]:
    """δ_t / K̂_t, from the cumulative factors."""
    before = uncut_before(uncut)
    return np.where(before > 0, uncut / np.where(before > 0, before, 1.0), 0.0)
