"""Rules by which arms clear tables in benchmarks: here, where processes of workers find them, too."""

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Array, record
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.world.actions import possible_actions, wait_of
from halfseen.world.policy import Policy, PolicyDraw, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState, attempt_counts, occlusion

MOST_FAILURES = 3


@record
class WashEverything(GreedyPolicy):
    """Washes the cup that failed least and is hidden least, dirty or not."""

    def worth(self, state: TableState) -> Float[Array, "*B N"]:
        """Above 0 as long as it is worth another try."""
        _, failures = attempt_counts(state)
        is_worth_it = state.is_on_table & (failures < MOST_FAILURES)
        return np.where(is_worth_it, MOST_FAILURES - failures - 0.9 * occlusion(state), -np.inf)


@record
class InTurn:
    """A team of which nobody begins while another is at work.

    Parameters
    ----------
    base
        Who decides else.
    """

    base: Policy

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for one table."""
        wait = wait_of(state.num_objects)
        usual = self.base.decide(state, key)
        is_to_wait = possible_actions(state)[..., wait]
        return surely(np.where(is_to_wait, wait, usual.action))
