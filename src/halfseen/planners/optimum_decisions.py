"""Between the states of the world and the cells of a small table: what a policy is shown, and where a state lies."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Int

from halfseen.errors import ArgumentError
from halfseen.planners.optimum_bellman import Attempt, Grid, Layer, Node, grid_shape
from halfseen.planners.optimum_model import (
    GridWorld,
    Result,
    after_attempt,
    after_look,
    current_levels,
    first_tally,
    is_there,
)
from halfseen.world.actions import num_actions
from halfseen.world.policy import Policy
from halfseen.world.state import NO_ATTEMPT, TableState

BATCH_SIZES = (64, 1024)
"""Numbers of states for which a policy is compiled: the smallest that holds all, or else the largest."""

_SAME_LOG_ODDS = 1e-3


@jax.jit
def _decide_each(policy: Policy, states: TableState, keys: Array) -> Array:
    return jax.vmap(policy.decide)(states, keys).action


def actions_in(
    world: GridWorld,
    horizon: int,
    index: int,
    layer: Layer,
    masses: dict[int, Grid],
    policy: Policy,
    key: Array,
) -> dict[int, Int[np.ndarray, "..."]]:
    """What a policy does in each cell of a layer that has some mass; 0 in the others.

    Raises
    ------
    ArgumentError
        It chose an action that is not possible.
    """
    if not masses:
        return {}
    cells = {place: np.flatnonzero(mass > 0.0) for place, mass in masses.items()}
    parts = [states_in(world, horizon, index, layer[place], cells[place]) for place in masses]
    states = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    decided = _decided(policy, states, key)
    _check_possible(decided, states["is_on_table"])
    actions, start = {}, 0
    for place, mass in masses.items():
        actions[place] = np.zeros(mass.shape, dtype=np.int64)
        actions[place].flat[cells[place]] = decided[start : start + len(cells[place])]
        start += len(cells[place])
    return actions


def _decided(policy: Policy, states: dict[str, np.ndarray], key: Array) -> Int[np.ndarray, " n"]:
    """Ask in batches, the last one filled up, so that few sizes are compiled."""
    num_states = len(states["steps_to_go"])
    size = next((size for size in BATCH_SIZES if size >= num_states), BATCH_SIZES[-1])
    decided = []
    for start in range(0, num_states, size):
        rows = np.minimum(np.arange(start, start + size), num_states - 1)
        batch = TableState(**{name: jnp.asarray(values[rows]) for name, values in states.items()})
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, rows)
        decided.append(np.asarray(_decide_each(policy, batch, keys)))
    return np.concatenate(decided)[:num_states].astype(np.int64)


def _check_possible(actions: Int[np.ndarray, " n"], there: Bool[np.ndarray, "n N"]) -> None:
    is_possible = np.concatenate([np.ones((len(there), 1), dtype=bool), there, there], axis=1)
    in_range = (actions >= 0) & (actions < num_actions(there.shape[1]))
    wrong = np.flatnonzero(~in_range | ~is_possible[np.arange(len(actions)), np.where(in_range, actions, 0)])
    if len(wrong):
        raise ArgumentError(
            f"policy chose action {actions[wrong[0]]} with objects {np.flatnonzero(there[wrong[0]]).tolist()} on the "
            "table; it must choose a possible one"
        )


def states_in(
    world: GridWorld, horizon: int, index: int, node: Node, cells: Int[np.ndarray, " n"]
) -> dict[str, np.ndarray]:
    """Return what a policy is shown in some cells of a node: the fields of a `TableState`, a row for each cell."""
    num_objects, there = world.num_objects, is_there(node.tally)
    axes = np.unravel_index(cells, grid_shape(world, node.tally))
    log_odds = np.zeros((len(cells), num_objects), dtype=np.float32)
    for cup, told in enumerate(node.tally):
        if told is not None:
            log_odds[:, cup] = world.log_odds(cup, told.looks)[axes[cup]]
    tried = np.full(horizon, NO_ATTEMPT, dtype=np.int32)
    occluded, succeeded = np.zeros(horizon, dtype=np.float32), np.zeros(horizon, dtype=bool)
    lifts = np.zeros(num_objects, dtype=np.int32)
    tally = after_look(world, first_tally(world))
    for step, (target, result) in enumerate(node.path):
        tried[step], succeeded[step] = target, result is not Result.FAILED
        occluded[step] = world.occlusions[target][current_levels(world, tally)[target]]
        lifts[target] += result is Result.LIFTED
        tally = after_attempt(world, tally, target, result)

    def each(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(values, (len(cells), *values.shape))

    return {
        "hides": each(world.hides.astype(np.float32)),
        "is_object": each(np.ones(num_objects, dtype=bool)),
        "is_on_table": each(np.isin(np.arange(num_objects), there)),
        "log_odds": log_odds,
        "lifts": each(lifts),
        "attempt_object": each(tried),
        "attempt_occlusion": each(occluded),
        "attempt_succeeded": each(succeeded),
        "steps_to_go": each(np.asarray(horizon - index, dtype=np.int32)),
    }


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
