"""What a linear Q looks at when one robot of a team decides.

The numbers of one robot's table (`tables.features`), summed three times: over all that stands on the table, over what
the robot that decides could begin with now (in its reach, and nobody at it or near it), and over what of that no other
robot that goes on reaches; then how many others are at work and how many go on. What concerns the target alone comes
last, and once more where another robot that goes on reaches it, too. All verbs look at all of the table, FINISH and
WAIT as well: the table goes on without this robot.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.tables.features import table_columns
from halfseen.team.actions import WAIT, possible_actions
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace, Verb
from halfseen.world.grasp_model import GraspModel

NUM_SHARED, NUM_OWN = 9, 11
NUM_FEATURES = 3 * NUM_SHARED + 3 + 2 * NUM_OWN


def team_features(state: TeamState, grasp: GraspModel | None = None) -> Float[Array, "A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
    table, robots, actions = state.table, state.robots, ActionSpace(state.table.num_objects)
    columns = table_columns(table, grasp)
    is_other = jnp.arange(robots.num_robots) != state.decider
    goes_on = is_other & ~robots.is_parked & ((robots.decisions_to_go > 0) | robots.is_busy)
    is_shared = jnp.any(goes_on[:, None] & state.workspace.is_in_reach, axis=0)
    is_mine = possible_actions(state)[actions.of(Verb.WASH)]
    per_object = jnp.stack(columns.table, axis=-1)
    sums = [_sum(per_object, among) for among in (columns.is_there, is_mine, is_mine & ~is_shared)]
    at_work = jnp.sum(is_other & robots.is_busy & (robots.verb != WAIT))
    of_team = jnp.stack([columns.idle, at_work.astype(jnp.float32), jnp.sum(goes_on).astype(jnp.float32)])
    common = jnp.concatenate([*sums, of_team])
    rows = [_row(common, jnp.zeros((1, NUM_OWN)), jnp.zeros(1))]
    for verb in TARGETED:
        own = jnp.stack(columns.of_verb[verb], axis=-1)
        rows.append(_row(common, jnp.pad(own, ((0, 0), (0, NUM_OWN - own.shape[1]))), is_shared))
    return jnp.concatenate([*rows, rows[0]])


def _sum(per_object: Float[Array, "N f"], among: Bool[Array, " N"]) -> Float[Array, " f"]:
    return jnp.sum(jnp.where(among[:, None], per_object, 0.0), axis=0)


def _row(common: Float[Array, " c"], own: Float[Array, "M o"], is_shared: Array) -> Float[Array, "M F"]:
    shared = jnp.where(is_shared[:, None], own, 0.0)
    return jnp.concatenate([jnp.broadcast_to(common, (len(own), len(common))), own, shared], axis=1)
