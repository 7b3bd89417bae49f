"""What a linear Q looks at on a table: a few numbers for each verb, whatever the number of objects.

Every feature is a sum over the objects on the table, or the largest of them, or concerns the target alone, so it
depends neither on N nor on the order of the objects, and none uses a parameter of the world.

The first eleven features describe the table and mean the same for every verb:

===========================  =========================================================================================
Σ p                          dirty objects expected on the table, p = P(DIRTY)
Σ 1                          objects on the table
Σ win, Σ sure                how much there is to win, win = (p − ½)₊, and to win almost surely, sure = (p − ¾)₊
Σ win·ease, Σ sure·ease      how much of it is within reach
Σ doubt, Σ doubt·ease        how much is not known, doubt = 4 p (1 − p), and how much of that is within reach
Σ ease                       how much is within reach
Σ soon                       how much of what there is to win after one more look is within reach
idle = exp(−8 · max soon)    1 where no object is worth another step, and soon 0 where one is
===========================  =========================================================================================

with ease = (1 − occlusion) · (1 + successes) / (1 + attempts) · likelier: the share in sight, times the rule of
succession for a grip, times what shows of the grip. Of that, likelier = 4 / (3 + e⁻ᵍ), with g the mean of the grip
offset, is the probability that odds of three to one become by g, over what it was. Or, given a grasp model, ease is
the probability that it gives to a grasp.

One more look at an object that shows the share v for the first time leaves win(v) = ½ (p − ½ + v/4)₊ + ½ (p − ½ − v/4)₊
to be won on average, were its label right with probability ½ + v/4, and soon = ease · win(v). While no surface counts
as seen, every look is news, and v = 1 − occlusion. Where some does, errors persist, and the last look was taken from
here: v = 0, and only an object that is held up shows what was not seen of it, v = unseen = 1 − seen.

What follows concerns the target; `laid bare` is what it would show if it were grasped: ease · Σ_j (occlusion of j that
target i alone causes) · (…), the doubt of j times unseen; and LIFT gains ease · (ease · win(unseen) − soon) by the
better look, and looks at the target's doubt times unseen. FINISH looks at Σ p alone.

What differs between targets decides between them. So the largest `soon` stands in a feature of the table, the same for
all: the largest of the *others* tells as much of the table, but is least for the best target, and turned Q against it.

**Of a team**, when one robot decides. One set of coefficients serves all verbs: what the team can do with a table is
worth the same, whatever one robot does meanwhile, and so is an attempt that is under way, whichever robot makes it. The
features describe what follows the action:

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
how long it will take                  the bound of `halfseen.world.actions`
=====================================  ================================================================================

Where robots differ in how they grasp (`GraspByRobot`), what is about one object goes by the robot that is at it, or
decides; what the team can clear is the same, whichever robot decides.

Where no other robot goes on, all that FINISH looks at is 0, and Q is measured from leaving the table (`rewards`).
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
"""Coefficients mean nothing beside other features: raise this number whenever a feature changes."""
NUM_FEATURES = 22
NUM_TABLE_FEATURES = 11
WASH_DIRTY, WASH_EASE = NUM_TABLE_FEATURES + 2, NUM_TABLE_FEATURES + 4
"""Where the features of WASH hold P(DIRTY) and the ease of the target."""
LEAST_IN_SIGHT = 1e-6
"""Share that one object leaves of another's silhouette at least: what is in sight without it follows by division."""
LIKELY_ODDS = 3.0
"""Odds that a grasp holds at which the mean of a grip offset counts: the rule of succession starts from certainty."""
ROUNDING = 1e-6
"""Differences of float32 numbers below this are 0."""


class Columns(NamedTuple):
    """What the features are made of, one number an object."""

    is_there: Bool[Array, "*B N"]
    table: list[Float[Array, "*B N"]]
    """To be summed over the objects on the table."""
    idle: Float[Array, "*B"]
    """What follows the sums."""
    of_verb: Mapping[Verb, list[Float[Array, "*B N"]]]
    """Of each object as a target of the verb."""

    def of_table(self) -> Float[Array, "*B 11"]:
        """Describe the table: the sums, and what follows them."""
        xp, each = library_of(self.idle), stacked_columns(self.table)
        sums = xp.sum(xp.where(self.is_there[..., None, :], each, np.float32(0.0)), axis=-1)
        return xp.concatenate([sums, self.idle[..., None]], axis=-1)


def stacked_columns(values: Sequence[Float[Array, "*B N"]]) -> Float[Array, "*B f N"]:
    """Stack what is known of each object."""
    return library_of(*values).stack(values, axis=-2)


def table_columns(state: TableState, grasp: GraspModel | None = None) -> Columns:
    """Find what the features of tables are made of."""
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
    # Rounding is no variance: where nothing else varies, a regression would scale it up.
    gained = xp.where(clearer > ROUNDING, clearer, np.float32(0.0))
    return Columns(
        is_there=state.is_on_table,
        table=[is_dirty, xp.ones_like(is_dirty), *at_stake, *in_doubt, soon],
        idle=xp.exp(-8.0 * best),
        of_verb={Verb.WASH: washed, Verb.LIFT: [laid_bare_doubt, *left_to_see, gained]},
    )


def ease_of(state: TableState, grasp: GraspModel | None = None, in_sight: Any = None) -> Float[Array, "*B N"]:
    """How likely a grasp of each object is, by a model; without one by the share in sight, found unless it is given."""
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
    """Q of every action of tables, with the offset first in `coefficients`: what `q_values` makes of the features.

    The features are never put together, so that a decision takes a third of the time.
    """
    columns = table_columns(state, grasp)
    table = columns.of_table()[..., None]
    # FINISH looks at the first alone.
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
    """Rule of succession for a grip, times what shows of it: P(held) of objects that are wholly in sight."""
    likelier = (1.0 + LIKELY_ODDS) / (LIKELY_ODDS + library_of(grip).exp(-grip))
    return (1.0 + successes) / (1.0 + successes + failures) * likelier


def _sight(state: TableState) -> tuple[Float[Array, "*B N"], Float[Array, "*B N N"]]:
    """Share of each object in sight; and [j, i], how much more of j would be without i, 0 for what is not there."""
    xp, is_there = library_of(state.hides), state.is_on_table
    left = xp.where(is_there[..., None, :], xp.maximum(1.0 - state.hides, LEAST_IN_SIGHT), np.float32(1.0))
    in_sight = xp.prod(left, axis=-1)
    more = xp.where(is_there[..., None], in_sight[..., None] * (1.0 / left - 1.0), np.float32(0.0))
    return in_sight, more


NUM_WASH, NUM_LIFT, NUM_TEAM, NUM_WAIT, NUM_FINISH = 12, 6, 18, 8, 2
NUM_TEAM_FEATURES = NUM_WASH + NUM_LIFT + NUM_TEAM + 2 + 2 + NUM_WAIT + NUM_FINISH + 1
_WIN_EASE, _SOON = 3, 9
"""Where the columns of a table hold win·ease and soon."""


def team_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "*B A F"]:
    """φ(S, a) of every action of the robot that decides, WAIT last."""
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
