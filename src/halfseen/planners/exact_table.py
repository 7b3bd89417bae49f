"""The exact optimum of a small table, and the exact value of any policy on it.

Backwards over the steps to go h, on the grids of `exact_model`, with n for a tally and d for a cell of its grid
(dynamic programming [Bellman1957]_ over sufficient statistics [SmallwoodSondik1973]_):

    V_h(n, d) = max_a  R(n, d, a) + Σ_x P(x | n, a) E_labels V_{h−1}(n', d'),    V_0(n, d) = price of what is left,

where x says whether the grasp succeeds. The expectation over labels is taken along one axis after the other: given the
past, the labels of different objects are independent. Everything is exact in float64, in the world whose grip
offsets lie on a grid; the nodes are those by which the planners' beliefs integrate. More nodes come nearer to
normal offsets, and cost no states.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from halfseen.errors import ArgumentError
from halfseen.planners.belief import NUM_NODES
from halfseen.planners.exact_bellman import (
    Attempt,
    Grid,
    Layer,
    expected_over_labels,
    grid_of_q,
    held_after,
    layers_of,
    spread_over_labels,
)
from halfseen.planners.exact_decisions import (
    Histories,
    Reached,
    actions_in,
    drawn,
    histories_of,
    place_of,
    reached_in,
    rewards_in,
    rows_by_place,
    states_in,
    told_in,
)
from halfseen.planners.exact_labels import Look
from halfseen.planners.exact_model import (
    GridWorld,
    Result,
    after_attempt,
    first_tally,
    looks_of,
)
from halfseen.world import random
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.scene import Scene
from halfseen.world.state import TableState

MAX_CELLS = 150_000_000
"""States that `solve_table` takes on unless told otherwise: 1.2 GB of values."""


@dataclass(frozen=True, eq=False)
class TableOptimum:
    """The best that can be done on one table.

    Attributes
    ----------
    value
        Expected reward of the best policy, before the first look.
    horizon
        Steps that a path may have.
    num_states
        Number of different states that were valued.
    """

    value: float
    horizon: int
    num_states: int
    _world: GridWorld
    _layers: list[Layer]
    _values: list[list[Grid]]
    _known_looks: dict[tuple[int, int, Attempt], tuple[Look | None, ...]] = field(default_factory=dict, repr=False)

    def q_values(self, state: TableState) -> Float[np.ndarray, " A"]:
        """Expected reward of every action of one reachable state, the best policy following; −∞ where impossible.

        Raises
        ------
        ArgumentError
            `state` is not one of this table within this horizon.
        """
        layer, node, cell = place_of(self._world, self._layers, state)
        after = self._values[layer + 1] if layer + 1 < self.horizon else []
        return grid_of_q(self._world, self._layers[layer][node], after)[:, *cell]

    def action(self, state: TableState) -> int:
        """Best action in one reachable state; the lowest in a tie.

        Raises
        ------
        ArgumentError
            `state` is not one of this table within this horizon.
        """
        return int(np.argmax(self.q_values(state)))

    def policy_value(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """Exact expected reward of a policy, before the first look.

        The policy is asked once in every state that it can reach, with a key of its own: a policy that draws its
        actions at random, or samples futures, is valued for the draws of `key`. Paths that differ only in the order of
        what happened, or in what is known of an object that has left, are one state; the policy is shown one of them.
        Heuristics, planners and learned policies cannot tell them apart.

        Parameters
        ----------
        policy
            Any policy for one robot.
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
        key = random.key_of(0) if key is None else key
        totals = np.zeros(len(policies))
        masses = {0: np.stack([self._first_mass()] * len(policies))}
        for index in range(self.horizon):
            if not masses:
                break
            step_key = random.fold_in(key, index)
            earned, reached, actions = self._asked(index, reached_in(masses), policies, step_key, max_states)
            totals += earned
            masses = self._moved(index, reached, actions) if index < self.horizon - 1 else {}
        return totals

    def _asked(
        self, index: int, every: Reached, policies: Sequence[Policy], key: Key, max_states: int | None
    ) -> tuple[Float[np.ndarray, " P"], Reached, Int[np.ndarray, "P n"]]:
        """What policies earn in a layer; the states in which they were asked, and what they did."""
        earned, reached, layer = np.zeros(len(every.mass)), every, self._layers[index]
        if max_states is not None:
            reached = drawn(every, max_states, random.fold_in(key, 0))
            # What the draw changed is known under the best policy: only by how much this one is worse stays noisy.
            earned = self._worth(index, every) - self._worth(index, reached)
        histories, told = self._histories[index], told_in(self._world, layer, reached)
        steps_to_go = self.horizon - index
        states = states_in(self._world, steps_to_go, histories, reached, told)
        actions = actions_in(states, reached, policies, key)
        rewards = rewards_in(self._world.config, histories, reached, told[0], actions, steps_to_go == 1)
        return earned + np.sum(reached.mass * rewards, axis=1), reached, actions

    def regret(self, policy: Policy, key: Key | None = None, max_states: int | None = None) -> float:
        """What a policy earns less than the best one, without simulation noise; see `policy_value`."""
        return self.value - self.policy_value(policy, key, max_states)

    @cached_property
    def _histories(self) -> list[Histories]:
        return histories_of(self._world, self._layers)

    def _first_mass(self) -> Grid:
        world, before = self._world, first_tally(self._world)
        shape = self._values[0][0].shape
        return spread_over_labels(np.ones((1,) * world.num_objects), looks_of(world, before), shape)

    def _worth(self, index: int, reached: Reached) -> Float[np.ndarray, " P"]:
        """What the best policy earns from here on, weighted by mass."""
        values = self._values[index]
        parts = [
            reached.mass[:, rows] @ values[place].ravel()[reached.cell[rows]] for place, rows in rows_by_place(reached)
        ]
        return np.sum(parts, axis=0)

    def _moved(self, index: int, reached: Reached, actions: Int[np.ndarray, "P n"]) -> dict[int, Grid]:
        """Masses of the next layer, of each policy, after the actions of this one."""
        masses: dict[int, Grid] = {}
        for place, rows in rows_by_place(reached):
            taken = self._taken(index, place, reached.of(rows), actions[:, rows])
            # An attempt that clears the table has no successor.
            for attempt, to in self._layers[index][place].successors.items():
                target, result = attempt
                tried = [taken[action] for action in self._leading_to[attempt] if action in taken]
                if tried:
                    probability = self._histories[index].probability[place, target]
                    moved = sum(tried) * (1.0 - probability if result is Result.FAILED else probability)
                    moved = moved.sum(axis=1 + target, keepdims=True) if result is Result.WASHED else moved
                    looks = (None, *self._looks_after(index, place, attempt))
                    shape = (len(moved), *self._values[index + 1][to].shape)
                    movers = np.flatnonzero(moved.reshape(len(moved), -1).any(axis=1))
                    arrived = spread_over_labels(moved[movers], looks, shape)
                    masses.setdefault(to, np.zeros(shape))[movers] += arrived
        # In the order of the layer, whoever else is valued.
        return dict(sorted(masses.items()))

    def _taken(self, index: int, place: int, reached: Reached, actions: Int[np.ndarray, "P n"]) -> dict[int, Grid]:
        """Mass that each policy moves by each action in the cells of a node."""
        shape = (len(actions), *self._values[index][place].shape)
        taken: dict[int, Grid] = {}
        for action in np.unique(actions).tolist():
            mass = np.zeros(shape)
            mass.reshape(len(actions), -1)[:, reached.cell] = np.where(actions == action, reached.mass, 0.0)
            taken[action] = mass
        return taken

    @cached_property
    def _leading_to(self) -> dict[Attempt, list[int]]:
        """Actions that an attempt with a result can be."""
        verbs = {Result.FAILED: (Verb.WASH, Verb.LIFT), Result.LIFTED: (Verb.LIFT,), Result.WASHED: (Verb.WASH,)}
        actions = ActionSpace(self._world.num_objects)
        return {
            (target, result): [int(actions.encode(verb, target)) for verb in of_result]
            for target in range(self._world.num_objects)
            for result, of_result in verbs.items()
        }

    def _looks_after(self, index: int, place: int, attempt: Attempt) -> tuple[Look | None, ...]:
        """What the look after an attempt does; kept, as every policy asks for it."""
        known = self._known_looks.get((index, place, attempt))
        if known is None:
            after = after_attempt(self._world, self._layers[index][place].tally, *attempt)
            known = self._known_looks[index, place, attempt] = looks_of(self._world, after, held_after(attempt))
        return known


def solve_table(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    horizon: int | None = None,
    num_grip_nodes: int = NUM_NODES,
    max_states: int = MAX_CELLS,
) -> TableOptimum:
    """Find the best that can be done on a small table, exactly.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world.
    horizon
        Steps that a path may have, by default the world's.
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
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    steps = config.horizon if horizon is None else horizon
    for name, number in (("horizon", steps), ("num_grip_nodes", num_grip_nodes), ("objects", table.num_objects)):
        if number < 1:
            raise ArgumentError(f"{name} is {number}; at least 1 is needed")
    world = GridWorld(table, config, num_grip_nodes)
    _check_doubt(world)
    layers = layers_of(world, steps, max_states)
    values = _values(world, layers)
    first = expected_over_labels(values[0][0], looks_of(world, first_tally(world)))
    num_states = sum(grid.size for grids in values for grid in grids)
    return TableOptimum(float(first.item()), steps, num_states, world, layers, values)


def _values(world: GridWorld, layers: list[Layer]) -> list[list[Grid]]:
    """V of every node of every layer, backwards."""
    values: list[list[Grid]] = [[]]
    for layer in reversed(layers):
        values.insert(0, [grid_of_q(world, node, values[0]).max(axis=0) for node in layer])
    return values[:-1]


def _check_doubt(world: GridWorld) -> None:
    """Log-odds must be finite."""
    _check_between("dirty_share", np.array([world.config.dirty_share], dtype=np.float64))
    for cup, labels in enumerate(world.labels):
        positive = np.stack(world.seeing.positive(labels.views.occluded, 0.0, labels.views.is_held))
        # A look that shows nothing never says DIRTY, and leaves all in doubt.
        _check_between(f"a label's probability of object {cup}", positive[:, (positive != 0.0).any(axis=0)].ravel())


def _check_between(name: str, probabilities: Float[np.ndarray, " k"]) -> None:
    wrong = probabilities[~((probabilities > 0.0) & (probabilities < 1.0))]
    if len(wrong):
        raise ArgumentError(f"{name} is {wrong[0]:g}; it lies between 0 and 1 and is neither: change config")
