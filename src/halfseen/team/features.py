"""What a linear Q looks at when one robot of a team decides.

One set of coefficients serves all verbs: what the team can do with a table is worth the same, whatever one robot does
meanwhile, and so is an attempt that is under way, whoever makes it. The features describe what follows the action:

=====================================  ================================================================================
WASHes under way                       their number, and the numbers of their targets on one robot's table
                                       (`tables.features`), summed over all robots
LIFTs under way                        the same
what the team can clear                the sums of one robot's table, over what a robot reaches that goes on, and idle;
                                       after FINISH, without the robot that decides
who reaches it                         win·ease and soon, summed: over what this robot alone reaches, and over what only
                                       others reach
what the others are at                 how many are at work, for how long in all [s], and how many go on
of WASH, and of LIFT                   win·ease and soon of the target, where another that goes on reaches it, too
of WAIT                                1; what the others are at; the largest win·ease and soon of what it could begin
                                       with now, and of what it reaches but others are in the way of
of FINISH                              1 where another goes on, and how many are at work
how long it will take                  the bound of `makespan`
=====================================  ================================================================================

Where robots differ in how they grasp (`grasp_by_robot`), what is about one object goes by the robot that is at it, or
decides; what the team can clear is the same, whoever decides.

Where no other robot goes on, all that FINISH looks at is 0, and Q is measured from leaving the table (`rewards`).
"""

from collections.abc import Sequence
from functools import partial

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.tables.features import table_columns
from halfseen.team.actions import possible_actions
from halfseen.team.grasp_by_robot import GraspByRobot
from halfseen.team.makespan import makespans
from halfseen.team.others import Others, others_of, reached_by_decider
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace, Verb
from halfseen.world.grasp_model import GraspModel

NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 12, 6, 18, 8, 2
NUM_FEATURES = NUM_WASH + NUM_LIFT + NUM_TEAM + 2 + 2 + NUM_WAIT + NUM_FINISH + 1

_WIN_EASE, _SOON = 3, 9
"""Where the columns of a table hold win·ease and soon."""


def team_features(state: TeamState, grasp: GraspModel | None = None) -> Float[Array, "A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
    table, others, num_objects = state.table, others_of(state), state.table.num_objects
    columns, mine = table_columns(table, grasp), reached_by_decider(state)
    by_robot = [columns]
    if isinstance(grasp, GraspByRobot):
        by_robot = [table_columns(table, grasp.of(robot)) for robot in range(state.robots.num_robots)]
    each = jnp.where(table.is_on_table[:, None], jnp.stack(columns.table, axis=-1), 0.0)
    two = own = each[:, jnp.array([_WIN_EASE, _SOON])]
    if len(by_robot) > 1:
        pairs = jnp.stack([jnp.stack([robot.table[k] for k in (_WIN_EASE, _SOON)], axis=-1) for robot in by_robot])
        own = jnp.where(table.is_on_table[:, None], pairs[state.decider], 0.0)
    is_free = possible_actions(state)[ActionSpace(num_objects).of(Verb.WASH)]
    at = jnp.stack([others.num_at_work, others.since_s, jnp.sum(others.goes_on).astype(jnp.float32)])
    shared = jnp.where(others.reached[:, None], own, 0.0)
    team, without = (_of_team(each, two, reach, others, at) for reach in (mine, jnp.zeros_like(mine)))
    columns_of = partial(_columns, num_objects)
    groups = [
        *(
            _under_way(verb, [jnp.stack(robot.of_verb[verb], axis=-1) for robot in by_robot], state, others)
            for verb in TARGETED
        ),
        columns_of(finish=without, wash=team, lift=team, wait=team),
        columns_of(wash=shared),
        columns_of(lift=shared),
        columns_of(wait=jnp.concatenate([jnp.ones(1), at, _largest(own, is_free), _largest(own, mine & ~is_free)])),
        columns_of(finish=jnp.stack([jnp.any(others.goes_on).astype(jnp.float32), others.num_at_work])),
        makespans(state, others)[:, None],
    ]
    return jnp.concatenate(groups, axis=1)


def _under_way(
    verb: Verb, by_robot: Sequence[Float[Array, "N f"]], state: TeamState, others: Others
) -> Float[Array, "A f1"]:
    """How many robots are at a verb after each action, and the sum of what it is about their targets.

    That is one for all robots, or by each robot.
    """
    counted = [jnp.concatenate([jnp.ones((len(own), 1)), own], axis=1) for own in by_robot]
    counted = [jnp.where(state.table.is_on_table[:, None], each, 0.0) for each in counted]
    is_at_it = others.is_at_object & (state.robots.verb == verb)
    of_targets, of_decider = counted[0][state.robots.target], counted[0]
    if len(counted) > 1:
        each = jnp.stack(counted)
        of_targets, of_decider = each[jnp.arange(len(each)), state.robots.target], each[state.decider]
    of_others = jnp.sum(jnp.where(is_at_it[:, None], of_targets, 0.0), axis=0)
    return of_others + _columns(len(of_decider), **{verb.name.lower(): of_decider})


def _of_team(
    each: Float[Array, "N f"],
    two: Float[Array, "N 2"],
    mine: Bool[Array, " N"],
    others: Others,
    at: Float[Array, " 3"],
) -> Float[Array, " 18"]:
    """What the team can clear, and who reaches it, where one robot does what is `mine`."""
    among, reached = mine | others.reached, others.reached
    idle = jnp.exp(-8.0 * jnp.max(jnp.where(among, each[:, _SOON], 0.0), initial=0.0)) * jnp.any(among)
    by_reach = [_sum(two, among) for among in (mine & ~reached, reached & ~mine)]
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
