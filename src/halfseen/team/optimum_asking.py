"""What a policy of a team does in the states of many nodes of a small table, asked some hundreds at once."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Int

from halfseen.errors import ArgumentError
from halfseen.planners.optimum_bellman import Grid
from halfseen.planners.optimum_model import Tally, grid_shape
from halfseen.team.optimum_model import PARKED, GridTeam, TeamNode
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import Robots, TeamState, Workspace
from halfseen.world.state import NO_ATTEMPT, TableState

BATCH_SIZES = (32, 1024)
"""Numbers of states for which a policy is compiled: the smallest that holds all, or else the largest."""


def actions_in(
    model: GridTeam, nodes: Sequence[TeamNode], masses: Sequence[Grid], policy: TeamPolicy, key: Array
) -> list[Int[np.ndarray, "..."]]:
    """Ask a policy in every cell of some nodes that has mass; FINISH in all others.

    Raises
    ------
    ArgumentError
        The policy chose an action that is not possible.
    """
    cells = [np.flatnonzero(mass) for mass in masses]
    rows = [_states(model, node, cell) for node, cell in zip(nodes, cells, strict=True)]
    states = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    chosen = np.split(_asked(model, states, policy, key), np.cumsum([len(cell) for cell in cells])[:-1])
    found = []
    for node, mass, cell, of_node in zip(nodes, masses, cells, chosen, strict=True):
        wrong = np.setdiff1d(of_node, model.possible(node))
        if len(wrong):
            raise ArgumentError(f"policy chose action {wrong[0]}; it must choose one of {model.possible(node)}")
        actions = np.zeros(mass.shape, dtype=np.int64)
        actions.ravel()[cell] = of_node
        found.append(actions)
    return found


def _asked(model: GridTeam, states: dict[str, np.ndarray], policy: TeamPolicy, key: Array) -> Int[np.ndarray, " n"]:
    num_states = len(states["decider"])
    size = next((size for size in BATCH_SIZES if size >= num_states), BATCH_SIZES[-1])
    # The last batch is filled up, so that few sizes are compiled.
    filled = {
        name: np.pad(rows, [(0, -num_states % size), *[(0, 0)] * (rows.ndim - 1)], "edge")
        for name, rows in states.items()
    }
    shared = _shared(model)
    starts = range(0, len(filled["decider"]), size)
    batches = [{name: rows[start : start + size] for name, rows in filled.items()} for start in starts]
    decided = [_decide(policy, shared, batch, jax.random.fold_in(key, k)) for k, batch in enumerate(batches)]
    return np.concatenate([np.asarray(each) for each in decided])[:num_states].astype(np.int64)


def _shared(model: GridTeam) -> dict[str, Array]:
    return {
        "hides": jnp.asarray(model.world.scene.hides, dtype=jnp.float32),
        "grip": jnp.asarray(model.world.grip, dtype=jnp.float32),
        "is_in_reach": jnp.asarray(model.is_in_reach),
        "is_near": jnp.asarray(model.is_near),
    }


@jax.jit
def _decide(policy: TeamPolicy, shared: dict[str, Array], batch: dict[str, Array], key: Array) -> Array:
    def decide(row: dict[str, Array], key: Array) -> Array:
        table = TableState(
            hides=shared["hides"],
            is_object=jnp.ones(len(shared["grip"]), dtype=bool),
            grip=shared["grip"],
            **{name[6:]: leaf for name, leaf in row.items() if name.startswith("table_")},
        )
        robots = Robots(**{name[6:]: leaf for name, leaf in row.items() if name.startswith("robot_")})
        state = TeamState(table, robots, Workspace(shared["is_in_reach"], shared["is_near"]), row["decider"])
        return policy.decide(state, key).action

    return jax.vmap(decide)(batch, jax.random.split(key, len(batch["decider"])))


def _states(model: GridTeam, node: TeamNode, cells: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
    """The states of some cells of a node, a row for each."""
    shared = _of_table(model, node.tally) | _of_robots(node)
    rows = {name: np.broadcast_to(leaf, (len(cells), *leaf.shape)) for name, leaf in shared.items()}
    axes = np.unravel_index(cells, grid_shape(model.world, node.tally))
    log_odds, seen = np.zeros((2, len(cells), model.world.num_objects))
    for cup, told in enumerate(node.tally):
        if told is not None:
            log_odds[:, cup] = model.world.labels[cup].log_odds(told.looks)[axes[cup]]
            seen[:, cup] = model.world.labels[cup].seen(told.looks)[axes[cup]]
    return rows | {"table_log_odds": log_odds.astype(np.float32), "table_seen": seen.astype(np.float32)}


def _of_table(model: GridTeam, tally: Tally) -> dict[str, np.ndarray]:
    room, tried = model.config.num_stages, _attempts(model, tally)
    objects, seen_at, succeeded = np.full(room, NO_ATTEMPT), np.zeros(room), np.zeros(room, dtype=bool)
    for k, attempt in enumerate(tried):
        objects[k], seen_at[k], succeeded[k] = attempt
    lifts = [0 if told is None else sum(told.successes) for told in tally]
    return {
        "table_is_on_table": np.array([told is not None for told in tally]),
        "table_lifts": np.array(lifts, dtype=np.int32),
        "table_attempt_object": objects.astype(np.int32),
        "table_attempt_occlusion": seen_at.astype(np.float32),
        "table_attempt_succeeded": succeeded,
        # Attempts at what has left are forgotten, so that there is room for all that follow.
        "table_steps_to_go": np.array(room - len(tried), dtype=np.int32),
    }


def _of_robots(node: TeamNode) -> dict[str, np.ndarray]:
    verbs = np.array([doing.verb for doing in node.doings])
    return {
        "robot_is_busy": verbs >= 0,
        "robot_is_parked": verbs == PARKED,
        "robot_verb": np.maximum(verbs, 0).astype(np.int32),
        "robot_target": np.array([doing.target for doing in node.doings], dtype=np.int32),
        "robot_since_s": np.array([doing.since_s for doing in node.doings], dtype=np.float32),
        "robot_decisions_to_go": np.array([doing.to_go for doing in node.doings], dtype=np.int32),
        "decider": np.array(node.decider, dtype=np.int32),
    }


def _attempts(model: GridTeam, tally: Tally) -> list[tuple[int, float, bool]]:
    """Attempts at what has not left: object, its occlusion, and whether it held."""
    return [
        (cup, float(model.world.occlusions[cup][level]), is_held)
        for cup, told in enumerate(tally)
        if told is not None
        for is_held, counts in ((False, told.failures), (True, told.successes))
        for level, count in enumerate(counts)
        for _ in range(count)
    ]
