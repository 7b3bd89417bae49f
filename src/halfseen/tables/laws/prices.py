"""What a log of tables tells of prices and times, which nobody need say: rewards of each verb, transport and limit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.logs import Logs
from halfseen.shapes import Float
from halfseen.tables.grasp.attempts import attempts
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping

ENOUGH_LEFT = 5.0
"""Dirty objects expected to be left, from which on FINISHes that paid nothing say that leaving them costs nothing."""
ENOUGH_HELD = 20
"""WASHes that held, from which on one reward of all of them is that of dirty objects and of clean ones."""
SAME = 1e-3
"""By how much multiples of a price may be off, in units of it."""


def paid_in(logs: Logs, horizon: int, left: Rows) -> WorldConfig:
    """Read prices and times off a log; what it does not tell is as `WorldConfig` has it.

    Parameters
    ----------
    logs
        A log of tables.
    horizon
        T, of each robot.
    left
        Objects expected to be dirty on the table before each stage of the log.

    Returns
    -------
    WorldConfig
        With the assumed laws, whose limit of an attempt is that of the log.
    """
    known, stages = WorldConfig(horizon=horizon), logs.stages
    reward = stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
    action = stages["action"].to_numpy(dtype=object)
    seconds = _durations(logs)
    is_over = ~(stages["trajectory"] == stages["trajectory"].shift(-1)).to_numpy()
    done = np.isfinite(reward)
    found: dict[str, float] = {}
    finished = done & (action == Verb.FINISH.name)
    if finished.any():
        found["transport_s"] = float(np.median(seconds[finished]))
        price = price_of_each(reward[finished], left[finished])
        if price is not None:
            found["reward_dirty_left"] = price
    found |= _washed(logs, horizon, reward, action, is_over)
    lifted = done & (action == Verb.LIFT.name) & ~is_over
    if lifted.any():
        found["reward_lift_per_s"] = float(reward[lifted] @ seconds[lifted] / (seconds[lifted] @ seconds[lifted]))
    known = replace(known, **found)
    attempted = done & np.isin(action, [Verb.WASH.name, Verb.LIFT.name])
    if attempted.any():
        longest = float(seconds[attempted].max()) - float(known.transport_s)
        if longest > 0.0:
            known = replace(known, grasping=AssumedGrasping(limit_s=longest))
    return known


def _durations(logs: Logs) -> Float[np.ndarray, " rows"]:
    elapsed = logs.stages["elapsed_s"]
    before = elapsed.groupby(logs.stages["trajectory"]).shift(fill_value=0.0)
    return (elapsed - before).to_numpy(dtype=np.float64, na_value=np.nan)


def price_of_each(paid: Rows, left: Rows) -> float | None:
    """Price of one object left dirty: what all that FINISH paid is a multiple of; else by regression.

    None where too little was left to tell.
    """
    some = paid < 0.0
    if not some.any():
        return 0.0 if left.sum() > ENOUGH_LEFT else None
    slope = float(paid @ left / (left @ left))
    for of_least in (1, 2, 3):
        price = float(paid[some].max()) / of_least
        count = paid / price
        if np.abs(count - np.round(count)).max() < SAME and 0.67 < slope / price < 1.5:
            return price
    return slope


def _washed(logs: Logs, horizon: int, reward: Rows, action: np.ndarray, is_over: np.ndarray) -> dict[str, float]:
    """Rewards of WASH: of what was dirty, of what was clean, and of a miss."""
    tried: Any = attempts(logs, horizon)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    keys: Any = logs.stages[["trajectory", "stage"]]
    row = pd.MultiIndex.from_frame(keys).get_indexer(pd.MultiIndex.from_frame(tried[["trajectory", "stage"]]))
    is_wash = (action[row] == Verb.WASH.name) & np.isfinite(reward[row])
    held = tried["succeeded"].fillna(False).to_numpy(dtype=bool)
    paid_held, paid_missed = reward[row[is_wash & held & ~is_over[row]]], reward[row[is_wash & ~held & ~is_over[row]]]
    found: dict[str, float] = {}
    if len(paid_missed):
        found["reward_wash_failed"] = float(np.median(paid_missed))
    return found | dirty_and_clean(paid_held)


def dirty_and_clean(paid: Rows) -> dict[str, float]:
    """Rewards of what was dirty and of what was clean: the upper and the lower of those that WASHes paid.

    Where few all paid alike, what pays is of dirty objects, and what costs is of clean ones.
    """
    if not len(paid):
        return {}
    if np.ptp(paid) == 0.0:
        if len(paid) >= ENOUGH_HELD:
            return dict.fromkeys(("reward_wash_dirty", "reward_wash_clean"), float(paid[0]))
        return {"reward_wash_dirty" if paid[0] > 0.0 else "reward_wash_clean": float(paid[0])}
    is_dirty = paid >= (paid.min() + paid.max()) / 2.0
    each = {"reward_wash_dirty": paid[is_dirty], "reward_wash_clean": paid[~is_dirty]}
    return {name: float(np.median(some)) for name, some in each.items()}
