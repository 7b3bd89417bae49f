"""Sampling variability of a learned policy, by the bootstrap over trajectories [Efron1979]_.

Trajectories are resampled from the log with replacement. For each draw Ĝ, the weights and, if targets are imputed, the
durations are estimated again, and Q is fitted as it was to the log, but without pessimism; features and the grid of λ
stay.
"""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.estimator import check_seed, is_count, is_number
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import QModel, checked_log
from halfseen.learning.q_space import TabularQ
from halfseen.learning.recursion import QFunctions, fit_q, stack_q
from halfseen.learning.rows import TrajectoryArrays, Transitions
from halfseen.logs import Logs
from halfseen.progress import Progress, Verbosity, verbosity
from halfseen.shapes import Float, Int
from halfseen.workers import ALONE, Workers, checked_workers
from halfseen.workers.threads import in_one_thread

BATCH_SIZE = 10
"""Replicates that a worker fits at once."""


@dataclass(frozen=True, eq=False)
class QBootstrap:
    """A learned policy and its bootstrap replicates.

    Parameters
    ----------
    policy
        The learned policy.
    replicates
        The policies of the draws; the coefficients have a leading axis of B.
    """

    policy: Any
    replicates: Any

    def q_interval(
        self, frame: pd.DataFrame, stage: int, level: float = 0.95
    ) -> tuple[Float[np.ndarray, "m A"], Float[np.ndarray, "m A"]]:
        """Central interval of Q for each row of covariates and action; for named actions only.

        Raises
        ------
        ArgumentError
            `level` is not between 0 and 1, or the policy is not one of named actions.
        """
        if not (is_number(level) and 0.0 < level < 1.0):
            raise ArgumentError(f"level is {level!r}; give a level between 0 and 1")
        draws = self._draws(frame, stage)
        low, high = np.quantile(draws, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
        return low, high

    def decision_shares(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Share of the draws in which each action is the best possible one; for named actions only."""
        draws = self._draws(frame, stage)
        possible = np.where(self._flat.is_possible[stage - 1], draws, -np.inf)
        best = np.argmax(possible, axis=-1)
        return (best[..., None] == np.arange(possible.shape[-1])).mean(axis=0)

    @property
    def _flat(self) -> DiscretePolicy:
        if not isinstance(self.policy, DiscretePolicy):
            raise ArgumentError(
                f"a {type(self.policy).__name__} does not decide by covariates alone; compare policy and replicates"
            )
        return self.policy

    def _draws(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "B m A"]:
        each = self.replicates.coefficients
        return np.stack([replace(self._flat, coefficients=one).q_values(frame, stage) for one in each])


@in_one_thread
def bootstrap(
    learner: CensoredQLearner,
    logs: Logs,
    num_replicates: int = 100,
    random_state: int = 0,
    is_quiet: bool = True,
    workers: Workers = ALONE,
) -> QBootstrap:
    """Learn again from trajectories resampled with replacement.

    Replicates are without pessimism, so the Q of a learner with it (the default) lies low in its interval.

    Parameters
    ----------
    learner
        A learner fitted to `logs`.
    logs
        The log.
    num_replicates
        B, number of draws, each of as many trajectories as the log has.
    random_state
        Seed of the draws.
    is_quiet
        Show no progress; otherwise a bar is shown if the output is a terminal.
    workers
        Workers for the fits; used once draws take long. The result is the same.

    Raises
    ------
    ArgumentError
        The learner was not fitted to this log, or `num_replicates` is below 2.
    """
    checked_log(logs, Logs)
    check_seed(random_state)
    checked_workers(workers)
    if not is_count(num_replicates) or num_replicates < 2:
        raise ArgumentError(f"num_replicates is {num_replicates!r}; give a whole number of at least 2")
    if not hasattr(learner, "policy_"):
        raise ArgumentError("the learner has no policy_; fit it to this log first")
    model = learner.model_
    trajectories = model.lay_out(logs)
    is_same = all(map(np.array_equal, model.support_in(trajectories), model.support or ()))
    if learner.weights_.shape[0] != logs.num_trajectories or not is_same:
        raise ArgumentError(
            f"the log of {logs.num_trajectories} trajectories is not that of {learner.weights_.shape[0]} which the "
            "learner was fitted to, or its actions differ; give it the log that it was fitted to"
        )
    share = np.full(trajectories.num_trajectories, 1.0 / trajectories.num_trajectories)
    counts = np.random.default_rng(random_state).multinomial(trajectories.num_trajectories, share, size=num_replicates)
    batches = [counts[start : start + BATCH_SIZE] for start in range(0, num_replicates, BATCH_SIZE)]
    fits: list[QFunctions] = []
    with (
        verbosity(Verbosity.NOTHING) if is_quiet else nullcontext(),
        Progress(num_replicates, "bootstrap", "draws") as bar,
        workers.ready_if_worth() as pool,
    ):
        for each in pool.in_order(
            partial(_learned_again, model, trajectories, model.transitions(trajectories)), batches
        ):
            fits += each
            bar.update(len(each))
    return QBootstrap(learner.policy_, model.policy(stack_q(fits)))


def _learned_again(
    model: QModel, trajectories: TrajectoryArrays, log: Transitions, counts: Int[np.ndarray, "B n"]
) -> list[QFunctions]:
    """Learn from some draws, given how often each trajectory was drawn; 0 gives it no weight."""
    regression = replace(model, pessimism=0.0).regression(*log.is_possible.shape[::2])
    fits = []
    for each in counts:
        drawn = trajectories.take(np.repeat(np.arange(len(each)), each))
        again = replace(model, cut_model=model.targets.fit_cuts(drawn.clocks))
        if isinstance(model.space, TabularQ):
            fits.append(again.fit(again.transitions(drawn)))
            continue
        weight, imputed = again.weights_and_imputation(drawn)
        back = partial(_spread, each)
        if imputed is not None:
            of_trajectories = {name: back(leaf) for name, leaf in imputed._asdict().items() if name != "is_used"}
            imputed = imputed._replace(**of_trajectories)
        redrawn = log._replace(weight=back(weight), imputation=imputed).counted(each.astype(np.float64))
        fits.append(fit_q(model.recent(redrawn), regression))
    return fits


def _spread(counts: Int[np.ndarray, " n"], leaf: np.ndarray) -> np.ndarray:
    """For each trajectory the values of its first copy; 0 if it was not drawn."""
    first, was_drawn = np.cumsum(counts) - counts, counts > 0
    spread = np.zeros((len(counts), *leaf.shape[1:]))
    spread[was_drawn] = leaf[first[was_drawn]]
    return spread
