"""Features of a table for a linear Q: a few numbers for each verb, whatever the number of objects.

Every feature is a sum or a maximum over the objects on the table, or concerns the target alone. So it depends neither
on N nor on the order of the objects. No feature uses a parameter of the world.

The first eleven features describe the table and are shared by all verbs:

===========================  =========================================================================================
Σ p                          expected number of dirty objects on the table, p = P(DIRTY)
Σ 1                          objects on the table
Σ win, Σ sure                possible gain, win = (p − ½)₊, and nearly certain gain, sure = (p − ¾)₊
Σ win·ease, Σ sure·ease      the part of each that can be grasped
Σ doubt, Σ doubt·ease        uncertainty, doubt = 4 p (1 − p), and the part of it that can be grasped
Σ ease                       number of objects that can be grasped
Σ soon                       possible gain after one more look, the part that can be grasped
idle = exp(−8 · max soon)    1 where no object is worth another step; falls quickly towards 0 where one is
===========================  =========================================================================================

with ease = (1 − occlusion) · (1 + successes) / (1 + attempts) · likelier: the visible share, times the rule of
succession for a grip, times the effect of the visible grip. Here likelier = 4 / (3 + e⁻ᵍ), with g the mean of the grip
offset: g is added to the log-odds of a probability of ¾, and likelier is the ratio of the result to ¾. With a grasp
model, ease is the probability that the model gives a grasp.

One more look at an object that shows the share v for the first time leaves an average possible gain of
win(v) = ½ (p − ½ + v/4)₊ + ½ (p − ½ − v/4)₊ if its label is right with probability ½ + v/4, and soon = ease · win(v).
While no surface counts as seen, every look is news, and v = 1 − occlusion. Otherwise label errors persist, and the last
look was taken from here. Then v = 0, and only an object that is held up shows its unseen share, v = unseen = 1 − seen.

The other features concern the target. `laid bare` is what a grasp of it would reveal: ease · Σ_j (occlusion of j that
target i alone causes) · (win of j, or its doubt times unseen). LIFT has ease · (ease · win(unseen) − soon), its gain by
the better look, and the target's doubt times unseen. FINISH uses Σ p alone.

Features that differ between targets decide between them. So the largest `soon` is a feature of the table, the same for
all targets. The largest among the *others* describes the table as well, but is smallest for the best target, and biased
Q against it.

**Teams**, for the deciding robot. One set of coefficients serves all verbs: the team's prospects on a table are worth
the same whatever one robot does meanwhile, and so is an attempt under way, whichever robot makes it. The features
describe the table after the action:

=====================================  ================================================================================
WASHes under way                       their number, and the features of their targets on one robot's table, summed over
                                       all robots
LIFTs under way                        the same
what the team can clear                the sums of one robot's table over objects in reach of a robot that continues,
                                       and idle; after FINISH, without the deciding robot
reach                                  win·ease and soon, summed over objects that this robot alone reaches, and over
                                       those that only others reach
activity of the others                 how many are at work, for how long in all [s], and how many continue
of WASH, and of LIFT                   win·ease and soon of the target, where another robot that continues reaches it
of WAIT                                1; activity of the others; the largest win·ease and soon of the objects that it
                                       could begin with now, and of those in reach that others block
of FINISH                              1 where another robot continues, and how many are at work
how long it will take                  the bound of `halfseen.world.actions`
=====================================  ================================================================================

Where robots grasp differently (`GraspByRobot`), features of one object use the model of the robot that is at it, or of
the one that decides; what the team can clear is the same, whichever robot decides.

Where no other robot continues, all features of FINISH are 0, and Q is relative to leaving the table (`rewards`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, expit, library_of
from halfseen.shapes import Bool, Float
from halfseen.tables.grasp_table import GraspByRobot
from halfseen.world import actions
from halfseen.world.actions import TARGETED, ActionSpace, Others, Verb
from halfseen.world.policy import GraspModel
from halfseen.world.state import TableState, attempt_counts

FEATURES_VERSION = 1
"""Coefficients are valid only for their own features: increase this number whenever a feature changes."""
NUM_FEATURES = 22
NUM_TABLE_FEATURES = 11
WASH_DIRTY, WASH_EASE = NUM_TABLE_FEATURES + 2, NUM_TABLE_FEATURES + 4
"""Columns of WASH that hold P(DIRTY) and the ease of the target."""
LEAST_IN_SIGHT = 1e-6
"""Least share of a silhouette that one object leaves visible: the share visible without it follows by division."""
LIKELY_ODDS = 3.0
"""Odds of a grasp to which the mean grip offset is applied: the rule of succession starts from certainty."""
ROUNDING = 1e-6
"""float32 differences below this count as 0."""


class FeatureColumns(NamedTuple):
    """Terms of the features, one number for each object."""

    is_there: Bool[Array, "*B N"]
    table: list[Float[Array, "*B N"]]
    """Terms to sum over the objects on the table."""
    idle: Float[Array, "*B"]
    """The feature after the sums."""
    of_verb: Mapping[Verb, list[Float[Array, "*B N"]]]
    """Terms of each object as a target of the verb."""

    def of_table(self) -> Float[Array, "*B 11"]:
        """Features of the table: the sums, and idle."""
        xp, each = library_of(self.idle), stacked_columns(self.table)
        sums = xp.sum(xp.where(self.is_there[..., None, :], each, np.float32(0.0)), axis=-1)
        return xp.concatenate([sums, self.idle[..., None]], axis=-1)


def stacked_columns(values: Sequence[Float[Array, "*B N"]]) -> Float[Array, "*B f N"]:
    """Stack the columns of the objects."""
    return library_of(*values).stack(values, axis=-2)


def table_columns(state: TableState, grasp: GraspModel | None = None) -> FeatureColumns:
    """Compute the terms of the features of tables."""
    xp, is_dirty = library_of(state.log_odds), expit(state.log_odds)
    win, sure = _above(is_dirty, 0.5), _above(is_dirty, 0.75)
    doubt, unseen = 4.0 * is_dirty * (1.0 - is_dirty), 1.0 - state.seen
    in_sight, laid_bare = _sight(state)
    ease = ease_of(state, grasp, in_sight)
    soon = ease * _win_after_look(is_dirty, xp.where(state.seen > 0.0, np.float32(0.0), in_sight))
    clearer = ease * (ease * _win_after_look(is_dirty, unseen) - soon)
    best = xp.max(xp.where(state.is_on_table, soon, np.float32(0.0)), axis=-1)
    behind = stacked_columns([win, doubt * unseen]) @ laid_bare
    laid_bare_win, laid_bare_doubt = ease * behind[..., 0, :], ease * behind[..., 1, :]
    in_doubt, left_to_see = ([part, ease, part * ease] for part in (doubt, doubt * unseen))
    at_stake = [win, win * ease, sure, sure * ease]
    washed = [laid_bare_win, laid_bare_doubt, is_dirty, is_dirty * ease, ease, *at_stake, soon, soon * ease]
    # Rounding errors are set to 0: a regression would scale them up where nothing else varies.
    gained = xp.where(clearer > ROUNDING, clearer, np.float32(0.0))
    return FeatureColumns(
        is_there=state.is_on_table,
        table=[is_dirty, xp.ones_like(is_dirty), *at_stake, *in_doubt, soon],
        idle=xp.exp(-8.0 * best),
        of_verb={Verb.WASH: washed, Verb.LIFT: [laid_bare_doubt, *left_to_see, gained]},
    )


def ease_of(state: TableState, grasp: GraspModel | None = None, in_sight: Any = None) -> Float[Array, "*B N"]:
    """P(a grasp holds) of each object by a model; without one, by the visible share, computed unless given."""
    if grasp is not None:
        return grasp.probability(state)
    in_sight = _sight(state)[0] if in_sight is None else in_sight
    return in_sight * succession(*attempt_counts(state), state.grip)


def table_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "*B A F"]:
    """φ(S, a) of every action of tables, in the order of the actions, padded with zeros to F = 22."""
    columns = table_columns(state, grasp)
    table = columns.of_table()
    xp, shape = library_of(table), (*table.shape[:-1], state.num_objects)
    shared = xp.broadcast_to(table[..., None, :], (*shape, NUM_TABLE_FEATURES))

    def of_verb(values: Sequence[Float[Array, "*B N"]]) -> Float[Array, "*B N F"]:
        padding = xp.zeros((*shape, NUM_FEATURES - NUM_TABLE_FEATURES - len(values)), dtype=np.float32)
        return xp.concatenate([shared, xp.stack(values, axis=-1), padding], axis=-1)

    rest = xp.zeros((*table.shape[:-1], NUM_FEATURES - 1), dtype=np.float32)
    finish = xp.concatenate([table[..., :1], rest], axis=-1)[..., None, :]
    return xp.concatenate([finish, *map(of_verb, columns.of_verb.values())], axis=-2)


def table_q(
    coefficients: Float[Array, "*#B K F"], state: TableState, grasp: GraspModel | None = None
) -> Float[Array, "*B A"]:
    """Q of every action of tables, equal to `q_values` of the features; the offset is first in `coefficients`.

    The features are never assembled, so that a decision takes a third of the time.
    """
    columns = table_columns(state, grasp)
    table = columns.of_table()[..., None]
    # FINISH uses the first feature only.
    finish = coefficients[..., Verb.FINISH, 0] + coefficients[..., Verb.FINISH, 1] * table[..., 0, 0]
    each = {verb: _q_of_verb(coefficients[..., verb, :], table, values) for verb, values in columns.of_verb.items()}
    return ActionSpace(state.num_objects).join(finish, each)


def _q_of_verb(
    coefficients: Float[Array, "*#B F"], table: Float[Array, "*B 11 1"], values: Sequence[Float[Array, "*B N"]]
) -> Float[Array, "*B N"]:
    first = 1 + NUM_TABLE_FEATURES
    offset, shared = coefficients[..., :1], coefficients[..., None, 1:first] @ table
    own = coefficients[..., None, first : first + len(values)] @ stacked_columns(values)
    return offset + shared[..., 0] + own[..., 0, :]


def _above(values: Float[Array, "*B N"], least: Any) -> Float[Array, "*B N"]:
    return library_of(values).maximum(values - least, np.float32(0.0))


def _win_after_look(is_dirty: Float[Array, "*B N"], shown: Float[Array, "*B N"]) -> Float[Array, "*B N"]:
    step = shown / 4.0
    return (_above(is_dirty, 0.5 - step) + _above(is_dirty, 0.5 + step)) / 2.0


def succession(successes: Any, failures: Any, grip: Any) -> Any:
    """Rule of succession for a grip, times the effect of the visible grip: P(held) of fully visible objects."""
    likelier = (1.0 + LIKELY_ODDS) / (LIKELY_ODDS + library_of(grip).exp(-grip))
    return (1.0 + successes) / (1.0 + successes + failures) * likelier


def _sight(state: TableState) -> tuple[Float[Array, "*B N"], Float[Array, "*B N N"]]:
    """Visible share of each object; and [j, i], how much more of j is visible without i, 0 for absent objects."""
    xp, is_there = library_of(state.hides), state.is_on_table
    left = xp.where(is_there[..., None, :], xp.maximum(1.0 - state.hides, LEAST_IN_SIGHT), np.float32(1.0))
    in_sight = xp.prod(left, axis=-1)
    more = xp.where(is_there[..., None], in_sight[..., None] * (1.0 / left - 1.0), np.float32(0.0))
    return in_sight, more


NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 12, 6, 18, 8, 2
NUM_TEAM_FEATURES = NUM_WASH + NUM_LIFT + NUM_TEAM + 2 + 2 + NUM_WAIT + NUM_FINISH + 1
_WIN_EASE, _SOON = 3, 9
"""Columns of a table that hold win·ease and soon."""


def team_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "*B A F"]:
    """φ(S, a) of every action of the deciding robot, WAIT last."""
    xp, others, mine = library_of(state.log_odds), actions.others_of(state), actions.reached_by_decider(state)
    columns = table_columns(state, grasp)
    by_robot = [columns]
    if isinstance(grasp, GraspByRobot):
        by_robot = [table_columns(state, grasp.of(robot)) for robot in range(state.num_robots)]
    each = _there(state, columns.table)
    two = each[..., [_WIN_EASE, _SOON]]
    own = _of_decider(_by_robot(state, [[one.table[k] for k in (_WIN_EASE, _SOON)] for one in by_robot]), state)
    is_free = actions.possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
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
        actions.makespans(state, others)[..., None],
    ]
    return xp.concatenate(groups, axis=-1)


def _under_way(
    verb: Verb, by_robot: Sequence[Sequence[Float[Array, "*B N"]]], state: TableState, others: Others
) -> Float[Array, "*B A f1"]:
    """Number of robots that execute a verb after each action, and the summed terms of their targets."""
    xp, robots = library_of(state.log_odds), state.robots
    assert robots is not None
    each = _by_robot(state, [[xp.ones_like(state.log_odds), *own] for own in by_robot])
    of_targets = xp.take_along_axis(each, robots.target[..., None, None], axis=-2)[..., 0, :]
    is_at_it = others.is_at_object & (robots.verb == verb)
    of_others = xp.sum(xp.where(is_at_it[..., None], of_targets, np.float32(0.0)), axis=-2)
    of_decider = _of_decider(each, state)
    return of_others[..., None, :] + _rows(state, of_decider.shape[-1], **{verb.name.lower(): of_decider})


def _by_robot(state: TableState, by_robot: Sequence[Sequence[Float[Array, "*B N"]]]) -> Float[Array, "*B K N f"]:
    """Columns of each object by each robot's grasp model; the same for all robots where they grasp alike."""
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
    """What the team can clear, and who reaches it; the deciding robot reaches `mine`."""
    xp, among, reached = library_of(each), mine | others.reached, others.reached
    best = xp.max(xp.where(among, each[..., _SOON], np.float32(0.0)), axis=-1)
    idle = xp.exp(-8.0 * best) * xp.any(among, axis=-1)
    by_reach = [_sum(two, group) for group in (mine & ~reached, reached & ~mine)]
    return xp.concatenate([_sum(each, among), idle[..., None], *by_reach, at_work], axis=-1)


def _rows(state: TableState, width: int, **of_verb: Float[Array, "*S {width}"]) -> Float[Array, "*B A {width}"]:
    """Features of some verbs, one row for all objects or one for each; zeros for the other verbs."""
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
