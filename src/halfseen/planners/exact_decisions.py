"""Between the states of the world and the cells of a small table: which are reached, what is done, where one lies."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import at, mapped
from halfseen.errors import ArgumentError
from halfseen.planners.exact_bellman import Attempt, Grid, Layer, Node
from halfseen.planners.exact_model import GridWorld, Result, current_levels, grid_shape
from halfseen.world import random
from halfseen.world.actions import FINISH, ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import NO_ATTEMPT, TableState

CHUNK_SIZE = 1024
"""States in which a policy is asked at once, so that one that samples futures has room."""

_SAME_LABELS = 1e-3


class Histories(NamedTuple):
    """What the states of each node of a layer share: a row for each node."""

    is_on_table: Bool[np.ndarray, "nodes N"]
    lifts: Int[np.ndarray, "nodes N"]
    attempt_object: Int[np.ndarray, "nodes T"]
    attempt_occlusion: Float[np.ndarray, "nodes T"]
    attempt_succeeded: Bool[np.ndarray, "nodes T"]
    probability: Float[np.ndarray, "nodes N"]
    """P(an attempt made now succeeds); 0 for what has left."""
    attempt_s: Float[np.ndarray, "nodes N"]
    """Its expected time [s]."""


class Reached(NamedTuple):
    """States of a layer that some of P policies reach, those of a node side by side."""

    place: Int[np.ndarray, " n"]
    """Of its node in the layer."""
    cell: Int[np.ndarray, " n"]
    """In the node's grid."""
    mass: Float[np.ndarray, "P n"]
    """Probability that a path of each policy comes here."""

    def of(self, states: Int[np.ndarray, " m"] | slice) -> "Reached":
        """Keep some of them."""
        return Reached(self.place[states], self.cell[states], self.mass[:, states])


def histories_of(world: GridWorld, layers: list[Layer]) -> list[Histories]:
    """Return what led to each node of each layer, along the path that the node names."""
    histories: list[Histories] = []
    occluded: list[tuple[float, ...]] = [()]
    for layer, following in zip(layers, [*layers[1:], []], strict=True):
        behind: list[tuple[float, ...]] = [()] * len(following)
        grasps = np.zeros((2, len(layer), world.num_objects))
        for row, (node, before) in enumerate(zip(layer, occluded, strict=True)):
            levels = current_levels(world, node.tally)
            for cup, told in enumerate(node.tally):
                if told is not None:
                    grasps[:, row, cup] = world.attempt(cup, told.failures, told.successes, levels[cup])
            for attempt, place in node.successors.items():
                if following[place].path == (*node.path, attempt):
                    behind[place] = (*before, world.occlusions[attempt[0]][levels[attempt[0]]])
        histories.append(Histories(*_shown_histories(world.num_objects, len(layers), layer, occluded), *grasps))
        occluded = behind
    return histories


def _shown_histories(
    num_objects: int, horizon: int, layer: Layer, occluded: list[tuple[float, ...]]
) -> tuple[np.ndarray, ...]:
    """What a policy is shown of the history of each node."""
    attempts = np.array([node.path for node in layer], dtype=np.int32).reshape(len(layer), -1, 2)
    num_done = attempts.shape[1]
    tried = np.full((len(layer), horizon), NO_ATTEMPT, dtype=np.int32)
    seen_at, succeeded = np.zeros(tried.shape, dtype=np.float32), np.zeros(tried.shape, dtype=bool)
    tried[:, :num_done], succeeded[:, :num_done] = attempts[..., 0], attempts[..., 1] != Result.FAILED
    seen_at[:, :num_done] = np.reshape(occluded, (len(layer), num_done))
    is_lift = (attempts[..., :1] == np.arange(num_objects)) & (attempts[..., 1:] == Result.LIFTED)
    there = np.array([[told is not None for told in node.tally] for node in layer])
    return there, is_lift.sum(axis=1, dtype=np.int32), tried, seen_at, succeeded


def reached_in(masses: dict[int, Grid]) -> Reached:
    """Return the cells of a layer's grids in which some policy (the first axis) has mass."""
    flat = {place: grid.reshape(len(grid), -1) for place, grid in masses.items()}
    cells = {place: np.flatnonzero((mass > 0.0).any(axis=0)) for place, mass in flat.items()}
    return Reached(
        place=np.repeat(np.fromiter(flat, dtype=np.int64), [len(of_node) for of_node in cells.values()]),
        cell=np.concatenate(list(cells.values())),
        mass=np.concatenate([mass[:, cells[place]] for place, mass in flat.items()], axis=1),
    )


def rows_by_place(reached: Reached) -> Iterator[tuple[int, slice]]:
    """Go through the nodes that are reached: place in the layer, and rows of `reached`."""
    starts = np.flatnonzero(np.diff(reached.place, prepend=-1)).tolist()
    for start, end in zip(starts, [*starts[1:], len(reached.place)], strict=True):
        yield int(reached.place[start]), slice(start, end)


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


def told_in(
    world: GridWorld, layer: Layer, reached: Reached
) -> tuple[Float[np.ndarray, "n N"], Float[np.ndarray, "n N"]]:
    """Log-odds of DIRTY, and share of the surface seen, in states of a layer; 0 for what has left."""
    log_odds, seen = np.zeros((2, len(reached.place), world.num_objects))
    for place, rows in rows_by_place(reached):
        tally = layer[place].tally
        axes = np.unravel_index(reached.cell[rows], grid_shape(world, tally))
        for cup, told in enumerate(tally):
            if told is not None:
                log_odds[rows, cup] = world.labels[cup].log_odds(told.looks)[axes[cup]]
                seen[rows, cup] = world.labels[cup].seen(told.looks)[axes[cup]]
    return log_odds, seen


def states_in(
    world: GridWorld,
    steps_to_go: int,
    histories: Histories,
    reached: Reached,
    told: tuple[Float[np.ndarray, "n N"], Float[np.ndarray, "n N"]],
) -> TableState:
    """Return states of a layer as a policy is shown them, by the log-odds of DIRTY and the shares seen of surfaces."""
    num_states, num_objects = len(reached.place), world.num_objects
    log_odds, seen = (values.astype(np.float32) for values in told)
    hides, grip = (np.asarray(of_scene, dtype=np.float32) for of_scene in (world.scene.hides, world.grip))
    shown = {name: getattr(histories, name)[reached.place] for name in Histories._fields[:-2]}
    return TableState(
        hides=np.broadcast_to(hides, (num_states, num_objects, num_objects)),
        is_object=np.ones((num_states, num_objects), dtype=bool),
        grip=np.broadcast_to(grip, (num_states, num_objects)),
        log_odds=log_odds,
        seen=seen,
        steps_to_go=np.full(num_states, steps_to_go, dtype=np.int32),
        **shown,
    )


def actions_in(states: TableState, reached: Reached, policies: Sequence[Policy], key: Key) -> Int[np.ndarray, "P n"]:
    """Ask each policy in the states that it reaches, each with a key of its own; FINISH where it never comes.

    Raises
    ------
    ArgumentError
        A policy chose an action that is not possible.
    """
    actions = np.full(reached.mass.shape, FINISH, dtype=np.int64)
    keys = random.fold_in(random.fold_in(key, reached.place), reached.cell)
    for of_policy, mass, policy in zip(actions, reached.mass, policies, strict=True):
        rows = np.flatnonzero(mass > 0.0)
        if len(rows):
            asked = rows_of(states, rows)
            of_policy[rows] = decided(policy, asked, keys[rows])
            _check_possible(asked, of_policy[rows])
    return actions


def decided(policy: Policy, states: TableState, keys: Key) -> Int[np.ndarray, " n"]:
    """Ask a policy in many states, some at once."""
    chunks = [slice(start, start + CHUNK_SIZE) for start in range(0, len(keys), CHUNK_SIZE)]
    return np.concatenate([policy.decide(rows_of(states, rows), keys[rows]).action for rows in chunks])


def rows_of(states: TableState, rows: Int[np.ndarray, " m"] | slice) -> TableState:
    """Return some of many states."""
    return mapped(lambda leaf: leaf[rows], states)


def _check_possible(states: TableState, actions: Int[np.ndarray, " n"]) -> None:
    is_possible = possible_actions(states)
    in_range = (actions >= 0) & (actions < is_possible.shape[1])
    wrong = np.flatnonzero(~in_range | ~at(is_possible, np.where(in_range, actions, 0)))
    if len(wrong):
        there = np.flatnonzero(states.is_on_table[wrong[0]]).tolist()
        raise ArgumentError(
            f"policy chose action {actions[wrong[0]]} with objects {there} on the table; it must choose a possible one"
        )


def rewards_in(
    config: WorldConfig,
    histories: Histories,
    reached: Reached,
    log_odds: Float[np.ndarray, "n N"],
    actions: Int[np.ndarray, "P n"],
    is_last: bool,
) -> Float[np.ndarray, "P n"]:
    """Expected reward of each policy's action, with the price of what is left if the path ends by it."""
    there, rows = histories.is_on_table[reached.place], np.arange(actions.shape[1])
    codec = ActionSpace(there.shape[1])
    target = codec.target(actions)
    probability, attempt_s = histories.probability[reached.place, target], histories.attempt_s[reached.place, target]
    is_dirty = np.where(there, 1.0 / (1.0 + np.exp(-log_odds)), 0.0)
    dirty, left = is_dirty[rows, target], float(config.reward_dirty_left) * is_dirty.sum(axis=1)
    washed = dirty * float(config.reward_wash_dirty) + (1.0 - dirty) * float(config.reward_wash_clean)
    wash = probability * washed + (1.0 - probability) * float(config.reward_wash_failed)
    lift = float(config.reward_lift_per_s) * attempt_s
    if is_last:
        wash, lift = wash + left - probability * float(config.reward_dirty_left) * dirty, lift + left
    return np.where(actions == FINISH, left, np.where(codec.verb(actions) == Verb.WASH, wash, lift))


def place_of(world: GridWorld, layers: list[Layer], state: TableState) -> tuple[int, int, tuple[int, ...]]:
    """Layer, node and cell of one state of the world.

    Raises
    ------
    ArgumentError
        It is not one of this table within this horizon.
    """
    index = len(layers) - int(state.steps_to_go)
    there = np.asarray(state.is_on_table)
    if there.shape != (world.num_objects,) or not 0 <= index < len(layers) or not there.any():
        raise ArgumentError(
            f"state has objects on the table {there.tolist()} and {int(state.steps_to_go)} steps to go; "
            f"give one of {world.num_objects} objects with 1 to {len(layers)} steps to go, and some object left"
        )
    place = 0
    for step, attempt in enumerate(_attempts(state, index)):
        if attempt not in layers[step][place].successors:
            raise ArgumentError(f"state's attempt {step + 1}, on object {attempt[0]}, is not possible on this table")
        place = layers[step][place].successors[attempt]
    told = (np.asarray(leaf, dtype=np.float64) for leaf in (state.log_odds, state.seen))
    return index, place, _cell_of(world, layers[index][place], *told)


def _attempts(state: TableState, num_attempts: int) -> list[Attempt]:
    """Objects and results; an object that left was washed by the last attempt that grasped it."""
    targets = np.asarray(state.attempt_object)[:num_attempts].tolist()
    succeeded = np.asarray(state.attempt_succeeded)[:num_attempts].tolist()
    there = np.asarray(state.is_on_table)
    last = {target: step for step, target in enumerate(targets)}
    attempts = []
    for step, (target, is_grasped) in enumerate(zip(targets, succeeded, strict=True)):
        is_washed = is_grasped and not there[target] and last[target] == step
        attempts.append((target, Result.WASHED if is_washed else Result.LIFTED if is_grasped else Result.FAILED))
    return attempts


def _cell_of(world: GridWorld, node: Node, log_odds: np.ndarray, seen: np.ndarray) -> tuple[int, ...]:
    """Cell that tells what the state does; where several are, they are worth the same."""
    cell = []
    for cup, told in enumerate(node.tally):
        if told is None:
            cell.append(0)
            continue
        labels = world.labels[cup]
        distance = np.abs(labels.log_odds(told.looks) - log_odds[cup]) + np.abs(labels.seen(told.looks) - seen[cup])
        cell.append(int(np.argmin(distance)))
        if not distance.min() < _SAME_LABELS:
            raise ArgumentError(
                f"state's log-odds of object {cup} are {log_odds[cup]:g}, with {seen[cup]:g} of it seen; the nearest "
                f"that its looks allow are {distance.min():.2g} away: give a state of this table"
            )
    return tuple(cell)
