"""Pseudo-outcomes for right-censored stages: doubly robust, or by Buckley and James.

Write X = R_t + V̂(S_{t+1}) for the target of eq. 3, D for the duration of the stage, and m(u) = E[X | S_t, A_t, D ≥ u]
for the expected target of a stage still in progress at age u. Both methods replace X by a pseudo-outcome Y, defined for
every stage that began.

*Doubly robust* (AIPCW) [Robins1992]_: with K̂ the probability that the stage, given that it began, is not cut before an
age,

    Y = δ X / K̂(D⁻) + (1 − δ) m(c) / K̂(c) − ∫_0^{min(D, c)} m(u) d(1/K̂(u)),

for a cut at age c. The last two terms have mean 0 if K̂ is right, whatever m is; and E[Y | S_t, A_t] = E[X | S_t, A_t]
if m is right, whatever K̂ is. m is a step function of the age, so the integral is an exact sum.

*Buckley–James* [BuckleyJames1979]_: Y = X if it was observed, and m(c) if the stage was cut at c. No K̂ is needed; m
must be right.

m comes from two regressions on the completed stages. The first is of X on φ(S_t, A_t) and terms g(D) of the duration, a
spline with few knots, by block and again at each step of eq. 3 (`recursion`). The second is of D on φ and t, by
proportional hazards with a baseline for each block; it gives the expected g(D). Completed stages are not a random
sample of all stages, but given their durations they are, if cuts depend on (S_t, A_t) alone. So a correct regression
needs no weights. A slightly misspecified one should err where stages are short: for doubly robust targets each stage
has the truncated weight δ/K̂(D⁻).
"""

from dataclasses import dataclass

import numpy as np

from halfseen.censoring import Cox, CutModel
from halfseen.censoring.clocks import SMALLEST_AGE_S
from halfseen.errors import ArgumentError
from halfseen.learning.rows import Imputation, TrajectoryArrays
from halfseen.shapes import Bool, Float, Int

NUM_AGES = 24
"""Steps of m, between quantiles of the ages at which stages ended."""

NUM_DURATIONS = 96
"""Largest number of durations in the support of D."""

KNOTS = (0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 1.0)
"""Quantiles of D at which the slope of its effect on X may change; beyond the last one the effect is constant."""

DURATION_RIDGE = 1.0
"""Penalty of the proportional hazards of D: a prior of one event, so that separation does not diverge."""


@dataclass(frozen=True)
class Durations:
    """The distribution of D given (S_t, A_t), on few durations."""

    model: Cox | None
    """Proportional hazards; None if no covariate varies."""
    columns: np.ndarray
    """Columns of the features that it uses."""
    at_s: Float[np.ndarray, " J"]
    """Durations that carry mass, increasing [s]."""
    hazard: Float[np.ndarray, " J"]
    """Cumulative hazard just after each duration, at the mean features."""

    def expected(
        self, features: Float[np.ndarray, "k P"], age_s: Float[np.ndarray, "k L"], terms: Float[np.ndarray, "J G"]
    ) -> Float[np.ndarray, "k L G"]:
        """E[g(D) | D > age] of each row, for several ages; `terms` holds g of each duration."""
        ratio = np.ones(len(features))
        if self.model is not None:
            score = (features[:, self.columns] - self.model.means_) @ self.model.coefficients_
            ratio = np.exp(np.clip(score, -50.0, 50.0))
        # Everything that survives the last duration ends there, so the mass sums to 1.
        survival = np.exp(-ratio[:, None] * np.concatenate([[0.0], self.hazard[:-1], [np.inf]]))
        mass = -np.diff(survival, axis=1)
        later = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1]
        first = np.minimum(np.searchsorted(self.at_s, age_s, side="right"), len(self.at_s) - 1)
        row = np.arange(len(features))[:, None]
        answer = np.empty((*age_s.shape, terms.shape[1]))
        for g in range(terms.shape[1]):
            sums = np.cumsum((mass * terms[:, g])[:, ::-1], axis=1)[:, ::-1]
            known = later[row, first]
            answer[..., g] = np.where(known > 1e-300, sums[row, first] / np.maximum(known, 1e-300), terms[first, g])
        return answer


def fit_durations(
    watched_s: Float[np.ndarray, " k"], is_completed: Bool[np.ndarray, " k"], features: Float[np.ndarray, "k P"]
) -> Durations:
    """Fit D to stages, each observed until it was completed or cut [s], by features that D may depend on."""
    # Here completion is the event, and it precedes a cut at the same time. Only the order matters.
    distinct, rank = np.unique(watched_s, return_inverse=True)
    ends = rank + np.where(is_completed, 1.0, 1.5)
    columns = np.flatnonzero(np.ptp(features, axis=0) > 0)
    if len(columns):
        model = Cox(ridge=DURATION_RIDGE).fit(ends, ~is_completed, features[:, columns])
        times, hazard = model.times_, model.cumulative_hazard_
    else:
        model = None
        times, events = np.unique(ends[is_completed], return_counts=True)
        at_risk = len(ends) - np.searchsorted(np.sort(ends), times)
        with np.errstate(divide="ignore"):
            hazard = np.cumsum(-np.log1p(-events / at_risk))
    kept = np.unique(np.linspace(0, len(times) - 1, min(NUM_DURATIONS, len(times))).astype(int))
    return Durations(model, columns, distinct[times[kept].astype(int) - 1], hazard[kept])


@dataclass(frozen=True)
class DurationModel:
    """D of every block."""

    knots: Float[np.ndarray, " G"]
    """Knots of g(D) [s]; tied durations give equal knots, so their number is the same for every log."""
    ages_s: Float[np.ndarray, " L"]
    """Quantiles of the ages at which stages ended, increasing [s]."""
    by_block: tuple[Durations, ...]
    """Of each block, or of all together for a block without a completed stage. Empty if no stage was completed."""


def fit_duration_model(
    trajectories: TrajectoryArrays,
    is_used: Float[np.ndarray, " F"],
    block_of_action: Int[np.ndarray, " A"],
    is_fitted: Bool[np.ndarray, " n"] | None = None,
) -> DurationModel:
    """Fit D to the stages of a log.

    Parameters
    ----------
    trajectories
        The log.
    is_used
        1 for each feature of the taken action that D may depend on, 0 for the others.
    block_of_action
        Block of each action.
    is_fitted
        Trajectories that D is fitted to; knots and steps use all. None for all.
    """
    watched_s, is_completed = trajectories.clocks.watched_s, trajectories.is_completed
    knots = np.quantile(watched_s[is_completed], KNOTS)
    ages = np.unique(np.quantile(watched_s[trajectories.is_begun], np.linspace(0.0, 1.0, NUM_AGES + 1)))
    features, blocks = duration_features(trajectories, is_used), block_of_action[trajectories.action]
    fitted = trajectories.is_begun if is_fitted is None else trajectories.is_begun & is_fitted[:, None]

    def fit(rows: Bool[np.ndarray, "n T"]) -> Durations:
        return fit_durations(watched_s[rows], is_completed[rows], features[rows])

    if not (fitted & is_completed).any():
        return DurationModel(knots, ages, ())
    own = [fitted & (blocks == block) for block in range(int(block_of_action.max()) + 1)]
    is_known = [bool((rows & is_completed).any()) for rows in own]
    of_all = [] if all(is_known) else [fit(fitted)]
    each = tuple(fit(rows) if known else of_all[0] for rows, known in zip(own, is_known, strict=True))
    return DurationModel(knots, ages, each)


def duration_terms(duration_s: Float[np.ndarray, "*S"], knots: Float[np.ndarray, " k"]) -> Float[np.ndarray, "*S k"]:
    """g(D): the duration up to the last knot, and the excess over each other knot, divided by the distance to the next.

    So a coefficient is the gain in X between two knots, and its prior (`with_prior`) is worth about the noise of one
    stage. Without the prior, an action whose stages all end just beyond a knot has a slope determined by two of them,
    along which stages that were cut late would be extrapolated.
    """
    begin, length = np.concatenate([[0.0], knots[:-1]]), np.diff(knots, prepend=0.0)
    beyond = np.maximum(np.minimum(duration_s, knots[-1])[..., None] - begin, 0.0)
    # Tied durations give equal knots: no distance to the next one, and no change of slope.
    return beyond / np.where(length > 0, length, np.inf)


def duration_features(trajectories: TrajectoryArrays, is_used: Float[np.ndarray, " F"]) -> Float[np.ndarray, "n T P"]:
    """Features of the action taken, and the stage."""
    stage = np.broadcast_to(np.arange(trajectories.action.shape[1], dtype=np.float64), trajectories.action.shape)
    return np.concatenate([trajectories.encoded.taken * is_used, stage[..., None]], axis=-1)


LARGEST_OUTCOME_WEIGHT = 3.0
"""Upper bound of the weight δ/K̂ of a completed stage in the regression of X."""

SMALLEST_PROBABILITY = 1e-12


def imputation(
    trajectories: TrajectoryArrays,
    cut_model: CutModel | None,
    is_used: Float[np.ndarray, " F"],
    block_of_action: Int[np.ndarray, " A"],
    durations: DurationModel,
) -> Imputation:
    """Compute what `recursion` needs to replace X by Y.

    Parameters
    ----------
    trajectories
        The log, or a part of it.
    cut_model
        Ĝ, for doubly robust targets; None for Buckley–James.
    is_used
        1 for each feature of the taken action that m may use, 0 for the others.
    block_of_action
        Block of coefficients of each action.
    durations
        D of every block.
    """
    _refuse_unknown_actions(trajectories, cut_model)
    features, knots, blocks = (
        duration_features(trajectories, is_used),
        durations.knots,
        block_of_action[trajectories.action],
    )
    watched_s, is_completed = trajectories.clocks.watched_s, trajectories.is_completed
    expected, share = np.zeros((*trajectories.action.shape, len(knots))), is_completed.astype(np.float64)
    # m has full weight where a stage was cut and, without K̂, weight 0 elsewhere.
    rows, steps, ages = trajectories.is_begun & ~is_completed, np.ones((*share.shape, 1)), watched_s[..., None]
    if cut_model is not None:
        rows, (share, steps, ages) = trajectories.is_begun, _augmentation(trajectories, cut_model, durations.ages_s)
    ages = np.broadcast_to(ages, steps.shape)
    for block, of_block in enumerate(durations.by_block):
        own = rows & (blocks == block)
        if own.any():
            of_age = of_block.expected(features[own], ages[own], duration_terms(of_block.at_s, knots))
            expected[own] = np.einsum("kl,klg->kg", steps[own], of_age)
    return Imputation(
        share=share,
        terms=np.where(is_completed[..., None], duration_terms(watched_s, knots), 0.0),
        expected=expected,
        outcome_weight=np.where(is_completed, np.minimum(share, LARGEST_OUTCOME_WEIGHT), 0.0),
        is_used=is_used,
    )


def _augmentation(
    trajectories: TrajectoryArrays, cut_model: CutModel, ages: Float[np.ndarray, " L"]
) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T L"], Float[np.ndarray, " L"]]:
    """The terms that depend on K̂ alone: the share δ/K̂(D⁻) of X, and the factor of m amid each age step."""
    clocks, rows = trajectories.clocks, trajectories.is_begun
    ended_s, is_completed = clocks.watched_s, trajectories.is_completed
    ages = np.concatenate([[0.0], ages[:-1], [np.inf]])
    middle = np.append((ages[:-2] + ages[1:-1]) / 2.0, ages[-2])
    # A stage cut at c was at risk until just after c. If K̂ falls to 0 at the last cut itself, divide by its value just
    # before; ages are rounded.
    at_risk_s = np.where(is_completed, ended_s, ended_s + 2.0 * SMALLEST_AGE_S)
    before_cut_s = np.maximum(ended_s - SMALLEST_AGE_S, 0.0)
    asked_s = np.concatenate([np.minimum(ages, at_risk_s[..., None]), before_cut_s[..., None]], axis=-1)
    weights, within = cut_model.weights(clocks), cut_model.survival(clocks, asked_s, rows)
    begun = np.concatenate([np.ones((len(weights), 1)), weights[:, :-1]], axis=1)
    if cut_model.truncate_at is not None:
        # Ĝ is never below the bound at which weights are truncated.
        within = np.maximum(within, np.maximum(begun, 1.0)[..., None] / cut_model.truncate_at)
    share = np.where(is_completed, weights / np.where(rows, begun, 1.0), 0.0)
    most = np.where(is_completed, share, 1.0 / np.maximum(within[..., -1], SMALLEST_PROBABILITY))
    least = np.where(within[..., :-1] > 0, within[..., :-1], 1.0 / most[..., None])
    inverse = np.minimum(1.0 / least, np.where(is_completed, most, np.inf)[..., None])
    inverse[..., -1] = np.where(is_completed, share, inverse[..., -1])
    steps = -np.diff(inverse, axis=-1)
    cut_in = (np.searchsorted(ages, ended_s, side="right") - 1)[..., None]
    at_cut = np.take_along_axis(steps, cut_in, axis=-1) + np.where(is_completed, 0.0, inverse[..., -1])[..., None]
    np.put_along_axis(steps, cut_in, at_cut, axis=-1)
    return share, np.where(rows[..., None], steps, 0.0), middle


def _refuse_unknown_actions(trajectories: TrajectoryArrays, cut_model: CutModel | None) -> None:
    unknown = trajectories.is_begun & ~trajectories.has_action
    if unknown.any():
        trajectory, stage = np.argwhere(unknown)[0]
        kind = "buckley-james" if cut_model is None else "doubly robust"
        raise ArgumentError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: its action is null, and {kind} "
            "learning needs the action of the stage in which a trajectory was cut; log it when the stage begins, or "
            "use weights alone"
        )
