"""What policies of the cell are worth: exactly, on a grid of weight, shine and clutter, backwards over the stages.

Only clutter changes along a trajectory, so E V_{t+1} is a matrix on the last axis; between grid points V is linear.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd
from cell_parts import (
    ACTIONS,
    ACTIONS_ALL,
    COVARIATES,
    GRIPPERS,
    HAND_OVER,
    HORIZON,
    MOVED,
    MOVED_NOISE,
    WEIGHTS_KG,
    Decision,
    chance_of_pick,
    mean_reward,
)
from jaxtyping import Float
from scipy.stats import norm

AXES = (np.linspace(*WEIGHTS_KG, 21), np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 41))
SHAPE = tuple(len(axis) for axis in AXES)
STATES = pd.DataFrame({n: a.ravel() for n, a in zip(COVARIATES, np.meshgrid(*AXES, indexing="ij"), strict=True)})
NUM_QUANTILES = 200


def optimum() -> tuple[float, list[Float[np.ndarray, "W H C A"]]]:
    """Find the largest expected reward of a trajectory, and Q of each stage on the grid; −inf where not possible."""
    value, q_of_stage = np.zeros(SHAPE), []
    for stage in range(HORIZON, 0, -1):
        q = np.stack([_q_of(value, action) for action in range(len(ACTIONS_ALL))], axis=-1)
        q[..., ~np.isin(ACTIONS_ALL, ACTIONS[stage])] = -np.inf
        value = q.max(axis=-1)
        q_of_stage.insert(0, q)
    return _mean_over_parts(value), q_of_stage


def policy_value(decide: Decision) -> float:
    """Expected reward of a trajectory under a policy."""
    return chances_value(lambda parts, stage: np.eye(len(ACTIONS_ALL))[decide(parts, stage)])


def chances_value(chances: Callable[[pd.DataFrame, int], Float[np.ndarray, "m A"]]) -> float:
    """Expected reward of a trajectory under a policy that draws its actions."""
    value = np.zeros(SHAPE)
    for stage in range(HORIZON, 0, -1):
        each = chances(STATES, stage).reshape(*SHAPE, len(ACTIONS_ALL))
        value = sum((each[..., action] * _q_of(value, action) for action in range(len(ACTIONS_ALL))), np.zeros(SHAPE))
    return _mean_over_parts(value)


def best_order() -> tuple[float, tuple[str, ...]]:
    """Find the best of all fixed orders of actions: its value, and the actions in their order.

    An order ends with a person, with stopping, or with the fourth stage; all others begin with a gripper each.
    """
    # The last stage first: an order is worth what its first action brings, and then the rest of it.
    rests: list[tuple[Float[np.ndarray, "W H C"], tuple[str, ...]]] = [(np.zeros(SHAPE), ())]
    for stage in range(HORIZON, 0, -1):
        longer = [(_q_of(value, ACTIONS_ALL.index(name)), (name, *rest)) for value, rest in rests for name in GRIPPERS]
        ends = [(_q_of(np.zeros(SHAPE), a), (ACTIONS_ALL[a],)) for a in range(HAND_OVER, len(ACTIONS_ALL))]
        rests = longer + (ends if stage > 1 else [])
    return max((_mean_over_parts(value), names) for value, names in rests)


def _q_of(later: Float[np.ndarray, "W H C"], action: int) -> Float[np.ndarray, "W H C"]:
    picked, earned, failed = _constants(action)
    goes_on = 0.0 if action >= HAND_OVER else later @ _moved().T
    return earned + (1.0 - picked) * (failed + goes_on)


@cache
def _constants(
    action: int,
) -> tuple[Float[np.ndarray, "W H C"], Float[np.ndarray, "W H C"], Float[np.ndarray, "W H C"]]:
    """Chance of a pick, what it brings on average, and what it costs if there is none."""
    picked = chance_of_pick(STATES, action)
    earned = picked * mean_reward(STATES, action, True)
    return picked.reshape(SHAPE), earned.reshape(SHAPE), mean_reward(STATES, action, False).reshape(SHAPE)


@cache
def _moved() -> Float[np.ndarray, "C C"]:
    """Row c: the weights of V's grid points in E V(clutter after a failed attempt)."""
    grid = AXES[-1]
    noise = MOVED_NOISE * norm.ppf((np.arange(NUM_QUANTILES) + 0.5) / NUM_QUANTILES)
    after = np.clip(grid[:, None] + MOVED + noise, 0.0, 1.0) * (len(grid) - 1)
    below = np.minimum(after.astype(np.int64), len(grid) - 2)
    weights = np.zeros((len(grid), len(grid)))
    row = np.broadcast_to(np.arange(len(grid))[:, None], below.shape)
    np.add.at(weights, (row, below), (below + 1 - after) / NUM_QUANTILES)
    np.add.at(weights, (row, below + 1), (after - below) / NUM_QUANTILES)
    return weights


def _mean_over_parts(value: Float[np.ndarray, "W H C"]) -> float:
    """Mean over new parts, uniform on the box, by the trapezoidal rule."""
    for num_points in SHAPE:
        weight = np.ones(num_points)
        weight[[0, -1]] = 0.5
        value = np.tensordot(weight / weight.sum(), value, axes=1)
    return float(value)
