"""What the log of a team tells of prices and times: as `prices` does of one robot, and the price of the clock.

A stage pays for all that ends in it. Where no object left the table and the trajectory goes on, its reward is certain
given how many WASHes failed, the seconds of the LIFTs that ended and its own: a regression tells their prices exactly.
What is left over where one object left is what a dirty or a clean one pays; and where the last robot parked, what the
objects cost that are left dirty. The last one to park alone takes what going home takes.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float
from halfseen.tables.grasp.attempts import attempts
from halfseen.tables.laws.prices import dirty_and_clean, price_of_each
from halfseen.tables.laws.team_evidence import (
    DIRT_BEFORE,
    FAILED,
    LASTED_S,
    LIFTED_S,
    NUM_LEFT,
    Brought,
    beside_prices,
    brought_by,
)
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping
from halfseen.world.state import TableState

ROUNDING = 1e-6
"""Prices of a second nearer to 0 are 0."""


def paid_in_team(logs: Logs, states: TableState) -> WorldConfig:
    """Read prices, times and speeds off the log of a team; what it does not tell is as `WorldConfig` has it.

    Parameters
    ----------
    logs
        The log.
    states
        Its states, axes (n, T).

    Returns
    -------
    WorldConfig
        With the assumed laws, whose limit of an attempt is that of the log; robot 0 has speed 1.
    """
    num_robots = states.num_robots
    known = WorldConfig(horizon=states.steps_to_go.shape[1] // num_robots, speed=(1.0,) * num_robots)
    brought = brought_by(logs, states)
    known = replace(known, **_certain(brought))
    is_last, home_s = _last_to_park(brought, states)
    known = replace(known, **_washed(brought, known), **_left(brought, known, is_last), **_times(home_s, num_robots))
    limit_s = _limit_s(logs, known)
    return known if limit_s is None else replace(known, grasping=AssumedGrasping(limit_s=limit_s))


def _certain(brought: Brought) -> dict[str, float]:
    """Prices of a failed WASH, a second of a LIFT, and one of the clock."""
    names = {FAILED: "reward_wash_failed", LIFTED_S: "reward_lift_per_s", LASTED_S: "reward_per_s"}
    outcome = brought.outcome[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 0)]
    told = [column for column in names if np.any(outcome[:, column] != 0.0)]
    if not told:
        return {}
    paid = brought.reward[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 0)]
    found = np.linalg.lstsq(outcome[:, told], paid, rcond=None)[0]
    prices = {names[column]: float(price) for column, price in zip(told, found, strict=True)}
    if "reward_per_s" in prices:
        prices["reward_per_s"] = min(0.0, prices["reward_per_s"]) if abs(prices["reward_per_s"]) > ROUNDING else 0.0
    return prices


def _washed(brought: Brought, known: WorldConfig) -> dict[str, float]:
    """Rewards of what was dirty, and of what was clean."""
    paid = beside_prices(brought, known)[brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1)]
    return dirty_and_clean(paid)


def _last_to_park(
    brought: Brought, states: TableState
) -> tuple[Bool[np.ndarray, "n T"], dict[int, Float[np.ndarray, " k"]]]:
    """Completed stages in which the last robot went home, and how long each robot took for that [s]."""
    robots, decider = states.robots, states.decider
    assert robots is not None
    assert decider is not None
    others_done = np.sum(robots.is_parked, axis=-1) == robots.num_robots - 1
    parks = brought.is_last & others_done & ~np.any(robots.is_busy, axis=-1) & brought.is_finish
    seconds = brought.outcome[..., LASTED_S]
    return parks, {k: seconds[parks & (decider == k)] for k in range(robots.num_robots)}


def _left(brought: Brought, known: WorldConfig, is_last: Bool[np.ndarray, "n T"]) -> dict[str, float]:
    """Price of an object that is left dirty."""
    if not is_last.any():
        return {}
    # Nothing has left the table in such a stage, whose reward beside its seconds is the price of what is left.
    paid = brought.reward[is_last] - known.reward_per_s * brought.outcome[is_last, LASTED_S]
    price = price_of_each(_rounded(paid), brought.outcome[is_last, DIRT_BEFORE])
    return {} if price is None else {"reward_dirty_left": price}


def _rounded(paid: Rows) -> Rows:
    return np.where(np.abs(paid) < 1e-3, 0.0, paid)


def _times(home_s: dict[int, Float[np.ndarray, " k"]], num_robots: int) -> dict[str, object]:
    """Seconds of going home, and how fast each robot is beside robot 0; 1 where it does not show."""
    each = [float(np.median(home_s[k])) if len(home_s[k]) else np.nan for k in range(num_robots)]
    if np.isnan(each).all():
        return {}
    transport_s = each[0] if np.isfinite(each[0]) else float(np.nanmedian(each))
    speed = tuple(float(np.round(transport_s / s, 3)) if np.isfinite(s) else 1.0 for s in each)
    return {"transport_s": transport_s, "speed": speed}


def _limit_s(logs: Logs, known: WorldConfig) -> float | None:
    """Longest attempt without its transport, as robot 0 would take [s]."""
    tried: Any = attempts(logs)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    if not len(tried):
        return None
    seconds = tried["time_s"].to_numpy(dtype=np.float64) * np.asarray(known.speed)[tried["robot"].to_numpy()]
    longest = float(seconds.max()) - float(known.transport_s)
    return longest if longest > 0.0 else None
