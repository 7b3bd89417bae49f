"""Two models of which action a state gets, from weighted votes: thresholds (bagged trees) and smooth borders.

Either is fitted to rows of a log and asked for the shares of all rows. They are small on purpose: a rule has a few
thresholds or one border, and scikit-learn's models of the same kind take longer to load than these to answer.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from halfseen.arrays import softmax
from halfseen.shapes import Float, Int

NUM_TREES, LEAF_SIZE, MOST_LEAVES, PURE = 12, 3, 256, 0.99
"""Rows of a leaf are at least `LEAF_SIZE`, and so many that there are no more than `MOST_LEAVES`; where one action has
this share of the votes, nothing is split."""
RIDGE, MOST_STEPS, TOLERANCE = 0.1, 300, 1e-4
"""Penalty ½·RIDGE·‖β‖² beside a log-likelihood that is summed over rows; steps at most, and the change of the
coefficients, as a share of the largest, that ends them."""


Shares = Callable[
    [Float[np.ndarray, "rows F"], Float[np.ndarray, "fitted A"], Int[np.ndarray, " fitted"]],
    Float[np.ndarray, "rows A"],
]
"""States of all rows, votes of those that are fitted to, and which these are → share of each action in every row."""


class _Split(NamedTuple):
    feature: int
    threshold: float


def forest_shares(
    states: Float[np.ndarray, "rows F"],
    votes: Float[np.ndarray, "fitted A"],
    fitted: Int[np.ndarray, " fitted"],
) -> Float[np.ndarray, "rows A"]:
    """Mean share of each action in the leaves of `NUM_TREES` classification trees [BreimanEtAl1984]_, bagged.

    Parameters
    ----------
    states
        Of all rows.
    votes
        Weight of a row for the action that it took, 0 for the others.
    fitted
        Rows that the trees are grown on.
    """
    rng, shares = np.random.default_rng(0), np.zeros((len(states), votes.shape[1]))
    least = max(LEAF_SIZE, -(-len(fitted) // MOST_LEAVES))
    for _ in range(NUM_TREES):
        times = np.bincount(rng.integers(len(fitted), size=len(fitted)), minlength=len(fitted))
        drawn = np.flatnonzero(times)
        shares += _tree_shares(states[fitted[drawn]], votes[drawn] * times[drawn, None], states, least)
    return shares / NUM_TREES


def _tree_shares(
    states: Float[np.ndarray, "n F"],
    votes: Float[np.ndarray, "n A"],
    asked: Float[np.ndarray, "m F"],
    least: int,
) -> Float[np.ndarray, "m A"]:
    """Grow a tree, and send what is asked down with it."""
    shares = np.empty((len(asked), votes.shape[1]))
    nodes = [(np.arange(len(states)), np.arange(len(asked)))]
    while nodes:
        rows, sent = nodes.pop()
        total = votes[rows].sum(axis=0)
        split = (
            _best_split(states[rows], votes[rows], least) if len(sent) and total.max() < PURE * total.sum() else None
        )
        if split is None:
            shares[sent] = total / total.sum()
            continue
        is_left, goes_left = (each[:, split.feature] <= split.threshold for each in (states[rows], asked[sent]))
        nodes += [(rows[is_left], sent[goes_left]), (rows[~is_left], sent[~goes_left])]
    return shares


def _best_split(states: Float[np.ndarray, "n F"], votes: Float[np.ndarray, "n A"], least: int) -> _Split | None:
    """The best of all features and thresholds; None where no side of one has rows enough."""
    if len(states) < 2 * least:
        return None
    order = np.argsort(states, axis=0)
    at = np.take_along_axis(states, order, axis=0)
    left = votes[order].cumsum(axis=0)
    total, left = left[-1], left[least - 1 : len(states) - least]
    right = total - left
    scores = (left**2).sum(axis=2) / left.sum(axis=2) + (right**2).sum(axis=2) / right.sum(axis=2)
    below, above = at[least - 1 : len(states) - least], at[least : len(states) - least + 1]
    scores = np.where(below < above, scores, -np.inf)
    place, feature = np.unravel_index(np.argmax(scores), scores.shape)
    if scores[place, feature] == -np.inf:
        return None
    return _Split(int(feature), float(below[place, feature] + above[place, feature]) / 2.0)


def logit_shares(
    states: Float[np.ndarray, "rows F"],
    votes: Float[np.ndarray, "fitted A"],
    fitted: Int[np.ndarray, " fitted"],
) -> Float[np.ndarray, "rows A"]:
    """Multinomial logit on features and their products.

    By steps with a bound of the curvature [BohningLindsay1988]_, accelerated. Parameters are those of `forest_shares`.
    A rule without noise has a border that can be ever steeper; where it lies is found long before that ends.
    """
    spread = states[fitted].std(axis=0)
    scaled = (states - states[fitted].mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    upper = np.triu_indices(states.shape[1])
    design = np.column_stack([np.ones(len(states)), scaled, scaled[:, upper[0]] * scaled[:, upper[1]]])
    own, weight = design[fitted], votes.sum(axis=1)
    penalty = np.full(design.shape[1], RIDGE)
    penalty[0] = 1e-8
    bound = 0.5 * (own.T * weight) @ own + np.diag(penalty)
    inverse = np.linalg.inv(bound)
    beta = ahead = np.zeros((design.shape[1], votes.shape[1]))
    pace = 1.0
    for _ in range(MOST_STEPS):
        slope = own.T @ (votes - weight[:, None] * softmax(own @ ahead)) - penalty[:, None] * ahead
        step = ahead + inverse @ slope - beta
        beta = beta + step
        if np.abs(step).max() <= TOLERANCE * np.abs(beta).max():
            break
        # Momentum, begun anew where it leads downhill.
        last, pace = (pace, 0.5 + np.sqrt(0.25 + pace**2)) if (slope * step).sum() > 0.0 else (1.0, 1.0)
        ahead = beta + (last - 1.0) / pace * step
    return softmax(design @ beta)
