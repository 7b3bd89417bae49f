"""A search tree over what may be done and seen, grown one simulation at a time.

Partially observable Monte Carlo planning [SilverVeness2010]_, compiled. A simulation draws a state s from the belief
and walks down the tree; at a node h (a history of actions and observations) it takes

    a = argmax  Q⁺(h, a) + c √( ln(1 + n(h)) / (1 + n(h, a)) ),
    Q⁺(h, a) = (w (q_0(h, a) + u(h)) + G(h, a)) / (w + n(h, a)),   u(h) = Σ_a (G(h, a) − n(h, a) q_0(h, a)) / n(h),

where q_0 is the problem's stated rule, which counts as w visits, and u is by how much it was wrong so far: a rule that
promises too little would else keep every action but the first from being tried. At the root the k-th best
action by Q⁺ gets a share of the visits in proportion to 1/k: none is left out, and no constant decides. Where it leaves
the tree it adds one node, of value V = max_a q_0; at the depth limit it stops. Going back up,

    G(h, a) = Σ over visits of  r  +  γ Σ_o n(h a o) V(h a o),   V(h) = max_a Q(h, a),

with Q = Q⁺ for u = 0. V is the best action's value, not the mean over all that were tried: trying an action costs its
parents nothing, but the best of noisy numbers is too large, the more so the fewer the simulations.
An action's error at the root is that of the mean of all returns that began with it.

Where the problem knows a control, q°(h, a) = E[r + γ V°(h a o)], the reward of a visit is not the one that was drawn
but q°(h, a) − γ V°(h a o). Its expectation is the same and it knows neither the hidden state nor its noise: a few
simulations do where drawn rewards take hundreds.

=============  =============================================================
symbol         here
=============  =============================================================
h, h a o       a row of the arrays of `Tree`; its row of ``parent, via, seen``
n(h, a), G     ``tries``, ``total``; n(h) = 1 + Σ_a n(h, a) is not kept, nor is V(h)
q_0            ``rule``; −∞ where an action is impossible
q°, V°         ``control``, ``base``
c              ``exploration``, in units of reward
w              ``rule_weight``
γ, H           ``problem.discount``, ``problem.horizon``
=============  =============================================================
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.generative import GenerativeProblem, State
from halfseen.world.config import Number

_FREE = -1


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
    rule: Float[Array, "M A"]
    control: Float[Array, "M A"]
    base: Float[Array, " M"]
    rule_weight: Float[Array, ""]
    tries: Float[Array, "M A"]
    total: Float[Array, "M A"]
    root_squares: Float[Array, " A"]
    """Σ of squared returns of the simulations that began with each action."""
    root_sums: Float[Array, " A"]


@jax.jit
def summary(tree: Tree) -> tuple[Array, Array, Array, Array, Array]:
    """Q and tries at the root, sums and squares of its returns, and the size of the tree."""
    return _q(tree, 0), tree.tries[0], tree.root_sums, tree.root_squares, tree.num_nodes


@partial(jax.jit, static_argnames="max_nodes")
def root(problem: GenerativeProblem, particles: State, key: Array, rule_weight: Number, max_nodes: int) -> Tree:
    """A tree of the root alone."""
    rule, control, base = _known(problem, _drawn(problem, particles, key))
    size, num_slots = (max_nodes, problem.num_actions), 2 ** math.ceil(math.log2(2 * max_nodes))
    return Tree(
        num_nodes=jnp.ones((), dtype=jnp.int32),
        slots=jnp.full(num_slots, _FREE, dtype=jnp.int32),
        parent=jnp.zeros(max_nodes, dtype=jnp.int32),
        via=jnp.zeros(max_nodes, dtype=jnp.int32),
        seen=jnp.zeros(max_nodes, dtype=jnp.int32),
        rule=jnp.zeros(size).at[0].set(rule),
        control=jnp.zeros(size).at[0].set(control),
        base=jnp.zeros(max_nodes).at[0].set(base),
        rule_weight=jnp.asarray(rule_weight, dtype=jnp.float32),
        tries=jnp.zeros(size),
        total=jnp.zeros(size),
        root_squares=jnp.zeros(problem.num_actions),
        root_sums=jnp.zeros(problem.num_actions),
    )


@partial(jax.jit, donate_argnames="tree")
def grown(
    problem: GenerativeProblem,
    particles: State,
    key: Array,
    exploration: Number,
    tree: Tree,
    depth: Int[Array, ""],
    begin: Number,
    end: Number,
    max_depth: Number,
) -> tuple[Tree, Int[Array, ""]]:
    """The tree after simulations `begin` to `end`, and the actions of the longest one; one draw each of `key`.

    None takes more than `max_depth` actions: the rule stands for what lies beyond.
    """

    def simulate(k: Array, tree_and_depth: tuple[Tree, Array]) -> tuple[Tree, Array]:
        tree, depth = tree_and_depth
        state_key, walk_key = jax.random.split(jax.random.fold_in(key, k))
        walk = _descent(problem, tree, exploration, _drawn(problem, particles, state_key), walk_key, max_depth)
        # What is over is worth nothing more, and asking the rule is the dearest part of a simulation.
        nothing = jnp.zeros(problem.num_actions)
        rule, control, base = jax.lax.cond(
            walk.is_over, lambda: (nothing, nothing, jnp.zeros(())), lambda: _known(problem, walk.state)
        )
        if problem.control(walk.state) is not None:
            unknown = jnp.where(walk.node == _FREE, problem.discount * base, 0.0)
            walk = walk._replace(rewards=walk.rewards.at[walk.length - 1].add(-unknown))
        tree = _backed_up(problem.discount, _with_leaf(tree, walk, rule, control, base), walk, jnp.max(rule))
        return tree, jnp.maximum(depth, walk.length)

    return jax.lax.fori_loop(begin, end, simulate, (tree, depth))


class _Walk(NamedTuple):
    """One way down the tree: `length` actions, and where they led."""

    state: State
    key: Array
    nodes: Int[Array, " H"]
    actions: Int[Array, " H"]
    rewards: Float[Array, " H"]
    visits: Float[Array, " H"]
    values: Float[Array, " H"]
    """n and V of each node. Read on the way down: in a loop that also writes, the tree's arrays would be copied."""
    length: Int[Array, ""]
    node: Int[Array, ""]
    """Where it stands, −1 outside the tree."""
    slot: Int[Array, ""]
    seen: Int[Array, ""]
    is_over: Bool[Array, ""]


def _descent(
    problem: GenerativeProblem, tree: Tree, exploration: Number, state: State, key: Array, max_depth: Number
) -> _Walk:
    """Walk down until the tree or the path ends, or for `max_depth` actions."""
    zero, path = jnp.zeros((), dtype=jnp.int32), jnp.zeros(problem.horizon, dtype=jnp.int32)
    nothing = jnp.zeros(problem.horizon)

    def goes_on(walk: _Walk) -> Array:
        return (walk.node != _FREE) & ~walk.is_over & (walk.length < max_depth)

    def one_step_down(walk: _Walk) -> _Walk:
        key, step_key = jax.random.split(walk.key)
        action = _chosen(tree, walk.node, exploration)
        after, seen, reward, is_over = problem.step(walk.state, action, step_key)
        seen = seen.astype(jnp.int32)
        slot, node = _found(tree, walk.node, action, seen)
        if problem.control(after) is not None:
            # What lies outside of the tree is not known yet.
            base = jnp.where((node != _FREE) & ~is_over, tree.base[node], 0.0)
            reward = tree.control[walk.node, action] - problem.discount * base
        return _Walk(
            state=after,
            key=key,
            nodes=walk.nodes.at[walk.length].set(walk.node),
            actions=walk.actions.at[walk.length].set(action),
            rewards=walk.rewards.at[walk.length].set(reward),
            visits=walk.visits.at[walk.length].set(1.0 + jnp.sum(tree.tries[walk.node])),
            values=walk.values.at[walk.length].set(jnp.max(_q(tree, walk.node))),
            length=walk.length + 1,
            node=node,
            slot=slot,
            seen=seen,
            is_over=is_over | (walk.length + 1 == problem.horizon),
        )

    start = _Walk(state, key, path, path, nothing, nothing, nothing, zero, zero, zero, zero, jnp.asarray(False))
    return jax.lax.while_loop(goes_on, one_step_down, start)


def _chosen(tree: Tree, node: Int[Array, ""], exploration: Number) -> Int[Array, ""]:
    """The action that a simulation takes at a node."""
    rule, tries, total = tree.rule[node], tree.tries[node], tree.total[node]
    is_possible, num_visits = rule > -jnp.inf, jnp.sum(tries)
    wrong_by = jnp.sum(jnp.where(is_possible & (tries > 0.0), total - tries * rule, 0.0)) / jnp.maximum(num_visits, 1.0)
    lifted = (tree.rule_weight * (rule + wrong_by) + total) / (tree.rule_weight + tries)
    rank = 1.0 + jnp.sum(lifted[None, :] > lifted[:, None], axis=1)
    most_owed = jnp.argmin(jnp.where(is_possible, (tries + 0.5) * rank, jnp.inf))
    bonus = exploration * jnp.sqrt(jnp.log1p(num_visits) / (1.0 + tries))
    return jnp.where(node == 0, most_owed, jnp.argmax(lifted + bonus)).astype(jnp.int32)


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
    """Scatter 32 bits, so that neighbours fall apart."""
    number = number.astype(jnp.uint32)
    number = (number ^ (number >> 16)) * jnp.uint32(0x85EBCA6B)
    number = (number ^ (number >> 13)) * jnp.uint32(0xC2B2AE35)
    return number ^ (number >> 16)


def _with_leaf(
    tree: Tree, walk: _Walk, rule: Float[Array, " A"], control: Float[Array, " A"], base: Float[Array, ""]
) -> Tree:
    """The tree with the node that the walk reached outside of it, if there is room."""
    max_nodes = tree.parent.shape[0]
    is_new = ~walk.is_over & (walk.node == _FREE) & (tree.num_nodes < max_nodes)
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
        rule=tree.rule.at[row].set(rule, mode="drop"),
        control=tree.control.at[row].set(control, mode="drop"),
        base=tree.base.at[row].set(base, mode="drop"),
    )


def _backed_up(discount: Number, tree: Tree, walk: _Walk, leaf_value: Float[Array, ""]) -> Tree:
    """The tree with what the walk brought, from its end up to the root.

    `gain` is by how much n V of the child has grown, `earned` the walk's own return.
    """

    def up(back: Array, carry: tuple[Tree, Array, Array]) -> tuple[Tree, Array, Array]:
        tree, gain, earned = carry
        at = walk.length - 1 - back
        node, action, reward = walk.nodes[at], walk.actions[at], walk.rewards[at]
        tree = replace(
            tree,
            tries=tree.tries.at[node, action].add(1.0),
            total=tree.total.at[node, action].add(reward + discount * gain),
        )
        now = jnp.max(_q(tree, node))
        return tree, now + walk.visits[at] * (now - walk.values[at]), reward + discount * earned

    tree, _, earned = jax.lax.fori_loop(0, walk.length, up, (tree, leaf_value, leaf_value))
    first = walk.actions[0]
    return replace(
        tree,
        root_sums=tree.root_sums.at[first].add(earned),
        root_squares=tree.root_squares.at[first].add(earned**2),
    )


def _q(tree: Tree, node: Array | int) -> Float[Array, " A"]:
    """Q(h, a) of a node."""
    return (tree.rule_weight * tree.rule[node] + tree.total[node]) / (tree.rule_weight + tree.tries[node])


def _known(problem: GenerativeProblem, state: State) -> tuple[Float[Array, " A"], Float[Array, " A"], Float[Array, ""]]:
    """q_0, −∞ where an action is impossible; q° and V°, 0 where the problem has no control."""
    rule = jnp.where(problem.is_possible(state), problem.rule_values(state), -jnp.inf).astype(jnp.float32)
    control = problem.control(state)
    if control is None:
        return rule, jnp.zeros_like(rule), jnp.zeros(())
    return rule, control.action_values.astype(jnp.float32), control.value.astype(jnp.float32)


def _drawn(problem: GenerativeProblem, particles: State, key: Array) -> State:
    """A state from the belief in which the decision is made."""
    if particles is None:
        return problem.initial_state(key)
    which = jax.random.randint(key, (), 0, jax.tree.leaves(particles)[0].shape[0])
    return jax.tree.map(lambda leaf: leaf[which], particles)
