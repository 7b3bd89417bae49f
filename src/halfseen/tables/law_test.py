"""Test of fitted laws on their own log, with censoring weights.

**The price of a LIFT.** A world has one transport time. A robot that turns a lifted object before its camera, or parks
slowly, has several. For one robot, times matter only through the price of a LIFT. So this price is corrected: the mean
reward of LIFTs is compared with that expected under the laws, both weighted by δ / Ĝ(U⁻).

**One robot: residuals of eq. 3.** Under the true laws Q°(S, A) = E[R + V°(S') | S, A]
(`halfseen.planners.one_step`), so that with w = δ / Ĝ(U⁻)

    Σ_t w_t · x(S_t, A_t) · (R_t + V°(S_{t+1}) − Q°(S_t, A_t))

has mean 0 for each trajectory and any function x of (S, A). Sums for several x are tested jointly across trajectories
by Hotelling's T² [Hotelling1931]_; trajectories, not stages, are independent. The test detects laws that treat every
look as news, overconfident log-odds, and objects that never hold. Errors that affect neither rewards nor future gains
change no decision, and are not tested.

**A team: outcomes of each stage.** A team's myopic look is not an exact expectation of the value of the next state. So
R + V(S') − Q(S, A) does not have mean 0 under the true laws, as it has for one robot. Predictions of a single step are
exact:

=======  ============================================================================================================
grasps   1{an attempt held} − P(it holds | information at its beginning)
dirt     1{an object that left the table was dirty} − P(DIRTY) just before
labels   change of P(DIRTY) by a look, summed over the objects that stay
=======  ============================================================================================================

Each has mean 0 when weighted by δ / Ĝ(U⁻) of the stage of its outcome, and multiplied by anything known before. Sums
are tested jointly across trajectories by Hotelling's T². The last two test the log-odds that the policy uses.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit, mapped
from halfseen.errors import PositivityError
from halfseen.learning.rows import TrajectoryArrays, stage_places, trajectory_arrays
from halfseen.learning.targets import Weighted
from halfseen.learning.task import Encoded
from halfseen.logs import Logs
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.one_step import HELD, left_price, outlook_of, table_of
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.encoding import logged_actions
from halfseen.tables.evidence import Brought, beside_prices
from halfseen.tables.grasp_attempts import attempts, rows_of_attempts
from halfseen.tables.look_ahead import Ahead, ahead_of
from halfseen.tables.rewards import NUM_LEFT
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.log_rows import begun_objects
from halfseen.world.state import TableState, attempt_counts, occlusion


class WeightedLog(NamedTuple):
    """A log of tables with censoring weights."""

    states: TableState
    """Axes (n, T)."""
    action: Int[np.ndarray, "n T"]
    reward: Float[np.ndarray, "n T"]
    weight: Float[np.ndarray, "n T"]
    """δ / Ĝ(U⁻) with the Kaplan–Meier Ĝ."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the trajectory ended by itself."""


def weighted_log(logs: Logs, states: TableState, *, is_team: bool = False) -> WeightedLog | str:
    """Weight the stages of a log, or return the reason why that is impossible."""
    action = logged_actions(logs, states.horizon, states.num_objects, is_team=is_team)
    is_possible = np.ones((*action.shape, ActionSpace(states.num_objects).num_actions + is_team), dtype=bool)
    return weighed(trajectory_arrays(logs, Encoded(np.zeros((*action.shape, 1, 0)), is_possible, action), None), states)


def weighed(trajectories: TrajectoryArrays, states: TableState) -> WeightedLog | str:
    """Weight the stages of a log given as arrays, or return the reason why that is impossible."""
    targets = Weighted()
    try:
        weight = targets.weights(trajectories, targets.fit_cuts(trajectories.clocks))
    except PositivityError as error:
        return f"the laws are not tested on the log: {error}"
    return WeightedLog(states, trajectories.action, trajectories.reward, weight, trajectories.is_last)


CLEARLY_PAID = 4.0
"""Standard errors beyond which the rewards of LIFTs differ from those of the laws."""


def with_lift_price(config: WorldConfig, log: WeightedLog) -> tuple[WorldConfig, str | None]:
    """Scale the price of LIFTs to their rewards where these clearly differ from those of the laws.

    Returns the laws with that price, and the change in words; None if there was none.
    """
    space = ActionSpace(log.states.num_objects)
    at = np.nonzero((space.verb(log.action) == Verb.LIFT) & (log.weight > 0.0) & ~log.is_last)
    if not len(at[0]) or not config.reward_lift_per_s:
        return config, None
    state, rows = mapped(lambda leaf: leaf[at], log.states), np.arange(len(at[0]))
    seconds = expected_attempt_s(config, occlusion(state), grip_posterior(config, state))
    expected = config.reward_lift_per_s * seconds[rows, space.target(log.action[at])]
    paid, weight = log.reward[at], log.weight[at]
    beyond = np.bincount(at[0], weight * (paid - expected), len(log.weight))
    if abs(beyond.sum()) <= CLEARLY_PAID * np.sqrt((beyond**2).sum()):
        return config, None
    mean_paid, was = weight @ paid / weight.sum(), weight @ expected / weight.sum()
    price = float(config.reward_lift_per_s * mean_paid / was)
    words = f"a LIFT paid {mean_paid:.2g} on average, but its times and price predict {was:.2g}: its price is corrected"
    return replace(config, reward_lift_per_s=price), words


LEVEL = 0.02
"""Largest level of the test. With n trajectories it is at most 1/n, because wrong laws are easier to detect in a longer
log."""


class Residuals(NamedTuple):
    """Residuals of the completed stages, R rows."""

    trajectory: Int[np.ndarray, " R"]
    stage: Int[np.ndarray, " R"]
    verb: Int[np.ndarray, " R"]
    weight: Float[np.ndarray, " R"]
    residual: Float[np.ndarray, " R"]
    """R + V°(S') − Q°(S, A)."""
    described: Float[np.ndarray, "R 6"]
    """1; P(DIRTY), occlusion, seen share and past failures of the target; and the steps to go."""


class LawTest(NamedTuple):
    """Result of a test of laws."""

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
        """The result in words."""
        z = ", ".join(f"{name} {of:+.1f}" for name, of in self.z.items())
        found = "contradicts" if self.is_rejected else "does not contradict"
        return f"the log {found} the laws (p = {self.p_value:.2g}; mean residuals in standard errors: {z})"


def residuals_of(config: WorldConfig, log: WeightedLog) -> Residuals:
    """Compute the residuals of a log under laws."""
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
    return ahead_of(config, table_of(config, there)), there


FEWEST = 5
"""Fewest trajectories in which a tested column differs from 0."""
USED = {Verb.FINISH: (0,), Verb.WASH: (0, 1, 2, 3, 4, 5), Verb.LIFT: (0, 2, 3, 5)}
"""Columns of `Residuals.described` that are tested, by verb."""


def hotelling_test(found: Residuals, num_trajectories: int) -> LawTest:
    """Test the mean residuals of the verbs, and these times all descriptions of a target (Bonferroni for the two).

    The first test has more power with few trajectories, the second with many.
    """
    sums = {}
    for verb, used in USED.items():
        rows = found.verb == verb
        weighted = (found.weight * found.residual)[rows, None] * found.described[rows][:, used]
        sums[verb.name] = _sums(found.trajectory[rows], weighted, num_trajectories)
    means = np.column_stack([each[:, 0] for each in sums.values()])
    (statistic, p_of_all), (_, p_of_means) = (hotelling(each) for each in (np.hstack([*sums.values()]), means))
    p_value, level = min(1.0, 2.0 * min(p_of_all, p_of_means)), min(LEVEL, 1.0 / num_trajectories)
    return LawTest(statistic, p_value, _standardised(sums), level)


def _sums(
    trajectory: Int[np.ndarray, " R"], values: Float[np.ndarray, "R k"], num_trajectories: int
) -> Float[np.ndarray, "n k"]:
    """Sums over the rows of each trajectory."""
    return np.column_stack([np.bincount(trajectory, each, num_trajectories) for each in values.T])


def _standardised(sums: dict[str, Float[np.ndarray, "n _"]]) -> dict[str, float]:
    """Total of each first column in its standard errors."""
    first = {name: each[:, 0] for name, each in sums.items()}
    return {name: float(each.sum() / max(np.sqrt((each**2).sum()), 1e-12)) for name, each in first.items()}


def hotelling(each: Float[np.ndarray, "n k"]) -> tuple[float, float]:
    """T² for a zero mean of the rows, and its p-value; columns that rarely differ from 0 are left out."""
    from scipy.special import fdtrc

    each = each[:, (each != 0.0).sum(axis=0) >= FEWEST]
    n, num = each.shape
    if num == 0 or n <= num + 2:
        return 0.0, 1.0
    mean, covariance = each.mean(axis=0), np.atleast_2d(np.cov(each.T))
    # Linearly dependent columns count once.
    statistic = float(n * mean @ np.linalg.pinv(covariance, rcond=1e-8, hermitian=True) @ mean)
    rank = int(np.linalg.matrix_rank(covariance, rtol=1e-8, hermitian=True))
    return statistic, float(fdtrc(rank, n - rank, statistic * (n - rank) / (rank * (n - 1))))


FEWEST_TRAJECTORIES = 80
"""Fewest trajectories for a test: misses are rare, and T² of such heavy-tailed sums rejects too often."""


class Predicted(NamedTuple):
    """Prediction errors of the laws, R rows."""

    trajectory: Int[np.ndarray, " R"]
    residual: Float[np.ndarray, " R"]
    """Weighted residual."""
    described: Float[np.ndarray, "R k"]
    """Information before the outcome; 1 first."""


def tested_on_team(
    config: WorldConfig, logs: Logs, states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]
) -> LawTest:
    """Test the laws on the log of a team.

    `weight` is δ / Ĝ(U⁻) of each stage; 0 where it was not completed.
    """
    groups = {
        "grasps": _grasps(config, logs, states, weight),
        "dirt": _dirt(config, states, brought, weight),
        "labels": _labels(states, brought, weight),
    }
    n = logs.num_trajectories
    sums = {name: _sums(each.trajectory, each.residual[:, None] * each.described, n) for name, each in groups.items()}
    z = _standardised(sums)
    found = hotelling(np.hstack([*sums.values()])) if n >= FEWEST_TRAJECTORIES else (0.0, 1.0)
    return LawTest(*found, z)


def _grasps(config: WorldConfig, logs: Logs, states: TableState, weight: Float[np.ndarray, "n T"]) -> Predicted:
    """Prediction errors of completed attempts; each has the weight of the stage in which it ended."""
    tried: Any = attempts(logs)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    row = rows_of_attempts(logs, tried)
    trajectory, stage, target = stage_places(logs)[0][row], tried["stage"].to_numpy() - 1, begun_objects(logs)[row]
    there = mapped(lambda leaf: leaf[trajectory, stage], states)
    robot, number = tried["robot"].to_numpy(), np.arange(len(row))
    expected = np.zeros(len(row))
    table = table_of(config, there)
    for k in range(config.num_robots if config.has_own_laws else 1):
        world = config.as_robot(k)
        look = outlook_of(world, table)
        is_its_own = (robot == k) | (not config.has_own_laws)
        expected = np.where(is_its_own, look.expected[0][HELD][target, number], expected)
    is_held = tried["succeeded"].to_numpy(dtype=bool)
    columns = tried[["occlusion", "failures"]].to_numpy(dtype=np.float64)
    of_end = weight[trajectory, _ended_in(states, weight, trajectory, stage, robot)]
    return Predicted(trajectory, of_end * (is_held - expected), np.column_stack([np.ones(len(row)), columns]))


def _ended_in(
    states: TableState,
    weight: Float[np.ndarray, "n T"],
    trajectory: Int[np.ndarray, " R"],
    stage: Int[np.ndarray, " R"],
    robot: Int[np.ndarray, " R"],
) -> Int[np.ndarray, " R"]:
    """Stage in which an attempt ended: the last one before the robot is free again."""
    assert states.robots is not None
    number = np.arange(weight.shape[1])
    is_stage = np.any(states.is_on_table, axis=-1)[trajectory]
    is_free = ~states.robots.is_busy[trajectory, :, robot] & is_stage & (number > stage[:, None])
    first = np.where(is_free.any(axis=1), is_free.argmax(axis=1), is_stage.sum(axis=1))
    return np.clip(first - 1, 0, number[-1])


def _dirt(config: WorldConfig, states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]) -> Predicted:
    """Prediction errors of objects that left the table as the only one of their stage."""
    at = np.nonzero(brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1) & (weight > 0.0))
    target = brought.has_left[at].argmax(axis=-1)
    p = expit(states.log_odds[(*at, target)].astype(np.float64))
    paid = beside_prices(brought, config)[at]
    is_dirty = np.abs(paid - config.reward_wash_dirty) < np.abs(paid - config.reward_wash_clean)
    seen = states.seen[(*at, target)].astype(np.float64)
    return Predicted(at[0], weight[at] * (is_dirty - p), np.column_stack([np.ones(len(p)), p, seen]))


def _labels(states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]) -> Predicted:
    """Changes of P(DIRTY) of objects that stay on the table from one stage to the next."""
    p = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
    stays: Bool[np.ndarray, "n T N"] = states.is_on_table & np.roll(states.is_on_table, -1, axis=1)
    moved = np.where(stays & brought.goes_on[..., None], np.roll(p, -1, axis=1) - p, 0.0)
    at = np.nonzero(brought.goes_on & (weight > 0.0))
    whole, likely = moved.sum(axis=-1)[at], (moved * (p > 0.5)).sum(axis=-1)[at]
    return Predicted(at[0], weight[at], np.column_stack([whole, likely]))
