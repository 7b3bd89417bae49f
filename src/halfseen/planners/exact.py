"""The exact optimum of a small table before K robots, and the exact value of any policy on it.

Backwards over what may happen, with n for all that must be counted of a trajectory and d for a cell of the grid of
labels, (dynamic programming [Bellman1957]_ over sufficient statistics [SmallwoodSondik1973]_):

    V(n, d) = max_a  R(n, d, a) + Σ_x P(x | n, a) E_labels V(n', d'),    price of what is left where it is over,

where x says which robot is done first, when, and whether its object is held. That is enough as all robots know the
same. It is the best of all that can be done by anyone who remembers everything that was seen, and at which time; a
policy of several robots' state knows a little less (how far a thing was hidden when another began with it, what was in
the air at the last look). Everything is exact in float64, in the world whose grip offsets lie on a grid; the nodes are
those by which the planners' beliefs integrate. More nodes come nearer to normal offsets, and cost no states.
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
from halfseen.planners.exact_graph import Graph, Node
from halfseen.planners.exact_policies import Flow, Reached, actions_in, drawn, labelled, reached_in, states_of
from halfseen.planners.exact_table import NOTHING, GridWorld, Tally
from halfseen.planners.exact_team import IDLE, Team, Work
from halfseen.shapes import Float
from halfseen.world import random
from halfseen.world.actions import ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.scene import Scene
from halfseen.world.state import TableState, Workspace

MAX_STATES = 150_000_000
"""States that are taken on unless more are allowed: 1.2 GB of values."""
_SAME_LABELS = 1e-3


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
        counted = tally[target] if 0 <= target < len(tally) else None
        if counted is None:
            raise ArgumentError(f"state's attempt {step + 1}, on object {target}, is not possible on this table")
        is_washed = is_held and not state.is_on_table[target] and last[target] == step
        after = None if is_washed else world.tried(counted, world.levels(tally)[target], is_held)
        tally = (*tally[:target], after, *tally[target + 1 :])
        tally, _ = world.looked(tally, frozenset([target]) if is_held and not is_washed else NOTHING)
    return tally


def _cell_of(world: GridWorld, node: Node, log_odds: np.ndarray, seen: np.ndarray) -> tuple[int, ...]:
    """Cell that tells what the state does; where several are, they are worth the same."""
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
                f"state's log-odds of object {cup} are {log_odds[cup]:g}, with {seen[cup]:g} of it seen; the nearest "
                f"that its looks allow are {distance.min():.2g} away: give a state of this table"
            )
    return tuple(cell)


@dataclass(frozen=True, eq=False)
class TeamOptimum:
    """The best that robots can do on one table.

    Attributes
    ----------
    value
        Expected reward of the best policy, before the first look.
    """

    value: float
    _graph: Graph = field(repr=False)

    @property
    def horizon(self) -> int:
        """Decisions that each robot may make."""
        return self._graph.team.config.horizon

    @property
    def num_states(self) -> int:
        """Number of different states that were valued."""
        return self._graph.num_states

    def policy_value(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """Exact expected reward of a policy, before the first look.

        The policy is asked once in every state that it can reach, with a key of its own: a policy that draws its
        actions at random, or samples futures, is valued for the draws of `key`. Trajectories that differ only in the
        order of what happened, or in what is known of an object that has left, are one state; the policy is shown one
        of them. Heuristics, planners and learned policies cannot tell them apart.

        Parameters
        ----------
        policy
            Any policy for so many robots.
        key
            What it draws from, by default ``random.key_of(0)``.
        max_states
            Ask in this many states of each step at most: in the likely ones, and in some of the others, drawn at
            random, that stand for the rest. The value is then an unbiased estimate, whose error shows over several
            keys: for a policy that takes its time. By default, all.

        Raises
        ------
        ArgumentError
            The policy chose an action that is not possible, or `max_states` is below 1.
        """
        return float(self.policy_values([policy], key, max_states)[0])

    def policy_values(
        self, policies: Sequence[Policy], key: Key | None = None, max_states: int | None = None
    ) -> Float[np.ndarray, " P"]:
        """Values of several policies, each as `policy_value` has it; what they share is found once.

        Raises
        ------
        ArgumentError
            As `policy_value` does, or no policy is given.
        """
        if not policies:
            raise ArgumentError("policies is empty; give at least one policy whose value is wanted")
        if max_states is not None and max_states < 1:
            raise ArgumentError(f"max_states is {max_states}; at least 1 is needed, or None for all")
        key, graph = random.key_of(0) if key is None else key, self._graph
        flow = Flow(graph, len(policies))
        for index, (layer, states) in enumerate(zip(graph.layers, self._states, strict=True)):
            if not flow.masses:
                break
            nodes, reached, step_key = list(layer.values()), reached_in(flow.masses), random.fold_in(key, index)
            if max_states is not None:
                # What the draw changed is known under the best policy: only by how much this one is worse stays noisy.
                kept = drawn(reached, max_states, random.fold_in(step_key, 0))
                flow.earned += self._worth(nodes, reached) - self._worth(nodes, kept)
                reached = kept
            shown = labelled(graph.world, states, nodes, reached)
            flow.go_on(nodes, reached, actions_in(shown, reached, policies, step_key))
        return flow.earned

    def regret(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """What a policy earns less than the best one, without simulation noise; see `policy_value`."""
        return self.value - self.policy_value(policy, key, max_states)

    @cached_property
    def _states(self) -> list[TableState]:
        """What a policy is shown in each node of each layer."""
        return [states_of(self._graph.team, layer.values()) for layer in self._graph.layers]

    def _worth(self, nodes: list[Node], reached: Reached) -> Float[np.ndarray, " P"]:
        """What the best policy earns from here on, weighted by mass."""
        worth = np.zeros(len(reached.mass))
        for place, rows in reached.by_node():
            worth += reached.mass[:, rows] @ self._graph.value(nodes[place]).ravel()[reached.cell[rows]]
        return worth


@dataclass(frozen=True, eq=False)
class TableOptimum(TeamOptimum):
    """The best that one robot can do on one table that it reaches everywhere."""

    def q_values(self, state: TableState) -> Float[np.ndarray, " A"]:
        """Expected reward of every action of one reachable state, the best policy following; −∞ where impossible.

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
    """Find the best that one robot can do on a small table, exactly.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world; one robot alone pays no price of time.
    horizon
        Steps that a trajectory may have, by default the world's.
    num_grip_nodes
        Grip offsets lie on this many Gauss–Hermite nodes; by default on those of the planners' beliefs.
    max_states
        Refuse what has more states than this; each takes 8 bytes.

    Returns
    -------
    TableOptimum
        Its `value`; Q, the best action, and the exact value of any policy.

    Raises
    ------
    ArgumentError
        A number is below 1, there is no object, the prior or a label leaves nothing in doubt, or there are more than
        `max_states` states.

    Notes
    -----
    States grow fastest where every object hides every other a little. Then two objects over 10 steps have 0.6 million,
    three over 6 steps 4.4 million, over 8 steps 118 million, and four over 4 steps 2.1 million; three over 9 steps are
    refused.

    Examples
    --------
    Two cups, one behind the other, and three steps. The plain rule forgets what a dirty cup left behind costs.

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
    """Find the best that a team can do on a small table, exactly.

    Parameters
    ----------
    scene, num_grip_nodes, max_states
        As `solve_table` has them.
    config
        The world with its robots; of several, the law of grasping is a `GridGrasping`.
    workspace
        Who reaches what, on one table.

    Returns
    -------
    TeamOptimum
        Its `value`, and the exact value of any policy.

    Raises
    ------
    ArgumentError
        As `solve_table` does; or the law is none on a grid, or not one for all robots, or robots may drop out.
    """
    return TeamOptimum(*_solved(scene, config, workspace, num_grip_nodes, max_states))


def _solved(
    scene: Scene | ArrayLike, config: WorldConfig, workspace: Workspace | None, num_grip_nodes: int, max_states: int
) -> tuple[float, Graph]:
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    numbers = {"horizon": config.horizon, "num_grip_nodes": num_grip_nodes, "objects": table.num_objects}
    for name, number in numbers.items():
        if number < 1:
            raise ArgumentError(f"{name} is {number}; at least 1 is needed")
    with _without_garbage_collection():
        graph = Graph(Team(GridWorld(table, config, num_grip_nodes), workspace), max_states)
        return float(graph.worth(graph.root).item()), graph


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Look for no garbage meanwhile: a graph that grows has none, and going through it takes a third of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
