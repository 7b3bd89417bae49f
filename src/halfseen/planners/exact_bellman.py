"""One node of the decision process of a small table: a tally, its grid of labels, and where its actions lead.

Every array here is over the grid of one tally: axis i belongs to object i and has length 1 once that has left.
"""

from dataclasses import dataclass, field
from math import prod
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.planners.exact_labels import Look
from halfseen.planners.exact_model import (
    NOTHING,
    GridWorld,
    Held,
    Result,
    Tally,
    after_attempt,
    after_look,
    current_levels,
    first_tally,
    grid_shape,
    is_there,
    looks_of,
)
from halfseen.world.actions import FINISH, ActionSpace, Verb

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


def held_after(attempt: Attempt) -> Held:
    """Return what is up in the air when the next look is taken."""
    return frozenset([attempt[0]]) if attempt[1] is Result.LIFTED else NOTHING


def layers_of(world: GridWorld, horizon: int, max_cells: int) -> list[Layer]:
    """Return every tally that can be reached, step by step, each once.

    Raises
    ------
    ArgumentError
        The states are more than `max_cells`.
    """
    layers = [[Node(after_look(world, first_tally(world)), ())]]
    cells = prod(grid_shape(world, layers[0][0].tally))
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
                    cells += prod(grid_shape(world, tally))
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
            says_dirty = along(look.says_dirty, axis, len(looks))
            if_clean, if_dirty = values.take(look.if_clean, axis), values.take(look.if_dirty, axis)
            values = if_clean + says_dirty * (if_dirty - if_clean)
    return values


def spread_over_labels(mass: Grid, looks: tuple[Look | None, ...], shape: tuple[int, ...]) -> Grid:
    """Probability of each cell of the grid (of `shape`) after a look, given that of each before it."""
    for axis, look in enumerate(looks):
        if look is not None:
            says_dirty = along(look.says_dirty, axis, len(looks))
            after = np.zeros((*mass.shape[:axis], shape[axis], *mass.shape[axis + 1 :]))
            before_axis = (slice(None),) * axis
            after[(*before_axis, look.if_clean)] += mass * (1.0 - says_dirty)
            after[(*before_axis, look.if_dirty)] += mass * says_dirty
            mass = after
    return mass


def along(values: Float[np.ndarray, " cells"], axis: int, num_axes: int) -> Grid:
    """Lay values along one axis of a grid."""
    return values.reshape([-1 if at == axis else 1 for at in range(num_axes)])


def grid_of_q(world: GridWorld, node: Node, after: list[Grid]) -> Float[np.ndarray, "A ..."]:
    """Q of every action in every cell of a node, given the next layer's values; −∞ where an action is impossible."""
    config, tally, actions = world.config, node.tally, ActionSpace(len(node.tally))
    levels = current_levels(world, tally)
    q = np.full((actions.num_actions, *grid_shape(world, tally)), -np.inf)
    q[FINISH] = price_of_left(world, tally)
    for cup, told in enumerate(tally):
        if told is None:
            continue
        dirty = along(world.dirty(cup, told.looks), cup, len(tally))
        probability, attempt_s = world.attempt(cup, told.failures, told.successes, levels[cup])
        washed = dirty * float(config.reward_wash_dirty) + (1.0 - dirty) * float(config.reward_wash_clean)
        wash = probability * washed + (1.0 - probability) * float(config.reward_wash_failed)
        lift = float(config.reward_lift_per_s) * attempt_s
        missed = (1.0 - probability) * _future(world, node, (cup, Result.FAILED), after)
        for verb, reward, won in ((Verb.WASH, wash, Result.WASHED), (Verb.LIFT, lift, Result.LIFTED)):
            action = actions.encode(verb, cup)
            q[action] = reward
            q[action] += missed
            q[action] += probability * _future(world, node, (cup, won), after)
    return q


def price_of_left(world: GridWorld, tally: Tally, without: int | None = None) -> Grid:
    """Expected price of what is dirty on the table when the path ends now."""
    nothing = np.zeros((1,) * len(tally))
    there = [(cup, told) for cup, told in enumerate(tally) if told is not None and cup != without]
    dirty = [along(world.dirty(cup, told.looks), cup, len(tally)) for cup, told in there]
    return float(world.config.reward_dirty_left) * sum(dirty, nothing)


def _future(world: GridWorld, node: Node, attempt: Attempt, after: list[Grid]) -> Grid:
    """Expected value of what follows an attempt, given the next layer's values.

    Where the path is over, only the price of what is left counts; its expectation does not change by looking.
    """
    target, result = attempt
    if attempt not in node.successors:
        return price_of_left(world, node.tally, without=target if result is Result.WASHED else None)
    looks = looks_of(world, after_attempt(world, node.tally, target, result), held_after(attempt))
    return expected_over_labels(after[node.successors[attempt]], looks)
