"""The myopic look-ahead, for one robot or several: the value of every action relative to leaving all, in closed form.

The state after the step is valued by a heuristic V_0: each object is left or tried once, whichever has the larger
value, within the decisions left and by the best robot for it. Q_1(b, a) = E[R + V_0(b')] has a closed form: the grasp
succeeds or fails, and each object gets one of two labels. It is exact unless more tries are wanted than decisions
remain; then the expected number of tries replaces their number.

With unlimited decisions there is no such exception: V° is V_0 without the limit, and Q°(b, a) = E[R + V°(b')] is exact,
except at the last step. Q° is a poor rule near the end, but reduces the variance of rollouts (`rollout`).

In this file, the batch axes *B come last. An object is occluded in M = N + 2 ways: now, without the first, the second,
… object, and in the hand. Tries after an attempt have two rows of M: tries in each of these ways, the last after a
success at the object itself; and the try after a failure at it, then tries with success probabilities as now while each
other object is held up, which only shows what is behind it.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, expit, library_of, softmax
from halfseen.planners.belief import grip_offsets, grip_posterior, known_grasping, known_seeing
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.state import TableState

_ZERO, _ONE, _NEVER, _TINY = np.float32(0.0), np.float32(1.0), np.float32(-np.inf), np.finfo(np.float32).tiny
MISSED, HELD, MISSED_THEN_HELD, HELD_TWICE, ATTEMPT_S, NOW = range(6)
"""Rows of `Chances.attempts`; from the last on, P(success) in each way except in the hand."""


class Beliefs(NamedTuple):
    """Beliefs of tables; entries of absent objects are arbitrary but finite."""

    is_there: Bool[Array, " N *B"]
    is_dirty: Float[Array, " N *B"]
    weights: Float[Array, "G N *B"]
    """Posterior weights of each grip offset on its nodes."""
    seen: Float[Array, " N *B"]
    steps_to_go: Int[Array, "*B"]
    hides: Float[Array, "N N *B"]
    grip: Float[Array, " N *B"]


class Chances(NamedTuple):
    """Occlusions and the resulting probabilities of labels and attempts."""

    occluded: Float[Array, "M N *B"]
    label: Float[Array, "2 2 M N *B"]
    """P(the next label says dirty, or not) for a dirty object, and for a clean one; 0 if the object is not tried."""
    attempts: tuple[Float[Array, "W G N *B"], ...]
    """Rows as in `MISSED` to `NOW`, at each node of the grip offset, under the law of each robot that may try next."""


class Outlook(NamedTuple):
    """Predicted outcomes of one attempt at each object."""

    occluded: Float[Array, "M N *B"]
    likelihood: Float[Array, "2 G N *B"]
    """P(an attempt now fails, and succeeds) at each node of the grip offset."""
    expected: tuple[Float[Array, "W N *B"], ...]
    """`Chances.attempts`, with the grip offset integrated out."""
    hit: Float[Array, "2 M N *B"]
    """P(the next label says dirty, or not, and the object is dirty)."""
    says: Float[Array, "2 M N *B"]
    """P(the next label says dirty, or not); 0 for absent objects."""
    worth: Float[Array, " N *B"]
    """Expected reward of an attempt to WASH, with the penalty that it avoids."""


@lru_cache(maxsize=64)
def _ways(num_objects: int) -> tuple[Float[np.ndarray, "M N"], Float[np.ndarray, "M N"]]:
    """Masks of the objects that hide nothing in each way, and of those that are tried in it."""
    none, each = np.zeros((1, num_objects)), np.eye(num_objects)
    gone = np.concatenate([none, each, none + 1.0])
    return gone.astype(np.float32), np.concatenate([none + 1.0, 1.0 - each, none + 1.0]).astype(np.float32)


def _pair(one: Float[Array, "*S"], other: Float[Array, "*S"]) -> Float[Array, "2 ..."]:
    """Stack two arrays; faster than `stack`."""
    return library_of(one).concatenate([one[None], other[None]])


def _behind(constants: np.ndarray, num_axes: int) -> np.ndarray:
    """Append `num_axes` batch axes."""
    return constants.reshape(constants.shape + (1,) * num_axes)


def table_of(config: WorldConfig, state: TableState) -> Beliefs:
    """Beliefs from states, with the batch axes last and no NaN in padding.

    Raises
    ------
    ArgumentError
        The world's law of grasping can only be sampled from.
    """
    # Checked even before the first attempt, when the posterior does not use the law.
    known_grasping(config)
    xp, num_axes = library_of(state.hides), state.is_on_table.ndim - 1
    is_there = xp.moveaxis(state.is_on_table, -1, 0)
    objects = (expit(state.log_odds), state.seen, state.grip)
    is_dirty, seen, grip = (xp.where(is_there, xp.moveaxis(each, -1, 0), _ZERO) for each in objects)
    weights = xp.moveaxis(softmax(grip_posterior(config, state).log_weights), (-1, -2), (0, 1))
    weights = xp.where(is_there, weights, _ONE)
    hides = xp.moveaxis(state.hides, range(num_axes), range(-num_axes, 0))
    return Beliefs(is_there, is_dirty, weights, seen, state.steps_to_go, hides, grip)


def setting_of(worlds: tuple[WorldConfig, ...], table: Beliefs, robot: Int[Array, "*B"] | None = None) -> Chances:
    """Compute the setting of a table.

    There is one world for each law of grasping; `robot` makes the first attempt if each has its own law.
    """
    xp, occluded = library_of(table.hides), occlusions_in(table)
    helds, seconds = [], []
    for world in worlds:
        law, offset = known_grasping(world), xp.moveaxis(grip_offsets(world, table.grip), -1, 0)
        # Some laws compute it faster than its logarithm.
        failure: Any = getattr(law, "failure", lambda *at, law=law: xp.exp(law.log_failure(*at)))
        helds.append(_ONE - failure(occluded[:-1, None], offset))
        seconds.append(law.expected_s(occluded[0], offset))
    own = helds[0][0]
    if robot is not None:
        own = xp.take_along_axis(xp.stack([held[0] for held in helds]), robot[None, None, None], axis=0)[0]
    missed = _ONE - own
    attempts = []
    for held, attempt_s in zip(helds, seconds, strict=True):
        first = (missed, own, missed * held[0], own * held[0], attempt_s)
        attempts.append(xp.concatenate([*(each[None] for each in first), held]))
    return Chances(occluded, labels_in(worlds[0], table, occluded), tuple(attempts))


def occlusions_in(table: Beliefs) -> Float[Array, "M N *B"]:
    """Occlusion of each object in each way."""
    xp, num_axes = library_of(table.hides), table.is_there.ndim - 1
    # Absent objects hide nothing, even if their share is padding (NaN).
    visible = xp.fmax(_ONE - table.hides, (~table.is_there).astype(np.float32))
    gone, _ = _ways(len(table.is_there))
    return _ONE - xp.prod(xp.fmax(visible, _behind(gone[:, None], num_axes)), axis=2)


def labels_in(config: WorldConfig, table: Beliefs, occluded: Float[Array, "M N *B"]) -> Float[Array, "2 2 M N *B"]:
    """`Chances.label`, from the occlusion in each way."""
    xp, (num_ways, num_objects) = library_of(occluded), occluded.shape[:2]
    is_in_hand = _behind(np.arange(num_ways)[:, None] == num_ways - 1, table.is_there.ndim - 1)
    says_dirty = xp.stack(known_seeing(config).positive(occluded, table.seen, is_in_hand))
    _, is_tried = _ways(num_objects)
    is_counted = table.is_there * _behind(is_tried, table.is_there.ndim - 1)
    return (xp.stack([says_dirty, _ONE - says_dirty], axis=1) * is_counted).astype(np.float32)


def outlook_of(config: WorldConfig, table: Beliefs, setting: Chances | None = None) -> Outlook:
    """Predict the outcomes of one attempt at each object, by default in the setting of the world's own law."""
    setting = setting_of((config,), table) if setting is None else setting
    expected = tuple((table.weights * each).sum(axis=1) for each in setting.attempts)
    hit = table.is_dirty * setting.label[0]
    says = hit + (_ONE - table.is_dirty) * setting.label[1]
    washed, missed = wash_rewards(config)
    worth = (washed[0] * table.is_dirty + washed[1]) * expected[0][HELD] + missed
    return Outlook(setting.occluded, setting.attempts[0][: HELD + 1], expected, hit, says, worth)


def wash_rewards(config: WorldConfig) -> tuple[tuple[Any, Any], Any]:
    """Reward of a successful WASH above a failed one, as slope in P(DIRTY) and intercept; and that of a failed one.

    It includes the penalty for a dirty object left, which a success avoids.
    """
    missed, of_clean = config.reward_wash_failed, config.reward_wash_clean
    return (config.reward_wash_dirty - config.reward_dirty_left - of_clean, of_clean - missed), missed


def tries_of(
    config: WorldConfig, look: Outlook, chances: tuple[Array, ...], effort: tuple[Any, ...], way: Any = slice(None)
) -> Float[Array, "2 ..."]:
    """E (value of one more try − its effort)₊ over the next label, and P(it is positive), under the best law.

    `chances` are P(the try succeeds) under each law of grasping, `effort` is the price of its time, and `way` selects
    the ways that the chances are for.
    """
    (by_dirt, washed), missed = wash_rewards(config)
    hit, says = look.hit[:, None, way], look.says[:, None, way]
    xp, if_held = library_of(says), by_dirt * hit + washed * says
    # Weighted by the label's probability, which avoids a division by it.
    worth, *others = (chance * if_held + (missed - price) * says for chance, price in zip(chances, effort, strict=True))
    for other in others:
        is_more = xp.maximum(other, _ZERO).sum(axis=0) > xp.maximum(worth, _ZERO).sum(axis=0)
        worth = xp.where(is_more, other, worth)
    gain, number = xp.maximum(worth, _ZERO), (worth > _ZERO) * says
    return _pair(gain[0] + gain[1], number[0] + number[1])


def limited(tries: Float[Array, "2 ..."], num_decisions: Int[Array, "*B"]) -> Float[Array, "..."]:
    """Expected gain of the tries that fit the decisions left, approximated by average instead of best tries."""
    xp = library_of(tries)
    steps = xp.asarray(num_decisions).astype(np.float32)
    return xp.minimum(_ONE, steps / xp.maximum(tries[1], _ONE)) * tries[0]


def _chances_then(expected: Float[Array, "W N *B"]) -> Float[Array, "2 M N *B"]:
    """P(success) of the tries that may follow an attempt."""
    xp, num_objects = library_of(expected), expected.shape[1]
    then = expected[MISSED_THEN_HELD : HELD_TWICE + 1] / xp.maximum(expected[: HELD + 1], _TINY)
    each = [expected[NOW:], then[1:], then[:1], *[expected[NOW : NOW + 1]] * (num_objects + 1)]
    return xp.concatenate(each).reshape(2, num_objects + 2, *expected.shape[1:])


def tries_then(config: WorldConfig, look: Outlook, effort: tuple[Any, ...]) -> Float[Array, "2 2 M N *B"]:
    """Expected gain of one more try at each object, and P(it is tried), in each way of the two rows."""
    return tries_of(config, look, tuple(_chances_then(each) for each in look.expected), effort)


def tries_after(each: Float[Array, "2 2 M N *B"]) -> Float[Array, "2 3 N *B"]:
    """Expected gain of tries, and their number, after a failure, a WASH and a LIFT of each object."""
    total = each.sum(axis=3)
    # After a failure, only the target's grip posterior has changed.
    missed = total[:, 0, :1] - each[:, 0, 0] + each[:, 1, 0]
    washed, lifted = total[:, 0, 1:-1], total[:, 1, 1:-1] + each[:, 0, -1]
    return library_of(each).concatenate([of[:, None] for of in (missed, washed, lifted)], axis=1)


def attempts_worth(
    config: WorldConfig,
    look: Outlook,
    gains: Float[Array, "L 3 N *B"],
    own_s: Float[Array, " N *B"],
    price_per_s: Any = 0.0,
) -> Float[Array, "L 2 N *B"]:
    """Value of WASH and LIFT of each object relative to leaving all.

    `gains` are those of tries after a failure, a WASH and a LIFT of each object, counted in L ways; `own_s` is the
    expected duration of an attempt with transport [s], at a price of `price_per_s` [1/s].
    """
    missed, held = look.expected[0][: HELD + 1]
    wash, lift = look.worth + price_per_s * own_s, (config.reward_lift_per_s + price_per_s) * own_s
    return _pair(wash, lift) + held * gains[:, 1:] + missed * gains[:, :1]


def rule_and_control(config: WorldConfig, table: Beliefs, look: Outlook) -> Float[Array, "2 C *B"]:
    """Q_1 and Q° of WASH and LIFT of each object relative to leaving all, for one robot; −∞ for absent objects.

    With one step to go, Q_1 is exact and Q° undefined.
    """
    return values_by(config, table, look, tries_then(config, look, (0.0,)))


def values_by(
    config: WorldConfig, table: Beliefs, look: Outlook, each: Float[Array, "2 2 M N *B"]
) -> Float[Array, "2 C *B"]:
    """`rule_and_control`, from the result of `tries_then`."""
    xp, tries = library_of(look.worth), tries_after(each)
    gains = _pair(limited(tries, table.steps_to_go - 1), tries[0])
    own_s = config.transport_s + look.expected[0][ATTEMPT_S]
    values = xp.where(table.is_there, attempts_worth(config, look, gains, own_s), _NEVER)
    return values.reshape(2, -1, *table.steps_to_go.shape)


def control_value(table: Beliefs, look: Outlook) -> Float[Array, "*B"]:
    """V° relative to leaving all: every object is left, or tried once if better, without a limit on steps."""
    xp = library_of(look.worth)
    return xp.where(table.is_there, xp.maximum(look.worth, _ZERO), _ZERO).sum(axis=0)


def left_price(config: WorldConfig, table: Beliefs) -> Float[Array, "*B"]:
    """Expected penalty for leaving all objects."""
    is_dirty = library_of(table.is_dirty).where(table.is_there, table.is_dirty, _ZERO)
    return config.reward_dirty_left * is_dirty.sum(axis=0)


def laid_out(finish: Float[Array, "*B"], values: Float[Array, "..."]) -> Float[Array, "*B A"]:
    """Values of FINISH, and of WASH and LIFT of each object, in action order, with the batch axes first."""
    wash, lift = library_of(values).moveaxis(values.reshape(2, -1, *finish.shape), 1, -1)
    return ActionSpace(wash.shape[-1]).join(finish, {Verb.WASH: wash, Verb.LIFT: lift})


def one_step_q(config: WorldConfig, state: TableState) -> Float[Array, "*B A"]:
    """Q_1 of every action of one robot, in closed form; −∞ if impossible."""
    table = table_of(config, state)
    look = outlook_of(config, table)
    left = left_price(config, table)
    return laid_out(left, left + rule_and_control(config, table, look)[0])
