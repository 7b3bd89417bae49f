"""The logging policy without its exploration: its most probable action in each state, estimated from the log.

A log holds the probability of the action that was *taken*, b(A | S), and of no other. It gives two kinds of information
on the rule a*(S) = argmax_a b(a | S).

* Whether it was taken. If b(A | S) > ½, A is the rule's action, because all others are less likely. If in every state
  some action has more than ½, then b(A | S) ≤ ½ means that A is not. This can be checked: E[1{b(A | S) > ½} / b(A | S)]
  is the share of states that have such an action. If it is 1, the likelihood ratio of the rule,
  1{A = a*(S)} / b(A | S), is known without any model (*revealed*).
* What it would have been. This needs a model of the actions, fitted with weights b(A | S)⁴. With them, action a has on
  average b(a | S)⁵ of the votes of a state, which has the same maximum and far less noise.

Each trajectory is evaluated with a model fitted without it; a model fitted to a trajectory's own actions would agree
with them too often.

Two models map states to actions by weighted votes: thresholds (bagged trees) and smooth borders (a logit). Either is
fitted to rows of a log and returns the shares of all rows. They are small on purpose: a rule has a few thresholds or
one border, and scikit-learn's equivalents take longer to import than these to fit.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from halfseen.arrays import softmax
from halfseen.evaluation.marginal import states_of
from halfseen.learning.behaviour import conditional_logit
from halfseen.learning.named_task import NamedActions
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int

NUM_TREES, LEAF_SIZE, MOST_LEAVES, PURE = 12, 3, 256, 0.99
"""Leaves have at least `LEAF_SIZE` rows, and enough that there are at most `MOST_LEAVES`. A node in which one action
has the share `PURE` of the votes is not split."""
RIDGE, MOST_STEPS, TOLERANCE = 0.1, 300, 1e-4
"""Penalty ½·RIDGE·‖β‖² added to a log-likelihood summed over rows; largest number of steps; and the change of the
coefficients, as a share of the largest, at which they stop."""


Shares = Callable[
    [Float[np.ndarray, "rows F"], Float[np.ndarray, "fitted A"], Int[np.ndarray, " fitted"]],
    Float[np.ndarray, "rows A"],
]
"""States of all rows, votes of the training rows, and the indices of these → share of each action in every row."""


def forest_shares(
    states: Float[np.ndarray, "rows F"], votes: Float[np.ndarray, "fitted A"], fitted: Int[np.ndarray, " fitted"]
) -> Float[np.ndarray, "rows A"]:
    """Mean share of each action in the leaves of `NUM_TREES` classification trees [BreimanEtAl1984]_, bagged.

    Parameters
    ----------
    states
        Of all rows.
    votes
        Weight of a row for the action taken, 0 for the others.
    fitted
        Rows to grow the trees on.
    """
    rng, shares = np.random.default_rng(0), np.zeros((len(states), votes.shape[1]))
    least = max(LEAF_SIZE, -(-len(fitted) // MOST_LEAVES))
    for _ in range(NUM_TREES):
        times = np.bincount(rng.integers(len(fitted), size=len(fitted)), minlength=len(fitted))
        drawn = np.flatnonzero(times)
        shares += _tree_shares(states[fitted[drawn]], votes[drawn] * times[drawn, None], states, least)
    return shares / NUM_TREES


def _tree_shares(
    states: Float[np.ndarray, "n F"], votes: Float[np.ndarray, "n A"], asked: Float[np.ndarray, "m F"], least: int
) -> Float[np.ndarray, "m A"]:
    """Grow a tree and evaluate it for the queried rows."""
    shares = np.empty((len(asked), votes.shape[1]))
    nodes = [(np.arange(len(states)), np.arange(len(asked)))]
    while nodes:
        rows, sent = nodes.pop()
        total = votes[rows].sum(axis=0)
        is_mixed = len(sent) and total.max() < PURE * total.sum()
        split = _best_split(states[rows], votes[rows], least) if is_mixed else None
        if split is None:
            shares[sent] = total / total.sum()
            continue
        is_left, goes_left = (each[:, split[0]] <= split[1] for each in (states[rows], asked[sent]))
        nodes += [(rows[is_left], sent[goes_left]), (rows[~is_left], sent[~goes_left])]
    return shares


def _best_split(
    states: Float[np.ndarray, "n F"], votes: Float[np.ndarray, "n A"], least: int
) -> tuple[int, float] | None:
    """The purest split over features and thresholds; None if every split has a side with too few rows."""
    if len(states) < 2 * least:
        return None
    order = np.argsort(states, axis=0)
    left = votes[order].cumsum(axis=0)
    total, left = left[-1], left[least - 1 : len(states) - least]
    right = total - left
    scores = (left**2).sum(axis=2) / left.sum(axis=2) + (right**2).sum(axis=2) / right.sum(axis=2)
    score, feature, threshold = best_threshold(np.take_along_axis(states, order, axis=0), scores, least)
    return None if score == -np.inf else (feature, threshold)


def best_threshold(
    ordered: Float[np.ndarray, "n F"], scores: Float[np.ndarray, "m F"], least: int
) -> tuple[float, int, float]:
    """Largest score of splits with enough rows on both sides, its feature and its threshold; −∞ if there is none."""
    num = len(ordered)
    below, above = ordered[least - 1 : num - least], ordered[least : num - least + 1]
    scores = np.where(below < above, scores, -np.inf)
    place, feature = np.unravel_index(np.argmax(scores), scores.shape)
    middle = float(below[place, feature] + above[place, feature]) / 2.0
    return float(scores[place, feature]), int(feature), middle


def logit_shares(
    states: Float[np.ndarray, "rows F"], votes: Float[np.ndarray, "fitted A"], fitted: Int[np.ndarray, " fitted"]
) -> Float[np.ndarray, "rows A"]:
    """Multinomial logit on features and, unless these outnumber the training rows, their products.

    Fitted by accelerated steps with a bound of the curvature [BohningLindsay1988]_. Parameters as in `forest_shares`.
    For a rule without noise the slope of the border diverges, but its position converges long before the steps end.
    """
    spread = states[fitted].std(axis=0)
    scaled = (states - states[fitted].mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    upper = np.triu_indices(states.shape[1])
    is_wide = 1 + states.shape[1] + len(upper[0]) > len(fitted)
    products = scaled[:, :0] if is_wide else scaled[:, upper[0]] * scaled[:, upper[1]]
    design = np.column_stack([np.ones(len(states)), scaled, products])
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
        # Restart the momentum when it points downhill.
        last, pace = (pace, 0.5 + np.sqrt(0.25 + pace**2)) if (slope * step).sum() > 0.0 else (1.0, 1.0)
        ahead = beta + (last - 1.0) / pace * step
    return softmax(design @ beta)


NAME = "the logging policy without its exploration"
POWER = 4
"""Exponent of the logged probability in the weights."""
NUM_FOLDS = 5
LEAST_WEIGHT = 1e-3
"""Rows with a weight below this share of the largest are omitted: they have no effect and take as long."""

Choice = Callable[[Float[np.ndarray, " rows"]], Int[np.ndarray, " rows"]]
"""Weights of the training rows → the most probable action of every row."""


class LoggingRule(NamedTuple):
    """The rule in the states of the log."""

    probabilities: Float[np.ndarray, "n T A"]
    """1 for its action, by a model fitted without the trajectory."""
    is_taken: Bool[np.ndarray, "n T"] | None
    """Whether the logged action is the rule's, if the logged probabilities reveal it; else None."""
    note: str
    """How the rule was estimated, and how well, in a sentence."""


def logging_rule(
    logs: Logs, trajectories: TrajectoryArrays, task: Task, fold: Int[np.ndarray, " n"], has_probability: bool
) -> LoggingRule | str:
    """Estimate the rule behind the logged actions, or return why there is none.

    If the logged probabilities are not trusted, the actions alone are used.
    """
    begun, taken = trajectories.is_begun, trajectories.action[trajectories.is_begun]
    # b(A | S) of each stage, 0 if the action or its probability is not known; 1 if none is trusted.
    logged = np.nan_to_num(trajectories.probability[begun]) if has_probability else 1.0
    likely = np.where(trajectories.has_action[begun], logged, 0.0)
    known, weight = likely > 0, likely**POWER
    weight = np.where(weight > LEAST_WEIGHT * weight.max(), weight, 0.0)
    weight /= weight[weight > 0].mean()
    row_fold = np.broadcast_to(fold[:, None] % NUM_FOLDS, begun.shape)[begun]
    guesses = [_held_out(choice, weight, row_fold) for choice in _choices(logs, trajectories, task)]
    # The model that agrees best with held-out stages.
    guess = max(guesses, key=lambda guess: float(weight[guess == taken].sum()))
    probabilities = np.zeros(trajectories.is_possible.shape)
    probabilities[begun] = guess[:, None] == np.arange(trajectories.is_possible.shape[-1])
    is_right = guess == taken
    if has_probability and _is_revealed(likely[known]):
        is_taken = np.zeros(begun.shape, dtype=bool)
        is_taken[begun] = likely > 0.5
        checked = is_right[likely > 0.5]
        note = (
            "where it was followed is known from probabilities above one half; what it would do elsewhere is "
            f"predicted by a model of the actions, which was right in {checked.sum()} of {len(checked)} stages where "
            "that can be checked"
        )
        return LoggingRule(probabilities, is_taken, note)
    chance = float((1.0 / trajectories.is_possible[begun][known].sum(axis=1)).mean())
    share, num_known = is_right[known].mean(), int(known.sum())
    if not share - chance > 2.0 * np.sqrt(share * (1.0 - share) / num_known):
        return (
            f"the log shows no rule: its apparently most probable action was taken in {share:.0%} of the stages, and "
            f"would be by chance in {chance:.0%}"
        )
    note = (
        "the log does not reveal it, so it is the most probable action by a model of the actions; that was taken in "
        f"{share:.0%} of {num_known} stages, and the accuracy of the model cannot be checked"
    )
    return LoggingRule(probabilities, None, note)


def _is_revealed(likely: Float[np.ndarray, " rows"]) -> bool:
    """Whether every state has an action of more than ½, up to sampling error."""
    share = np.where(likely > 0.5, 1.0 / likely, 0.0)
    return bool(share.any() and share.mean() >= 1.0 - 2.0 * share.std() / np.sqrt(len(share)))


def _held_out(
    choice: Choice, weight: Float[np.ndarray, " rows"], fold: Int[np.ndarray, " rows"]
) -> Int[np.ndarray, " rows"]:
    guess = np.zeros(len(fold), dtype=np.int64)
    for k in np.unique(fold):
        guess[fold == k] = choice(np.where(fold == k, 0.0, weight))[fold == k]
    return guess


def _choices(logs: Logs, trajectories: TrajectoryArrays, task: Task) -> list[Choice]:
    """Candidate models of the rule: thresholds, or smooth borders; for a table, on the features of Q."""
    begun = trajectories.is_begun
    taken = trajectories.action[begun]
    if not isinstance(task, NamedActions):
        features, is_possible = trajectories.features[begun], trajectories.is_possible[begun]
        blocks = task.block_of_action(is_possible.shape[1])
        return [lambda weight: conditional_logit(features, is_possible, taken, blocks, weight).argmax(axis=1)]
    states, stage = states_of(logs, trajectories, task.categories, added=["stage"])[begun], np.nonzero(begun)[1]
    was_taken = np.zeros(trajectories.is_possible.shape[1:], dtype=bool)
    was_taken[stage[trajectories.has_action[begun]], taken[trajectories.has_action[begun]]] = True
    possible = was_taken[stage]
    return [
        lambda weight, each=each: _likeliest(each, states, taken, weight, possible)
        for each in (forest_shares, logit_shares)
    ]


def _likeliest(
    shares_of: Shares,
    states: Float[np.ndarray, "rows F"],
    taken: Int[np.ndarray, " rows"],
    weight: Float[np.ndarray, " rows"],
    possible: Bool[np.ndarray, "rows A"],
) -> Int[np.ndarray, " rows"]:
    """Fit a model of the actions and return the most probable of the possible actions."""
    fitted = np.flatnonzero(weight > 0)
    kinds, kind = np.unique(taken[fitted], return_inverse=True)
    votes = weight[fitted, None] * (kind[:, None] == np.arange(len(kinds)))
    chances = np.zeros(possible.shape)
    if len(fitted):  # else all rows with weight are held out, and every action is an equally good guess
        chances[:, kinds] = shares_of(states, votes, fitted)
    return np.where(possible, chances, -1.0).argmax(axis=1)
