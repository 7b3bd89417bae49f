"""What a linear Q looks at when one robot of a team decides.

One set of coefficients serves all verbs: what the rest of the team can do with a table is worth the same, whatever one
robot does meanwhile, so that only what sets the verbs apart needs features of its own. They are, in this order:

=====================================  ================================================================================
of the target of WASH                  its numbers on one robot's table (`tables.features`)
what the team can clear                the sums of one robot's table, over what a robot reaches that goes on, and idle;
                                       after FINISH, without the robot that decides
who reaches it                         win·ease and soon, summed: over what this robot alone reaches, over what only
                                       others reach, and over what others are at
what the others are at                 how many are at work, for how long in all [s], and how many go on
of WASH                                1; and win·ease and soon of the target, where another that goes on reaches it
of LIFT                                1; its numbers on one robot's table; and the same two
of WAIT                                1; what the others are at; the largest win·ease and soon of what it could begin
                                       with now, and of what it reaches but others are in the way of
of FINISH                              1 where another goes on, and how many are at work
how long it will take                  the bound of `makespan` on what follows
=====================================  ================================================================================

Where no other robot goes on, all that FINISH looks at is 0, and Q is measured from leaving the table (`rewards`).
"""

from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.tables.features import table_columns
from halfseen.team.actions import possible_actions
from halfseen.team.makespan import makespans
from halfseen.team.others import Others, others_of, reached_by_decider
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.grasp_model import GraspModel

NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 11, 4, 20, 8, 2
NUM_FEATURES = NUM_WASH + NUM_TEAM + 3 + 1 + NUM_LIFT + 2 + NUM_WAIT + NUM_FINISH + 1

WASH_DIRTY, WASH_EASE = 2, 4
"""Where the features of WASH hold P(DIRTY) and the ease of the target; all are 0 of what does not stand on the table."""

_WIN_EASE, _SOON = 3, 9
"""Where the columns of a table hold win·ease and soon."""


def team_features(state: TeamState, grasp: GraspModel | None = None) -> Float[Array, "A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
    table, others, num_objects = state.table, others_of(state), state.table.num_objects
    columns = table_columns(table, grasp)
    each = jnp.where(table.is_on_table[:, None], jnp.stack(columns.table, axis=-1), 0.0)
    two, mine = each[:, jnp.array([_WIN_EASE, _SOON])], reached_by_decider(state)
    is_free = possible_actions(state)[ActionSpace(num_objects).of(Verb.WASH)]
    at = jnp.stack([others.num_at_work, others.since_s, jnp.sum(others.goes_on).astype(jnp.float32)])
    wash, lift = (
        jnp.where(table.is_on_table[:, None], jnp.stack(columns.of_verb[verb], axis=-1), 0.0)
        for verb in (Verb.WASH, Verb.LIFT)
    )
    shared = jnp.where(others.reached[:, None], two, 0.0)
    one, team = jnp.ones((num_objects, 1)), _of_team(each, two, mine, others, at)
    of_wait = jnp.concatenate([jnp.ones(1), at, _largest(two, is_free), _largest(two, mine & ~is_free)])
    columns_of = partial(_columns, num_objects)
    groups = [
        columns_of(wash=wash),
        columns_of(finish=_of_team(each, two, jnp.zeros_like(mine), others, at), wash=team, lift=team, wait=team),
        columns_of(wash=jnp.concatenate([one, shared], axis=1)),
        columns_of(lift=jnp.concatenate([one, lift, shared], axis=1)),
        columns_of(wait=of_wait),
        columns_of(finish=jnp.stack([jnp.any(others.goes_on).astype(jnp.float32), others.num_at_work])),
        makespans(state, others)[:, None],
    ]
    return jnp.concatenate(groups, axis=1)


def _of_team(
    each: Float[Array, "N f"],
    two: Float[Array, "N 2"],
    mine: Bool[Array, " N"],
    others: Others,
    at: Float[Array, " 3"],
) -> Float[Array, " 20"]:
    """What the team can clear, and who reaches it, where one robot does what is `mine`."""
    among, reached = mine | others.reached, others.reached
    idle = jnp.exp(-8.0 * jnp.max(jnp.where(among, each[:, _SOON], 0.0), initial=0.0)) * jnp.any(among)
    by_reach = [_sum(two, among) for among in (mine & ~reached, reached & ~mine, others.taken)]
    return jnp.concatenate([_sum(each, among), idle[None], *by_reach, at])


def _columns(num_objects: int, **of_verb: Float[Array, "*M f"]) -> Float[Array, "A f"]:
    """Columns that some verbs have, one row for all of its objects or one for each; the others have zeros."""
    width = next(iter(of_verb.values())).shape[-1]
    sizes = {"finish": 1, "wash": num_objects, "lift": num_objects, "wait": 1}
    return jnp.concatenate(
        [jnp.broadcast_to(of_verb.get(verb, jnp.zeros(width)), (size, width)) for verb, size in sizes.items()]
    )


def _sum(per_object: Float[Array, "N f"], among: Bool[Array, " N"]) -> Float[Array, " f"]:
    return jnp.sum(jnp.where(among[:, None], per_object, 0.0), axis=0)


def _largest(per_object: Float[Array, "N f"], among: Bool[Array, " N"]) -> Float[Array, " f"]:
    return jnp.max(jnp.where(among[:, None], per_object, 0.0), axis=0, initial=0.0)
