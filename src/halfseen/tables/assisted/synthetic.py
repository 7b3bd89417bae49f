"""E: what the look one step ahead misses, by eq. 3 on trajectories of beliefs that are simulated in a known world.

With Q_h = Q_1 + E_h, backwards over steps to go h from E_1 ≡ 0 (with one step to go Q_1 is exact),

    E_h(b, a)  ←  Q°(b, a) − Q_1(b, a) + E[Q_1(b', a') + E_{h−1}(b', a') − V°(b')],    a' = argmax Q_1(b', ·),

for E[R + V°(b')] = Q°(b, a). So what is regressed are small differences, not rewards. E is linear in the features of
`features`, with coefficients for each verb and h, kept within the range of what was fitted, and 0 for FINISH. The
successor's action is that of Q_1, not the largest of Q_1 + E: one step of policy iteration, of which no error of E is
maximised over. With maxima over a linear Q that was not anchored the values diverged.

Trajectories begin as those of the log did: its tables, before any label. At each belief a few actions are tried, drawn
the likelier the more Q_1 promises; the best one is followed, or one of these.
"""

from typing import NamedTuple

import numpy as np

from halfseen.arrays import Array, library_of, mapped, record
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import Table, table_of
from halfseen.planners.trajectories import picked, successor
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.assisted.features import NUM_FEATURES, NUM_TABLE, Ahead, ahead_of
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.state import Layout
from halfseen.world.transition import start

NUM_TRAJECTORIES = 2000
NUM_TRIED = 4
"""Actions that are tried at each belief."""
RANDOM_SHARE = 0.3
"""Probability that one of these is followed, and not the best one."""
TEMPERATURE, LEAST = 1.0, -5.0
"""Of the draw of what is tried: log-odds of an action by what it falls short of the best, at least `LEAST`."""
REG = 1e-2
"""λ, of features of unit variance."""
RANGE = (0.01, 0.99)
"""Quantiles of what was fitted within which E is kept."""
FEWEST_ROWS = 100
LANES = 512
"""Trajectories that advance together: their arrays stay in the cache of a core."""


@record
class Excess:
    """E, linear by verb and steps to go; 0 for FINISH and with one step to go."""

    coefficients: Float[np.ndarray, "T 2 F"]
    """The offset first."""
    low: Float[np.ndarray, "T 2"]
    high: Float[np.ndarray, "T 2"]

    @classmethod
    def none(cls, horizon: int) -> "Excess":
        """E ≡ 0."""
        low, high = np.zeros((2, horizon, 2), dtype=np.float32)
        return cls(np.zeros((horizon, 2, 1 + NUM_FEATURES), dtype=np.float32), low, high)

    def __call__(self, ahead: Ahead) -> Float[Array, " C *B"]:
        """E of WASH and LIFT of each object."""
        xp, to_go = library_of(ahead.own, self.coefficients), ahead.table.steps_to_go - 1
        weights, low, high = (_by_steps(each, to_go) for each in (self.coefficients, self.low, self.high))
        of_table = weights[:, 0] + (weights[:, 1 : 1 + NUM_TABLE] * ahead.of_table).sum(axis=1)
        own = xp.einsum("vf...,fvn...->vn...", weights[:, 1 + NUM_TABLE :], ahead.own)
        values = xp.clip(of_table[:, None] + own, low[:, None], high[:, None])
        return values.reshape(-1, *values.shape[2:])


def _by_steps(each: Float[Array, "T ..."], to_go: Int[Array, "*B"]) -> Float[Array, "..."]:
    """Those of the steps to go of each table, the axes of the batch last."""
    xp, num_axes = library_of(each, to_go), np.ndim(to_go)
    return xp.moveaxis(xp.take(each, to_go, axis=0), range(num_axes), range(-num_axes, 0))


class Tried(NamedTuple):
    """Actions tried with h steps to go, and the best that may follow each; R rows."""

    verb: Int[np.ndarray, " R"]
    """0 for WASH, 1 for LIFT."""
    features: Float[np.ndarray, "R F"]
    beyond: Float[np.ndarray, " R"]
    """Q°(b, a) − Q_1(b, a) + Q_1(b', a') − V°(b')."""
    next_verb: Int[np.ndarray, " R"]
    """−1 for FINISH, and where nothing is left."""
    next_features: Float[np.ndarray, "R F"]


def fitted_excess(
    config: WorldConfig,
    layouts: Layout,
    seed: int,
    num_trajectories: int = NUM_TRAJECTORIES,
) -> Excess:
    """Simulate in a known world, and fit E.

    Parameters
    ----------
    config
        The world.
    layouts
        Tables to begin with, in turn.
    seed
        Of all draws.
    num_trajectories
        How many are simulated.
    """
    parts = [
        simulated(config, layouts, np.arange(first, min(first + LANES, num_trajectories)), seed)
        for first in range(0, num_trajectories, LANES)
    ]
    found = Excess.none(config.horizon)
    for to_go in range(2, config.horizon + 1):
        some = [part[to_go] for part in parts if to_go in part]
        if not some:
            continue
        tried = Tried(*map(np.concatenate, zip(*some, strict=True)))
        coefficients, low, high = (each[to_go - 2] for each in (found.coefficients, found.low, found.high))
        after = np.zeros(len(tried.verb))
        for verb in range(2):
            at = tried.next_verb == verb
            values = coefficients[verb, 0] + tried.next_features[at] @ coefficients[verb, 1:]
            after[at] = np.clip(values, low[verb], high[verb])
        for verb in range(2):
            rows = tried.verb == verb
            if rows.sum() < FEWEST_ROWS:
                continue
            of_verb = _regressed(tried.features[rows], (tried.beyond + after)[rows])
            fit = of_verb[0] + tried.features[rows] @ of_verb[1:]
            found.coefficients[to_go - 1, verb] = of_verb
            found.low[to_go - 1, verb], found.high[to_go - 1, verb] = np.quantile(fit, RANGE)
    return found


def _regressed(features: Float[np.ndarray, "R F"], target: Float[np.ndarray, " R"]) -> Float[np.ndarray, " F1"]:
    """Ridge regression on features of unit variance; the offset, which is not shrunk, first."""
    features = features.astype(np.float64)
    mean, std = features.mean(axis=0), features.std(axis=0)
    scale = np.where(std > 1e-4, std, np.inf)
    unit = (features - mean) / scale
    gram = unit.T @ unit / len(unit) + REG * np.eye(unit.shape[1])
    slope = np.linalg.solve(gram, unit.T @ (target - target.mean()) / len(unit)) / scale
    return np.append(target.mean() - slope @ mean, slope)


def simulated(config: WorldConfig, layouts: Layout, trajectory: Int[np.ndarray, " R"], seed: int) -> dict[int, Tried]:
    """Simulate some trajectories, by number: what was tried at each number of steps to go at which any is left."""
    rng, found = np.random.default_rng([seed, int(trajectory[0])]), {}
    ahead = ahead_of(config, _begun(config, layouts, trajectory, seed))
    for to_go in range(config.horizon, 1, -1):
        tried, is_possible = _to_try(ahead, rng)
        after = ahead_of(config, after_each(config, ahead, tried, rng))
        found[to_go] = rows_of(ahead, tried, is_possible, after)
        # Trajectories that end here are followed no more.
        is_explored = rng.random(tried.shape[1]) < RANDOM_SHARE
        place = is_explored * is_possible[1]
        num_lanes = tried.shape[1]
        is_finish = ahead.one_step.max(axis=0) <= 0.0
        followed = place * num_lanes + np.arange(num_lanes)
        goes_on = (~is_finish | is_explored) & after.table.is_there.any(axis=0)[followed]
        if not goes_on.any():
            break
        ahead = picked(after, followed[goes_on])
    return found


def _begun(config: WorldConfig, layouts: Layout, trajectory: Int[np.ndarray, " R"], seed: int) -> Table:
    """Tables after the first look."""
    layout = mapped(lambda leaf: leaf[trajectory % len(leaf)], layouts)
    state, _ = start(config, layout, random.fold_in(random.key_of(seed), trajectory))
    return table_of(belief_of(config, state))


def _to_try(ahead: Ahead, rng: np.random.Generator) -> tuple[Int[np.ndarray, "M R"], Bool[np.ndarray, "M R"]]:
    """The best action by Q_1 but FINISH, others drawn the likelier the more they promise; and which there are."""
    q = ahead.one_step
    best = q.argmax(axis=0)
    short = (q - q.max(axis=0)) / TEMPERATURE
    perturbed = np.where(np.isfinite(q), np.maximum(short, LEAST) + rng.gumbel(size=q.shape), -np.inf)
    perturbed[best, np.arange(len(best))] = np.inf
    tried = np.argsort(-perturbed, axis=0)[:NUM_TRIED]
    return tried, np.take_along_axis(perturbed, tried, axis=0) > -np.inf


def after_each(config: WorldConfig, ahead: Ahead, tried: Int[np.ndarray, "M R"], rng: np.random.Generator) -> Table:
    """What is believed after each action that is tried."""
    lanes = np.tile(np.arange(tried.shape[1]), len(tried))
    table, look = picked((ahead.table, ahead.look), lanes)
    draws = rng.random((1 + len(table.is_there), len(lanes)), dtype=np.float32)
    return successor(config, table, look, tried.ravel(), draws)


def rows_of(ahead: Ahead, tried: Int[np.ndarray, "M R"], is_possible: Bool[np.ndarray, "M R"], after: Ahead) -> Tried:
    """Rows of what was tried, where it is possible, by what was believed after it."""
    choice, kept = tried.ravel(), is_possible.ravel()
    lanes = np.tile(np.arange(tried.shape[1]), len(tried))
    choice, lanes = choice[kept], lanes[kept]
    one_step, control = ahead.values[:, choice, lanes]
    reached = np.flatnonzero(kept)
    best = after.one_step[:, reached].argmax(axis=0)
    worth = after.one_step[best, reached]
    follows = worth > 0.0
    beyond = control - one_step + np.where(follows, worth, 0.0) - after.control[reached]
    num_objects = len(ahead.table.is_there)
    return Tried(
        verb=choice // num_objects,
        features=features_of(ahead, choice, lanes),
        beyond=beyond,
        next_verb=np.where(follows, best // num_objects, -1),
        next_features=features_of(after, best, reached),
    )


def features_of(ahead: Ahead, choice: Int[np.ndarray, " R"], lanes: Int[np.ndarray, " R"]) -> Float[np.ndarray, "R F"]:
    """Features of an action at some of the beliefs."""
    own = ahead.own.reshape(len(ahead.own), -1, ahead.own.shape[-1])[:, choice, lanes]
    return np.concatenate([ahead.of_table[:, lanes], own]).T
