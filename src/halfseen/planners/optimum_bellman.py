"""One node of the decision process of a small table: a tally, its grid of labels, and where its actions lead.

Every array here is over the grid of one tally: axis i belongs to object i and has length 1 once that has left.
"""

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.planners.optimum_model import (
    GridWorld,
    Look,
    Result,
    Tally,
    after_attempt,
    after_look,
    current_levels,
    first_tally,
    is_there,
    looks_of,
    num_cells,
)
from halfseen.world.action_space import FINISH, ActionSpace, Verb

Grid: TypeAlias = Float[np.ndarray, "..."]
Attempt: TypeAlias = tuple[int, Result]
"""An object, and what came of trying to grasp it."""


@dataclass(eq=False)
class Node:
    """All states of a layer that share a tally.

    Attributes
    ----------
    tally
        Looks and attempts of the objects on the table.
    path
        One sequence of attempts that leads here; others may, and tell the same.
    successors
        Place in the next layer of what every attempt leads to; an attempt that clears the table is left out.
    """

    tally: Tally
    path: tuple[Attempt, ...]
    successors: dict[Attempt, int] = field(default_factory=dict)


Layer: TypeAlias = list[Node]


def attempts_of(tally: Tally) -> list[Attempt]:
    """Return every attempt on what stands on the table, with every result."""
    return [(target, result) for target in is_there(tally) for result in Result]


def held_after(attempt: Attempt) -> int | None:
    """Return the object that is up in the air when the next look is taken."""
    return attempt[0] if attempt[1] is Result.LIFTED else None


def layers_of(world: GridWorld, horizon: int, max_cells: int) -> list[Layer]:
    """Return every tally that can be reached, step by step, each once.

    Raises
    ------
    ArgumentError
        The states are more than `max_cells`.
    """
    layers = [[Node(after_look(world, first_tally(world)), ())]]
    cells = num_cells(layers[0][0].tally)
    for steps in range(1, horizon):
        places: dict[Tally, int] = {}
        layer: Layer = []
        for node in layers[-1]:
            for attempt in attempts_of(node.tally):
                tally = after_attempt(world, node.tally, *attempt)
                if not is_there(tally):
                    continue
                tally = after_look(world, tally, held_after(attempt))
                if tally not in places:
                    places[tally] = len(layer)
                    layer.append(Node(tally, (*node.path, attempt)))
                    cells += num_cells(tally)
                    if cells > max_cells:
                        raise ArgumentError(
                            f"{world.num_objects} objects over {horizon} steps have more than {max_cells:,} states "
                            f"(so many after {steps} of them); shorten the horizon or take fewer objects"
                        )
                node.successors[attempt] = places[tally]
        layers.append(layer)
    return layers


def expected_over_labels(values: Grid, looks: tuple[Look | None, ...]) -> Grid:
    """Mean of `values`, on the grid after a look, over what the look may say; on the grid before it."""
    for axis, look in enumerate(looks):
        if look is not None:
            says_dirty = _along(look.says_dirty, axis, len(looks))
            if_clean, if_dirty = values.take(look.if_clean, axis), values.take(look.if_dirty, axis)
            values = if_clean + says_dirty * (if_dirty - if_clean)
    return values


def spread_over_labels(mass: Grid, looks: tuple[Look | None, ...], shape: tuple[int, ...]) -> Grid:
    """Probability of each cell of the grid (of `shape`) after a look, given that of each before it."""
    for axis, look in enumerate(looks):
        if look is not None:
            says_dirty = _along(look.says_dirty, axis, len(looks))
            after = np.zeros((*mass.shape[:axis], shape[axis], *mass.shape[axis + 1 :]))
            before_axis = (slice(None),) * axis
            after[(*before_axis, look.if_clean)] += mass * (1.0 - says_dirty)
            after[(*before_axis, look.if_dirty)] += mass * says_dirty
            mass = after
    return mass


def _along(values: Float[np.ndarray, " cells"], axis: int, num_axes: int) -> Grid:
    return values.reshape([-1 if at == axis else 1 for at in range(num_axes)])


class NodeModel:
    """Probabilities and rewards of one node, on its grid."""

    def __init__(self, world: GridWorld, tally: Tally) -> None:
        self.world, self.tally, self.actions = world, tally, ActionSpace(len(tally))
        self.shape = grid_shape(world, tally)
        levels = current_levels(world, tally)
        self.dirty: dict[int, Grid] = {}
        self.probability: dict[int, float] = {}
        self.attempt_s: dict[int, float] = {}
        for cup, told in enumerate(tally):
            if told is not None:
                self.dirty[cup] = _along(world.dirty(cup, told.looks), cup, len(tally))
                grasp = world.attempt(cup, told.failures, told.successes, levels[cup])
                self.probability[cup], self.attempt_s[cup] = grasp

    def left(self, without: int | None = None) -> Grid:
        """Expected price of what is dirty on the table when the path ends now."""
        dirty = [dirty for cup, dirty in self.dirty.items() if cup != without]
        return float(self.world.config.reward_dirty_left) * sum(dirty, np.zeros((1,) * len(self.tally)))

    def reward(self, action: int) -> Grid:
        """Expected reward of an action itself, whatever follows; that of FINISH is the price of what is left."""
        config, target = self.world.config, self.actions.target(action)
        if action == FINISH:
            return self.left()
        if self.actions.verb(action) == Verb.LIFT:
            return np.full((1,) * len(self.tally), float(config.reward_lift_per_s) * self.attempt_s[target])
        dirty, probability = self.dirty[target], self.probability[target]
        washed = dirty * float(config.reward_wash_dirty) + (1.0 - dirty) * float(config.reward_wash_clean)
        return probability * washed + (1.0 - probability) * float(config.reward_wash_failed)

    def outcomes(self, action: int) -> list[tuple[float, Attempt]]:
        """What may come of an action that is an attempt, and how likely that is."""
        target = self.actions.target(action)
        won = Result.WASHED if self.actions.verb(action) == Verb.WASH else Result.LIFTED
        return [(1.0 - self.probability[target], (target, Result.FAILED)), (self.probability[target], (target, won))]

    def looks(self, attempt: Attempt) -> tuple[Look | None, ...]:
        """What the look after an attempt does to each axis."""
        return looks_of(self.world, after_attempt(self.world, self.tally, *attempt), held_after(attempt))

    def future(self, attempt: Attempt, after: Grid | None) -> Grid:
        """Expected value of what follows an attempt; `after` is the values there, or None where the path is over.

        Then only the price of what is left counts; its expectation does not change by looking.
        """
        if after is None:
            target, result = attempt
            return self.left(without=target if result is Result.WASHED else None)
        return expected_over_labels(after, self.looks(attempt))

    def q_values(self, after: dict[Attempt, Grid]) -> Float[np.ndarray, "A ..."]:
        """Q of every action in every cell, given the values behind each attempt; −∞ where an action is impossible."""
        q = np.full((self.actions.num_actions, *self.shape), -np.inf)
        q[FINISH] = self.reward(FINISH)
        future = {attempt: self.future(attempt, after.get(attempt)) for attempt in attempts_of(self.tally)}
        for target in self.dirty:
            for verb in (Verb.WASH, Verb.LIFT):
                action = self.actions.encode(verb, target)
                q[action] = self.reward(action)
                for probability, attempt in self.outcomes(action):
                    q[action] += probability * future[attempt]
        return q


def grid_shape(world: GridWorld, tally: Tally) -> tuple[int, ...]:
    """Return the length of each object's axis."""
    return tuple(1 if told is None else len(world.log_odds(cup, told.looks)) for cup, told in enumerate(tally))
