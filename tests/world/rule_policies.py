"""Policies for tests that look at objects by their index, so that padding cannot change what they do."""

import numpy as np

from halfseen.arrays import record
from halfseen.world.actions import FINISH
from halfseen.world.policy import surely


@record
class InTurn:
    """LIFT, then WASH, the first object on the table, until it is gone; then the next; FINISH at the last step."""

    def decide(self, state, key):
        first = np.argmax(state.is_on_table, axis=-1)
        is_lift = state.steps_to_go % 2 == 0
        action = 1 + first + np.where(is_lift, state.num_objects, 0)
        return surely(np.where(state.steps_to_go == 1, FINISH, action))


@record
class Suspicious:
    """WASH what looks dirtiest."""

    def decide(self, state, key):
        worst = np.argmax(np.where(state.is_on_table, state.log_odds, -np.inf), axis=-1)
        return surely(1 + worst)
