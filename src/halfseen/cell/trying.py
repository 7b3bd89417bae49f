"""What a robot does to learn its own laws: it lifts whatever stands there, at random."""

import numpy as np

from halfseen.arrays import record
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.policy import Decision, uniformly
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class LiftAtRandom:
    """Lifts each object on the table with the same probability; finishes where none is left."""

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose for each table."""
        actions = ActionSpace(state.num_objects)
        verbs = actions.verb(np.arange(actions.num_actions))
        is_lift = possible_actions(state) & (verbs == Verb.LIFT)
        return uniformly(np.where(is_lift.any(axis=-1, keepdims=True), is_lift, verbs == Verb.FINISH), key)
