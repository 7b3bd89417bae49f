"""Planning with a known model, h steps ahead in the space of beliefs: the planner of the table as a policy.

Q_1 is the myopic look-ahead of `one_step`. Further ahead, Q_h(b, a) is the worth of action a and then of h − 1 actions
by that look-ahead, the last of them worth Q_1, which stands for all that comes after; by rollouts (`rollout`). With h
as long as the path, the number of rollouts is all that bounds it.

This is the planner under `jax.jit` and `jax.vmap`, its budget a number of rollouts; `anytime.plan` is the same one
against a clock.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.errors import ArgumentError
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import one_step_q
from halfseen.planners.rollout import searched_values
from halfseen.world.config import Number, WorldConfig
from halfseen.world.policy import Decision
from halfseen.world.state import TableState

NUM_SIMULATIONS = 256


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
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
    planning_horizon: Number = 2
    num_simulations: int = field(default=NUM_SIMULATIONS, metadata={"static": True})

    def __post_init__(self) -> None:
        # Under a transformation the horizon may be a placeholder without a value.
        if not isinstance(self.planning_horizon, (int, float)):
            return
        if not float(self.planning_horizon).is_integer():
            raise ArgumentError(f"planning_horizon is {self.planning_horizon}; it is a whole number")
        if self.planning_horizon == 1:
            object.__setattr__(self, "num_simulations", 0)
            return
        for name in ("planning_horizon", "num_simulations"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it is at least 1")

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table; the rollouts draw from `key` (the probability of a choice is not known)."""
        q = self.q_values(state, key)
        return Decision(jnp.argmax(q).astype(jnp.int32), jnp.full((), jnp.nan, dtype=jnp.float32))

    def q_values(self, state: TableState, key: Array) -> Float[Array, " A"]:
        """Q_h of every action of one table; −∞ where an action is impossible."""
        if self.num_simulations == 0:
            return one_step_q(self.config, belief_of(self.config, state))
        return searched_values(self.config, state, key, self.num_simulations, self.planning_horizon)
