"""What tells the probability of a grasp where nothing is said: the rule of succession, unless a Beta foretells better.

A table's features take a grasp to succeed with the share in sight times the rule of succession
(`halfseen.tables.features`). That needs no data, and is right where what is hidden is hard to grip. A cell in which it
is not so shows it in its own attempts. So paths are dealt into folds; `BetaGrasp` learns from all but one and foretells
the attempts of that one, and it is taken only where that at least halves the squared error, beyond noise. To foretell
a little better is not enough. The share in sight also says how much a look shows and how long an attempt takes, and
under the assumed laws features with the true probability of a grasp in its place earn less, though their error is a
fourth smaller; under the law of the cell, where the Beta leaves a fifth of it, they earn more.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.arrays import RowIds, Rows
from halfseen.errors import HalfseenError, HalfseenWarning
from halfseen.logs import Logs
from halfseen.tables.features import succession
from halfseen.tables.grasp.attempts import attempts
from halfseen.tables.grasp.beta_grasp import fitted_thetas, predictive
from halfseen.tables.grasp.grasp_table import GraspTable, every_history, table_of
from halfseen.tables.grasp.grip_effect import fitted_effect
from halfseen.tables.grasp.inputs import Decided, History, checked_attempts
from halfseen.workers.threads import one_thread

NUM_FOLDS = 5

WORTH = 0.5
"""Share of the rule's squared error that the Beta must take away."""

CLEARLY = 2.0
"""Standard errors by which it must take away more than that."""

FEWEST_ATTEMPTS = 30
"""Decided attempts below which there is nothing to choose by."""

KEPT = "the probability of a grasp is the rule of succession’s"


class GraspChoice(NamedTuple):
    """What tells the probability of a grasp, and why.

    Parameters
    ----------
    grasp
        A Beta regression, as policies hold it; None for the rule of succession.
    sentence
        What was chosen and why.
    """

    grasp: GraspTable | None
    sentence: str


def choose_grasp(logs: Logs, horizon: int) -> GraspChoice:
    """Choose by a log; the rule of succession where the log does not tell what became of its attempts.

    Parameters
    ----------
    logs
        Of tables.
    horizon
        T.
    """
    try:
        return choose_by(attempts(logs, horizon), horizon)
    except HalfseenError as error:
        return GraspChoice(None, f"{KEPT}: {error}")


def choose_by(tried: pd.DataFrame, horizon: int) -> GraspChoice:
    """Choose by attempts.

    Parameters
    ----------
    tried
        As `halfseen.tables.grasp.attempts.attempts` gives them.
    horizon
        T.

    Raises
    ------
    PositivityError
        A weight is not identified.
    """
    num_decided = int(tried["is_finished"].sum())
    if num_decided < FEWEST_ATTEMPTS:
        return GraspChoice(None, f"{KEPT}: {num_decided} decided attempts are too few to learn it from")
    with warnings.catch_warnings(), one_thread():
        # Nobody asked for these weights, and the standard error tells how much they are worth.
        warnings.simplefilter("ignore", HalfseenWarning)
        decided = checked_attempts(tried)
        grip = tried["grip"].to_numpy(dtype=np.float64)[decided.row]
        path = np.unique(tried["path"].to_numpy(), return_inverse=True)[1][decided.row]
        *held_out, whole = fitted_thetas(decided, _weightings(decided, path))
        errors = _errors(decided, grip, path, held_out)
    lead = (1.0 - WORTH) * errors.rule - errors.beta
    left = f"{errors.beta.sum() / errors.rule.sum():.0%} of its squared error"
    if lead.mean() > CLEARLY * lead.std(ddof=1) / np.sqrt(len(lead)):
        effect = fitted_effect(predictive(whole, decided.history), decided, grip)
        return GraspChoice(
            table_of(predictive(whole, every_history(horizon)), horizon, effect),
            "the probability of a grasp is learned from the log’s attempts: held out, a Beta regression foretells them "
            f"better than the rule of succession, with {left}",
        )
    return GraspChoice(None, f"{KEPT}: held out, a Beta regression does not clearly halve its error (it leaves {left})")


def _weightings(decided: Decided, path: RowIds) -> Float[np.ndarray, "V n"]:
    """Weights without the paths of each fold, and those of all."""
    return np.vstack([(path % NUM_FOLDS != np.arange(NUM_FOLDS)[:, None]) * decided.weight, decided.weight])


class _Errors(NamedTuple):
    """Squared errors of what is foretold, weighted and summed over the attempts of each path."""

    rule: Rows
    beta: Rows


def _errors(decided: Decided, grip: Rows, path: RowIds, held_out: Sequence[Float[np.ndarray, "3"]]) -> _Errors:
    """Errors of the rule, and of a Beta that was fitted to other paths; both as far as they go by history alone."""
    said = np.stack([predictive(theta, decided.history) for theta in held_out])
    beta, rule = said[path % NUM_FOLDS, np.arange(len(path))], _by_succession(decided.history, grip)
    squared = (decided.weight * np.square(each - decided.succeeded) for each in (rule, beta))
    return _Errors(*(np.bincount(path, each, path.max() + 1) for each in squared))


def _by_succession(history: History, grip: Rows) -> Rows:
    """What the features say: they take what shows of a grip in full."""
    return (1.0 - history.occlusion) * succession(history.successes, history.failures, grip)
