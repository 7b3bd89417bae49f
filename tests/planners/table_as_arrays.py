"""A table of one or two cups and two steps written as arrays T, O, R: every chance in plain Python, state by state.

A state is what each cup is (dirty or not, and its grip offset, on a coarse grid) and where it is: on the table, or held
up for a moment by the last LIFT; or None, once it is gone. Whatever comes after the last step is one state, as it is
after FINISH. An observation is whether the last attempt grasped, and what each cup on the table is labelled.

Arrays know no last step, at which the dirty cups left are paid for. So they are paid for at the outset (`owed`), and a
dirty cup that is washed gives the price back.
"""

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from naive_optimum import hermite


class Cup(NamedTuple):
    is_dirty: bool
    grip_offset: float
    is_held: bool = False


class TableArrays:
    """The arrays, and the beliefs that belong to them; FINISH is 0, then WASH and LIFT of each cup."""

    def __init__(self, config, hides, num_nodes):
        self.config, self.hides, self.num_cups = config, hides, len(hides)
        self.observations = list(product((False, True), repeat=1 + self.num_cups))
        self.grips = hermite(config, num_nodes)
        cups = [Cup(is_dirty, offset) for is_dirty in (False, True) for offset, _ in self.grips]
        first: list[Any] = list(product(cups, repeat=self.num_cups))
        second = [after for state in first for a in self.attempts() for _, after in self._outcomes(a, state)]
        self.states: list[Any] = [*dict.fromkeys(first + second), None]
        self.index = {state: row for row, state in enumerate(self.states)}
        num_states, num_actions = len(self.states), 1 + 2 * self.num_cups
        self.T = np.zeros((num_actions, num_states, num_states))
        self.O = np.zeros((num_actions, num_states, len(self.observations)))
        self.R = np.zeros((num_actions, num_states))
        for action, (row, state) in product(range(num_actions), enumerate(self.states)):
            self.R[action, row] = self._step(action, row, state)
            self.O[action, row] = self._observed(action, state)

    def attempts(self):
        return range(1, 1 + 2 * self.num_cups)

    def after_first_look(self, labels):
        """Belief once each cup was labelled, all of them on the table, and how likely those labels are."""
        chances = np.zeros(len(self.states))
        weights = dict(self.grips)
        for row, state in enumerate(self.states):
            if state is not None and not any(cup is None or cup.is_held for cup in state):
                dirty_share = self.config.dirty_share
                prior = [(dirty_share if c.is_dirty else 1 - dirty_share) * weights[c.grip_offset] for c in state]
                chances[row] = np.prod(prior) * self._labels_chance(state, labels)
        return chances / chances.sum(), chances.sum()

    def owed(self, belief):
        """Expected price of the dirty cups on the table."""
        dirty = [0 if state is None else sum(c is not None and c.is_dirty for c in state) for state in self.states]
        return self.config.reward_dirty_left * float(belief @ np.array(dirty))

    def _step(self, action, row, state: Any):
        """Fill the row of T; return the expected reward. An attempt on what is gone ends it, as FINISH does."""
        outcomes = [] if state is None or action == 0 else self._outcomes(action, state)
        if state is None or not outcomes:
            self.T[action, row, -1] = 1.0
            return 0.0
        for chance, after in outcomes:
            self.T[action, row, self.index.get(after, -1)] += chance
        is_lift, i = divmod(action - 1, self.num_cups)
        config, (missed, caught) = self.config, [chance for chance, _ in outcomes]
        if is_lift:
            return config.reward_lift_per_s * (config.transport_s + self._scale_s(i, state) * caught)
        back = config.reward_wash_dirty - config.reward_dirty_left
        return missed * config.reward_wash_failed + caught * (back if state[i].is_dirty else config.reward_wash_clean)

    def _outcomes(self, action, state: Any):
        """Failure and success of an attempt: chance and state after it; nothing if there is no such cup."""
        is_lift, i = divmod(action - 1, self.num_cups)
        if state[i] is None:
            return []
        missed = np.exp(-self.config.grasping.limit_s / self._scale_s(i, state))
        rest: list[Any] = [None if cup is None else cup._replace(is_held=False) for cup in state]
        grasped = [cup if j != i else cup._replace(is_held=True) if is_lift else None for j, cup in enumerate(rest)]
        return [(missed, tuple(rest)), (1 - missed, tuple(grasped))]

    def _scale_s(self, i, state: Any):
        hidden = self._occlusion(i, [cup is not None for cup in state])
        log_time = self.config.grasping.log_time + self.config.grasping.log_time_per_occlusion * hidden
        return np.exp(log_time - state[i].grip_offset)

    def _occlusion(self, i, is_hiding):
        return 1 - np.prod([1 - self.hides[i][j] for j in range(self.num_cups) if is_hiding[j]])

    def _observed(self, action, state):
        """Chance of each observation once an action has led to a state."""
        if state is None or action == 0:
            return [float(not any(seen)) for seen in self.observations]
        is_lift, i = divmod(action - 1, self.num_cups)
        is_grasped = state[i] is None or (is_lift and state[i].is_held)
        return [(seen[0] == is_grasped) * self._labels_chance(state, seen[1:]) for seen in self.observations]

    def _labels_chance(self, state, labels):
        """A cup that is held hides nothing and is seen whole; what is gone is always labelled CLEAN."""
        is_hiding = [cup is not None and not cup.is_held for cup in state]
        chance = 1.0
        for i, (cup, says_dirty) in enumerate(zip(state, labels, strict=True)):
            if cup is None:
                chance *= not says_dirty
                continue
            seen = 1.0 if cup.is_held else 1 - self._occlusion(i, is_hiding)
            right = self.config.seeing.floor + self.config.seeing.gain * seen**self.config.seeing.power
            chance *= right if says_dirty == cup.is_dirty else 1 - right
        return chance
