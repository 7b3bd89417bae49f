"""The numbers of the world: this project's own choice, stated in one place.

The paper prints none of them. Whoever compares results must compare them under the same configuration; the study
prints it.
"""

from dataclasses import dataclass, field
from typing import TypeAlias

import jax
from jax import Array

HORIZON = 10

Number: TypeAlias = float | int | Array
"""A plain number, or what JAX makes of it inside a compiled call."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WorldConfig:
    """Parameters of the table world (a pytree whose leaves may be traced; only `horizon` is static).

    Parameters
    ----------
    horizon
        Steps after which a path ends by itself.
    dirty_share
        Prior probability that an object is DIRTY.
    grip_offset_std
        Standard deviation of the hidden grip offset u.
    grasp_log_time, grasp_log_time_per_occlusion
        Log of the scale of the time to grasp, T = exp(a + b·occ − u)·E with E ~ Exp(1) [log s].
    attempt_limit_s
        τ: an attempt succeeds when T ≤ τ [s].
    transport_s
        Time that every action takes on top of its attempt; FINISH takes only this (the arm goes home) [s].
    reward_wash_dirty, reward_wash_clean, reward_wash_failed
        Reward of WASH.
    reward_lift_per_s
        Reward of LIFT for each second of the attempt, transport included [1/s].
    reward_dirty_left
        Reward for each dirty object on the table when the path ends.
    label_floor, label_gain, label_power
        A label is right with probability floor + gain·(1 − occ)^power.
    """

    dirty_share: Number = 0.6
    grip_offset_std: Number = 1.0
    grasp_log_time: Number = 0.6
    grasp_log_time_per_occlusion: Number = 2.2
    attempt_limit_s: Number = 6.0
    transport_s: Number = 1.0
    reward_wash_dirty: Number = 5.0
    reward_wash_clean: Number = -10.0
    reward_wash_failed: Number = -1.0
    reward_lift_per_s: Number = -0.1
    reward_dirty_left: Number = -5.0
    label_floor: Number = 0.5
    label_gain: Number = 0.3
    label_power: Number = 1.5
    horizon: int = field(default=HORIZON, metadata={"static": True})
