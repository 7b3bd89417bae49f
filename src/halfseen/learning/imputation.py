"""Pseudo-outcomes for right-censored stages: doubly robust, or by Buckley and James.

Write X = R_t + V̂(S_{t+1}) for the target of eq. 3, D for the duration of the stage, and m(u) = E[X | S_t, A_t, D ≥ u]
for the expected target of a stage that is still going at age u. Both ways replace X by a pseudo-outcome Y that every
begun stage has.

*Doubly robust* (AIPCW) [Robins1992]_: with K̂ the probability that the stage is not cut before an age, given that it
began,

    Y = δ X / K̂(D⁻) + (1 − δ) m(c) / K̂(c) − ∫_0^{min(D, c)} m(u) d(1/K̂(u)),

for a cut at age c. The last two terms have mean 0 if K̂ is right, whatever m is; and E[Y | S_t, A_t] = E[X | S_t, A_t]
if m is right, whatever K̂ is. m is a step function of the age, so the integral is a sum without error.

*Buckley–James* [BuckleyJames1979]_: Y = X where it was observed, m(c) where the stage was cut at c. No K̂ is needed; m
must be right.

m comes from two regressions, on the completed stages: of X on φ(S_t, A_t) and terms g(D) of the duration, a spline of
few bends, by block and anew at each step of eq. 3 (`recursion`); and of D on φ and t, by proportional hazards with a
baseline for each block, which says what g(D) is to be expected. A stage that is completed is not a fair draw of all,
but given its duration it is, if cuts depend on (S_t, A_t) alone; so a regression that is right needs no weights. One
that is a little wrong had better be wrong where stages are short: for doubly robust targets each stage weighs
δ/K̂(D⁻), truncated.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.censoring import CutModel
from halfseen.censoring.stage_clocks import SMALLEST_AGE_S
from halfseen.errors import ArgumentError
from halfseen.learning.durations import DurationModel, duration_features, duration_terms
from halfseen.learning.path_arrays import PathArrays
from halfseen.learning.transitions import Imputation

LARGEST_OUTCOME_WEIGHT = 3.0
"""Of a completed stage in the regression of X: it weighs δ/K̂, up to this."""

SMALLEST_PROBABILITY = 1e-12


def imputation(
    paths: PathArrays,
    cut_model: CutModel | None,
    is_used: Float[np.ndarray, " F"],
    block_of_action: Int[np.ndarray, " A"],
    durations: DurationModel,
) -> Imputation:
    """Work out what `recursion` needs to make Y of X.

    Parameters
    ----------
    paths
        The log, or a part of it.
    cut_model
        Ĝ, for doubly robust targets; None for those of Buckley and James.
    is_used
        1 for each feature of the taken action that m may look at, 0 for the others.
    block_of_action
        Which block of coefficients each action uses.
    durations
        D of every block.

    Raises
    ------
    ArgumentError
        The action of a stage in which a path was cut was not logged.
    """
    _refuse_unknown_actions(paths, cut_model)
    features, knots = duration_features(paths, is_used), durations.knots
    watched_s, is_completed = paths.clocks.watched_s, paths.is_completed
    expected, share = np.zeros((*paths.action.shape, len(knots))), is_completed.astype(np.float64)
    blocks = block_of_action[paths.action]
    augmented = None if cut_model is None else _augmentation(paths, cut_model, durations.ages_s)
    for block, of_block in enumerate(durations.by_block):
        rows = paths.is_begun & (blocks == block)
        if not rows.any():
            continue
        terms = duration_terms(of_block.at_s, knots)
        if augmented is None:
            cut = rows & ~is_completed
            expected[cut] = of_block.expected(features[cut], watched_s[cut][:, None], terms)[:, 0]
        else:
            share[rows], steps = augmented.share[rows], augmented.steps[rows]
            ages = np.broadcast_to(augmented.age_s, steps.shape)
            expected[rows] = np.einsum("kl,klg->kg", steps, of_block.expected(features[rows], ages, terms))
    return Imputation(
        share=share,
        terms=np.where(is_completed[..., None], duration_terms(watched_s, knots), 0.0),
        expected=expected,
        outcome_weight=np.where(is_completed, np.minimum(share, LARGEST_OUTCOME_WEIGHT), 0.0),
        is_used=is_used,
    )


class _Augmentation(NamedTuple):
    share: Float[np.ndarray, "n T"]
    """δ/K̂(D⁻) of each begun stage."""
    steps: Float[np.ndarray, "n T L"]
    """What m is multiplied by, for each step of the age."""
    age_s: Float[np.ndarray, " L"]
    """In the middle of each step."""


def _augmentation(paths: PathArrays, cut_model: CutModel, ages: Float[np.ndarray, " L"]) -> _Augmentation:
    """What depends on K̂ alone: the share of X, and the weights of the sums over m."""
    clocks, rows = paths.clocks, paths.is_begun
    ended_s, is_completed = clocks.watched_s, paths.is_completed
    ages = np.concatenate([[0.0], ages[:-1], [np.inf]])
    middle = np.append((ages[:-2] + ages[1:-1]) / 2.0, ages[-2])
    # A stage that was cut at c was at risk until just after c. Where K̂ falls to 0 with the last cut itself, the nearest
    # that can be divided by is just before; ages are rounded.
    at_risk_s = np.where(is_completed, ended_s, ended_s + 2.0 * SMALLEST_AGE_S)
    before_cut_s = np.maximum(ended_s - SMALLEST_AGE_S, 0.0)
    asked_s = np.concatenate([np.minimum(ages, at_risk_s[..., None]), before_cut_s[..., None]], axis=-1)
    weights = cut_model.weights(clocks)
    begun = np.concatenate([np.ones((len(weights), 1)), weights[:, :-1]], axis=1)
    within = _truncated(cut_model.survival(clocks, asked_s, rows), begun, cut_model.truncate_at)
    share = np.where(is_completed, weights / np.where(rows, begun, 1.0), 0.0)
    most = np.where(is_completed, share, 1.0 / np.maximum(within[..., -1], SMALLEST_PROBABILITY))
    least = np.where(within[..., :-1] > 0, within[..., :-1], 1.0 / most[..., None])
    inverse = np.minimum(1.0 / least, np.where(is_completed, most, np.inf)[..., None])
    inverse[..., -1] = np.where(is_completed, share, inverse[..., -1])
    steps = -np.diff(inverse, axis=-1)
    cut_in = (np.searchsorted(ages, ended_s, side="right") - 1)[..., None]
    at_cut = np.take_along_axis(steps, cut_in, axis=-1) + np.where(is_completed, 0.0, inverse[..., -1])[..., None]
    np.put_along_axis(steps, cut_in, at_cut, axis=-1)
    return _Augmentation(share, np.where(rows[..., None], steps, 0.0), middle)


def _truncated(
    within: Float[np.ndarray, "n T L"], begun: Float[np.ndarray, "n T"], truncate_at: float | int | None
) -> Float[np.ndarray, "n T L"]:
    """K̂, with Ĝ nowhere below the bound that weights are truncated at; `begun` is 1/Ĝ as each stage begins."""
    if truncate_at is None:
        return within
    inverse = np.maximum(begun, 1.0)[..., None]
    return np.maximum(within, inverse / truncate_at)


def _refuse_unknown_actions(paths: PathArrays, cut_model: CutModel | None) -> None:
    unknown = paths.is_begun & ~paths.has_action
    if unknown.any():
        path, stage = np.argwhere(unknown)[0]
        kind = "buckley-james" if cut_model is None else "doubly robust"
        raise ArgumentError(
            f"path {paths.path_ids[path]}, stage {stage + 1}: its action is null, and {kind} learning needs the "
            "action of the stage in which a path was cut; log it when the stage begins, or use weights alone"
        )
