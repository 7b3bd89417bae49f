"""E: the error of the one-step look-ahead, learned from trajectories simulated in a known world.

**One robot.** With Q_h = Q_1 + E_h, backwards over steps to go h from E_1 ≡ 0 (with one step to go Q_1 is exact),

    E_h(b, a)  ←  Q°(b, a) − Q_1(b, a) + E[Q_1(b', a') + E_{h−1}(b', a') − V°(b')],    a' = argmax Q_1(b', ·),

because E[R + V°(b')] = Q°(b, a). The regression targets are small differences, not rewards. E is linear in the features
of `look_ahead`, with coefficients for each verb and h. It is clipped to the range of the fitted values, and is 0 for
FINISH. The successor's action is the argmax of Q_1, not of Q_1 + E: one step of policy iteration, which does not
maximise over errors of E. With maxima over a linear Q without this anchor the values diverged.

Trajectories begin as those of the log: with its tables, before any label. At each belief a few actions are tried, drawn
with a probability that rises with Q_1. The best one is followed, or one of these.

**A team.** For a state S with myopic action a* and another action a, in futures of S in which all robots act
myopically from then on,

    E(S, a)  ←  (Σ R after a) − (Σ R after a*) − (Q(S, a) − Q(S, a*)),    Q that of the myopic look:

This is eq. 3 with the myopic policy in place of the maximum, simulated to the end of each trajectory, so that errors of
a later E do not enter an earlier one. Both futures share the hidden truth and the random draws, so their difference
has less noise than one stage plus the value of its successor. States come from trajectories on the log's tables, in
which robots sometimes deviate from the myopic action.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners.futures import future_rewards
from halfseen.planners.myopic import MyopicPolicy
from halfseen.planners.one_step import Beliefs, table_of
from halfseen.planners.rollout import picked, successor
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.assisted import Excess, TeamExcess
from halfseen.tables.look_ahead import Ahead, ahead_of, team_described
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import PolicyDraw, surely
from halfseen.world.random import Key
from halfseen.world.rollout import play
from halfseen.world.state import Layout, TableState
from halfseen.world.transition import start

NUM_TRIED = 4
"""Actions tried at each belief, including the best one."""
RANDOM_SHARE = 0.3
"""Probability that one of these is followed instead of the best one."""
TEMPERATURE, LEAST = 1.0, -5.0
"""Of the draw of tried actions: log-odds of an action are its shortfall from the best, at least `LEAST`."""
TEAM_TEMPERATURE, TEAM_LEAST = 0.7, -3.0
REG, TEAM_REG = 1e-2, 3e-2
"""λ, for features of unit variance, or of unit mean square."""
RANGE = (0.01, 0.99)
"""Quantiles of the fitted values to which E is clipped."""
NUM_TRAJECTORIES, FEWEST_ROWS = 2000, 100
NUM_STATES, NUM_FUTURES, STATES_A_TRAJECTORY = 5000, 2, 4.0
LANES, TEAM_LANES = 512, 64
"""Trajectories, or states, advanced together: their arrays fit in the cache of a core."""


def _ridge(
    features: Float[np.ndarray, "R F"], target: Float[np.ndarray, " R"], size: Float[np.ndarray, " F"], reg: float
) -> Float[np.ndarray, " F"]:
    """Ridge regression without an offset, on features divided by their sizes."""
    scale = np.where(size > 1e-4, size, np.inf)
    unit = features / scale
    gram = unit.T @ unit / len(unit) + reg * np.eye(unit.shape[1])
    return np.linalg.solve(gram, unit.T @ target / len(unit)) / scale


class TriedActions(NamedTuple):
    """Actions tried with h steps to go, and the best action after each; R rows."""

    verb: Int[np.ndarray, " R"]
    """0 for WASH, 1 for LIFT."""
    features: Float[np.ndarray, "R F"]
    beyond: Float[np.ndarray, " R"]
    """Q°(b, a) − Q_1(b, a) + Q_1(b', a') − V°(b')."""
    next_verb: Int[np.ndarray, " R"]
    """−1 for FINISH, or where nothing is left."""
    next_features: Float[np.ndarray, "R F"]


def fitted_excess(config: WorldConfig, layouts: Layout, seed: int, num_trajectories: int = NUM_TRAJECTORIES) -> Excess:
    """Simulate one robot in a known world, and fit E.

    Trajectories cycle through the layouts.
    """
    parts = [
        _simulated(config, layouts, np.arange(first, min(first + LANES, num_trajectories)), seed)
        for first in range(0, num_trajectories, LANES)
    ]
    found = Excess.none(config.horizon)
    for to_go in range(2, config.horizon + 1):
        some = [part[to_go] for part in parts if to_go in part]
        if some:
            _fit_step(found, to_go, TriedActions(*map(np.concatenate, zip(*some, strict=True))))
    return found


def _fit_step(found: Excess, to_go: int, tried: TriedActions) -> None:
    """Fit E with h steps to go, given E with h − 1, in place."""
    coefficients, low, high = (each[to_go - 2] for each in (found.coefficients, found.low, found.high))
    target = tried.beyond.astype(np.float64)
    for verb in range(2):
        at = tried.next_verb == verb
        values = coefficients[verb, 0] + tried.next_features[at] @ coefficients[verb, 1:]
        target[at] = tried.beyond[at] + np.clip(values, low[verb], high[verb]).astype(np.float64)
    for verb in range(2):
        rows = tried.verb == verb
        if rows.sum() < FEWEST_ROWS:
            continue
        of_verb = _regressed(tried.features[rows], target[rows])
        found.coefficients[to_go - 1, verb] = of_verb
        fit = of_verb[0] + tried.features[rows] @ of_verb[1:]
        found.low[to_go - 1, verb], found.high[to_go - 1, verb] = np.quantile(fit, RANGE)


def _regressed(features: Float[np.ndarray, "R F"], target: Float[np.ndarray, " R"]) -> Float[np.ndarray, " F1"]:
    """Ridge regression on features of unit variance; the unpenalised offset comes first."""
    features = features.astype(np.float64)
    mean = features.mean(axis=0)
    slope = _ridge(features - mean, target - target.mean(), features.std(axis=0), REG)
    return np.append(target.mean() - slope @ mean, slope)


def _simulated(
    config: WorldConfig, layouts: Layout, trajectory: Int[np.ndarray, " R"], seed: int
) -> dict[int, TriedActions]:
    """Simulate trajectories, given by number: the tried actions by steps to go, while any trajectory is left."""
    rng, found = np.random.default_rng([seed, int(trajectory[0])]), {}
    layout = mapped(lambda leaf: leaf[trajectory % len(leaf)], layouts)
    state, _ = start(config, layout, random.fold_in(random.key_of(seed), trajectory))
    ahead = ahead_of(config, table_of(config, state))
    for to_go in range(config.horizon, 1, -1):
        tried, is_possible = _to_try(ahead, rng)
        after = ahead_of(config, after_each(config, ahead, tried, rng))
        found[to_go] = rows_of(ahead, tried, is_possible, after)
        num_lanes = tried.shape[1]
        is_explored = rng.random(num_lanes) < RANDOM_SHARE
        followed = is_explored * is_possible[1] * num_lanes + np.arange(num_lanes)
        # Trajectories that end here are dropped.
        goes_on = ((ahead.one_step.max(axis=0) > 0.0) | is_explored) & after.table.is_there.any(axis=0)[followed]
        if not goes_on.any():
            break
        ahead = picked(after, followed[goes_on])
    return found


def _to_try(ahead: Ahead, rng: np.random.Generator) -> tuple[Int[np.ndarray, "M R"], Bool[np.ndarray, "M R"]]:
    """The best action by Q_1 other than FINISH, others drawn by Q_1; and which of these are possible."""
    q = ahead.one_step
    best = q.argmax(axis=0)
    short = (q - q.max(axis=0)) / TEMPERATURE
    perturbed = np.where(np.isfinite(q), np.maximum(short, LEAST) + rng.gumbel(size=q.shape), -np.inf)
    perturbed[best, np.arange(len(best))] = np.inf
    tried = np.argsort(-perturbed, axis=0)[:NUM_TRIED]
    return tried, np.take_along_axis(perturbed, tried, axis=0) > -np.inf


def after_each(config: WorldConfig, ahead: Ahead, tried: Int[np.ndarray, "M R"], rng: np.random.Generator) -> Beliefs:
    """Belief after each tried action."""
    lanes = np.tile(np.arange(tried.shape[1]), len(tried))
    table, look = picked((ahead.table, ahead.look), lanes)
    draws = rng.random((1 + len(table.is_there), len(lanes)), dtype=np.float32)
    return successor(config, table, look, tried.ravel(), draws)


def rows_of(
    ahead: Ahead, tried: Int[np.ndarray, "M R"], is_possible: Bool[np.ndarray, "M R"], after: Ahead
) -> TriedActions:
    """Rows of the tried actions that are possible, from the belief after each."""
    reached = np.flatnonzero(is_possible)
    choice, lanes = tried.ravel()[reached], reached % tried.shape[1]
    one_step, control = ahead.values[:, choice, lanes]
    best = after.one_step[:, reached].argmax(axis=0)
    worth = after.one_step[best, reached]
    num_objects = len(ahead.table.is_there)
    return TriedActions(
        verb=choice // num_objects,
        features=features_of(ahead, choice, lanes),
        beyond=control - one_step + np.where(worth > 0.0, worth, 0.0) - after.control[reached],
        next_verb=np.where(worth > 0.0, best // num_objects, -1),
        next_features=features_of(after, best, reached),
    )


def features_of(ahead: Ahead, choice: Int[np.ndarray, " R"], lanes: Int[np.ndarray, " R"]) -> Float[np.ndarray, "R F"]:
    """Features of one action at each of some beliefs."""
    own = ahead.own.reshape(len(ahead.own), -1, ahead.own.shape[-1])[:, choice, lanes]
    return np.concatenate([ahead.of_table[:, lanes], own]).T


def fitted_team_excess(config: WorldConfig, layouts: Layout, seed: int) -> TeamExcess:
    """Simulate a team in a known world, and fit E."""
    states = visited(config, layouts, seed, NUM_STATES)
    key = random.fold_in(random.key_of(seed), np.arange(len(states.steps_to_go)))
    parts = [
        team_simulated(config, *mapped(lambda leaf, k=k: leaf[k : k + TEAM_LANES], (states, key)), NUM_FUTURES)
        for k in range(0, len(key), TEAM_LANES)
    ]
    features, beyond = map(np.concatenate, zip(*parts, strict=True))
    if not len(beyond):
        return TeamExcess.none()
    coefficients = _ridge(features, beyond, np.sqrt((features**2).mean(axis=0)), TEAM_REG)
    low, high = np.quantile(features @ coefficients, RANGE)
    return TeamExcess(coefficients.astype(np.float32), float(min(low, 0.0)), float(max(high, 0.0)))


class _Deviating:
    """Takes the myopic action, or an alternative that is tried."""

    def __init__(self, config: WorldConfig) -> None:
        self.num_robots = config.num_robots
        self._base = MyopicPolicy(config)

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        explore_key, try_key = random.split(key)
        q = self._base.q_values(state)
        _, order = drawn(q, try_key)
        share = random.uniform(explore_key, 2)
        place = np.where(share[..., 0] < RANDOM_SHARE, (share[..., 1] * NUM_TRIED).astype(np.int64), 0)
        action = np.take_along_axis(order, np.minimum(place, order.shape[-1] - 1)[..., None], axis=-1)[..., 0]
        is_possible = np.take_along_axis(q, action[..., None], axis=-1)[..., 0] > -np.inf
        return surely(np.where(is_possible, action, order[..., 0]))


def drawn(q: Float[np.ndarray, "B A"], key: Key) -> tuple[Bool[np.ndarray, "B A"], np.ndarray]:
    """Mask of the tried actions: the best by Q, and others drawn with odds that rise with Q; and all in that order."""
    share = random.uniform(key, q.shape[-1]).astype(np.float64)
    gumbel = -np.log(-np.log(np.clip(share, 1e-12, 1.0 - 1e-7)))
    with np.errstate(invalid="ignore"):
        short = np.maximum((q - q.max(axis=-1, keepdims=True)), TEAM_LEAST)
    perturbed = np.where(q > -np.inf, short + TEAM_TEMPERATURE * gumbel, -np.inf)
    np.put_along_axis(perturbed, q.argmax(axis=-1)[..., None], np.inf, axis=-1)
    order = np.argsort(-perturbed, axis=-1, kind="stable")
    is_tried = np.zeros(q.shape, dtype=bool)
    np.put_along_axis(is_tried, order[..., :NUM_TRIED], True, axis=-1)
    return is_tried & (q > -np.inf), order


def visited(config: WorldConfig, layouts: Layout, seed: int, num_states: int) -> TableState:
    """States drawn at random from trajectories on some tables; one axis."""
    num = max(1, int(np.ceil(num_states / STATES_A_TRAJECTORY)))
    played = play(config, layouts, _Deviating(config), random.fold_in(random.key_of(seed), 1), num)
    at = np.nonzero(played.is_taken)
    chosen = np.random.default_rng([seed, 1]).permutation(len(at[0]))[:num_states]
    return mapped(lambda leaf: leaf[tuple(index[chosen] for index in at)], played.states)


def team_simulated(
    config: WorldConfig, state: TableState, key: Key, num_futures: int
) -> tuple[Float[np.ndarray, "R F"], Float[np.ndarray, " R"]]:
    """Try alternatives to the myopic action in some states; R rows.

    Returns the features of each minus those of the myopic action, and the error of the myopic look in their difference,
    averaged over the futures.
    """
    future_key, try_key = random.split(key)
    base = MyopicPolicy(config)
    q = base.q_values(state)
    is_tried, _ = drawn(q, try_key)
    best = q.argmax(axis=-1)[:, None]
    reward = future_rewards(config, state, base, future_key, num_futures, is_tried)
    reward = np.where(is_tried, np.where(is_tried[:, None], reward, 0.0).mean(axis=1), 0.0)
    beyond = np.where(is_tried, reward - np.where(is_tried, q, 0.0), 0.0)
    features = team_described(state, q)
    of_best = np.take_along_axis(features, best[..., None], axis=1)
    np.put_along_axis(is_tried, best, False, axis=-1)
    gained = beyond - np.take_along_axis(beyond, best, axis=-1)
    return (features - of_best)[is_tried].astype(np.float64), gained[is_tried].astype(np.float64)


def counting_time(config: WorldConfig, unpriced_per_s: float) -> WorldConfig:
    """The same team; a second of the table's clock costs `unpriced_per_s` if it cost nothing [1/s]."""
    return config if config.reward_per_s else replace(config, reward_per_s=-unpriced_per_s)
