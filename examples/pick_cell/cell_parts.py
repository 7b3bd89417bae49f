"""The cell: one part after another, three grippers, a person nearby, and an operator who stops what drags on.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
S         weight_kg of the part (0.1 to 3), shine of its surface (0 to 1; smooth ones shine), and clutter around it
          (0 to 1), which grows with each failed attempt: the part was moved
A         suction, parallel or soft, the grippers; from the second stage on also hand over (to a person) and stop
R         1 for a part that was picked, −0.2 for a failed attempt; a part handed over counts 0.8 − 0.25 weight_kg; and
          every second of the cell costs 0.01
          a part that was picked, handed over or left ends its trajectory; so does the fourth stage. So it is counted in
          picks, less what they cost: REWARD_UNIT
C         cut: the longer a stage drags on and the more clutter the camera looks into, the sooner somebody stops the
          cell or the camera loses the part: the hazard is (3/2) √(age/s) · RATE · exp(CLUTTER · clutter), age in
          the stage [s]. It knows of nothing else, so Cox's model on the clock of the stage is right; Kaplan–Meier on
          that of the trajectory, which knows nothing of clutter, is not
========  ==============================================================================================
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

GRIPPERS = ("suction", "parallel", "soft")
ACTIONS_ALL = (*GRIPPERS, "hand over", "stop")
HAND_OVER, STOP = ACTIONS_ALL.index("hand over"), ACTIONS_ALL.index("stop")
HORIZON = 4
ACTIONS = {1: list(GRIPPERS), **{stage: list(ACTIONS_ALL) for stage in range(2, HORIZON + 1)}}
COVARIATES = ["weight_kg", "shine", "clutter"]
WEIGHTS_KG = (0.1, 3.0)
COST_PER_S = 0.01
REWARD_UNIT = "net picks"
MOVED, MOVED_NOISE = 0.12, 0.06
"""What a failed attempt adds to clutter: mean and standard deviation."""
RATE, CLUTTER = 0.002, 3.0

Decision = Callable[[pd.DataFrame, int], Int[np.ndarray, " m"]]
"""(covariates, stage from 1) → index among `ACTIONS_ALL` for each row."""


class Outcome(NamedTuple):
    """What one stage brought, whether or not it was cut before it was over."""

    duration_s: Float[np.ndarray, " m"]
    reward: Float[np.ndarray, " m"]
    is_over: Bool[np.ndarray, " m"]
    """The part has left the cell, by whatever way."""
    clutter: Float[np.ndarray, " m"]
    """Afterwards."""
    cut_s: Float[np.ndarray, " m"]
    """Age of the stage at which it is cut, if it lasts so long [s]."""


def new_parts(num_parts: int, rng: np.random.Generator) -> pd.DataFrame:
    """Put parts into the cell."""
    drawn = rng.random((num_parts, 3)) * [WEIGHTS_KG[1] - WEIGHTS_KG[0], 1.0, 1.0] + [WEIGHTS_KG[0], 0.0, 0.0]
    return pd.DataFrame(drawn, columns=pd.Index(COVARIATES))


def chance_of_pick(parts: pd.DataFrame, action: Int[np.ndarray, " m"] | int) -> Float[np.ndarray, " m"]:
    """Chance that an attempt picks the part; 0 for what is no attempt."""
    weight, shine, clutter = (parts[name].to_numpy() for name in COVARIATES)
    suction = -1.0 + 3.5 * shine - 1.5 * (weight - 1.0) - 1.5 * clutter
    parallel = 1.2 + 0.8 * (weight - 1.0) - 4.0 * clutter * clutter
    soft = 1.0 - 2.2 * (weight - 0.5)
    never = np.full(len(parts), -np.inf)
    return 1.0 / (1.0 + np.exp(-np.choose(action, [suction, parallel, soft, never, never])))


def mean_duration_s(
    parts: pd.DataFrame, action: Int[np.ndarray, " m"] | int, is_picked: Bool[np.ndarray, " m"] | bool
) -> Float[np.ndarray, " m"]:
    """Mean duration of a stage [s]; a parallel gripper that fails is long at it, suction knows at once."""
    clutter = parts["clutter"].to_numpy()
    person, parked = np.full(len(parts), 12.0), np.full(len(parts), 3.0)
    picked = np.choose(action, [4.0 + 0.0 * clutter, 5.0 + 2.0 * clutter, 7.0 + 0.0 * clutter, person, parked])
    failed = np.choose(action, [5.0 + 0.0 * clutter, 9.0 + 12.0 * clutter, 9.0 + 0.0 * clutter, person, parked])
    return np.where(is_picked, picked, failed)


def mean_reward(
    parts: pd.DataFrame, action: Int[np.ndarray, " m"] | int, is_picked: Bool[np.ndarray, " m"] | bool
) -> Float[np.ndarray, " m"]:
    """Mean reward of a stage, its seconds included."""
    return _earned(parts, action, is_picked) - COST_PER_S * mean_duration_s(parts, action, is_picked)


def attempt(
    parts: pd.DataFrame, action: Int[np.ndarray, " m"], rng: np.random.Generator, rate: float = RATE
) -> Outcome:
    """Do something with each part, once; `rate` takes the place of RATE."""
    is_picked = rng.random(len(parts)) < chance_of_pick(parts, action)
    duration_s = mean_duration_s(parts, action, is_picked) * rng.gamma(4.0, 0.25, size=len(parts))
    clutter = parts["clutter"].to_numpy()
    moved = np.clip(clutter + MOVED + MOVED_NOISE * rng.normal(size=len(parts)), 0.0, 1.0)
    hazard = rate * np.exp(CLUTTER * clutter)
    return Outcome(
        duration_s=duration_s,
        reward=_earned(parts, action, is_picked) - COST_PER_S * duration_s,
        is_over=is_picked | (action >= HAND_OVER),
        clutter=moved,
        cut_s=(rng.exponential(size=len(parts)) / hazard) ** (2.0 / 3.0),
    )


def _earned(
    parts: pd.DataFrame, action: Int[np.ndarray, " m"] | int, is_picked: Bool[np.ndarray, " m"] | bool
) -> Float[np.ndarray, " m"]:
    attempted = np.where(is_picked, 1.0, -0.2)
    handed_over = 0.8 - 0.25 * parts["weight_kg"].to_numpy()
    return np.choose(action, [attempted, attempted, attempted, handed_over, np.zeros(len(parts))])
