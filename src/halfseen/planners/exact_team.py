"""The exact optimum of a small table before a team, and the exact value of any policy on it.

Backwards over what may happen, on the grids of labels of `exact_table`, which is enough as all robots know the
same [SmallwoodSondik1973]_:

    V(n) = max_a C(n after a),    C(n) = V(n) if a robot is free, the price of what is left if the path is over,
                                  and else Σ_events P(event | n)·(R + E_labels C(n')).

Under one node all labels that may have been told lie side by side, so that a node is valued once for all of them. It is
the best of all that can be done by whoever remembers everything that was seen, and at which time; a policy of a state
knows a little less (how far a thing was hidden when another began with it, what was in the air at the last look). All
is exact in float64 in the team's world (`world.transition`) under a law of grasping whose times and grips lie on grids
(`grid_grasping`).

What a policy of a team does in the states of many nodes of a small table, asked some hundreds at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.planners.belief import NUM_NODES
from halfseen.planners.exact_bellman import Grid, expected_over_labels, price_of_left, spread_over_labels
from halfseen.planners.exact_decisions import CHUNK_SIZE, decided
from halfseen.planners.exact_model import GridWorld, Tally, after_look, first_tally, grid_shape, looks_of
from halfseen.planners.exact_team_model import PARKED, Doing, Event, GridTeam, TeamNode, events_of
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.scene import Scene
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, Workspace

MAX_CELLS = 50_000_000
"""Values that `solve_team` keeps unless told otherwise: 400 MB."""


@dataclass(frozen=True, eq=False)
class TeamOptimum:
    """The best that a team can do on one table.

    Attributes
    ----------
    value
        Expected reward of the best policy, before the first look.
    """

    value: float
    _model: GridTeam
    _values: "_Values"

    @property
    def num_states(self) -> int:
        """Number of different states that were valued."""
        return self._values.num_cells

    def policy_value(self, policy: Policy, key: Key | None = None) -> float:
        """Exact expected reward of a policy, before the first look.

        The policy is asked once in every state that it can reach, with a key of its own. Paths that differ only in the
        order of what happened, or in what is known of an object that has left, are one state.

        Parameters
        ----------
        policy
            Any policy of a team.
        key
            What it draws from, by default ``random.key_of(0)``.

        Raises
        ------
        ArgumentError
            The policy chose an action that is not possible.
        """
        model, total = self._model, 0.0
        key = random.key_of(0) if key is None else key
        before, node = _first(model)
        looks, shape = looks_of(model.world, before), grid_shape(model.world, node.tally)
        masses = {node: spread_over_labels(np.ones((1,) * model.world.num_objects), looks, shape)}
        for step in range(model.config.num_stages):
            if not masses:
                break
            nodes = list(masses)
            asked = actions_in(model, nodes, list(masses.values()), policy, random.fold_in(key, step))
            following: dict[TeamNode, Grid] = {}
            for each, actions in zip(nodes, asked, strict=True):
                for action in np.unique(actions[masses[each] > 0.0]).tolist():
                    mass = np.where(actions == action, masses[each], 0.0)
                    total += self._moved(model.begun(each, action), mass, following)
            masses = following
        return float(total)

    def regret(self, policy: Policy, key: Key | None = None) -> float:
        """What a policy earns less than the best one; see `policy_value`."""
        return self.value - self.policy_value(policy, key)

    def _moved(self, node: TeamNode, mass: Grid, following: dict[TeamNode, Grid]) -> float:
        """Let mass go on until somebody decides; what it earns until then."""
        if node.is_over or node.num_decisions == 0:
            return float(np.sum(mass * self._values.after(node)))
        if node.is_asked:
            following[node] = following[node] + mass if node in following else mass
            return 0.0
        earned = 0.0
        for event in self._values.events(node):
            share = event.probability * mass
            earned += float(np.sum(share * event.reward))
            share = share if event.gone is None else share.sum(axis=event.gone, keepdims=True)
            if event.looks is not None:
                shape = grid_shape(self._model.world, event.after.tally)
                share = spread_over_labels(share, event.looks, shape)
            earned += self._moved(event.after, share, following)
        return earned


@dataclass(eq=False)
class _Values:
    """Values of nodes, each found once."""

    model: GridTeam
    max_cells: int
    num_cells: int = 0
    _best: dict[TeamNode, Grid] = field(default_factory=dict)
    _after: dict[TeamNode, Grid] = field(default_factory=dict)
    _events: dict[TeamNode, list[Event]] = field(default_factory=dict)

    def best(self, node: TeamNode) -> Grid:
        """V: the value of a node in which a robot decides, in every cell."""
        known = self._best.get(node)
        if known is None:
            shape = grid_shape(self.model.world, node.tally)
            values = [self.after(self.model.begun(node, action)) for action in self.model.possible(node)]
            known = self._best[node] = np.max([np.broadcast_to(value, shape) for value in values], axis=0)
            self._count(known)
        return known

    def after(self, node: TeamNode) -> Grid:
        """C: the value of what follows, whether or not a robot decides."""
        if node.is_over:
            return price_of_left(self.model.world, node.tally)
        if node.is_asked:
            return self.best(node)
        known = self._after.get(node)
        if known is None:
            known = self._after[node] = np.asarray(sum(map(self._worth, events_of(self.model, node))))
            self._count(known)
        return known

    def events(self, node: TeamNode) -> list[Event]:
        """What may happen next."""
        if node not in self._events:
            self._events[node] = list(events_of(self.model, node))
        return self._events[node]

    def _worth(self, event: Event) -> Grid:
        following = self.after(event.after)
        if event.looks is not None:
            following = expected_over_labels(following, event.looks)
        return event.probability * (event.reward + following)

    def _count(self, grid: Grid) -> None:
        self.num_cells += np.size(grid)
        if self.num_cells > self.max_cells:
            raise ArgumentError(
                f"{self.model.world.num_objects} objects, {self.model.config.num_robots} robots and "
                f"{self.model.config.horizon} decisions of each have more than {self.max_cells:,} states; "
                "shorten the horizon or take fewer objects"
            )


def solve_team(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    workspace: Workspace,
    num_grip_nodes: int = NUM_NODES,
    max_states: int = MAX_CELLS,
) -> TeamOptimum:
    """Find the best that a team can do on a small table, exactly.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world with its robots; the law of grasping is a `GridGrasping`.
    workspace
        Who reaches what, on one table.
    num_grip_nodes
        Grip offsets lie on this many Gauss–Hermite nodes; by default on those of the planners' beliefs.
    max_states
        Refuse what has more states than this; each takes 8 bytes.

    Returns
    -------
    TeamOptimum
        Its `value`, and the exact value of any policy.

    Raises
    ------
    ArgumentError
        The law is none on a grid, or not one for all robots; robots may drop out; or there are more than `max_states`
        states.
    """
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    world = GridWorld(table, config, num_grip_nodes)
    model = GridTeam(world, np.asarray(workspace.is_in_reach), np.asarray(workspace.is_near))
    values = _Values(model, max_states)
    before, node = _first(model)
    value = expected_over_labels(values.best(node), looks_of(world, before))
    return TeamOptimum(float(value.item()), model, values)


def _first(model: GridTeam) -> tuple[Tally, TeamNode]:
    """The tally before anything was seen, and where the team begins."""
    before, doings = first_tally(model.world), (Doing(model.config.horizon),) * model.config.num_robots
    return before, TeamNode(after_look(model.world, before), doings)


def actions_in(
    model: GridTeam, nodes: Sequence[TeamNode], masses: Sequence[Grid], policy: Policy, key: Key
) -> list[Int[np.ndarray, "..."]]:
    """Ask a policy in every cell of some nodes that has mass; FINISH in all others.

    Raises
    ------
    ArgumentError
        The policy chose an action that is not possible.
    """
    cells = [np.flatnonzero(mass) for mass in masses]
    parts = [_states(model, node, cell) for node, cell in zip(nodes, cells, strict=True)]
    states = mapped(lambda *leaves: np.concatenate(leaves), *parts)
    numbers = np.arange(len(states.is_on_table))
    keys = random.fold_in(random.fold_in(key, numbers // CHUNK_SIZE), numbers % CHUNK_SIZE)
    chosen = np.split(decided(policy, states, keys), np.cumsum([len(cell) for cell in cells])[:-1])
    found = []
    for node, mass, cell, of_node in zip(nodes, masses, cells, chosen, strict=True):
        wrong = np.setdiff1d(of_node, model.possible(node))
        if len(wrong):
            raise ArgumentError(f"policy chose action {wrong[0]}; it must choose one of {model.possible(node)}")
        actions = np.zeros(mass.shape, dtype=np.int64)
        actions.ravel()[cell] = of_node
        found.append(actions)
    return found


def _states(model: GridTeam, node: TeamNode, cells: Int[np.ndarray, " n"]) -> TableState:
    """The states of some cells of a node."""
    log_odds, seen = _told(model, node.tally, cells)
    objects, seen_at, succeeded = _attempts(model, node.tally)
    lifts = [0 if told is None else sum(told.successes) for told in node.tally]
    shared = TableState(
        hides=np.asarray(model.world.scene.hides, dtype=np.float32),
        is_object=np.ones(model.world.num_objects, dtype=bool),
        is_on_table=np.array([told is not None for told in node.tally]),
        grip=np.asarray(model.world.grip, dtype=np.float32),
        log_odds=log_odds[0],
        seen=seen[0],
        lifts=np.array(lifts, dtype=np.int32),
        attempt_object=objects,
        attempt_occlusion=seen_at,
        attempt_succeeded=succeeded,
        # Attempts at what has left are forgotten, so that there is room for all that follow.
        steps_to_go=np.int32(np.sum(objects == NO_ATTEMPT)),
        robots=_robots(node),
        workspace=Workspace(model.is_in_reach, model.is_near),
        decider=np.int32(node.decider),
    )
    every = mapped(lambda leaf: np.broadcast_to(leaf, (len(cells), *np.shape(leaf))), shared)
    return replace(every, log_odds=log_odds, seen=seen)


def _told(model: GridTeam, tally: Tally, cells: Int[np.ndarray, " n"]) -> Float[np.ndarray, "2 n N"]:
    """Log-odds of DIRTY, and share of the surface seen, in some cells; 0 for what has left."""
    axes = np.unravel_index(cells, grid_shape(model.world, tally))
    found = np.zeros((2, len(cells), model.world.num_objects), dtype=np.float32)
    for cup, told in enumerate(tally):
        if told is not None:
            labels = model.world.labels[cup]
            found[:, :, cup] = labels.log_odds(told.looks)[axes[cup]], labels.seen(told.looks)[axes[cup]]
    return found


def _robots(node: TeamNode) -> Robots:
    verbs = np.array([doing.verb for doing in node.doings])
    return Robots(
        is_busy=verbs >= 0,
        is_parked=verbs == PARKED,
        verb=np.maximum(verbs, 0).astype(np.int32),
        target=np.array([doing.target for doing in node.doings], dtype=np.int32),
        since_s=np.array([doing.since_s for doing in node.doings], dtype=np.float32),
        decisions_to_go=np.array([doing.to_go for doing in node.doings], dtype=np.int32),
    )


def _attempts(
    model: GridTeam, tally: Tally
) -> tuple[Int[np.ndarray, " T"], Float[np.ndarray, " T"], Bool[np.ndarray, " T"]]:
    """Attempts at what has not left: object, its occlusion, and whether it held."""
    tried = [
        (cup, float(model.world.occlusions[cup][level]), is_held)
        for cup, told in enumerate(tally)
        if told is not None
        for is_held, counts in ((False, told.failures), (True, told.successes))
        for level, count in enumerate(counts)
        for _ in range(count)
    ]
    rest = [(NO_ATTEMPT, 0.0, False)] * (model.config.num_stages - len(tried))
    objects, seen_at, succeeded = zip(*tried, *rest, strict=True)
    return np.array(objects, dtype=np.int32), np.array(seen_at, dtype=np.float32), np.array(succeeded, dtype=bool)
