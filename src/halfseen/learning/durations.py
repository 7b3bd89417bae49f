"""How long a stage lasts given (S_t, A_t), and the terms g(D) by which its target may bend with that.

D is fitted by proportional hazards, with a baseline for each block, on the stages that began, of which some were cut.
What bends and where the age of a stage steps are quantiles; all of it can be fitted to some paths, and serve others.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.censoring import Cox
from halfseen.learning.path_arrays import PathArrays

NUM_AGES = 24
"""Steps of m: between quantiles of the ages at which stages ended."""

NUM_DURATIONS = 96
"""Durations that the distribution of D is put on, at most."""

KNOTS = (0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 1.0)
"""Quantiles of D at which its effect on X may bend; beyond the longest it stays what it was."""

DURATION_RIDGE = 1.0
"""Penalty of the proportional hazards of D: a prior of one event, so that separation has an end."""


@dataclass(frozen=True)
class Durations:
    """The distribution of D given (S_t, A_t), on few durations.

    Parameters
    ----------
    model
        Proportional hazards; None where no covariate tells stages apart.
    columns
        Columns of the features that it uses.
    at_s
        Durations that carry mass, increasing [s].
    hazard
        Cumulative hazard just after each of them, at the mean features.
    """

    model: Cox | None
    columns: np.ndarray
    at_s: Float[np.ndarray, " J"]
    hazard: Float[np.ndarray, " J"]

    def expected(
        self, features: Float[np.ndarray, "k P"], age_s: Float[np.ndarray, "k L"], terms: Float[np.ndarray, "J G"]
    ) -> Float[np.ndarray, "k L G"]:
        """E[g(D) | D > age] of each row, for several ages; `terms` holds g of each duration."""
        ratio = np.ones(len(features))
        if self.model is not None:
            score = (features[:, self.columns] - self.model.means_) @ self.model.coefficients_
            ratio = np.exp(np.clip(score, -50.0, 50.0))
        # What outlives the last duration ends there: the mass adds up to 1.
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
    """Fit D to begun stages, of which some were cut.

    Parameters
    ----------
    watched_s
        Until the stage was completed or cut [s].
    is_completed
        False where it was cut.
    features
        What D may depend on.
    """
    # Here completion is the event, and at equal times it comes before the cut.
    ends = np.where(is_completed, watched_s, np.nextafter(watched_s, np.inf))
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
    return Durations(model, columns, times[kept], hazard[kept])


@dataclass(frozen=True)
class DurationModel:
    """D of every block.

    Parameters
    ----------
    knots
        Where g(D) bends [s]; those of tied durations tie, so every log has as many.
    ages_s
        Quantiles of the ages at which stages ended, increasing [s].
    by_block
        Of each block; of all together for a block that was never seen to end. Empty where nothing was.
    """

    knots: Float[np.ndarray, " G"]
    ages_s: Float[np.ndarray, " L"]
    by_block: tuple[Durations, ...]


def fit_duration_model(
    paths: PathArrays,
    is_used: Float[np.ndarray, " F"],
    block_of_action: Int[np.ndarray, " A"],
    is_fitted: Bool[np.ndarray, " n"] | None = None,
) -> DurationModel:
    """Fit D to the stages of a log.

    Parameters
    ----------
    paths
        The log.
    is_used
        1 for each feature of the taken action that D may depend on, 0 for the others.
    block_of_action
        Block of each action.
    is_fitted
        Paths that D is fitted to, which bends and steps do not depend on; None for all.
    """
    watched_s, is_completed = paths.clocks.watched_s, paths.is_completed
    knots = np.quantile(watched_s[is_completed], KNOTS)
    ages = np.unique(np.quantile(watched_s[paths.is_begun], np.linspace(0.0, 1.0, NUM_AGES + 1)))
    features, blocks = duration_features(paths, is_used), block_of_action[paths.action]
    fitted = paths.is_begun if is_fitted is None else paths.is_begun & is_fitted[:, None]

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
    """g(D): the duration up to the last knot, and how far it is beyond each other one, by the way to the next knot.

    So a coefficient is what X gains by a bend before the next one comes, and is weighed against a prior (`with_prior`)
    of about the noise of one stage. Without it, an action whose stages all end just beyond a knot has a slope that two
    of them decide, and that those which were cut late would be valued along.
    """
    begin, length = np.concatenate([[0.0], knots[:-1]]), np.diff(knots, prepend=0.0)
    beyond = np.maximum(np.minimum(duration_s, knots[-1])[..., None] - begin, 0.0)
    # Knots of tied durations are one and the same: no way from one to the next, and no bend.
    return beyond / np.where(length > 0, length, np.inf)


def duration_features(paths: PathArrays, is_used: Float[np.ndarray, " F"]) -> Float[np.ndarray, "n T P"]:
    """Features of the action that was taken, and the stage."""
    stage = np.broadcast_to(np.arange(paths.action.shape[1], dtype=np.float64), paths.action.shape)
    return np.concatenate([paths.encoded.taken * is_used, stage[..., None]], axis=-1)
