"""Exact values of policies on a table with a known state graph, by propagating probability mass layer by layer."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.planners.exact_graph import GO_ON, ActionOutcomes, Arrival, Node, StateGraph
from halfseen.planners.exact_labels import Grid, spread_over_labels
from halfseen.planners.exact_table import GridWorld, Tally
from halfseen.planners.exact_team import PARKED, TeamActions
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.actions import FINISH
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, initial_state, pad_scenes

_ASKED_AT_ONCE = 1024
"""Batch size of a policy's decisions, which limits the memory of policies that sample futures."""


class Reached(NamedTuple):
    """States of a layer that any of P policies reaches, grouped by node."""

    place: Int[np.ndarray, " n"]
    """Index of the state's node in the layer."""
    cell: Int[np.ndarray, " n"]
    """Index of the state's cell in the node's grid."""
    mass: Float[np.ndarray, "P n"]
    """Probability that a trajectory of each policy reaches the state."""

    def by_node(self) -> Iterator[tuple[int, slice]]:
        """Iterate over the nodes: index in the layer, and rows of its states."""
        starts = np.flatnonzero(np.diff(self.place, prepend=-1)).tolist()
        for start, end in zip(starts, [*starts[1:], len(self.place)], strict=True):
            yield int(self.place[start]), slice(start, end)


def reached_in(masses: dict[int, Grid]) -> Reached:
    """The cells of a layer's grids in which any policy (the first axis) has mass, in layer order."""
    flat = {place: masses[place].reshape(len(masses[place]), -1) for place in sorted(masses)}
    cells = {place: np.flatnonzero((mass > 0.0).any(axis=0)) for place, mass in flat.items()}
    return Reached(
        place=np.repeat(np.fromiter(flat, dtype=np.int64), [len(of_node) for of_node in cells.values()]),
        cell=np.concatenate(list(cells.values())),
        mass=np.concatenate([mass[:, cells[place]] for place, mass in flat.items()], axis=1),
    )


def drawn(reached: Reached, max_states: int, key: Key) -> Reached:
    """Sample at most `max_states` states for each policy, which then represent all that it reaches."""
    mass = np.stack([_thinned(of_policy, max_states, float(random.uniform(key))) for of_policy in reached.mass])
    kept = np.flatnonzero((mass > 0.0).any(axis=0))
    return Reached(reached.place[kept], reached.cell[kept], mass[:, kept])


def _thinned(mass: Float[np.ndarray, " n"], max_states: int, draw: float) -> Float[np.ndarray, " n"]:
    """Keep the likely states, and a random sample of the others that represents the rest.

    Expectations are unchanged [FearnheadClifford2003]_: a mass m < c becomes c with probability m/c, otherwise 0, and c
    is set so that `max_states` states remain.
    """
    if np.count_nonzero(mass) <= max_states:
        return mass
    ordered = np.sort(mass)[::-1]
    others = np.cumsum(ordered[::-1])[::-1][:max_states]
    share = others / np.arange(max_states, 0, -1)
    num_likely = int(np.argmax(ordered[:max_states] < share))
    is_likely = mass >= share[num_likely]
    rest = np.flatnonzero(~is_likely & (mass > 0.0))
    ladder = np.cumsum(mass[rest]) / share[num_likely]
    # Systematic sampling adds less noise than independent draws.
    steps = draw + np.arange(max_states - num_likely)
    lucky = rest[np.minimum(np.searchsorted(ladder, steps, side="right"), len(rest) - 1)]
    kept = np.where(is_likely, mass, 0.0)
    kept[lucky] = share[num_likely]
    return kept


def states_of(team: TeamActions, nodes: Collection[Node]) -> TableState:
    """State shown to a policy in each of some nodes, without the labels.

    It holds only attempts at objects that have not left, so that there is room for all later attempts.
    """
    num, world, tallies, works = len(nodes), team.world, [node.tally for node in nodes], [node.work for node in nodes]
    tried = np.zeros((num, team.config.num_stages, 3))
    tried[..., 0] = NO_ATTEMPT
    for row, tally in zip(tried, tallies, strict=True):
        attempts = _attempts(world, tally)
        row[: len(attempts)] = np.reshape(attempts, (-1, 3))
    lifts = [[0 if counted is None else sum(counted.successes) for counted in tally] for tally in tallies]
    doings = np.array([[doing[:4] for doing in work.doings] for work in works]).reshape(num, -1, 4)
    to_go, is_busy = np.array([work.to_go for work in works], dtype=np.int32), doings[..., 0] >= 0
    robots = Robots(
        is_busy=is_busy,
        is_parked=doings[..., 0] == PARKED,
        verb=np.maximum(doings[..., 0], 0).astype(np.int32),
        target=doings[..., 1].astype(np.int32),
        since_s=doings[..., 3].astype(np.float32),
        decisions_to_go=to_go,
    )
    space = team.workspace
    layout = replace(pad_scenes([world.scene]), workspace=mapped(lambda leaf: np.asarray(leaf)[None], space))
    begun = mapped(lambda leaf: np.broadcast_to(leaf, (num, *leaf.shape[1:])), initial_state(team.config, layout))
    return replace(
        begun,
        is_on_table=np.array([[counted is not None for counted in tally] for tally in tallies]),
        lifts=np.array(lifts, dtype=np.int32),
        attempt_object=tried[..., 0].astype(np.int32),
        attempt_occlusion=tried[..., 1].astype(np.float32),
        attempt_succeeded=tried[..., 2] > 0.0,
        steps_to_go=(to_go.sum(axis=1) + is_busy.sum(axis=1)).astype(np.int32),
        robots=None if space is None else robots,
        decider=None if space is None else np.array([work.decider for work in works], dtype=np.int32),
    )


def _attempts(world: GridWorld, tally: Tally) -> list[tuple[int, float, bool]]:
    """Attempts at objects that have not left: object, occlusion, and success."""
    return [
        (cup, world.occlusions[cup][level], is_held)
        for cup, counted in enumerate(tally)
        if counted is not None
        for is_held, counts in ((False, counted.failures), (True, counted.successes))
        for level, count in enumerate(counts)
        for _ in range(count)
    ]


def labelled(world: GridWorld, states: TableState, nodes: list[Node], reached: Reached) -> TableState:
    """Complete the states of a layer's nodes with the labels of each reached cell."""
    shown = np.zeros((2, len(reached.place), world.num_objects), dtype=np.float32)
    for place, rows in reached.by_node():
        axes = np.unravel_index(reached.cell[rows], nodes[place].shape)
        for cup, of_cup in enumerate(nodes[place].tally):
            if of_cup is not None:
                cells = world.labels[cup].cells(of_cup.looks)
                shown[:, rows, cup] = cells.log_odds[axes[cup]], cells.seen[axes[cup]]
    chosen = mapped(lambda leaf: leaf[reached.place], states)
    return replace(chosen, log_odds=shown[0], seen=shown[1])


def actions_in(states: TableState, reached: Reached, policies: Sequence[Policy], key: Key) -> Int[np.ndarray, "P n"]:
    """Decisions of each policy in the states that it reaches, each with its own key; FINISH in all others."""
    actions = np.full(reached.mass.shape, FINISH, dtype=np.int64)
    keys = random.fold_in(random.fold_in(key[None], reached.place), reached.cell)
    for of_policy, mass, policy in zip(actions, reached.mass, policies, strict=True):
        asked = np.flatnonzero(mass > 0.0)
        for rows in np.split(asked, range(_ASKED_AT_ONCE, len(asked), _ASKED_AT_ONCE)):
            if len(rows):
                of_policy[rows] = policy.decide(mapped(lambda leaf, rows=rows: leaf[rows], states), keys[rows]).action
    return actions


class Flow:
    """Probability mass and accumulated reward of the trajectories of P policies."""

    def __init__(self, graph: StateGraph, num_policies: int) -> None:
        self.graph, self.earned = graph, np.zeros(num_policies)
        self.masses: dict[int, Grid] = {}
        """For each node of the next layer, by index: probability of each cell under each policy."""
        self._arrive(graph.root, np.ones((num_policies, *(1,) * graph.world.num_objects)), np.arange(num_policies))

    def go_on(self, nodes: list[Node], reached: Reached, actions: Int[np.ndarray, "P n"]) -> None:
        """Advance every policy from the states of a layer to the next decision.

        Raises
        ------
        ArgumentError
            An action is not possible.
        """
        self.masses = {}
        for place, rows in reached.by_node():
            node, mass, of_node = nodes[place], reached.mass[:, rows], actions[:, rows]
            axes, choices = np.unravel_index(reached.cell[rows], node.shape), self.graph.choices(node)
            for action in np.unique(of_node[mass > 0.0]).tolist():
                if action not in choices:
                    there = [cup for cup, counted in enumerate(node.tally) if counted is not None]
                    raise ArgumentError(
                        f"policy chose action {action} with objects {there} on the table; it must choose a possible one"
                    )
                choice, taken = choices[action], np.where(of_node == action, mass, 0.0)
                self.earned += taken @ np.broadcast_to(self._paid(choice), node.shape)[axes]
                if any(arrival.node for arrival in choice.ways):
                    movers = np.flatnonzero(taken.any(axis=1))
                    moved = np.zeros((len(movers), *node.shape))
                    moved[:, *axes] = taken[movers]
                    self._send(choice, moved, movers)

    def _paid(self, choice: ActionOutcomes) -> Grid | float:
        """Reward of a choice until the next decision or the end."""
        ends = [(arrival, probability) for arrival, probability in choice.ways.items() if arrival.node is None]
        return sum((probability * self.graph.worth(arrival) for arrival, probability in ends), choice.reward)

    def _send(self, choice: ActionOutcomes, mass: Grid, movers: Int[np.ndarray, " M"]) -> None:
        for arrival, probability in choice.ways.items():
            if arrival.node is not None:
                self._arrive(arrival, probability * mass, movers)

    def _arrive(self, arrival: Arrival, mass: Grid, movers: Int[np.ndarray, " M"]) -> None:
        node = arrival.node
        assert node is not None, "the trajectory goes on"
        gone = tuple(1 + cup for cup, counted in enumerate(node.tally) if counted is None)
        mass = spread_over_labels(mass.sum(axis=gone, keepdims=True), arrival.looks, node.shape)
        if node.place is None:
            choice = node.choices[GO_ON]
            self.earned[movers] += np.sum(mass * self._paid(choice), axis=tuple(range(1, mass.ndim)))
            self._send(choice, mass, movers)
        elif node.place in self.masses:
            self.masses[node.place][movers] += mass
        else:
            self.masses[node.place] = np.zeros((len(self.earned), *node.shape))
            self.masses[node.place][movers] = mass
