"""Rules by which arms clear tables in benchmarks: here, where processes of workers find them, too."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import TeamState
from halfseen.world.policy import Decision, surely
from halfseen.world.state import TableState, attempt_counts, occlusion

MOST_FAILURES = 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WashEverything(GreedyPolicy):
    """Washes the cup that failed least and is hidden least, dirty or not."""

    def worth(self, state: TableState) -> Float[Array, " N"]:
        """Above 0 as long as it is worth another try."""
        _, failures = attempt_counts(state)
        is_worth_it = state.is_on_table & (failures < MOST_FAILURES)
        return jnp.where(is_worth_it, MOST_FAILURES - failures - 0.9 * occlusion(state), -jnp.inf)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InTurn:
    """A team of which nobody begins while another is at work.

    Parameters
    ----------
    base
        Who decides else.
    """

    base: TeamPolicy

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table."""
        wait = wait_of(state.table.num_objects)
        usual = self.base.decide(state, key)
        is_to_wait = possible_actions(state)[wait]
        return surely(jnp.where(is_to_wait, wait, usual.action).astype(jnp.int32))
