"""What the log of a team tells of its laws where several robots act at once: which looks, and what washing showed.

*Looks.* What another robot holds in the air hides nothing and is seen whole, and no log says since when it is held. So
labels count only where nobody was at an object when they were made, and where the stage brought one look: in a stage
in which a robot came to its end, which frees nobody, there were two. Which looks those are does not depend on what they
said.

*Washing.* The reward of a stage holds what all robots did in it. Failures, LIFTs and seconds have known prices, so that
what is left over, where one object left the table, shows whether it was dirty. The last stage of a trajectory tells
nothing, as its reward holds the price of what is left, too; nor does one in which a robot was at the last of its
decisions, as nobody wrote down when that ended.
"""

import numpy as np

from halfseen.arrays import record
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float
from halfseen.tables.encoding import logged_actions
from halfseen.tables.rewards import outcomes_of
from halfseen.world.actions import FINISH, ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.others import is_decider
from halfseen.world.state import TableState

FAILED, LIFTED_S, LASTED_S, NUM_LEFT, DIRT_LEFT, DIRT_BEFORE = range(6)
"""Columns of `outcomes_of`."""


def is_plain_look(states: TableState) -> Bool[np.ndarray, "n T"]:
    """Whether the look before each stage was one, and nobody was at an object then."""
    robots = states.robots
    assert robots is not None
    is_nobody_at_work = ~np.any(robots.is_busy & np.isin(robots.verb, (1, 2)), axis=-1)
    num_done = robots.is_done.sum(axis=-1)
    return is_nobody_at_work & (np.diff(num_done, axis=1, prepend=0) == 0)


@record
class Brought:
    """What the stages of a team's log brought."""

    outcome: Float[np.ndarray, "n T 6"]
    """As `outcomes_of` has them."""
    reward: Float[np.ndarray, "n T"]
    """NaN where not completed."""
    goes_on: Bool[np.ndarray, "n T"]
    """Completed stages that another one follows, in which no robot is at the last of its decisions."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the trajectory had come to its end, or was cut at once."""
    is_finish: Bool[np.ndarray, "n T"]
    """Stages that a FINISH began."""
    has_left: Bool[np.ndarray, "n T N"]
    """Which objects left the table; of no meaning where the trajectory does not go on."""


def brought_by(logs: Logs, states: TableState) -> Brought:
    """Read what each stage brought."""
    at, (num, horizon) = stage_places(logs), states.steps_to_go.shape
    action, space = logged_actions(logs, horizon, states.num_objects, is_team=True), ActionSpace(states.num_objects)
    reward, clock_s = np.full((num, horizon), np.nan), np.full((num, horizon), np.nan)
    for values, column in ((reward, "reward"), (clock_s, "elapsed_s")):
        values[at] = logs.stages[column].to_numpy(dtype=np.float64, na_value=np.nan)
    is_stage = np.zeros((num, horizon + 1), dtype=bool)
    is_stage[at] = True
    lasted_s = np.nan_to_num(np.diff(clock_s, axis=1, prepend=0.0))
    robots = states.robots
    assert robots is not None
    is_at_last = (is_decider(states) & (robots.decisions_to_go == 1)) | (robots.is_busy & (robots.decisions_to_go == 0))
    goes_on = np.isfinite(reward) & is_stage[:, 1:]
    after = np.concatenate([states.is_on_table[:, 1:], np.zeros_like(states.is_on_table[:, :1])], axis=1)
    return Brought(
        outcomes_of(states, space.verb(action), space.target(action), lasted_s),
        reward,
        goes_on & ~np.any(is_at_last, axis=-1),
        np.isfinite(reward) & ~is_stage[:, 1:],
        is_stage[:, :-1] & (action == FINISH),
        states.is_on_table & ~after,
    )


def beside_prices(brought: Brought, config: WorldConfig) -> Float[np.ndarray, "n T"]:
    """What each stage paid beside failures, LIFTs and seconds."""
    prices = (config.reward_wash_failed, config.reward_lift_per_s, config.reward_per_s)
    return brought.reward - brought.outcome[..., : LASTED_S + 1] @ np.array(prices, dtype=np.float64)


def shown_by_washing(brought: Brought, config: WorldConfig) -> Bool[np.ndarray, "2 n N"]:
    """Which objects washing showed to be dirty, and which clean."""
    is_one = brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1)
    paid = np.where(is_one, beside_prices(brought, config), np.nan)
    is_clean = np.abs(paid - config.reward_wash_dirty) >= np.abs(paid - config.reward_wash_clean)
    each = [is_one & ~is_clean, is_one & is_clean]
    return np.stack([np.any(brought.has_left & which[..., None], axis=1) for which in each])
