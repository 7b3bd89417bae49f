"""A problem of one's own in thirty lines: the tiger behind one of two doors, planned at several budgets.

python examples/tiger.py
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import Array

from halfseen.planners import Step, plan

LISTEN, OPEN_LEFT, OPEN_RIGHT = range(3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TigerProblem:
    """Listen (right in 85 %), or open a door; a state is where the tiger is: 0 left, 1 right."""

    left_chance: float | Array = 0.5
    discount: float | Array = 0.95
    horizon: int = field(default=3, metadata={"static": True})
    num_actions: int = field(default=3, metadata={"static": True})

    def initial_state(self, key: Array) -> Array:
        """Hide the tiger."""
        return (jax.random.uniform(key) >= self.left_chance).astype(jnp.int32)

    def is_possible(self, state: Array) -> Array:
        """Everything, always."""
        return jnp.ones(3, dtype=bool)

    def step(self, state: Array, action: Array, key: Array) -> Step:
        """Listen, or open and start anew."""
        draw = jax.random.uniform(key)
        heard = jnp.where(draw < 0.85, state, 1 - state)
        anew = (draw < 0.5).astype(jnp.int32)
        opened = jnp.where(action == OPEN_LEFT + state, -100.0, 10.0)
        is_listening = action == LISTEN
        state, observation = jnp.where(is_listening, state, anew), jnp.where(is_listening, heard, 0)
        return Step(state, observation, jnp.where(is_listening, -1.0, opened), jnp.asarray(False))

    def log_likelihood(self, observation: Array, state_after: Array, action: Array) -> Array:
        """How well a sound fits to where the tiger is."""
        heard = jnp.log(jnp.where(observation == state_after, 0.85, 0.15))
        return jnp.where(action == LISTEN, heard, jnp.where(observation == 0, 0.0, -jnp.inf))

    def rule_values(self, state: Array) -> Array:
        """Earn what one action brings where nothing is known."""
        return jnp.array([-1.0, -45.0, -45.0])

    def control(self, state: Array) -> None:
        """No noise is taken away."""


def main() -> None:
    """Plan three actions at each budget and print what was found."""
    problem, key = TigerProblem(), jax.random.key(0)
    plan(problem, key, num_simulations=1)  # compiles
    print("The tiger, three actions: the optimum listens and is worth 2.310.")
    for budget_s in (0.001, 0.01, 0.1, 1.0):
        found = plan(problem, key, budget_s=budget_s, exploration=100.0)
        name = ("listen", "open left", "open right")[found.action]
        note = "" if found.was_searched else " (not searched)"
        print(f"{budget_s:5.3f} s: {found.num_simulations:7d} simulations, {name}, value {found.value:.3f}{note}")


if __name__ == "__main__":
    main()
