"""The value of a policy by simulation, with its variance reduced by a control variate.

With V° and Q° of `one_step` under the true laws, the reward of a trajectory has the same mean as

    V°(b_1) + Σ_t (Q°(b_t, a_t) − V°(b_t)),

because E[R_t + V°(b_{t+1}) | b_t, a_t] = Q°(b_t, a_t), and V° is 0 after the end. With one step to go, the exact Q_1
replaces Q°. The advantages are small if V° is near the policy's value, so little noise remains: about a quarter of the
tables gives the same precision.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from halfseen.arrays import at, library_of, mapped
from halfseen.planners import one_step
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.rollout import BATCH, in_parts, side_by_side, stages_of_play
from halfseen.world.state import Layout, TableState
from halfseen.world.transition import start


class Controlled(NamedTuple):
    """Variance-reduced reward of a policy on B tables, in two parts, and duration."""

    value: Float[np.ndarray, " B"]
    """V°(b_1), the same for all policies."""
    advantage: Float[np.ndarray, " B"]
    """Σ_t (Q°(b_t, a_t) − V°(b_t))."""
    robot_s: Float[np.ndarray, " B"]
    """The table's clock at the trajectory's own end [s]."""

    @property
    def reward(self) -> Float[np.ndarray, " B"]:
        """Estimate with the same mean as the reward of each trajectory, but less variance."""
        return self.value + self.advantage


def controlled(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[np.ndarray, " B"]
) -> Controlled:
    """Play the same tables as `halfseen.world.rollout.evaluate_some`, for one robot.

    `config` is the true world.

    Raises
    ------
    ArgumentError
        The world's laws can only be sampled from.
    """
    return in_parts(_controlled, config, layouts, policy, key, episode)


def controlled_each(
    config: WorldConfig, layouts: Layout, policies: Sequence[Policy], key: Key, episode: Int[np.ndarray, " B"]
) -> list[Controlled]:
    """Result of `controlled` for each policy; playing them side by side is faster."""
    return side_by_side(_controlled, config, layouts, policies, key, episode)


def start_values(
    config: WorldConfig, layouts: Layout, key: Key, episode: Int[np.ndarray, " B"]
) -> Float[np.ndarray, " B"]:
    """V°(b_1) of tables at their start, which are not played, so that many are cheap.

    Their mean replaces that of the played tables, which also removes the noise of these starts.
    """
    found = []
    for first in range(0, len(episode), BATCH):
        some = episode[first : first + BATCH]
        layout = mapped(lambda leaf, some=some: leaf[some % len(leaf)], layouts)
        begun, _ = start(config, layout, random.split(random.fold_in(key, some), 3)[0])
        table, look = _looked(config, begun)
        found.append(one_step.left_price(config, table) + one_step.control_value(table, look))
    return np.concatenate(found)


def _controlled(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[np.ndarray, " B"]
) -> Controlled:
    _, stages = stages_of_play(config, layouts, policy, key, episode)
    value, total, robot_s = np.zeros((3, len(episode)))
    for number, stage in enumerate(stages):
        table, look = _looked(config, stage.state)
        of_state, left = one_step.control_value(table, look), one_step.left_price(config, table)
        rule, control = one_step.rule_and_control(config, table, look)
        values = library_of(rule).where(table.steps_to_go == 1, rule, control)
        if number == 0:
            value = (left + of_state).astype(np.float64)
        of_action = at(one_step.laid_out(np.zeros_like(left), values), stage.decision.action)
        total += np.where(stage.is_taken, of_action - of_state, 0.0)
        robot_s += np.where(stage.is_taken, stage.outcome.duration_s, 0.0)
    return Controlled(value, total, robot_s)


def _looked(config: WorldConfig, state: TableState) -> tuple[one_step.Beliefs, one_step.Outlook]:
    """Beliefs of tables, and the possible outcomes of one attempt."""
    table = one_step.table_of(config, state)
    return table, one_step.outlook_of(config, table)
