"""The exact optimum of a small table before K robots, and the exact value of any policy on it.

Dynamic programming [Bellman1957]_ over sufficient statistics [SmallwoodSondik1973]_, with n the counts of a trajectory
and d a cell of the grid of labels:

    V(n, d) = max_a  R(n, d, a) + Σ_x P(x | n, a) E_labels V(n', d'),    price of dirty objects left at the end,

where the event x is the first robot to finish, its time, and whether its object is held. This suffices as all robots
share the same information. The optimum is over all policies that remember every observation and its time. A policy
that sees only the state of a team knows a little less: not the occlusion of an object when another robot began with
it, nor which objects were in the air at the last look. Results are exact in float64 for a world whose grip offsets lie
on a grid, the quadrature nodes of the planners' beliefs. More nodes approach normal offsets without adding states.
"""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from halfseen.errors import ArgumentError
from halfseen.planners.belief import NUM_NODES
from halfseen.planners.exact_graph import Node, StateGraph
from halfseen.planners.exact_policies import Flow, Reached, actions_in, drawn, labelled, reached_in, states_of
from halfseen.planners.exact_table import NOTHING, GridWorld, Tally
from halfseen.planners.exact_team import IDLE, TeamActions, Work
from halfseen.shapes import Float
from halfseen.world import random
from halfseen.world.actions import ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.scene import Scene
from halfseen.world.state import TableState, Workspace

MAX_STATES = 150_000_000
"""Default limit on the number of states: 1.2 GB of values."""
_SAME_LABELS = 1e-3


def place_of(graph: StateGraph, state: TableState) -> tuple[Node, tuple[int, ...]]:
    """Node and cell of one state of a single robot.

    Raises
    ------
    ArgumentError
        The state is not one of this table within this horizon.
    """
    world, horizon = graph.world, len(graph.layers)
    index, there = horizon - int(state.steps_to_go), np.asarray(state.is_on_table)
    if there.shape != (world.num_objects,) or not 0 <= index < horizon or not there.any():
        raise ArgumentError(
            f"state has objects on the table {there.tolist()} and {int(state.steps_to_go)} steps to go; give a "
            f"state of {world.num_objects} objects with 1 to {horizon} steps to go and at least one object left"
        )
    work = Work((IDLE,), (horizon - index,))
    node = graph.layers[index][_tally_of(world, state, index), work]
    return node, _cell_of(world, node, np.asarray(state.log_odds), np.asarray(state.seen))


def _tally_of(world: GridWorld, state: TableState, num_attempts: int) -> Tally:
    """Tally of looks and attempts along the trajectory; an object that left was washed by its last attempt."""
    targets, held = (
        np.asarray(each)[:num_attempts].tolist() for each in (state.attempt_object, state.attempt_succeeded)
    )
    last = {target: step for step, target in enumerate(targets)}
    tally, _ = world.looked(world.first, NOTHING)
    for step, (target, is_held) in enumerate(zip(targets, held, strict=True)):
        counted = tally[target] if 0 <= target < len(tally) else None
        if counted is None:
            raise ArgumentError(f"state's attempt {step + 1}, on object {target}, is not possible on this table")
        is_washed = is_held and not state.is_on_table[target] and last[target] == step
        after = None if is_washed else world.tried(counted, world.levels(tally)[target], is_held)
        tally = (*tally[:target], after, *tally[target + 1 :])
        tally, _ = world.looked(tally, frozenset([target]) if is_held and not is_washed else NOTHING)
    return tally


def _cell_of(world: GridWorld, node: Node, log_odds: np.ndarray, seen: np.ndarray) -> tuple[int, ...]:
    """Cell with the state's log-odds and shares seen; if several match, their values are equal."""
    cell = []
    for cup, counted in enumerate(node.tally):
        if counted is None:
            cell.append(0)
            continue
        cells = world.labels[cup].cells(counted.looks)
        distance = np.abs(cells.log_odds - log_odds[cup]) + np.abs(cells.seen - seen[cup])
        cell.append(int(np.argmin(distance)))
        if not distance.min() < _SAME_LABELS:
            raise ArgumentError(
                f"state's log-odds of object {cup} are {log_odds[cup]:g}, with {seen[cup]:g} of it seen; the "
                f"nearest that its looks allow differ by {distance.min():.2g}; give a state of this table"
            )
    return tuple(cell)


@dataclass(frozen=True, eq=False)
class TeamOptimum:
    """The optimum of a team on one table.

    Attributes
    ----------
    value
        Expected reward of the best policy, before the first look.
    """

    value: float
    _graph: StateGraph = field(repr=False)

    @property
    def horizon(self) -> int:
        """Largest number of decisions of each robot."""
        return self._graph.team.config.horizon

    @property
    def num_states(self) -> int:
        """Number of distinct states evaluated."""
        return self._graph.num_states

    def policy_value(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """Exact expected reward of a policy, before the first look.

        The policy decides once in every state that it can reach, with a separate key: a policy that draws random
        actions or samples futures is evaluated for the draws of `key`. Trajectories that differ only in the order of
        events, or in the history of an object that has left, share a state, and the policy sees one of them.
        Heuristics, planners and learned policies cannot distinguish them.

        Parameters
        ----------
        policy
            Any policy for this number of robots.
        key
            Random key of its draws, by default ``random.key_of(0)``.
        max_states
            Largest number of states per step in which the policy decides, for slow policies: the likely states, and a
            random sample that represents the others. The value is then an unbiased estimate, whose error shows over
            several keys. By default, all.

        Raises
        ------
        ArgumentError
            The policy chose an action that is not possible, or `max_states` is below 1.
        """
        return float(self.policy_values([policy], key, max_states)[0])

    def policy_values(
        self, policies: Sequence[Policy], key: Key | None = None, max_states: int | None = None
    ) -> Float[np.ndarray, " P"]:
        """Values of several policies, as in `policy_value`; shared computations are done once.

        Raises
        ------
        ArgumentError
            As in `policy_value`, or no policy is given.
        """
        if not policies:
            raise ArgumentError("policies is empty; give at least one policy to evaluate")
        if max_states is not None and max_states < 1:
            raise ArgumentError(f"max_states is {max_states}; give at least 1, or None for all")
        key, graph = random.key_of(0) if key is None else key, self._graph
        flow = Flow(graph, len(policies))
        for index, (layer, states) in enumerate(zip(graph.layers, self._states, strict=True)):
            if not flow.masses:
                break
            nodes, reached, step_key = list(layer.values()), reached_in(flow.masses), random.fold_in(key, index)
            if max_states is not None:
                # Control variate: the draw's effect on the optimal value is known, so only the regret is noisy.
                kept = drawn(reached, max_states, random.fold_in(step_key, 0))
                flow.earned += self._worth(nodes, reached) - self._worth(nodes, kept)
                reached = kept
            shown = labelled(graph.world, states, nodes, reached)
            flow.go_on(nodes, reached, actions_in(shown, reached, policies, step_key))
        return flow.earned

    def regret(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """Optimal value minus the policy's value, without simulation noise; see `policy_value`."""
        return self.value - self.policy_value(policy, key, max_states)

    @cached_property
    def _states(self) -> list[TableState]:
        """State shown to a policy in each node of each layer."""
        return [states_of(self._graph.team, layer.values()) for layer in self._graph.layers]

    def _worth(self, nodes: list[Node], reached: Reached) -> Float[np.ndarray, " P"]:
        """Optimal value from here on, weighted by mass."""
        worth = np.zeros(len(reached.mass))
        for place, rows in reached.by_node():
            worth += reached.mass[:, rows] @ self._graph.value(nodes[place]).ravel()[reached.cell[rows]]
        return worth


@dataclass(frozen=True, eq=False)
class TableOptimum(TeamOptimum):
    """The optimum of one robot on one table that it reaches everywhere."""

    def q_values(self, state: TableState) -> Float[np.ndarray, " A"]:
        """Expected reward of every action in one reachable state, then the optimal policy; −∞ if impossible.

        Raises
        ------
        ArgumentError
            `state` is not one of this table within this horizon.
        """
        node, cell = place_of(self._graph, state)
        q = np.full(ActionSpace(state.num_objects).num_actions, -np.inf)
        for action, of_action in self._graph.q(node).items():
            q[action] = np.broadcast_to(of_action, node.shape)[cell]
        return q

    def action(self, state: TableState) -> int:
        """Best action in one reachable state; the lowest in a tie.

        Raises
        ------
        ArgumentError
            `state` is not one of this table within this horizon.
        """
        return int(np.argmax(self.q_values(state)))


def solve_table(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    horizon: int | None = None,
    num_grip_nodes: int = NUM_NODES,
    max_states: int = MAX_STATES,
) -> TableOptimum:
    """Compute the exact optimum of one robot on a small table.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world; a single robot pays no price of time.
    horizon
        Largest number of steps of a trajectory, by default the world's.
    num_grip_nodes
        Number of Gauss–Hermite nodes of the grip offsets, by default that of the planners' beliefs.
    max_states
        Limit on the number of states, at 8 bytes each.

    Returns
    -------
    TableOptimum
        Its `value`; Q, the best action, and the exact value of any policy.

    Raises
    ------
    ArgumentError
        A number is below 1, there is no object, the prior or a label is certain, or there are more than `max_states`
        states.

    Notes
    -----
    The number of states grows fastest if every object hides every other a little. Then two objects over 10 steps have
    0.6 million, three over 6 steps 4.4 million, over 8 steps 118 million, and four over 4 steps 2.1 million; three over
    9 steps exceed the default limit.

    Examples
    --------
    Two cups, one behind the other, and three steps. The plain rule ignores the penalty for dirty cups left.

    >>> from halfseen.planners import GreedyPolicy
    >>> from halfseen.world import WorldConfig
    >>> optimum = solve_table([[0.0, 0.6], [0.1, 0.0]], WorldConfig(), horizon=3)
    >>> greedy = [GreedyPolicy(WorldConfig(), counts_penalty=counts) for counts in (False, True)]
    >>> round(optimum.value, 3), [round(optimum.policy_value(policy), 3) for policy in greedy]
    (0.898, [-0.872, -0.023])
    """
    steps = config.horizon if horizon is None else horizon
    alone = replace(config, horizon=steps, speed=(1.0,), reward_per_s=0.0, drop_out_rate=None)
    return TableOptimum(*_solved(scene, alone, None, num_grip_nodes, max_states))


def solve_team(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    workspace: Workspace,
    num_grip_nodes: int = NUM_NODES,
    max_states: int = MAX_STATES,
) -> TeamOptimum:
    """Compute the exact optimum of a team on a small table.

    Parameters
    ----------
    scene, num_grip_nodes, max_states
        As in `solve_table`.
    config
        The world with its robots; for several, the law of grasping is a `GridGrasping`.
    workspace
        Which robot reaches which object, on one table.

    Returns
    -------
    TeamOptimum
        Its `value`, and the exact value of any policy.

    Raises
    ------
    ArgumentError
        As in `solve_table`; or the law is not on a grid, or differs between robots, or robots may drop out.
    """
    return TeamOptimum(*_solved(scene, config, workspace, num_grip_nodes, max_states))


def _solved(
    scene: Scene | ArrayLike, config: WorldConfig, workspace: Workspace | None, num_grip_nodes: int, max_states: int
) -> tuple[float, StateGraph]:
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    numbers = {"horizon": config.horizon, "num_grip_nodes": num_grip_nodes, "objects": table.num_objects}
    for name, number in numbers.items():
        if number < 1:
            raise ArgumentError(f"{name} is {number}; give at least 1")
    with _without_garbage_collection():
        graph = StateGraph(TeamActions(GridWorld(table, config, num_grip_nodes), workspace), max_states)
        return float(graph.worth(graph.root).item()), graph


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Disable garbage collection: a growing graph has no garbage, and scanning it takes a third of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
