"""One backward step of eq. 3 as sums over the rows of a part, which those of all parts add up to.

An imputed target Y is linear in the coefficients of the regression of X (see `transitions.Imputation`), which are known
only once all parts were read. So Σ w x Y is kept as what it is of the share of X, and what it is for each coefficient.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.learning.rows import Rows
from halfseen.learning.spread import WeightSums


class Bound(NamedTuple):
    """How far Q is lowered (see `spread`): by ‖Rᵀ (1, φ)‖ of each block, times `margin`."""

    root: Float[np.ndarray, "K F F"]
    margin: Float[np.ndarray, " K"]


class Successor(NamedTuple):
    """What V̂(S_{t+1}) is made of."""

    slices: tuple[int, ...]
    """Those that hold S_{t+1}."""
    coefficients: Float[np.ndarray, "K F"]
    bound: Bound | None
    forced: int | None = None
    """The action that is taken, whatever Q says: the one that the horizon forces upon a path."""


class Step(NamedTuple):
    """One backward step."""

    slices: tuple[int, ...]
    """Those that are fitted."""
    successor: Successor | None
    """None where nothing follows."""
    centre: Float[np.ndarray, "K F"] | None
    """What coefficients are shrunk towards, those of control variates among them; None for 0."""


class Shape(NamedTuple):
    """Of the sums."""

    num_folds: int
    num_blocks: int
    is_pessimistic: bool


class OutcomeGrams(NamedTuple):
    """Of imputed targets: the regression of X, and how Σ w x Y depends on its coefficients."""

    gram: Float[np.ndarray, "V K M M"]
    of_state: Float[np.ndarray, "V K F M1"]
    """Σ w x (1 − share) xᵀ, for the coefficients of the features."""
    of_time: Float[np.ndarray, "V K F G"]
    """Σ w x expectedᵀ, for those of the terms."""


class SeenGrams(NamedTuple):
    """Of the completed stages, for pessimism."""

    gram: Float[np.ndarray, "K F F"]
    weights: WeightSums


class Grams(NamedTuple):
    """Sums that no target changes."""

    main: Float[np.ndarray, "V K F F"]
    outcome: OutcomeGrams | None
    seen: SeenGrams | None


class SeenCrosses(NamedTuple):
    """Of the completed stages: Σ w x X and Σ w X²."""

    cross: Float[np.ndarray, "K F"]
    square: Float[np.ndarray, " K"]


class Crosses(NamedTuple):
    """Sums that depend on the targets X."""

    main: Float[np.ndarray, "V K F"]
    """Of X, or of its share in imputed targets, less what the centre says."""
    outcome: Float[np.ndarray, "V K M"] | None
    seen: SeenCrosses | None


class _Weights(NamedTuple):
    """What rows weigh in each sum."""

    main: Float[np.ndarray, " R"]
    of_state: Float[np.ndarray, " R"]
    seen: Float[np.ndarray, " R"]
    outcome: Float[np.ndarray, " R"]


def _weights(rows: Rows) -> _Weights:
    weight = rows.weight
    if rows.share is None or rows.outcome_weight is None:
        return _Weights(weight, weight, weight, weight)
    of_outcome = np.where(weight > 0, rows.outcome_weight, 0.0)
    return _Weights(weight, weight * (1.0 - rows.share), weight * rows.outcome_weight, of_outcome)


def grams_of(rows: Rows, slices: tuple[int, ...], shape: Shape) -> Grams:
    """Sum up what no target changes over the rows of some slices.

    Parameters
    ----------
    rows
        A part of the log.
    slices
        Which.
    shape
        Of the sums.
    """
    weights, width = _weights(rows), rows.matrix.shape[1]
    moments = np.zeros((len(weights), shape.num_folds, shape.num_blocks, width, width))
    sums = np.zeros((3, shape.num_blocks))
    for which, fold, block, begin, end in rows.groups:
        if which in slices:
            for each, found in _moments(rows.matrix[begin:end], [weight[begin:end] for weight in weights]):
                moments[each, fold, block] += found
            seen = weights.seen[begin:end]
            sums[:, block] += seen.sum(), seen @ seen, np.count_nonzero(seen)
    num_features, num_variates, num_terms, _ = rows.widths
    num_design = num_features + num_variates
    terms = slice(num_design, num_design + num_terms)
    main, seen = moments[0, :, :, :num_design, :num_design], None
    if shape.is_pessimistic:
        seen = SeenGrams(moments[2, :, :, :num_design, :num_design].sum(axis=0), WeightSums(*sums))
    if rows.is_used is None:
        return Grams(main, None, seen)
    is_outcome = np.r_[:num_features, terms]
    used = np.concatenate([rows.is_used, np.ones(num_terms)])
    outcome = OutcomeGrams(
        gram=moments[3][:, :, is_outcome[:, None], is_outcome] * used[:, None] * used,
        of_state=moments[1, :, :, :num_design, :num_features] * rows.is_used,
        of_time=moments[0, :, :, :num_design, terms.stop :],
    )
    return Grams(main, outcome, seen)


def _moments(
    matrix: Float[np.ndarray, "r M"], weights: list[Float[np.ndarray, " r"]]
) -> Iterator[tuple[list[int], Float[np.ndarray, "M M"]]]:
    """Σ w z zᵀ for several weights: those that are the same are summed once, and those that are 0 not at all."""
    left = [number for number, weight in enumerate(weights) if weight.any()]
    while left:
        weight = weights[left[0]]
        same = [number for number in left if (weights[number] == weight).all()]
        weighted = matrix if (weight == 1.0).all() else matrix * weight[:, None]
        yield same, matrix.T @ weighted
        left = [number for number in left if number not in same]


def crosses_of(rows: Rows, step: Step, values: Float[np.ndarray, " R1"], shape: Shape) -> Crosses:
    """Sum up what depends on the targets over the rows of a step.

    Parameters
    ----------
    rows
        A part of the log.
    step
        The step.
    values
        V̂ of the state of every row, and 0.
    shape
        Of the sums.
    """
    weights, num_design = _weights(rows), int(rows.widths[:2].sum())
    width = int(rows.widths[:3].sum())
    sums = np.zeros((shape.num_folds, shape.num_blocks, width, 3))
    squares = np.zeros(shape.num_blocks)
    for which, fold, block, begin, end in rows.groups:
        if which not in step.slices:
            continue
        group = slice(begin, end)
        target = rows.reward[group] + values[rows.after[group]]
        of_share = target if rows.share is None else rows.share[group] * target
        if step.centre is not None:
            of_share = of_share - rows.design[group] @ step.centre[block]
        of_seen = weights.seen[group] * target
        each = np.array([weights.main[group] * of_share, weights.outcome[group] * target, of_seen]).T
        sums[fold, block] += rows.matrix[group, :width].T @ each
        squares[block] += of_seen @ target
    seen = SeenCrosses(sums[:, :, :num_design, 2].sum(axis=0), squares) if shape.is_pessimistic else None
    if rows.is_used is None:
        return Crosses(sums[:, :, :num_design, 0], None, seen)
    of_terms = slice(num_design, width)
    outcome = np.concatenate([sums[:, :, : rows.widths[0], 1] * rows.is_used, sums[:, :, of_terms, 1]], axis=-1)
    return Crosses(sums[:, :, :num_design, 0], outcome, seen)


def plus(one: Any, other: Any) -> Any:
    """Add up the sums of two parts; None is nothing yet."""
    if one is None or other is None:
        return other if one is None else one
    if isinstance(one, tuple):
        each = (plus(*pair) for pair in zip(one, other, strict=True))
        return type(one)(*each) if hasattr(one, "_fields") else type(one)(each)
    return one + other
