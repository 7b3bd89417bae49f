"""Between the states of the world and the cells of a small table: what a policy is shown, and where a state lies."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.optimum_bellman import Attempt, Grid, Layer, Node, grid_shape
from halfseen.planners.optimum_model import GridWorld, Result, current_levels
from halfseen.world.action_space import FINISH, TARGETED, ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import NO_ATTEMPT, TableState

BATCH_SIZES = (4, 32, 1024)
"""Numbers of states for which a policy is compiled: the smallest that holds all, or else the largest."""

_SAME_LOG_ODDS = 1e-3


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
    """States of a layer that are reached with some probability: a row for each, those of a node side by side."""

    place: Int[np.ndarray, " n"]
    """Of its node in the layer."""
    cell: Int[np.ndarray, " n"]
    """In the node's grid."""
    mass: Float[np.ndarray, " n"]
    """Probability that a path comes here."""


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


def reached_in(masses: dict[int, Grid]) -> list[Reached]:
    """Return the cells of a layer's grids that have some mass, of each policy (the first axis)."""
    flat = [grid.reshape(len(grid), -1) for grid in masses.values()]
    policy, cell = (np.concatenate(axes) for axes in zip(*(np.nonzero(mass > 0.0) for mass in flat), strict=True))
    place = np.repeat(np.fromiter(masses, dtype=np.int64), [np.count_nonzero(mass > 0.0) for mass in flat])
    mass = np.concatenate([mass[mass > 0.0] for mass in flat])
    return [Reached(place[own], cell[own], mass[own]) for own in (policy == k for k in range(len(flat[0])))]


def rows_by_place(reached: Reached) -> Iterator[tuple[int, slice]]:
    """Go through the nodes that are reached: place in the layer, and rows of `reached`."""
    starts = np.flatnonzero(np.diff(reached.place, prepend=-1)).tolist()
    for start, end in zip(starts, [*starts[1:], len(reached.place)], strict=True):
        yield int(reached.place[start]), slice(start, end)


def drawn(reached: Reached, max_states: int, key: Array) -> Reached:
    """Keep at most so many states: the likely ones, and at random some of the others, which then stand for the rest.

    No expectation changes [FearnheadClifford2003]_: a mass m < c becomes c with probability m/c, or else 0, and c is
    such that as many states are left as are wanted.
    """
    mass = reached.mass
    if len(mass) <= max_states:
        return reached
    ordered = np.sort(mass)[::-1]
    others = np.cumsum(ordered[::-1])[::-1][:max_states]
    share = others / np.arange(max_states, 0, -1)
    num_likely = int(np.argmax(ordered[:max_states] < share))
    is_likely = mass >= share[num_likely]
    rest = np.flatnonzero(~is_likely)
    ladder = np.cumsum(mass[rest]) / share[num_likely]
    # Evenly spaced draws add less noise than independent ones.
    steps = float(jax.random.uniform(key)) + np.arange(max_states - num_likely)
    lucky = rest[np.unique(np.minimum(np.searchsorted(ladder, steps, side="right"), len(rest) - 1))]
    kept = np.sort(np.concatenate([np.flatnonzero(is_likely), lucky]))
    return Reached(reached.place[kept], reached.cell[kept], np.maximum(mass, share[num_likely])[kept])


def log_odds_in(world: GridWorld, layer: Layer, reached: Reached) -> Float[np.ndarray, "n N"]:
    """Log-odds of DIRTY in states of a layer; 0 for what has left."""
    log_odds = np.zeros((len(reached.place), world.num_objects))
    for place, rows in rows_by_place(reached):
        tally = layer[place].tally
        axes = np.unravel_index(reached.cell[rows], grid_shape(world, tally))
        for cup, told in enumerate(tally):
            if told is not None:
                log_odds[rows, cup] = world.log_odds(cup, told.looks)[axes[cup]]
    return log_odds


def actions_in(
    world: GridWorld,
    steps_to_go: int,
    histories: Histories,
    reached: Reached,
    log_odds: Float[np.ndarray, "n N"],
    policy: Policy,
    key: Array,
) -> Int[np.ndarray, " n"]:
    """What a policy does in states of a layer, each with a key of its own.

    Raises
    ------
    ArgumentError
        It chose an action that is not possible.
    """
    shown = _Shown(log_odds.astype(np.float32), *(rows[reached.place] for rows in histories[:-2]))
    num_states = len(reached.place)
    size = next((size for size in BATCH_SIZES if size >= num_states), BATCH_SIZES[-1])
    hides, decided = jnp.asarray(world.hides, dtype=jnp.float32), []
    for start in range(0, num_states, size):
        # The last batch is filled up, so that few sizes are compiled.
        rows = np.minimum(np.arange(start, start + size), num_states - 1)
        batch = _Shown(*(values[rows] for values in shown))
        decided.append(np.asarray(_decide_each(policy, hides, np.int32(steps_to_go), batch, key, rows)))
    actions = np.concatenate(decided)[:num_states].astype(np.int64)
    _check_possible(actions, histories.is_on_table[reached.place])
    return actions


def rewards_in(
    config: WorldConfig,
    histories: Histories,
    reached: Reached,
    log_odds: Float[np.ndarray, "n N"],
    actions: Int[np.ndarray, " n"],
    is_last: bool,
) -> Float[np.ndarray, " n"]:
    """Expected reward of an action in states of a layer, with the price of what is left if the path ends by it."""
    there, rows = histories.is_on_table[reached.place], np.arange(len(actions))
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
    return np.select([actions == FINISH, codec.verb(actions) == Verb.WASH], [left, wash], lift)


class _Shown(NamedTuple):
    """What differs between the states of a layer, a row for each."""

    log_odds: Float[Array | np.ndarray, "n N"]
    is_on_table: Bool[Array | np.ndarray, "n N"]
    lifts: Int[Array | np.ndarray, "n N"]
    attempt_object: Int[Array | np.ndarray, "n T"]
    attempt_occlusion: Float[Array | np.ndarray, "n T"]
    attempt_succeeded: Bool[Array | np.ndarray, "n T"]


@jax.jit
def _decide_each(policy: Policy, hides: Array, steps_to_go: Array, shown: _Shown, key: Array, rows: Array) -> Array:
    is_object = jnp.ones(hides.shape[0], dtype=bool)

    def decide(shown: _Shown, row: Array) -> Array:
        state = TableState(hides=hides, is_object=is_object, steps_to_go=steps_to_go, **shown._asdict())
        return policy.decide(state, jax.random.fold_in(key, row)).action

    return jax.vmap(decide)(shown, rows)


def _check_possible(actions: Int[np.ndarray, " n"], there: Bool[np.ndarray, "n N"]) -> None:
    known = [there & (verb in (Verb.WASH, Verb.LIFT)) for verb in TARGETED]
    is_possible = np.concatenate([np.ones((len(there), 1), dtype=bool), *known], axis=1)
    in_range = (actions >= 0) & (actions < ActionSpace(there.shape[1]).num_actions)
    wrong = np.flatnonzero(~in_range | ~is_possible[np.arange(len(actions)), np.where(in_range, actions, 0)])
    if len(wrong):
        raise ArgumentError(
            f"policy chose action {actions[wrong[0]]} with objects {np.flatnonzero(there[wrong[0]]).tolist()} on the "
            "table; it must choose a possible one"
        )


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
    return index, place, _cell_of(world, layers[index][place], np.asarray(state.log_odds, dtype=np.float64))


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


def _cell_of(world: GridWorld, node: Node, log_odds: np.ndarray) -> tuple[int, ...]:
    """Cell whose log-odds are those of the state; where several are, they are worth the same."""
    cell = []
    for cup, told in enumerate(node.tally):
        if told is None:
            cell.append(0)
            continue
        distance = np.abs(world.log_odds(cup, told.looks) - log_odds[cup])
        cell.append(int(np.argmin(distance)))
        if not distance.min() < _SAME_LOG_ODDS:
            raise ArgumentError(
                f"state's log-odds of object {cup} are {log_odds[cup]:g}; the nearest that its looks allow are "
                f"{distance.min():.2g} away: give a state of this table"
            )
    return tuple(cell)
