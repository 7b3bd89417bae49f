"""Planning until the time is up: how much of a search tree to grow, and what is read off it (`search_tree`)."""

import math
import time
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.generative import GenerativeProblem, State
from halfseen.planners.search_tree import Tree, grown, root, summary

_FIRST = 16
_SHARE_OF_TIME_LEFT = 0.5
_NUM_NODES = 2**14


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
        Of the mean return of the simulations that began with each action, infinite where they were fewer than two. The
        rule's error beyond the tree, and that of taking a maximum of noisy values below the root, are not in it.
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
    max_nodes: int = _NUM_NODES,
    max_depth: int | None = None,
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
        c: about the spread of what one action may bring, in units of reward; it acts below the root.
    rule_weight
        w: how many simulations the rule's word is worth, above 0.
    max_nodes
        Bound on the size of the tree.
    max_depth
        Most actions that a simulation takes before the rule stands for the rest; None for the problem's horizon.

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
    ``examples/tiger.py`` states a problem and plans for it.
    """
    begin_s = time.perf_counter()
    _check(budget_s, num_simulations, exploration, rule_weight, max_nodes, max_depth, problem.horizon)
    tree, depth = root(problem, particles, key, float(rule_weight), max_nodes), jnp.zeros((), dtype=jnp.int32)
    grow = partial(grown, problem, particles, key, float(exploration), max_depth=max_depth or problem.horizon)
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
    values, tries, sums, squares, num_nodes = jax.device_get(summary(tree))
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


def _check(
    budget_s: float | None,
    num_simulations: int | None,
    exploration: float,
    rule_weight: float,
    max_nodes: int,
    max_depth: int | None,
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
    for name, number in (("max_nodes", max_nodes), ("max_depth", max_depth), ("the problem's horizon", horizon)):
        if number is not None and number < 1:
            raise ArgumentError(f"{name} is {number}; it is at least 1")
