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

from halfseen.arrays import Array, library_of
from halfseen.shapes import Bool, Float
from halfseen.tables.features import table_columns
from halfseen.tables.grasp.grasp_table import GraspByRobot
from halfseen.world.actions import TARGETED, ActionSpace, Verb, possible_actions
from halfseen.world.others import Others, makespans, others_of, reached_by_decider
from halfseen.world.policy import GraspModel
from halfseen.world.state import TableState

NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 12, 6, 18, 8, 2
NUM_FEATURES = NUM_WASH + NUM_LIFT + NUM_TEAM + 2 + 2 + NUM_WAIT + NUM_FINISH + 1

_WIN_EASE, _SOON = 3, 9
"""Where the columns of a table hold win·ease and soon."""


def team_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "*B A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
    xp, others, mine = library_of(state.log_odds), others_of(state), reached_by_decider(state)
    columns = table_columns(state, grasp)
    by_robot = [columns]
    if isinstance(grasp, GraspByRobot):
        by_robot = [table_columns(state, grasp.of(robot)) for robot in range(state.num_robots)]
    each = _there(state, columns.table)
    two = each[..., [_WIN_EASE, _SOON]]
    own = _of_decider(_by_robot(state, [[one.table[k] for k in (_WIN_EASE, _SOON)] for one in by_robot]), state)
    is_free = possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
    num_going_on = xp.sum(others.goes_on, axis=-1).astype(np.float32)
    at_work = xp.stack([others.num_at_work, others.since_s, num_going_on], axis=-1)
    shared = xp.where(others.reached[..., None], own, np.float32(0.0))
    team, without = (_of_team(each, two, reach, others, at_work) for reach in (mine, xp.zeros_like(mine)))
    one = xp.ones_like(at_work[..., :1])
    waits = xp.concatenate([one, at_work, _largest(own, is_free), _largest(own, mine & ~is_free)], axis=-1)
    leaves = xp.stack([xp.any(others.goes_on, axis=-1).astype(np.float32), others.num_at_work], axis=-1)
    groups = [
        *(_under_way(verb, [one.of_verb[verb] for one in by_robot], state, others) for verb in TARGETED),
        _rows(state, NUM_TEAM, finish=without, wash=team, lift=team, wait=team),
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
    """How many robots are at a verb after each action, and the sum of what it is about their targets."""
    xp, robots = library_of(state.log_odds), state.robots
    assert robots is not None
    each = _by_robot(state, [[xp.ones_like(state.log_odds), *own] for own in by_robot])
    of_targets = xp.take_along_axis(each, robots.target[..., None, None], axis=-2)[..., 0, :]
    is_at_it = others.is_at_object & (robots.verb == verb)
    of_others = xp.sum(xp.where(is_at_it[..., None], of_targets, np.float32(0.0)), axis=-2)
    of_decider = _of_decider(each, state)
    return of_others[..., None, :] + _rows(state, of_decider.shape[-1], **{verb.name.lower(): of_decider})


def _by_robot(state: TableState, by_robot: Sequence[Sequence[Float[Array, "*B N"]]]) -> Float[Array, "*B K N f"]:
    """What is known of each object, as each robot grasps; the same of all where they grasp alike."""
    xp, each = library_of(state.log_odds), [_there(state, columns) for columns in by_robot]
    return xp.broadcast_to(xp.stack(each, axis=-3), (*each[0].shape[:-2], state.num_robots, *each[0].shape[-2:]))


def _of_decider(each: Float[Array, "*B K N f"], state: TableState) -> Float[Array, "*B N f"]:
    decider: Any = state.decider
    return library_of(each).take_along_axis(each, decider[..., None, None, None], axis=-3)[..., 0, :, :]


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


def _there(state: TableState, columns: Sequence[Float[Array, "*B N"]]) -> Float[Array, "*B N f"]:
    stacked = library_of(*columns).stack(columns, axis=-1)
    return library_of(stacked).where(state.is_on_table[..., None], stacked, np.float32(0.0))


def _sum(per_object: Float[Array, "*B N f"], among: Bool[Array, "*B N"]) -> Float[Array, "*B f"]:
    xp = library_of(per_object)
    return xp.sum(xp.where(among[..., None], per_object, np.float32(0.0)), axis=-2)


def _largest(per_object: Float[Array, "*B N f"], among: Bool[Array, "*B N"]) -> Float[Array, "*B f"]:
    xp = library_of(per_object)
    return xp.max(xp.where(among[..., None], per_object, np.float32(0.0)), axis=-2)
