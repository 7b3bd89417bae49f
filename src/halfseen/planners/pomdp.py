"""Planning with a known model, h steps ahead in the space of beliefs: the planner of the table as a policy.

Q_1 is the myopic look-ahead of `one_step`. Further ahead, Q_h(b, a) is the worth of action a and then of h − 1 actions
by that look-ahead, the last of them worth Q_1, which stands for all that comes after; by rollouts (`rollout`). With h
as long as the path, the number of rollouts is all that bounds it.

Its budget is a number of rollouts; `anytime.plan` is the same planner against a clock.
"""

from dataclasses import field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from halfseen.arrays import STATIC, Array, library_of, record
from halfseen.errors import ArgumentError
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import one_step_q
from halfseen.planners.rollout import searched_values
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision
from halfseen.world.random import Key
from halfseen.world.state import TableState

NUM_SIMULATIONS = 256


@record
class POMDPPolicy:
    """The best action by a look of `planning_horizon` steps ahead.

    Parameters
    ----------
    config
        The world that it believes in.
    planning_horizon
        h, ≥ 1.
    num_simulations
        Rollouts a decision, about, of all actions together, ≥ 1; a look of one step takes none, whatever is given.

    Raises
    ------
    ArgumentError
        A number is below 1, or the horizon is no whole number.
    """

    config: WorldConfig
    planning_horizon: int | float = field(default=2, metadata=STATIC)
    num_simulations: int = field(default=NUM_SIMULATIONS, metadata=STATIC)

    num_robots: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if not float(self.planning_horizon).is_integer():
            raise ArgumentError(f"planning_horizon is {self.planning_horizon}; it is a whole number")
        if self.planning_horizon == 1:
            object.__setattr__(self, "num_simulations", 0)
            return
        for name in ("planning_horizon", "num_simulations"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it is at least 1")

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table; the rollouts draw from `key` (the probability of a choice is not known)."""
        q = self.q_values(state, key)
        xp = library_of(q)
        return Decision(xp.argmax(q, axis=-1).astype(np.int32), xp.full(q.shape[:-1], np.nan, dtype=np.float32))

    def q_values(self, state: TableState, key: Key) -> Float[Array, "*B A"]:
        """Q_h of every action; −∞ where an action is impossible."""
        if self.num_simulations == 0:
            return one_step_q(self.config, belief_of(self.config, state))
        return searched_values(self.config, state, key, self.num_simulations, self.planning_horizon)
