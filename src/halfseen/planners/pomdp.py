"""Planning with a known model, h steps ahead in the space of beliefs: the planner of the table as a policy.

Q_1 is the closed look of `one_step`. Further ahead,

    Q_h(b, a) = E[ R + V_{h−1}(b') ],   V_h(b) = max_a Q_h(b, a),

by a tree of h − 1 actions (`search_tree`) at whose leaves stands V_1. With h as long as the path, the number of
simulations is all that bounds it.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.errors import ArgumentError
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import one_step_q
from halfseen.planners.search_tree import grown, root, summary
from halfseen.planners.table_problem import TableProblem
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision
from halfseen.world.state import TableState

NUM_SIMULATIONS = 256
_EXPLORATION = _RULE_WEIGHT = 1.0


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
        Simulations a decision, ≥ 1; a look of one step needs none.

    Raises
    ------
    ArgumentError
        A number is below 1.
    """

    config: WorldConfig
    planning_horizon: int = field(default=2, metadata={"static": True})
    num_simulations: int = field(default=NUM_SIMULATIONS, metadata={"static": True})

    def __post_init__(self) -> None:
        for name in ("planning_horizon", "num_simulations"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it is at least 1")

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table; `key` is the simulations' (the probability of a choice is not known)."""
        q = self.q_values(state, key)
        return Decision(jnp.argmax(q).astype(jnp.int32), jnp.full((), jnp.nan, dtype=jnp.float32))

    def q_values(self, state: TableState, key: Array) -> Float[Array, " A"]:
        """Q_h of every action of one table; −∞ where an action is impossible."""
        if self.planning_horizon == 1:
            return one_step_q(self.config, belief_of(self.config, state))
        problem, nothing = TableProblem(self.config, state), jnp.zeros((), dtype=jnp.int32)
        tree = root(problem, None, key, _RULE_WEIGHT, self.num_simulations + 1)
        max_depth = self.planning_horizon - 1
        tree, _ = grown(problem, None, key, _EXPLORATION, tree, nothing, 0, self.num_simulations, max_depth)
        return summary(tree)[0]
