"""What a policy of a team does in the states of many nodes of a small table, asked some hundreds at once."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.planners.exact_bellman import Grid
from halfseen.planners.exact_decisions import CHUNK_SIZE, decided
from halfseen.planners.exact_model import Tally, grid_shape
from halfseen.planners.exact_team_model import PARKED, GridTeam, TeamNode
from halfseen.world import random
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, Workspace


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
