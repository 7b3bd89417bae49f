"""What policies do in many states of a small table, those that are alike asked at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.optimum_decisions import Histories, Reached
from halfseen.planners.optimum_model import GridWorld
from halfseen.world.action_space import FINISH, TARGETED, ActionSpace, Verb
from halfseen.world.policy import Policy
from halfseen.world.state import TableState

BATCH_SIZES = (4, 32, 1024)
"""Numbers of states for which a policy is compiled: the smallest that holds all, or else the largest."""


@dataclass(frozen=True)
class Alike:
    """Policies that one compiled call can ask, as they differ in numbers alone."""

    which: tuple[int, ...]
    policy: Policy
    """With an axis for them, unless it is only one."""


def groups_of(policies: Sequence[Policy]) -> list[Alike]:
    """Group policies that are alike."""
    groups: dict[Any, list[int]] = {}
    for k, policy in enumerate(policies):
        leaves, structure = jax.tree.flatten(policy)
        kind = structure, tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        groups.setdefault(kind, []).append(k)
    return [Alike(tuple(which), _stacked([policies[k] for k in which])) for which in groups.values()]


def _stacked(policies: Sequence[Policy]) -> Policy:
    one = policies[0]
    return one if len(policies) == 1 else jax.tree.map(lambda *leaves: jnp.stack(leaves), *policies)


def actions_in(
    world: GridWorld,
    steps_to_go: int,
    histories: Histories,
    reached: Reached,
    told: tuple[Float[np.ndarray, "n N"], Float[np.ndarray, "n N"]],
    groups: Sequence[Alike],
    key: Array,
) -> Int[np.ndarray, "P n"]:
    """What each policy does in states of a layer, each state with a key of its own; FINISH where it never comes.

    `told` are the log-odds of DIRTY and the shares of the surfaces seen.

    Raises
    ------
    ArgumentError
        A policy chose an action that is not possible.
    """
    actions = np.full(reached.mass.shape, FINISH, dtype=np.int64)
    there = histories.is_on_table[reached.place]
    place, cell = reached.place.astype(np.int32), reached.cell.astype(np.int32)
    labels = (values.astype(np.float32) for values in told)
    shown = _Shown(place, cell, *labels, *(rows[reached.place] for rows in histories[:-2]))
    for group in groups:
        is_reached = reached.mass[list(group.which)] > 0.0
        states = np.flatnonzero(is_reached.any(axis=0))
        asked = _asked(group, world, steps_to_go, _Shown(*(values[states] for values in shown)), key)
        for k, of_policy, own in zip(group.which, asked, is_reached[:, states], strict=True):
            _check_possible(of_policy[own], there[states[own]])
            actions[k, states[own]] = of_policy[own]
    return actions


def _asked(group: Alike, world: GridWorld, steps_to_go: int, shown: "_Shown", key: Array) -> Int[np.ndarray, "G n"]:
    """What policies that are alike do in some states."""
    num_states = len(shown.place)
    if not num_states:
        return np.zeros((len(group.which), 0), dtype=np.int64)
    size = next((size for size in BATCH_SIZES if size >= num_states), BATCH_SIZES[-1])
    # The last batch is filled up, so that few sizes are compiled.
    filled = _Shown(*(np.pad(rows, [(0, -num_states % size), *[(0, 0)] * (rows.ndim - 1)], "edge") for rows in shown))
    batches = [_Shown(*(rows[start : start + size] for rows in filled)) for start in range(0, num_states, size)]
    decide = _decide_each if len(group.which) == 1 else _decide_alike
    hides, grip = (jnp.asarray(of_scene, dtype=jnp.float32) for of_scene in (world.scene.hides, world.grip))
    table = _Table(hides, grip, np.int32(steps_to_go))
    decided = [decide(group.policy, table, batch, key) for batch in batches]
    return np.concatenate([np.atleast_2d(each) for each in decided], axis=1)[:, :num_states].astype(np.int64)


class _Table(NamedTuple):
    """What the states of a layer share."""

    hides: Float[Array, "N N"]
    grip: Float[Array, " N"]
    steps_to_go: Int[Array | np.ndarray, ""] | np.int32


class _Shown(NamedTuple):
    """What differs between the states of a layer, a row for each; place and cell number them, whoever asks."""

    place: Int[Array | np.ndarray, " n"]
    cell: Int[Array | np.ndarray, " n"]
    log_odds: Float[Array | np.ndarray, "n N"]
    seen: Float[Array | np.ndarray, "n N"]
    is_on_table: Bool[Array | np.ndarray, "n N"]
    lifts: Int[Array | np.ndarray, "n N"]
    attempt_object: Int[Array | np.ndarray, "n T"]
    attempt_occlusion: Float[Array | np.ndarray, "n T"]
    attempt_succeeded: Bool[Array | np.ndarray, "n T"]


@jax.jit
def _decide_each(policy: Policy, table: _Table, shown: _Shown, key: Array) -> Array:
    is_object = jnp.ones(len(table.grip), dtype=bool)

    def decide(place: Any, cell: Any, *of_state: Any) -> Array:
        known = dict(zip(_Shown._fields[2:], of_state, strict=True))
        state = TableState(is_object=is_object, **table._asdict(), **known)
        return policy.decide(state, jax.random.fold_in(jax.random.fold_in(key, place), cell)).action

    return jax.vmap(decide)(*shown)


_decide_alike = jax.jit(jax.vmap(_decide_each, in_axes=(0, None, None, None)))


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
