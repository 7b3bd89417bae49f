"""Between states of the world and cells of a graph: which are reached, what a policy does there, where one lies."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.planners.exact_graph import Graph, Node
from halfseen.planners.exact_labels import Grid
from halfseen.planners.exact_model import NOTHING, GridWorld, Tally
from halfseen.planners.exact_process import IDLE, PARKED, Team, Work
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.actions import FINISH
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import NO_ATTEMPT, Robots, TableState

_ASKED_AT_ONCE = 1024
"""States in which a policy is asked at once, so that one that samples futures has room."""
_SAME_LABELS = 1e-3


class Reached(NamedTuple):
    """States of a layer that some of P policies reach, those of a node side by side."""

    place: Int[np.ndarray, " n"]
    """Of its node in the layer."""
    cell: Int[np.ndarray, " n"]
    """In the node's grid."""
    mass: Float[np.ndarray, "P n"]
    """Probability that a trajectory of each policy comes here."""

    def of(self, rows: Int[np.ndarray, " m"] | slice) -> "Reached":
        """Keep some of them."""
        return Reached(self.place[rows], self.cell[rows], self.mass[:, rows])

    def by_node(self) -> Iterator[tuple[int, slice]]:
        """Go through the nodes: place in the layer, and rows of its states."""
        starts = np.flatnonzero(np.diff(self.place, prepend=-1)).tolist()
        for start, end in zip(starts, [*starts[1:], len(self.place)], strict=True):
            yield int(self.place[start]), slice(start, end)


def reached_in(masses: dict[int, Grid]) -> Reached:
    """The cells of a layer's grids in which some policy (the first axis) has mass, in the order of the layer."""
    flat = {place: masses[place].reshape(len(masses[place]), -1) for place in sorted(masses)}
    cells = {place: np.flatnonzero((mass > 0.0).any(axis=0)) for place, mass in flat.items()}
    return Reached(
        place=np.repeat(np.fromiter(flat, dtype=np.int64), [len(of_node) for of_node in cells.values()]),
        cell=np.concatenate(list(cells.values())),
        mass=np.concatenate([mass[:, cells[place]] for place, mass in flat.items()], axis=1),
    )


def drawn(reached: Reached, max_states: int, key: Key) -> Reached:
    """Let each policy keep at most so many states, which then stand for all that it reaches."""
    draw = float(random.uniform(key))
    mass = np.stack([_thinned(of_policy, max_states, draw) for of_policy in reached.mass])
    return reached._replace(mass=mass).of(np.flatnonzero((mass > 0.0).any(axis=0)))


def _thinned(mass: Float[np.ndarray, " n"], max_states: int, draw: float) -> Float[np.ndarray, " n"]:
    """Keep the likely states, and at random some of the others, which then stand for the rest.

    No expectation changes [FearnheadClifford2003]_: a mass m < c becomes c with probability m/c, or else 0, and c is
    such that as many states are left as are wanted.
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
    # Evenly spaced draws add less noise than independent ones.
    steps = draw + np.arange(max_states - num_likely)
    lucky = rest[np.minimum(np.searchsorted(ladder, steps, side="right"), len(rest) - 1)]
    kept = np.where(is_likely, mass, 0.0)
    kept[lucky] = share[num_likely]
    return kept


def states_of(team: Team, nodes: Collection[Node]) -> TableState:
    """What a policy is shown in each of some nodes, but for the labels.

    Of attempts it is shown those at objects that have not left: the others are forgotten, so that there is room for all
    that follow.
    """
    num, world, num_stages = len(nodes), team.world, team.config.num_stages
    num_objects = world.num_objects
    tallies = [node.tally for node in nodes]
    tried = np.zeros((num, num_stages, 3))
    tried[..., 0] = NO_ATTEMPT
    for row, tally in zip(tried, tallies, strict=True):
        attempts = _attempts(world, tally)
        row[: len(attempts)] = np.reshape(attempts, (-1, 3))
    lifts = [[0 if told is None else sum(told.successes) for told in tally] for tally in tallies]
    works = [node.work for node in nodes]
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

    def each(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(values, (num, *values.shape))

    return TableState(
        hides=each(world.scene.hides.astype(np.float32)),
        is_object=np.ones((num, num_objects), dtype=bool),
        is_on_table=np.array([[told is not None for told in tally] for tally in tallies]),
        grip=each(world.grip.astype(np.float32)),
        log_odds=np.zeros((num, num_objects), dtype=np.float32),
        seen=np.zeros((num, num_objects), dtype=np.float32),
        lifts=np.array(lifts, dtype=np.int32),
        attempt_object=tried[..., 0].astype(np.int32),
        attempt_occlusion=tried[..., 1].astype(np.float32),
        attempt_succeeded=tried[..., 2] > 0.0,
        steps_to_go=(to_go.sum(axis=1) + is_busy.sum(axis=1)).astype(np.int32),
        robots=None if space is None else robots,
        workspace=None if space is None else mapped(lambda leaf: each(np.asarray(leaf)), space),
        decider=None if space is None else np.array([work.decider for work in works], dtype=np.int32),
    )


def _attempts(world: GridWorld, tally: Tally) -> list[tuple[int, float, bool]]:
    """Attempts at what has not left: object, its occlusion, and whether it held."""
    return [
        (cup, world.occlusions[cup][level], is_held)
        for cup, told in enumerate(tally)
        if told is not None
        for is_held, counts in ((False, told.failures), (True, told.successes))
        for level, count in enumerate(counts)
        for _ in range(count)
    ]


def labelled(world: GridWorld, states: TableState, nodes: list[Node], reached: Reached) -> TableState:
    """The states that are reached of a layer, given what is shown in each of its nodes."""
    told = np.zeros((2, len(reached.place), world.num_objects), dtype=np.float32)
    for place, rows in reached.by_node():
        axes = np.unravel_index(reached.cell[rows], nodes[place].shape)
        for cup, of_cup in enumerate(nodes[place].tally):
            if of_cup is not None:
                cells = world.labels[cup].cells(of_cup.looks)
                told[:, rows, cup] = cells.log_odds[axes[cup]], cells.seen[axes[cup]]
    chosen = mapped(lambda leaf: leaf[reached.place], states)
    return replace(chosen, log_odds=told[0], seen=told[1])


def actions_in(states: TableState, reached: Reached, policies: Sequence[Policy], key: Key) -> Int[np.ndarray, "P n"]:
    """Ask each policy in the states that it reaches, each with a key of its own; FINISH where it never comes."""
    actions = np.full(reached.mass.shape, FINISH, dtype=np.int64)
    keys = random.fold_in(random.fold_in(key[None], reached.place), reached.cell)
    for of_policy, mass, policy in zip(actions, reached.mass, policies, strict=True):
        asked = np.flatnonzero(mass > 0.0)
        for rows in np.split(asked, range(_ASKED_AT_ONCE, len(asked), _ASKED_AT_ONCE)):
            if len(rows):
                of_policy[rows] = policy.decide(mapped(lambda leaf, rows=rows: leaf[rows], states), keys[rows]).action
    return actions


def place_of(graph: Graph, state: TableState) -> tuple[Node, tuple[int, ...]]:
    """Node and cell of one state of a robot that works alone.

    Raises
    ------
    ArgumentError
        It is not one of this table within this horizon.
    """
    world, horizon = graph.world, len(graph.layers)
    index, there = horizon - int(state.steps_to_go), np.asarray(state.is_on_table)
    if there.shape != (world.num_objects,) or not 0 <= index < horizon or not there.any():
        raise ArgumentError(
            f"state has objects on the table {there.tolist()} and {int(state.steps_to_go)} steps to go; "
            f"give one of {world.num_objects} objects with 1 to {horizon} steps to go, and some object left"
        )
    work = Work((IDLE,), (horizon - index,))
    node = graph.layers[index][_tally_of(world, state, index), work]
    return node, _cell_of(world, node, np.asarray(state.log_odds), np.asarray(state.seen))


def _tally_of(world: GridWorld, state: TableState, num_attempts: int) -> Tally:
    """Looks and attempts along the trajectory; an object that left was washed by the last attempt that grasped it."""
    targets, held = (
        np.asarray(each)[:num_attempts].tolist() for each in (state.attempt_object, state.attempt_succeeded)
    )
    last = {target: step for step, target in enumerate(targets)}
    tally, _ = world.looked(world.first, NOTHING)
    for step, (target, is_held) in enumerate(zip(targets, held, strict=True)):
        told = tally[target] if 0 <= target < len(tally) else None
        if told is None:
            raise ArgumentError(f"state's attempt {step + 1}, on object {target}, is not possible on this table")
        is_washed = is_held and not state.is_on_table[target] and last[target] == step
        after = None if is_washed else world.tried(told, world.levels(tally)[target], is_held)
        tally = (*tally[:target], after, *tally[target + 1 :])
        tally, _ = world.looked(tally, frozenset([target]) if is_held and not is_washed else NOTHING)
    return tally


def _cell_of(world: GridWorld, node: Node, log_odds: np.ndarray, seen: np.ndarray) -> tuple[int, ...]:
    """Cell that tells what the state does; where several are, they are worth the same."""
    cell = []
    for cup, told in enumerate(node.tally):
        if told is None:
            cell.append(0)
            continue
        cells = world.labels[cup].cells(told.looks)
        distance = np.abs(cells.log_odds - log_odds[cup]) + np.abs(cells.seen - seen[cup])
        cell.append(int(np.argmin(distance)))
        if not distance.min() < _SAME_LABELS:
            raise ArgumentError(
                f"state's log-odds of object {cup} are {log_odds[cup]:g}, with {seen[cup]:g} of it seen; the nearest "
                f"that its looks allow are {distance.min():.2g} away: give a state of this table"
            )
    return tuple(cell)
