"""Features of E, the error of the one-step look-ahead, computed from a belief under known laws.

The look-ahead (`halfseen.planners.one_step`) values the stages beyond one attempt by a rule that leaves each object or
tries it once. Its error depends on which objects are worth trying, what may still be revealed, and how scarce steps
are. All features follow from the look-ahead itself:

===============  ===================================================================================================
gain             (value of a WASH now)₊, including the penalty that it avoids
scarce           by how much the objects worth a WASH outnumber the steps to go
reveal           increase in the gains of the others after the next look, if the target is removed
around           the same if it is held up and put back
own              increase in the gain of the target after it was held up
bare             shares of others that the target hides, times their doubt and unseen share
===============  ===================================================================================================

E of a team uses the values of the myopic look, and the team's table after each action:

=====================  ==============================================================================================
1                      by verb, including WAIT
short, near            by verb: shortfall of the action from the best in the myopic look, and (short + 1)₊
table afterwards       the features of `features.team_features`: attempts under way, objects that the team can
                       still clear, their reach, and how long all robots will be busy
=====================  ==============================================================================================

For one robot, features of what labels may still reveal are sufficient. For several the schedule matters as much, and
the myopic look accounts only for shared seconds.
"""

from typing import NamedTuple

import numpy as np

from halfseen.arrays import Array, library_of
from halfseen.planners import one_step
from halfseen.planners.one_step import MISSED, MISSED_THEN_HELD, NOW, Beliefs, Outlook
from halfseen.shapes import Bool, Float
from halfseen.tables.features import NUM_TEAM_FEATURES, team_features
from halfseen.world.actions import VERB_NAMES, WAIT, ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.state import TableState

EXCESS_VERSION = 1
"""Coefficients are valid only for their own features: increase this number whenever a feature changes."""
NUM_TABLE, NUM_OWN = 14, 30
NUM_EXCESS_FEATURES = NUM_TABLE + NUM_OWN
ZERO, ONE, _TINY = np.float32(0.0), np.float32(1.0), np.finfo(np.float32).tiny


class Ahead(NamedTuple):
    """The look-ahead from some beliefs; batch axes *B come last."""

    table: Beliefs
    look: Outlook
    values: Float[Array, "2 C *B"]
    """Q_1 and Q° of WASH and LIFT of each object above leaving all; −∞ for absent objects."""
    control: Float[Array, "*B"]
    """V° above leaving all."""
    of_table: Float[Array, " 14 *B"]
    own: Float[Array, "30 2 N *B"]
    """Features of WASH and of LIFT of each object; 0 for absent objects."""

    @property
    def one_step(self) -> Float[Array, " C *B"]:
        """Q_1."""
        return self.values[0]


def ahead_of(config: WorldConfig, table: Beliefs) -> Ahead:
    """Look ahead, and compute the features."""
    look = one_step.outlook_of(config, table)
    each = one_step.tries_then(config, look, (ZERO,))
    values = one_step.values_by(config, table, look, each)
    control = one_step.control_value(table, look)
    return Ahead(table, look, values, control, *_described(config, table, look, each[0], values))


class _Objects(NamedTuple):
    """Results of the look-ahead for each object; 0 for absent objects."""

    worth: Float[Array, " N *B"]
    gain: Float[Array, " N *B"]
    holds: Float[Array, " N *B"]
    again: Float[Array, " N *B"]
    doubt: Float[Array, " N *B"]
    unseen: Float[Array, " N *B"]
    reveal: Float[Array, " N *B"]
    around: Float[Array, " N *B"]
    own: Float[Array, " N *B"]
    occluded: Float[Array, " N *B"]
    bare: Float[Array, " N *B"]
    bare_dirty: Float[Array, " N *B"]
    second: Float[Array, " N *B"]
    lift_net: Float[Array, " N *B"]
    total: Float[Array, "*B"]
    """Sum of all gains."""
    wanted: Float[Array, "*B"]
    """Number of objects worth a WASH."""
    scarce: Float[Array, "*B"]


def _objects(config: WorldConfig, table: Beliefs, look: Outlook, gains: Float[Array, "2 M N *B"]) -> _Objects:
    xp, there = library_of(gains), table.is_there
    expected, p = look.expected[0], table.is_dirty
    holds, again = expected[NOW], expected[MISSED_THEN_HELD] / xp.maximum(expected[MISSED], _TINY)

    def if_there(each: Array) -> Array:
        return xp.where(there, each, ZERO)

    worth, gain = if_there(look.worth), if_there(xp.maximum(look.worth, ZERO))
    total, wanted = gain.sum(axis=0), ((worth > ZERO) * ONE).sum(axis=0)
    unseen, doubt = if_there(ONE - table.seen), if_there(4.0 * p * (ONE - p))
    others = total - gain
    reveal, around = (if_there(of_row[1:-1].sum(axis=1) - others) for of_row in gains)
    own = if_there(gains[0, -1] - gain)
    hidden = xp.where(there, xp.maximum(look.occluded[0] - look.occluded[1:-1], ZERO), ZERO)
    bare, bare_dirty, second = (
        if_there((hidden * each).sum(axis=1)) for each in (doubt * unseen, (p > 0.5) * unseen, reveal)
    )
    own_s = config.transport_s + expected[one_step.ATTEMPT_S]
    return _Objects(
        worth=worth,
        gain=gain,
        holds=holds,
        again=again,
        doubt=doubt,
        unseen=unseen,
        reveal=reveal,
        around=around,
        own=own,
        occluded=if_there(look.occluded[0]),
        bare=bare,
        bare_dirty=bare_dirty,
        second=second,
        lift_net=if_there(holds * (own + around) + config.reward_lift_per_s * own_s),
        total=total,
        wanted=wanted,
        scarce=xp.maximum(wanted - table.steps_to_go.astype(np.float32), ZERO),
    )


def _described(
    config: WorldConfig, table: Beliefs, look: Outlook, gains: Float[Array, "2 M N *B"], values: Float[Array, "2 C *B"]
) -> tuple[Float[Array, " 14 *B"], Float[Array, "30 2 N *B"]]:
    """Features of the table, and features of each verb and target."""
    xp, there = library_of(values), table.is_there
    each = _objects(config, table, look, gains)
    above, control = (of_row.reshape(2, *there.shape) for of_row in values)
    # Absent objects have zero features; one product for all is faster than one for each.
    by_target = xp.stack(_of_target(table, each))[:, None]
    by_target = xp.broadcast_to(by_target, (len(by_target), *above.shape))
    of_verb = xp.stack(_of_verb(there, above, control, each.total))
    own = xp.where(there, xp.concatenate([of_verb, by_target]), ZERO).astype(np.float32)
    return xp.stack(_of_table(table, each)).astype(np.float32), own


def _of_table(table: Beliefs, each: _Objects) -> list[Float[Array, "*B"]]:
    xp = library_of(each.gain)
    in_order = xp.sort(each.gain, axis=0)[::-1]
    number = np.arange(len(in_order)).reshape(-1, *(1,) * (in_order.ndim - 1))
    within = xp.where(number < table.steps_to_go.astype(np.float32), in_order, ZERO).sum(axis=0)
    most_lift = each.lift_net.max(axis=0)
    return [
        each.total / 10.0,
        each.wanted / 5.0,
        each.scarce / 3.0,
        (each.total - within) / 10.0,
        (table.is_there * ONE).sum(axis=0) / 5.0,
        each.reveal.max(axis=0),
        each.own.max(axis=0),
        each.own.sum(axis=0) / 3.0,
        each.bare.sum(axis=0),
        most_lift,
        xp.maximum(most_lift, ZERO),
        each.reveal.sum(axis=0) / 3.0,
        (each.doubt * each.unseen).sum(axis=0) / 3.0,
        (each.gain * (ONE - each.holds)).sum(axis=0) / 5.0,
    ]


def _of_target(table: Beliefs, each: _Objects) -> list[Float[Array, " N *B"]]:
    return [
        each.worth / 5.0,
        each.gain / 5.0,
        table.is_dirty,
        each.holds,
        each.again,
        each.holds * each.again,
        each.doubt,
        each.unseen,
        each.own,
        each.reveal,
        each.around,
        each.bare,
        each.bare_dirty,
        each.second,
        each.gain * (ONE - each.holds) / 5.0,
        (each.gain <= ZERO) * each.holds,
        each.holds * each.reveal,
        each.holds * each.own,
        (table.seen <= ZERO) * ONE,
        (table.is_dirty > 0.8) * ONE,
        each.gain * each.scarce / 10.0,
        each.reveal * each.scarce / 3.0,
        each.own * each.scarce / 3.0,
        each.occluded,
        each.doubt * each.unseen * each.holds,
    ]


def _of_verb(
    there: Bool[Array, " N *B"],
    above: Float[Array, "2 N *B"],
    control: Float[Array, "2 N *B"],
    total: Float[Array, "*B"],
) -> list[Float[Array, "2 N *B"]]:
    """Shortfall of each action from the best, and its value beyond that of the gains without it."""
    xp = library_of(above)
    best, second_best = _best_two(above)
    short, beyond = (xp.where(there, each, ZERO) for each in (above - best, control - total))
    rival = xp.where(there & (short >= -1e-6), second_best - best, ZERO)
    return [short / 5.0, beyond / 5.0, xp.maximum(short + ONE, ZERO), xp.maximum(beyond + ONE, ZERO), rival / 5.0]


def _best_two(above: Float[Array, "2 N *B"]) -> tuple[Float[Array, "*B"], Float[Array, "*B"]]:
    """Best and second-best value of all actions, including FINISH, whose value is 0."""
    xp = library_of(above)
    flat = above.reshape(-1, *above.shape[2:])
    first = flat.argmax(axis=0)
    best = flat.max(axis=0)
    number = np.arange(len(flat)).reshape(-1, *(1,) * (flat.ndim - 1))
    rest = xp.where(number == first, np.float32(-np.inf), flat).max(axis=0)
    return xp.maximum(best, ZERO), xp.maximum(xp.minimum(best, ZERO), rest)


TEAM_EXCESS_VERSION = 1
"""Coefficients are valid only for their own features: increase this number whenever a feature changes."""
NUM_VERBS = len(VERB_NAMES)
NUM_TEAM_EXCESS_FEATURES = 3 * NUM_VERBS + NUM_TEAM_FEATURES


def team_described(state: TableState, q: Float[Array, "*B A"]) -> Float[Array, "*B A F"]:
    """Features of every action of the deciding robot.

    `q` holds the values of the myopic look; −∞ where an action is impossible.
    """
    xp = library_of(q)
    verb = np.append(ActionSpace(state.num_objects).verbs, WAIT)
    is_verb = xp.asarray(np.eye(NUM_VERBS, dtype=np.float32)[verb])
    short = xp.where(q > -np.inf, q - xp.max(q, axis=-1, keepdims=True), ZERO)
    numbers = (xp.ones_like(short), short / np.float32(5.0), xp.maximum(short + ONE, ZERO))
    by_verb = [each[..., None] * is_verb for each in numbers]
    return xp.concatenate([*by_verb, team_features(state)], axis=-1).astype(np.float32)
