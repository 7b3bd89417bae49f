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
how long it will take                  the bound of `halfseen.world.others`
=====================================  ================================================================================

Where robots differ in how they grasp (`GraspByRobot`), what is about one object goes by the robot that is at it, or
decides; what the team can clear is the same, whoever decides.

Where no other robot goes on, all that FINISH looks at is 0, and Q is measured from leaving the table (`rewards`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Array, library_of
from halfseen.tables.features import Columns, table_columns
from halfseen.tables.grasp.grasp_table import GraspByRobot
from halfseen.world.actions import TARGETED, ActionSpace, Verb, of_robot, possible_actions
from halfseen.world.others import Others, makespans, others_of, reached_by_decider
from halfseen.world.policy import GraspModel
from halfseen.world.state import TableState

NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 12, 6, 18, 8, 2
NUM_FEATURES = NUM_WASH + NUM_LIFT + NUM_TEAM + 2 + 2 + NUM_WAIT + NUM_FINISH + 1

_WIN_EASE, _SOON = 3, 9
"""Where the columns of a table hold win·ease and soon."""


def team_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "*B A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
    return features_of(state, table_columns(state, grasp), grasp)


def features_of(state: TableState, columns: Columns, grasp: GraspModel | None) -> Float[Array, "*B A F"]:
    """`team_features`, where the columns of the table are known already."""
    xp, others, mine = library_of(state.log_odds), others_of(state), reached_by_decider(state)
    by_robot = [columns]
    if isinstance(grasp, GraspByRobot):
        by_robot = [table_columns(state, grasp.of(robot)) for robot in range(state.num_robots)]
    each = _there(state, xp.stack(columns.table, axis=-1))
    own = two = each[..., [_WIN_EASE, _SOON]]
    if len(by_robot) > 1:
        pairs = [xp.stack([robot.table[k] for k in (_WIN_EASE, _SOON)], axis=-1) for robot in by_robot]
        own = _there(state, _of_decider(xp.stack(pairs, axis=-3), state))
    is_free = possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
    num_going_on = xp.sum(others.goes_on, axis=-1).astype(np.float32)
    at_work = xp.stack([others.num_at_work, others.since_s, num_going_on], axis=-1)
    shared = xp.where(others.reached[..., None], own, np.float32(0.0))
    team, without = (_of_team(each, two, reach, others, at_work) for reach in (mine, xp.zeros_like(mine)))
    one = xp.ones_like(at_work[..., :1])
    waits = xp.concatenate([one, at_work, _largest(own, is_free), _largest(own, mine & ~is_free)], axis=-1)
    leaves = xp.stack([xp.any(others.goes_on, axis=-1).astype(np.float32), others.num_at_work], axis=-1)
    groups = [
        *(_under_way(verb, [robot.of_verb[verb] for robot in by_robot], state, others) for verb in TARGETED),
        _rows(state, 18, finish=without, wash=team, lift=team, wait=team),
        _rows(state, 2, wash=shared),
        _rows(state, 2, lift=shared),
        _rows(state, NUM_WAIT, wait=waits),
        _rows(state, NUM_FINISH, finish=leaves),
        makespans(state, others)[..., None],
    ]
    return xp.concatenate(groups, axis=-1)


def _under_way(
    verb: Verb, by_robot: Sequence[Sequence[Float[Array, "*B N"]]], state: TableState, others: Others
) -> Float[Array, "*B A f1"]:
    """How many robots are at a verb after each action, and the sum of what it is about their targets.

    That is one for all robots, or by each robot.
    """
    xp, robots = library_of(state.log_odds), state.robots
    assert robots is not None
    one = xp.ones_like(state.log_odds)
    counted = [_there(state, xp.stack([one, *own], axis=-1)) for own in by_robot]
    is_at_it = others.is_at_object & (robots.verb == verb)
    if len(counted) == 1:
        of_targets, of_decider = xp.take_along_axis(counted[0], robots.target[..., None], axis=-2), counted[0]
    else:
        each = xp.stack(counted, axis=-3)
        of_targets = xp.take_along_axis(each, robots.target[..., None, None], axis=-2)[..., 0, :]
        of_decider = _of_decider(each, state)
    of_others = xp.sum(xp.where(is_at_it[..., None], of_targets, np.float32(0.0)), axis=-2)
    return of_others[..., None, :] + _rows(state, of_decider.shape[-1], **{verb.name.lower(): of_decider})


def _of_decider(each: Float[Array, "*B K N f"], state: TableState) -> Float[Array, "*B N f"]:
    assert state.decider is not None
    flat = each.reshape(*each.shape[:-2], -1)
    return of_robot(flat, state.decider).reshape(*each.shape[:-3], *each.shape[-2:])


def _of_team(
    each: Float[Array, "*B N f"],
    two: Float[Array, "*B N 2"],
    mine: Bool[Array, "*B N"],
    others: Others,
    at_work: Float[Array, "*B 3"],
) -> Float[Array, "*B 18"]:
    """What the team can clear, and who reaches it, where one robot does what is `mine`."""
    xp, among, reached = library_of(each), mine | others.reached, others.reached
    best = xp.max(xp.where(among, each[..., _SOON], np.float32(0.0)), axis=-1)
    idle = xp.exp(-8.0 * best) * xp.any(among, axis=-1)
    by_reach = [_sum(two, group) for group in (mine & ~reached, reached & ~mine)]
    return xp.concatenate([_sum(each, among), idle[..., None], *by_reach, at_work], axis=-1)


def _rows(state: TableState, width: int, **of_verb: Float[Array, "*S {width}"]) -> Float[Array, "*B A {width}"]:
    """What some verbs have, one row for all of its objects or one for each; the others have zeros."""
    xp, batch = library_of(state.log_odds), state.is_object.shape[:-1]
    sizes = {"finish": 1, "wash": state.num_objects, "lift": state.num_objects, "wait": 1}

    def of(verb: str, size: int) -> Any:
        given = of_verb.get(verb)
        if given is None:
            return xp.zeros((*batch, size, width), dtype=np.float32)
        rows = given if given.ndim > len(batch) + 1 else given[..., None, :]
        return xp.broadcast_to(rows, (*batch, size, width))

    return xp.concatenate([of(verb, size) for verb, size in sizes.items()], axis=-2)


def _there(state: TableState, per_object: Float[Array, "*B N f"]) -> Float[Array, "*B N f"]:
    return library_of(per_object).where(state.is_on_table[..., None], per_object, np.float32(0.0))


def _sum(per_object: Float[Array, "*B N f"], among: Bool[Array, "*B N"]) -> Float[Array, "*B f"]:
    xp = library_of(per_object)
    return xp.sum(xp.where(among[..., None], per_object, np.float32(0.0)), axis=-2)


def _largest(per_object: Float[Array, "*B N f"], among: Bool[Array, "*B N"]) -> Float[Array, "*B f"]:
    xp = library_of(per_object)
    return xp.max(xp.where(among[..., None], per_object, np.float32(0.0)), axis=-2)
