"""Does a log contradict the laws that were fitted to it? By the residuals of eq. 3 on the weighted log.

Under the true laws Q°(S, A) = E[R + V°(S') | S, A] (`halfseen.planners.one_step`), so that with w = δ / Ĝ(U⁻)

    Σ_t w_t · x(S_t, A_t) · (R_t + V°(S_{t+1}) − Q°(S_t, A_t))

has mean 0 for each trajectory, whatever x is taken from (S, A). Sums over trajectories of some x are tested together by
Hotelling's T² [Hotelling1931]_; trajectories, not stages, are independent. A law that takes each look for news, dirt
that log-odds overstate or an object that never holds shows at once; what moves neither rewards nor what is left to
gain changes no decision, and is not looked for.
"""

from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import left_price, table_of
from halfseen.shapes import Float, Int
from halfseen.tables.assisted.features import Ahead, ahead_of
from halfseen.tables.assisted.weighted_log import WeightedLog
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.state import TableState, attempt_counts

LEVEL = 0.02
"""Probability with which right laws are taken for wrong ones, at most; of n trajectories at most 1/n, as wrong laws
show the better, the longer the log."""


class Residuals(NamedTuple):
    """Of the completed stages, R rows."""

    trajectory: Int[np.ndarray, " R"]
    stage: Int[np.ndarray, " R"]
    verb: Int[np.ndarray, " R"]
    weight: Float[np.ndarray, " R"]
    residual: Float[np.ndarray, " R"]
    """R + V°(S') − Q°(S, A)."""
    described: Float[np.ndarray, "R 6"]
    """Of the target: 1, P(DIRTY), occlusion, share seen, past failures; and the steps to go."""


class LawTest(NamedTuple):
    """What the residuals say of the laws."""

    statistic: float
    p_value: float
    z: dict[str, float]
    """Mean residual of each verb, in its standard errors."""
    level: float = LEVEL

    @property
    def is_rejected(self) -> bool:
        """Whether the log contradicts the laws."""
        return self.p_value < self.level

    @property
    def sentence(self) -> str:
        """What was found."""
        z = ", ".join(f"{name} {of:+.1f}" for name, of in self.z.items())
        found = "contradicts" if self.is_rejected else "does not contradict"
        return f"the log {found} the laws (p = {self.p_value:.2g}; mean residuals in standard errors: {z})"


def residuals_of(config: WorldConfig, log: WeightedLog) -> Residuals:
    """Compute the residuals under some laws."""
    at = np.nonzero(log.weight > 0.0)
    after = at[0], np.minimum(at[1] + 1, log.weight.shape[1] - 1)
    is_last = log.is_last[at]
    ahead, state = _ahead_at(config, log.states, at)
    following, _ = _ahead_at(config, log.states, after)
    action, rows = log.action[at], np.arange(len(at[0]))
    left, left_after = (left_price(config, each.table) for each in (ahead, following))
    values = np.where(ahead.table.steps_to_go == 1, ahead.values[0], ahead.values[1])
    worth = np.concatenate([np.zeros((1, len(rows)), dtype=np.float32), values])[action, rows]
    beyond = np.where(is_last, 0.0, left_after + following.control)
    space = ActionSpace(state.num_objects)
    target = space.target(action)
    failures = attempt_counts(state)[1]
    columns = (ahead.table.is_dirty.T, ahead.look.occluded[0].T, ahead.table.seen.T, failures)
    of_target = [each[rows, target] for each in columns]
    return Residuals(
        *at,
        verb=space.verb(action),
        weight=log.weight[at],
        residual=log.reward[at] + beyond - left - worth,
        described=np.column_stack([np.ones(len(rows)), *of_target, ahead.table.steps_to_go / 10.0]),
    )


def _ahead_at(config: WorldConfig, states: TableState, at: tuple[np.ndarray, ...]) -> tuple[Ahead, TableState]:
    there = mapped(lambda leaf: leaf[at], states)
    return ahead_of(config, table_of(belief_of(config, there))), there


FEWEST = 5
"""Trajectories of which a column must differ from 0."""

USED = {Verb.FINISH: (0,), Verb.WASH: (0, 1, 2, 3, 4, 5), Verb.LIFT: (0, 2, 3, 5)}
"""Which of the descriptions are tested, by verb."""


def hotelling_test(found: Residuals, num_trajectories: int) -> LawTest:
    """Test the laws: mean residuals of the verbs, and these with all that describes a target; both count (Bonferroni).

    Few trajectories can tell little of many means, and many tell more by what residuals depend on.
    """
    columns, means, z = [], [], {}
    for verb, used in USED.items():
        rows = found.verb == verb
        weighted = (found.weight * found.residual)[rows]
        sums = [
            np.bincount(found.trajectory[rows], weighted * found.described[rows, k], num_trajectories) for k in used
        ]
        columns, means = columns + sums, [*means, sums[0]]
        z[verb.name] = float(sums[0].sum() / max(np.sqrt((sums[0] ** 2).sum()), 1e-12))
    (statistic, p_of_all), (_, p_of_means) = (hotelling(np.column_stack(each)) for each in (columns, means))
    level = min(LEVEL, 1.0 / num_trajectories)
    return LawTest(statistic, min(1.0, 2.0 * min(p_of_all, p_of_means)), z, level)


def hotelling(each: Float[np.ndarray, "n k"]) -> tuple[float, float]:
    """T² of the mean of rows being 0, and its p-value; columns that hardly ever differ from 0 are left out."""
    from scipy.special import fdtrc

    each = each[:, (each != 0.0).sum(axis=0) >= FEWEST]
    n, num = each.shape
    if num == 0 or n <= num + 2:
        return 0.0, 1.0
    mean, covariance = each.mean(axis=0), np.atleast_2d(np.cov(each.T))
    # Columns that say the same count once.
    statistic = float(n * mean @ np.linalg.pinv(covariance, rcond=1e-8, hermitian=True) @ mean)
    rank = int(np.linalg.matrix_rank(covariance, rtol=1e-8, hermitian=True))
    return statistic, float(fdtrc(rank, n - rank, statistic * (n - rank) / (rank * (n - 1))))
