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

Two models of scikit-learn map states to actions: thresholds (bagged trees) and smooth borders (a logit). They are small
on purpose: a rule has a few thresholds or one border.
"""

from collections.abc import Callable
from math import comb
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.marginal import states_of
from halfseen.learning.behaviour import conditional_logit
from halfseen.learning.named_task import NamedActions
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int

NUM_TREES, LEAF_SIZE, MOST_LEAVES = 12, 3, 256
"""Leaves have at least `LEAF_SIZE` rows, and enough that there are at most `MOST_LEAVES`."""
RIDGE = 0.1
"""Penalty ½·RIDGE·‖β‖² added to a log-likelihood summed over rows."""


def forest(num_rows: int) -> Any:
    """Bagged classification trees [BreimanEtAl1984]_ for so many rows."""
    from sklearn.ensemble import RandomForestClassifier

    every: Any = None
    least = max(LEAF_SIZE, -(-num_rows // MOST_LEAVES))
    return RandomForestClassifier(NUM_TREES, max_features=every, min_samples_leaf=least, random_state=0)


def logit(num_rows: int) -> Any:
    """Multinomial logit."""
    from sklearn.linear_model import LogisticRegression

    # A Newton step by a Cholesky factor takes (features × actions)³.
    return LogisticRegression(C=1.0 / RIDGE, solver="newton-cg", tol=1e-6, max_iter=1000)


def ranks(states: Float[np.ndarray, "rows F"]) -> Int[np.ndarray, "rows F"]:
    """Ranks of covariates: trees do not depend on their scale, and scikit-learn's have single precision."""
    return np.column_stack([np.unique(column, return_inverse=True)[1] for column in states.T])


def products(states: Float[np.ndarray, "rows F"]) -> Float[np.ndarray, "rows G"]:
    """Scaled covariates and, unless these outnumber the rows, their products."""
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    num_rows, num_covariates = states.shape
    degree = 1 if comb(num_covariates + 2, 2) > num_rows else 2
    return PolynomialFeatures(degree, include_bias=False).fit_transform(StandardScaler().fit_transform(states))


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
        lambda weight, model=model, design=design: _likeliest(model, design, taken, weight, possible)
        for model, design in ((forest, ranks(states)), (logit, products(states)))
    ]


def _likeliest(
    model_for: Callable[[int], Any],
    design: Float[np.ndarray, "rows G"] | Int[np.ndarray, "rows G"],
    taken: Int[np.ndarray, " rows"],
    weight: Float[np.ndarray, " rows"],
    possible: Bool[np.ndarray, "rows A"],
) -> Int[np.ndarray, " rows"]:
    """Fit a model of the actions and return the most probable of the possible actions."""
    fitted, chances = weight > 0, np.zeros(possible.shape)
    kinds = np.unique(taken[fitted])
    chances[:, kinds] = 1.0
    if len(kinds) > 1:
        model = model_for(int(fitted.sum())).fit(design[fitted], taken[fitted], sample_weight=weight[fitted])
        chances[:, kinds] = model.predict_proba(design)
    return np.where(possible, chances, -1.0).argmax(axis=1)
