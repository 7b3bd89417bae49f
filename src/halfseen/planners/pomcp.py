"""Planning until the time is up: a search tree over what may be done and seen, grown one simulation at a time.

Partially observable Monte Carlo planning [SilverVeness2010]_, compiled. A simulation draws a state s from the belief
and walks down the tree; at a node h (a history of actions and observations) it takes

    a = argmax  Q(h, a) + c √( ln(1 + n(h)) / (1 + n(h, a)) ),   Q(h, a) = (w q_0(h, a) + G(h, a)) / (w + n(h, a)),

where q_0 is the problem's stated rule, which counts as w visits. Where it leaves the tree it adds one node, of value
V = max_a q_0. Going back up,

    G(h, a) = Σ over visits of  r  +  γ Σ_o n(h a o) V(h a o),   V(h) = max_a Q(h, a):

the best action's value, not the mean over all that were tried, so that trying an action costs its parents nothing.
An action's error at the root is that of the mean of r + γ V over its visits.

=============  =============================================================
symbol         here
=============  =============================================================
h, h a o       a row of the arrays of `Tree`; its row of ``parent, via, seen``
n(h), V(h)     ``visits``, ``value``
n(h, a), G     ``tries``, ``total``
q_0            ``rule``; −∞ where an action is impossible
c              ``exploration``, in units of reward
w              ``rule_weight``
γ, H           ``problem.discount``, ``problem.horizon``
=============  =============================================================
"""

import math
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.generative import GenerativeProblem, State

NUM_NODES = 8192
_FREE = -1
_FIRST = 4
_SHARE_OF_TIME_LEFT = 0.5


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Tree:
    """The search tree of one decision; row 0 is the root, rows from `num_nodes` on are free."""

    num_nodes: Int[Array, ""]
    slots: Int[Array, " K"]
    """Rows by the hash of (parent, via, seen), −1 where free."""
    parent: Int[Array, " M"]
    via: Int[Array, " M"]
    seen: Int[Array, " M"]
    visits: Float[Array, " M"]
    value: Float[Array, " M"]
    rule: Float[Array, "M A"]
    rule_weight: Float[Array, ""]
    tries: Float[Array, "M A"]
    total: Float[Array, "M A"]
    root_squares: Float[Array, " A"]
    """Σ (r + γ V)² over the simulations that began with each action."""
    root_sums: Float[Array, " A"]


@dataclass(frozen=True)
class Plan:
    """A decision, what it is worth, and how it was found.

    Attributes
    ----------
    action
        The best action.
    values
        Estimated value of each action; −∞ where it is impossible.
    standard_errors
        Of the simulations alone; infinite for an action that fewer than two began with. The rule's error beyond the
        tree, and that of taking a maximum, are not in it.
    num_tries
        Simulations that began with each action.
    num_simulations
        All of them.
    depth
        Actions in the longest simulation.
    num_nodes
        Size of the tree; once it reaches its bound, the tree is refined but grows no further.
    was_searched
        Whether a simulation began with `action`. If not, `action` is the rule's own choice.
    elapsed_s
        Time that it took [s].
    """

    action: int
    values: Float[np.ndarray, " A"]
    standard_errors: Float[np.ndarray, " A"]
    num_tries: Int[np.ndarray, " A"]
    num_simulations: int
    depth: int
    num_nodes: int
    was_searched: bool
    elapsed_s: float

    @property
    def value(self) -> float:
        """Estimated value of `action`."""
        return float(self.values[self.action])


def plan(
    problem: GenerativeProblem,
    key: Array,
    *,
    budget_s: float | None = None,
    num_simulations: int | None = None,
    particles: State = None,
    exploration: float = 1.0,
    rule_weight: float = 1.0,
    max_nodes: int = NUM_NODES,
) -> Plan:
    """Search for the best action until time or simulations are used up.

    The first call for a kind of problem compiles (seconds) and overruns its budget; call it once with
    ``num_simulations=1`` before the clock matters. The number of simulations is all that the clock decides: the
    same `key` and number give the same plan.

    Parameters
    ----------
    problem
        What is planned for.
    key
        The only source of chance.
    budget_s
        Wall-clock time [s], positive. Give this or `num_simulations`.
    num_simulations
        Number of simulations, ≥ 0.
    particles
        States with one leading axis that stand for the belief in place of ``problem.initial_state``.
    exploration
        c: about the spread of what one action may bring, in units of reward.
    rule_weight
        w: how many simulations the rule's word is worth, above 0.
    max_nodes
        Bound on the size of the tree.

    Returns
    -------
    Plan
        With `was_searched` False where the budget did not suffice for a simulation of the action.

    Raises
    ------
    ArgumentError
        Neither or both of `budget_s` and `num_simulations` are given, or a number is out of range.

    Examples
    --------
    ``examples/planning/tiger.py`` states a problem and plans for it.
    """
    begin_s = time.perf_counter()
    _check(budget_s, num_simulations, exploration, rule_weight, max_nodes, problem.horizon)
    tree, depth = _root(problem, particles, key, float(rule_weight), max_nodes), jnp.zeros((), dtype=jnp.int32)
    grow = partial(_grown, problem, particles, key, float(exploration))
    num_done = 0
    if budget_s is None:
        num_done = num_simulations or 0
        tree, depth = grow(tree, depth, 0, num_done)
    else:
        end_s = begin_s + budget_s
        jax.block_until_ready(tree)
        num_next = _FIRST
        while num_next > 0 and time.perf_counter() < end_s:
            before_s = time.perf_counter()
            tree, depth = jax.block_until_ready(grow(tree, depth, num_done, num_done + num_next))
            now_s = time.perf_counter()
            num_done += num_next
            num_next = int(_SHARE_OF_TIME_LEFT * (end_s - now_s) / (now_s - before_s) * num_next)
    return _read(tree, num_done, int(depth), begin_s)


def _read(tree: Tree, num_simulations: int, depth: int, begin_s: float) -> Plan:
    values, tries, sums, squares, num_nodes = jax.device_get(_summary(tree))
    count = np.maximum(tries, 2.0)
    variance = np.maximum(squares - sums**2 / count, 0.0) / (count - 1.0)
    action = int(np.argmax(values))
    return Plan(
        action=action,
        values=values.astype(np.float64),
        standard_errors=np.where(tries >= 2.0, np.sqrt(variance / count), math.inf).astype(np.float64),
        num_tries=tries.astype(np.int64),
        num_simulations=num_simulations,
        depth=depth,
        num_nodes=int(num_nodes),
        was_searched=bool(tries[action] > 0),
        elapsed_s=time.perf_counter() - begin_s,
    )


@jax.jit
def _summary(tree: Tree) -> tuple[Array, Array, Array, Array, Array]:
    return _q(tree, 0), tree.tries[0], tree.root_sums, tree.root_squares, tree.num_nodes


@partial(jax.jit, static_argnames="max_nodes")
def _root(problem: GenerativeProblem, particles: State, key: Array, rule_weight: float, max_nodes: int) -> Tree:
    """A tree of the root alone."""
    rule = _rule(problem, _drawn(problem, particles, key))
    size, num_slots = (max_nodes, problem.num_actions), 2 ** math.ceil(math.log2(2 * max_nodes))
    return Tree(
        num_nodes=jnp.ones((), dtype=jnp.int32),
        slots=jnp.full(num_slots, _FREE, dtype=jnp.int32),
        parent=jnp.zeros(max_nodes, dtype=jnp.int32),
        via=jnp.zeros(max_nodes, dtype=jnp.int32),
        seen=jnp.zeros(max_nodes, dtype=jnp.int32),
        visits=jnp.zeros(max_nodes).at[0].set(1.0),
        value=jnp.zeros(max_nodes).at[0].set(jnp.max(rule)),
        rule=jnp.zeros(size).at[0].set(rule),
        rule_weight=jnp.asarray(rule_weight, dtype=jnp.float32),
        tries=jnp.zeros(size),
        total=jnp.zeros(size),
        root_squares=jnp.zeros(problem.num_actions),
        root_sums=jnp.zeros(problem.num_actions),
    )


@partial(jax.jit, donate_argnames="tree")
def _grown(
    problem: GenerativeProblem,
    particles: State,
    key: Array,
    exploration: float,
    tree: Tree,
    depth: Int[Array, ""],
    begin: int,
    end: int,
) -> tuple[Tree, Int[Array, ""]]:
    """The tree after simulations `begin` to `end`, and the actions of the longest one; one draw each of `key`."""

    def simulate(k: Array, tree_and_depth: tuple[Tree, Array]) -> tuple[Tree, Array]:
        tree, depth = tree_and_depth
        state_key, walk_key = jax.random.split(jax.random.fold_in(key, k))
        walk = _descent(problem, tree, exploration, _drawn(problem, particles, state_key), walk_key)
        # What is over is worth nothing more, and asking the rule is the dearest part of a simulation.
        rule = jax.lax.cond(
            walk.is_over, lambda: jnp.zeros(problem.num_actions), lambda: _rule(problem, walk.state)
        )
        return _backed_up(problem.discount, _with_leaf(tree, walk, rule), walk, jnp.max(rule)), jnp.maximum(
            depth, walk.length
        )

    return jax.lax.fori_loop(begin, end, simulate, (tree, depth))


class _Walk(NamedTuple):
    """One way down the tree: `length` actions, and where they led."""

    state: State
    key: Array
    nodes: Int[Array, " H"]
    actions: Int[Array, " H"]
    rewards: Float[Array, " H"]
    length: Int[Array, ""]
    node: Int[Array, ""]
    """Where it stands, −1 outside the tree."""
    slot: Int[Array, ""]
    seen: Int[Array, ""]
    is_over: Bool[Array, ""]


def _descent(problem: GenerativeProblem, tree: Tree, exploration: float, state: State, key: Array) -> _Walk:
    """Walk down until the tree or the path ends."""
    zero, path = jnp.zeros((), dtype=jnp.int32), jnp.zeros(problem.horizon, dtype=jnp.int32)
    rewards = jnp.zeros(problem.horizon)

    def goes_on(walk: _Walk) -> Array:
        return (walk.node != _FREE) & ~walk.is_over

    def one_step_down(walk: _Walk) -> _Walk:
        key, step_key = jax.random.split(walk.key)
        tries = tree.tries[walk.node]
        bonus = exploration * jnp.sqrt(jnp.log1p(jnp.sum(tries)) / (1.0 + tries))
        action = jnp.argmax(_q(tree, walk.node) + bonus).astype(jnp.int32)
        after, seen, reward, is_over = problem.step(walk.state, action, step_key)
        seen = seen.astype(jnp.int32)
        slot, node = _found(tree, walk.node, action, seen)
        return _Walk(
            state=after,
            key=key,
            nodes=walk.nodes.at[walk.length].set(walk.node),
            actions=walk.actions.at[walk.length].set(action),
            rewards=walk.rewards.at[walk.length].set(reward),
            length=walk.length + 1,
            node=node,
            slot=slot,
            seen=seen,
            is_over=is_over | (walk.length + 1 == problem.horizon),
        )

    start = _Walk(state, key, path, path, rewards, zero, zero, zero, zero, jnp.asarray(False))
    return jax.lax.while_loop(goes_on, one_step_down, start)


def _found(tree: Tree, node: Array, action: Array, seen: Array) -> tuple[Array, Array]:
    """Slot and row of a node's child, or the free slot where it belongs and −1."""
    last = tree.slots.shape[0] - 1
    mixed = _mixed(_mixed(_mixed(node) ^ action.astype(jnp.uint32)) ^ seen.astype(jnp.uint32))

    def is_other(slot: Array) -> Array:
        row = tree.slots[slot]
        is_child = (tree.parent[row] == node) & (tree.via[row] == action) & (tree.seen[row] == seen)
        return (row != _FREE) & ~is_child

    slot = jax.lax.while_loop(is_other, lambda slot: (slot + 1) & last, (mixed & last).astype(jnp.int32))
    return slot, tree.slots[slot]


def _mixed(number: Array) -> Array:
    """Scatter 32 bits, so that neighbours fall apart [Steele2014]_."""
    number = number.astype(jnp.uint32)
    number = (number ^ (number >> 16)) * jnp.uint32(0x85EBCA6B)
    number = (number ^ (number >> 13)) * jnp.uint32(0xC2B2AE35)
    return number ^ (number >> 16)


def _with_leaf(tree: Tree, walk: _Walk, rule: Float[Array, " A"]) -> Tree:
    """The tree with the node that the walk reached outside of it, if there is room."""
    max_nodes = tree.parent.shape[0]
    is_new = ~walk.is_over & (tree.num_nodes < max_nodes)
    # Writing out of range is dropped: a branch would copy the arrays.
    row = jnp.where(is_new, tree.num_nodes, max_nodes)
    slot = jnp.where(is_new, walk.slot, tree.slots.shape[0])
    return replace(
        tree,
        num_nodes=tree.num_nodes + is_new,
        slots=tree.slots.at[slot].set(row, mode="drop"),
        parent=tree.parent.at[row].set(walk.nodes[walk.length - 1], mode="drop"),
        via=tree.via.at[row].set(walk.actions[walk.length - 1], mode="drop"),
        seen=tree.seen.at[row].set(walk.seen, mode="drop"),
        visits=tree.visits.at[row].set(1.0, mode="drop"),
        value=tree.value.at[row].set(jnp.max(rule), mode="drop"),
        rule=tree.rule.at[row].set(rule, mode="drop"),
    )


def _backed_up(discount: Array, tree: Tree, walk: _Walk, leaf_value: Float[Array, ""]) -> Tree:
    """The tree with what the walk brought, from its end up to the root.

    `gain` is what n V of the child has grown by, `sample` the walk's own r + γ V.
    """

    def up(back: Array, carry: tuple[Tree, Array, Array, Array]) -> tuple[Tree, Array, Array, Array]:
        tree, gain, value_after, _ = carry
        at = walk.length - 1 - back
        node, action, reward = walk.nodes[at], walk.actions[at], walk.rewards[at]
        tree = replace(
            tree,
            tries=tree.tries.at[node, action].add(1.0),
            total=tree.total.at[node, action].add(reward + discount * gain),
        )
        visits, before, now = tree.visits[node], tree.value[node], jnp.max(_q(tree, node))
        tree = replace(tree, visits=tree.visits.at[node].add(1.0), value=tree.value.at[node].set(now))
        return tree, (visits + 1.0) * now - visits * before, now, reward + discount * value_after

    start = (tree, leaf_value, leaf_value, jnp.zeros(()))
    tree, _, _, sample = jax.lax.fori_loop(0, walk.length, up, start)
    first = walk.actions[0]
    return replace(
        tree,
        root_sums=tree.root_sums.at[first].add(sample),
        root_squares=tree.root_squares.at[first].add(sample**2),
    )


def _q(tree: Tree, node: Array | int) -> Float[Array, " A"]:
    """Q(h, a) of a node."""
    return (tree.rule_weight * tree.rule[node] + tree.total[node]) / (tree.rule_weight + tree.tries[node])


def _rule(problem: GenerativeProblem, state: State) -> Float[Array, " A"]:
    """q_0, −∞ where an action is impossible."""
    return jnp.where(problem.is_possible(state), problem.rule_values(state), -jnp.inf).astype(jnp.float32)


def _drawn(problem: GenerativeProblem, particles: State, key: Array) -> State:
    """A state from the belief in which the decision is made."""
    if particles is None:
        return problem.initial_state(key)
    which = jax.random.randint(key, (), 0, jax.tree.leaves(particles)[0].shape[0])
    return jax.tree.map(lambda leaf: leaf[which], particles)


def _check(
    budget_s: float | None,
    num_simulations: int | None,
    exploration: float,
    rule_weight: float,
    max_nodes: int,
    horizon: int,
) -> None:
    if (budget_s is None) == (num_simulations is None):
        raise ArgumentError(f"budget_s is {budget_s} and num_simulations is {num_simulations}; give one of the two")
    if budget_s is not None and not 0.0 < budget_s < math.inf:
        raise ArgumentError(f"budget_s is {budget_s}; it is a positive number of seconds")
    if num_simulations is not None and num_simulations < 0:
        raise ArgumentError(f"num_simulations is {num_simulations}; it is at least 0")
    if not 0.0 <= exploration < math.inf:
        raise ArgumentError(f"exploration is {exploration}; it is a finite number of at least 0")
    if not 0.0 < rule_weight < math.inf:
        raise ArgumentError(f"rule_weight is {rule_weight}; it is a finite number above 0")
    if max_nodes < 1 or horizon < 1:
        raise ArgumentError(f"max_nodes is {max_nodes} and the problem's horizon {horizon}; both are at least 1")
