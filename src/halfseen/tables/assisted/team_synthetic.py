"""E of a team: what the myopic look misses, from futures that are simulated in a known world.

For a state S with myopic action a*, and another action a, in futures of S in which all robots are myopic ever after,

    E(S, a)  ←  (Σ R after a) − (Σ R after a*) − (Q(S, a) − Q(S, a*)),    Q that of the myopic look:

eq. 3 with the myopic policy in the place of the maximum, run through to the end of each trajectory, so that no error
of a later E is in an earlier one. Both meet the same hidden truth and the same draws: the noise of their difference is
less than that of one stage and the value of what follows. E is linear in the features of `team_features`, by ridge
regression on differences of features, and kept within the range of what was fitted.

States are those of trajectories on the log's tables, in which robots deviate from the myopic action now and then.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners.futures import future_rewards
from halfseen.planners.myopic import MyopicPolicy
from halfseen.shapes import Bool, Float
from halfseen.tables.assisted.team_features import team_described
from halfseen.tables.assisted.team_policy import TeamExcess
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, surely
from halfseen.world.random import Key
from halfseen.world.rollout import play
from halfseen.world.state import Layout, TableState

NUM_STATES, NUM_FUTURES = 5000, 2
NUM_TRIED = 4
"""Actions that are tried in each state, the myopic one among them."""
RANDOM_SHARE = 0.3
"""Probability that another one of these is taken on the way, and not the myopic one."""
TEMPERATURE, LEAST = 0.7, -3.0
"""Of the draw of what is tried: log-odds of an action by what it falls short of the best, at least `LEAST`."""
REG = 3e-2
"""λ, of features of unit mean square."""
RANGE = (0.01, 0.99)
"""Quantiles of what was fitted within which E is kept."""
STATES_A_TRAJECTORY = 4.0
"""Picked of each, about."""
LANES = 64
"""States whose futures are played at once: their arrays stay in the cache of a core."""


class Tried(NamedTuple):
    """Actions tried beside the myopic one; R rows."""

    features: Float[np.ndarray, "R F"]
    """Of the action less those of the myopic one."""
    beyond: Float[np.ndarray, " R"]
    """By how much it did better than the myopic look says, in the mean of the futures."""


class _Deviating:
    """Takes the myopic action, or one that is tried beside it."""

    def __init__(self, config: WorldConfig) -> None:
        self.num_robots = config.num_robots
        self._base = MyopicPolicy(config)

    def decide(self, state: TableState, key: Key) -> Decision:
        explore_key, try_key = random.split(key)
        q = self._base.q_values(state)
        _, order = drawn(q, try_key)
        drawn_share = random.uniform(explore_key, 2)
        place = np.where(drawn_share[..., 0] < RANDOM_SHARE, (drawn_share[..., 1] * NUM_TRIED).astype(np.int64), 0)
        action = np.take_along_axis(order, np.minimum(place, order.shape[-1] - 1)[..., None], axis=-1)[..., 0]
        is_possible = np.take_along_axis(q, action[..., None], axis=-1)[..., 0] > -np.inf
        return surely(np.where(is_possible, action, order[..., 0]))


def drawn(q: Float[np.ndarray, "B A"], key: Key) -> tuple[Bool[np.ndarray, "B A"], np.ndarray]:
    """Which actions are tried: the best by Q, and others, the likelier the more they promise; and all in that order."""
    share = random.uniform(key, q.shape[-1]).astype(np.float64)
    gumbel = -np.log(-np.log(np.clip(share, 1e-12, 1.0 - 1e-7)))
    with np.errstate(invalid="ignore"):
        short = np.maximum((q - q.max(axis=-1, keepdims=True)), LEAST)
    perturbed = np.where(q > -np.inf, short + TEMPERATURE * gumbel, -np.inf)
    np.put_along_axis(perturbed, q.argmax(axis=-1)[..., None], np.inf, axis=-1)
    order = np.argsort(-perturbed, axis=-1, kind="stable")
    is_tried = np.zeros(q.shape, dtype=bool)
    np.put_along_axis(is_tried, order[..., :NUM_TRIED], True, axis=-1)
    return is_tried & (q > -np.inf), order


def fitted_team_excess(
    config: WorldConfig, layouts: Layout, seed: int, num_states: int = NUM_STATES, num_futures: int = NUM_FUTURES
) -> TeamExcess:
    """Simulate in a known world, and fit E.

    Parameters
    ----------
    config
        The world.
    layouts
        Tables to begin with, in turn.
    seed
        Of all draws.
    num_states
        In how many states actions are tried.
    num_futures
        In how many futures each.
    """
    states = visited(config, layouts, seed, num_states)
    key = random.fold_in(random.key_of(seed), np.arange(len(states.steps_to_go)))
    starts = range(0, len(key), LANES)
    parts = [
        simulated(config, *mapped(lambda leaf, k=k: leaf[k : k + LANES], (states, key)), num_futures) for k in starts
    ]
    tried = Tried(*map(np.concatenate, zip(*parts, strict=True)))
    if not len(tried.beyond):
        return TeamExcess.none()
    coefficients = _regressed(*tried)
    low, high = np.quantile(tried.features @ coefficients, RANGE)
    return TeamExcess(coefficients.astype(np.float32), float(min(low, 0.0)), float(max(high, 0.0)))


def visited(config: WorldConfig, layouts: Layout, seed: int, num_states: int) -> TableState:
    """States of trajectories on some tables, drawn at random; one axis."""
    num = max(1, int(np.ceil(num_states / STATES_A_TRAJECTORY)))
    played = play(config, layouts, _Deviating(config), random.fold_in(random.key_of(seed), 1), num)
    at = np.nonzero(played.is_taken)
    chosen = np.random.default_rng([seed, 1]).permutation(len(at[0]))[:num_states]
    return mapped(lambda leaf: leaf[tuple(index[chosen] for index in at)], played.states)


def simulated(config: WorldConfig, state: TableState, key: Key, num_futures: int) -> Tried:
    """Try actions in some states."""
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
    return Tried(
        (features - of_best)[is_tried].astype(np.float64),
        (beyond - np.take_along_axis(beyond, best, axis=-1))[is_tried].astype(np.float64),
    )


def _regressed(features: Float[np.ndarray, "R F"], target: Float[np.ndarray, " R"]) -> Float[np.ndarray, " F"]:
    """Ridge regression without an offset, on features of unit mean square."""
    size = np.sqrt((features**2).mean(axis=0))
    scale = np.where(size > 1e-4, size, np.inf)
    unit = features / scale
    gram = unit.T @ unit / len(unit) + REG * np.eye(unit.shape[1])
    return np.linalg.solve(gram, unit.T @ target / len(unit)) / scale


def counting_time(config: WorldConfig, unpriced_per_s: float) -> WorldConfig:
    """The same team, in which a second of the table's clock costs so much where it costs nothing [1/s]."""
    return config if config.reward_per_s else replace(config, reward_per_s=-unpriced_per_s)
