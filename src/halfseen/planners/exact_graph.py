"""The state graph of a small table before K robots.

A state consists of a tally of looks and attempts (`exact_table`), the robots' actions in progress (`exact_team`), and
labels. A node holds all states that differ only in their labels, with its values on the grid of labels. A layer holds
the nodes in which a robot decides after the same number of decisions.
"""

from dataclasses import dataclass, field
from functools import reduce
from math import prod
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.planners.exact_labels import Grid, LabelTransitions, Looks, expected_over_labels
from halfseen.planners.exact_table import NOTHING, GridWorld, Held, Tally
from halfseen.planners.exact_team import IDLE, TeamActions, Work

GO_ON = -1
"""The only choice of a node in which no robot decides."""


@dataclass(eq=False, slots=True)
class Arrival:
    """The next look, and the node that it leads to."""

    looks: tuple[LabelTransitions | None, ...]
    """Transition of the look along each axis of the grid."""
    node: "Node | None"
    """None if the trajectory is over."""
    left: tuple[Looks | None, ...] = ()
    """At the end, the record of looks at each object left."""


class ActionOutcomes(NamedTuple):
    """Expected reward and transitions of an action."""

    reward: Grid | float
    """Expected reward until the next node, without the penalty for dirty objects left at the end."""
    ways: dict[Arrival, float]
    """Possible arrivals with their probabilities."""


@dataclass(eq=False, slots=True)
class Node:
    """All states that differ only in their labels."""

    tally: Tally
    work: Work
    shape: tuple[int, ...]
    place: int | None
    """Index in its layer; None if no robot decides."""
    choices: dict[int, ActionOutcomes] = field(default_factory=dict)
    """By action; only `GO_ON` if no robot decides."""
    value: Grid | None = None
    """Optimal value from here on, cached once computed."""


Key: TypeAlias = tuple[Tally, Work]


@dataclass(eq=False)
class StateGraph:
    """The state graph of a table: each node once, layer by layer.

    Raises
    ------
    ArgumentError
        There are more than `max_states` states.
    """

    team: TeamActions
    max_states: int
    num_states: int = 0
    root: Arrival = field(init=False)
    layers: list[dict[Key, Node]] = field(default_factory=list)

    def __post_init__(self) -> None:
        config = self.team.config
        self._begin_layer()
        work = Work((IDLE,) * config.num_robots, (config.horizon,) * config.num_robots)
        self.root = self._arrival(self.world.first, work, NOTHING)
        for _ in range(config.num_stages - 1):
            self.layers.append(self._following)
            self._begin_layer()
            for node in self.layers[-1].values():
                node.choices = self.choices(node)
        self.layers.append(self._following)
        self._begin_layer()

    @property
    def world(self) -> GridWorld:
        """The table."""
        return self.team.world

    def _begin_layer(self) -> None:
        self._following: dict[Key, Node] = {}
        self._between: dict[Key, Node] = {}
        self._arrivals: dict[tuple[Tally, Work, Held | None], Arrival] = {}
        self._ends: dict[tuple[Looks | None, ...], Arrival] = {}

    def choices(self, node: Node) -> dict[int, ActionOutcomes]:
        """Choices in a node; those of the last layer, which are most of the graph, are not kept."""
        if node.choices:
            return node.choices
        if node.place is None:
            return {GO_ON: self._outcome(node.tally, node.work)}
        decisions = self.team.decisions(node.tally, node.work)
        if self.team.is_alone:
            # The next event is the next decision, so no node is needed in between.
            return {action: self._outcome(node.tally, work) for action, work in decisions}
        return {action: ActionOutcomes(0.0, {self._arrival(node.tally, work, None): 1.0}) for action, work in decisions}

    def _outcome(self, tally: Tally, work: Work) -> ActionOutcomes:
        reward: Grid | float = 0.0
        ways: dict[Arrival, float] = {}
        for probability, paid, after, then, held in self.team.outcomes(tally, work):
            reward = reward + probability * paid
            arrival = self._arrival(after, then, held)
            ways[arrival] = ways.get(arrival, 0.0) + probability
        return ActionOutcomes(reward, ways)

    def _arrival(self, tally: Tally, work: Work, held: Held | None) -> Arrival:
        """Arrival after a look, or without a look if `held` is None."""
        if not any(tally) or (held is None and (self.team.is_alone or work.is_done)):
            left = tuple([counted and counted.looks for counted in tally])
            found = self._ends.get(left)
            if found is None:
                found = self._ends[left] = Arrival((), None, left)
            return found
        key = tally, work, held
        found = self._arrivals.get(key)
        if found is None:
            after, looks = (tally, ()) if held is None else self.world.looked(tally, held)
            found = self._arrivals[key] = Arrival(looks, self._node(after, work))
        return found

    def _node(self, tally: Tally, work: Work) -> Node:
        is_asked = work.decider is not None
        known = self._following if is_asked else self._between
        node = known.get((tally, work))
        if node is None:
            shape = self.world.shape(tally)
            node = known[tally, work] = Node(tally, work, shape, len(self._following) if is_asked else None)
            self._count(prod(shape))
            if not is_asked:
                node.choices = self.choices(node)
        return node

    def _count(self, num_cells: int) -> None:
        self.num_states += num_cells
        if self.num_states > self.max_states:
            config, num_done = self.team.config, len(self.layers)
            raise ArgumentError(
                f"{self.world.num_objects} objects over {config.num_stages} steps have more than "
                f"{self.max_states:,} states (exceeded after {num_done} of them); shorten the horizon or use "
                "fewer objects"
            )

    def q(self, node: Node) -> dict[int, Grid]:
        """Q(n, a) = R(n, a) + Σ P(event | n, a) E_labels V(n') for each possible action."""
        choices = self.choices(node)
        # A failed WASH and a failed LIFT share an arrival.
        arrivals = dict.fromkeys(arrival for choice in choices.values() for arrival in choice.ways)
        worth = {arrival: self.worth(arrival) for arrival in arrivals}
        return {
            action: sum((share * worth[arrival] for arrival, share in choice.ways.items()), np.asarray(choice.reward))
            for action, choice in choices.items()
        }

    def value(self, node: Node) -> Grid:
        """V(n) = max_a Q(n, a)."""
        if node.value is None:
            best = reduce(np.maximum, self.q(node).values())
            node.value = best if best.shape == node.shape else np.broadcast_to(best, node.shape)
        return node.value

    def worth(self, arrival: Arrival) -> Grid:
        """Value before a look."""
        if arrival.node is None:
            return self.world.price_of_left(arrival.left)
        return expected_over_labels(self.value(arrival.node), arrival.looks)
