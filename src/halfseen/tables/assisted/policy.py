"""What is learned of tables with the help of fitted laws, as a policy."""

from typing import ClassVar

import numpy as np

from halfseen.arrays import Array, library_of, record
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import laid_out, left_price, table_of
from halfseen.shapes import Float
from halfseen.tables.assisted.features import ahead_of
from halfseen.tables.assisted.synthetic import Excess
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class AssistedPolicy:
    """argmax over possible actions of Q_1 + E_h.

    Parameters
    ----------
    config
        The world with its fitted laws.
    excess
        E.
    """

    config: WorldConfig
    excess: Excess

    num_robots: ClassVar[int] = 1

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        return surely(library_of(state.log_odds).argmax(self.q_values(state), axis=-1))

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action; −∞ where an action is impossible."""
        ahead = ahead_of(self.config, table_of(belief_of(self.config, state)))
        left = left_price(self.config, ahead.table)
        above = ahead.one_step + self.excess(ahead)
        return laid_out(left, left + above)
