"""What tells the probability of a grasp where the robots of a team differ in how they grasp.

What the team can do with a table is worth the same, whoever decides, and goes by one model of all attempts. What is
about one object goes by the robot that is at it. Both are Beta regressions (`halfseen.tables.grasp.beta_grasp`), and
are taken only where those of each robot's own attempts foretell held-out attempts better than one of all, beyond noise.
"""

import warnings

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.arrays import Array, Rows, mapped, record, stacked
from halfseen.errors import HalfseenWarning
from halfseen.tables.grasp.beta_grasp import fitted_thetas, predictive
from halfseen.tables.grasp.choice import CLEARLY, FEWEST_ATTEMPTS, NUM_FOLDS
from halfseen.tables.grasp.grasp_table import GraspTable, every_history, table_of
from halfseen.tables.grasp.grip_effect import fitted_effect
from halfseen.tables.grasp.inputs import Decided, checked_attempts
from halfseen.workers.threads import one_thread
from halfseen.world.state import TableState

SENTENCE = (
    "the probability of a grasp is learned from each robot’s own attempts: held out, these foretell them better than "
    "those of all"
)


@record
class GraspByRobot:
    """P(an attempt succeeds) by whoever makes it, and by each robot (a `GraspModel`).

    Parameters
    ----------
    shared
        Learned from the attempts of all.
    own
        Learned from those of each robot; axis K first.
    """

    shared: GraspTable
    own: GraspTable

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, whoever makes it."""
        return self.shared.probability(state)

    def of(self, robot: int) -> GraspTable:
        """Give what tells the probability of one robot."""
        return mapped(lambda leaf: leaf[robot], self.own)


def choose_by_robot(tried: pd.DataFrame, num_robots: int, horizon: int) -> GraspByRobot | None:
    """Learn it from attempts; None where robots do not clearly differ, or one made too few.

    Parameters
    ----------
    tried
        As `halfseen.tables.grasp.team_attempts` gives them.
    num_robots
        K.
    horizon
        T.

    Raises
    ------
    PositivityError
        A weight is not identified.
    """
    finished = tried["robot"][tried["is_finished"].to_numpy(dtype=bool)]
    if num_robots < 2 or np.bincount(finished, minlength=num_robots).min() < FEWEST_ATTEMPTS:
        return None
    with warnings.catch_warnings(), one_thread():
        # Nobody asked for these weights, and the standard error tells how much they are worth.
        warnings.simplefilter("ignore", HalfseenWarning)
        decided = checked_attempts(tried)
        robot, path, grip = (tried[name].to_numpy()[decided.row] for name in ("robot", "path", "grip"))
        path = np.unique(path, return_inverse=True)[1]
        is_of = np.vstack([np.ones(len(robot), dtype=bool), robot == np.arange(num_robots)[:, None]])
        is_kept = np.vstack([path % NUM_FOLDS != np.arange(NUM_FOLDS)[:, None], np.ones(len(path), dtype=bool)])
        # Of all, then of each robot; without each fold, then with all.
        weight = (is_of[:, None] & is_kept) * decided.weight
        thetas = np.reshape(fitted_thetas(decided, weight.reshape(-1, len(path))), (*weight.shape[:2], -1))
        lead = _lead(decided, robot, path, thetas[:, :-1])
        if lead.mean() <= CLEARLY * lead.std(ddof=1) / np.sqrt(len(lead)):
            return None
        shared, *own = (
            _table(theta, decided, grip, mine, horizon) for theta, mine in zip(thetas[:, -1], is_of, strict=True)
        )
        return GraspByRobot(shared, stacked(own))


def _lead(
    decided: Decided, robot: Int[np.ndarray, " n"], path: Int[np.ndarray, " n"], thetas: Float[np.ndarray, "K1 V 3"]
) -> Float[np.ndarray, " paths"]:
    """By how much the squared error of a path is less by each robot's own attempts than by those of all, held out."""
    said = np.stack([[predictive(theta, decided.history) for theta in of] for of in thetas])
    fold, each = path % NUM_FOLDS, np.arange(len(path))
    of_all, own = (np.square(said[of, fold, each] - decided.succeeded) for of in (np.zeros_like(robot), 1 + robot))
    return np.bincount(path, decided.weight * (of_all - own), path.max() + 1)


def _table(theta: Float[np.ndarray, "3"], decided: Decided, grip: Rows, mine: np.ndarray, horizon: int) -> GraspTable:
    own = decided.among(mine)
    effect = fitted_effect(predictive(theta, own.history), own, grip[mine].astype(np.float64))
    return table_of(predictive(theta, every_history(horizon)), horizon, effect)
