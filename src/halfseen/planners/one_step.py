"""A closed look one step ahead in the space of beliefs: the rule that searches of the table build upon.

What lies beyond the step is valued by a rule of thumb V_0: each object is left, or tried once, whichever is worth more,
as far as the steps allow. Q_1(b, a) = E[R + V_0(b')] is computed in closed form: the grasp succeeds or not, and each
label says one thing or the other, object by object (exact unless more tries are wanted than steps remain: then the
expected number of tries stands for their number).

With unlimited steps that exception falls away: V° is V_0 with more steps than any try could want, and
Q°(b, a) = E[R + V°(b')] is exact, for any steps to go but the last. It is no good rule near the end, but takes noise
out of rollouts (`rollout`). Both are read off one `Outlook`.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, expit, library_of, softmax
from halfseen.planners.belief import (
    Belief,
    grasp_probability,
    grip_offsets,
    known_grasping,
    known_seeing,
    occlusion_without,
)
from halfseen.planners.heuristics import wash_worth
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig

_ZERO, _ONE, _NEVER, _TINY = np.float32(0.0), np.float32(1.0), np.float32(-np.inf), np.finfo(np.float32).tiny


class Label(NamedTuple):
    """What the next label of each object may say."""

    hit: Float[Array, "*S N"]
    """P(it says dirty, and the object is)."""
    alarm: Float[Array, "*S N"]
    """P(it says dirty, and the object is not)."""


class Tries(NamedTuple):
    """One more try of each object, where it is worth it."""

    gain: Float[Array, "*S N"]
    number: Float[Array, "*S N"]
    """Probability that it is worth it."""

    def among(self, is_there: Bool[Array, "*S N"]) -> "Tries":
        """Sum over objects."""
        xp = library_of(self.gain)
        return Tries(*(xp.sum(xp.where(is_there, each, _ZERO), axis=-1) for each in self))


def tries_after_label(
    config: WorldConfig,
    is_dirty: Float[Array, "*#S N"],
    label: Label,
    probability: Float[Array, "*S N"],
    effort: Any = 0.0,
) -> Tries:
    """E (worth of one more try, less the effort of it)₊ over the next label, and P(it is positive)."""
    xp, missed = library_of(probability), config.reward_wash_failed
    of_dirty = config.reward_wash_dirty - config.reward_dirty_left - missed
    of_clean = config.reward_wash_clean - missed
    # By the probability of what the label says, so that nothing is divided by it.
    says = label.hit + label.alarm
    says_not = _ONE - says
    if_said = of_dirty * label.hit + of_clean * label.alarm
    if_not = (of_clean + (of_dirty - of_clean) * is_dirty) - if_said
    worth_said = probability * if_said + (missed - effort) * says
    worth_not = probability * if_not + (missed - effort) * says_not
    return Tries(
        gain=xp.maximum(worth_said, _ZERO) + xp.maximum(worth_not, _ZERO),
        number=(worth_said > _ZERO) * says + (worth_not > _ZERO) * says_not,
    )


def left_or_tried(left: Float[Array, "*#S"], tries: Tries, steps_to_go: Int[Array, "*#S"]) -> Float[Array, "*S"]:
    """Value of leaving all, plus the gains of as many tries as there are steps (their mean stands for the best)."""
    xp = library_of(tries.gain)
    steps = xp.asarray(steps_to_go).astype(np.float32)
    return left + xp.minimum(_ONE, steps / xp.maximum(tries.number, _ONE)) * tries.gain


def occlusions_of_each(belief: Belief) -> Float[Array, "*B M N"]:
    """Occlusion of each object in M = N + 2 ways: now, without the first, the second, … object, and in the hand."""
    xp, num_objects = library_of(belief.hides), belief.is_on_table.shape[-1]
    # What hides nothing lets all be seen, also where its share is padding (NaN).
    visible = xp.fmax(_ONE - belief.hides, (~belief.is_on_table).astype(np.float32)[..., None, :])
    visible = xp.fmax(visible[..., None, :, :], ways_of(num_objects).hides_nothing[:, None, :])
    return _ONE - visible.prod(axis=-1)


class _Ways(NamedTuple):
    """The ways in which an object may be hidden: now, without each of the others, and in the hand."""

    hides_nothing: Float[np.ndarray, "M N"]
    """1 for the objects that hide nothing, else 0."""
    is_in_hand: Bool[np.ndarray, "M 1"]
    is_other: Bool[np.ndarray, "M N"]
    """Which objects are tried in each of them, of those that are wanted."""


@lru_cache(maxsize=64)
def ways_of(num_objects: int) -> _Ways:
    """The M ways of so many objects."""
    one, each = np.ones((1, num_objects), dtype=bool), ~np.eye(num_objects, dtype=bool)
    is_in_hand = np.arange(num_objects + 2)[:, None] == num_objects + 1
    return _Ways(
        1.0 - np.concatenate([one, each, ~one]).astype(np.float32), is_in_hand, np.concatenate([one, each, one])
    )


def label_in_each(
    config: WorldConfig, seen: Float[Array, "*B N"], occluded: Float[Array, "*B M N"]
) -> tuple[Float[Array, "*B M N"], Float[Array, "*B M N"]]:
    """P(the next label says dirty) of what is dirty, and of what is clean, in each of the ways."""
    return known_seeing(config).positive(occluded, seen[..., None, :], ways_of(seen.shape[-1]).is_in_hand)


def label_of_tries(
    is_dirty: Float[Array, "*B N"], if_dirty: Float[Array, "*B M N"], if_clean: Float[Array, "*B M N"]
) -> Label:
    """What the label before each of the tries of `probabilities_of_tries` may say; axes (B, 1, M, N)."""
    is_dirty = is_dirty[..., None, None, :]
    return Label(is_dirty * if_dirty[..., None, :, :], (_ONE - is_dirty) * if_clean[..., None, :, :])


def probabilities_of_tries(
    by_way: Float[Array, "*B V N"], if_held: Float[Array, "*B N"], if_missed: Float[Array, "*B N"]
) -> Float[Array, "*B 2 M N"]:
    """P(it succeeds) of the tries that may follow an attempt, by how each object is hidden then.

    First now, without each of the others, which is in the dishwasher, and of what was held; then after a miss, and as
    now, where the other is held up and only shows what is behind it. `by_way` has no way in the hand.
    """
    xp, now = library_of(by_way), by_way[..., :1, :]
    num_ways, num_objects = by_way.shape[-2] + 1, by_way.shape[-1]
    each = [by_way, if_held[..., None, :], if_missed[..., None, :], *[now] * (num_ways - 1)]
    found = xp.concatenate(each, axis=-2)
    return found.reshape(*found.shape[:-2], 2, num_ways, num_objects)


def summed_tries(tries: Tries, is_wanted: Bool[Array, "*B N"]) -> Tries:
    """All tries of what is wanted after a miss, a WASH and a LIFT of each, by those of `probabilities_of_tries`."""
    xp, num = library_of(is_wanted), is_wanted.shape[-1]
    # No more than 0 of what is not, also where it is padding (NaN); of the others as much as there is.
    most = xp.where(is_wanted[..., None, None, :] & ways_of(num).is_other, -_NEVER, _ZERO)
    each = xp.fmin(xp.concatenate([each[None] for each in tries]), most)
    total = each.sum(axis=-1)
    # After a miss all is as before but the grip of the target.
    missed = total[..., 0, :1] - each[..., 0, 0, :] + each[..., 1, 0, :]
    washed, lifted = total[..., 0, 1:-1], total[..., 1, 1:-1] + each[..., 0, -1, :]
    found = xp.concatenate([each[..., None, :] for each in (missed, washed, lifted)], axis=-2)
    return Tries(found[0], found[1])


class Setting(NamedTuple):
    """How objects stand, and what follows of that for attempts and labels: the same for the same set of them."""

    occluded: Float[Array, "*B M N"]
    """As `occlusions_of_each` has it."""
    if_dirty: Float[Array, "*B M N"]
    if_clean: Float[Array, "*B M N"]
    """As `label_in_each` has them."""
    failed: Float[Array, "*B N G"]
    """Log P(an attempt fails) now at each node of the grip offset."""
    missing: Float[Array, "*B V N G"]
    """P(an attempt fails) at each node, in each of the ways but that in the hand."""
    attempt_s: Float[Array, "*B N G"]
    """Expected duration of an attempt now at each node, without transport [s]."""


def setting_of(config: WorldConfig, belief: Belief) -> Setting:
    """What the objects on a table make of attempts and labels."""
    law, occluded, offset = known_grasping(config), occlusions_of_each(belief), grip_offsets(config, belief.grip.mean)
    failed = law.log_failure(occluded[..., :-1, :, None], offset[..., None, :, :])
    return Setting(
        occluded,
        *label_in_each(config, belief.seen, occluded),
        failed=failed[..., 0, :, :],
        missing=library_of(failed).exp(failed),
        attempt_s=law.expected_s(occluded[..., 0, :, None], offset),
    )


class Chances(NamedTuple):
    """How an attempt now may go, and what is seen then: what a future is drawn by."""

    is_dirty: Float[Array, "*B N"]
    occluded: Float[Array, "*B M N"]
    """As `occlusions_of_each` has it."""
    label: tuple[Float[Array, "*B M N"], Float[Array, "*B M N"]]
    """As `label_in_each` has it."""
    failed: Float[Array, "*B N G"]
    """Log P(an attempt fails) now at each node of the grip offset."""
    probability: Float[Array, "*B N"]
    """P(an attempt succeeds) now."""


class Outlook(NamedTuple):
    """What may follow one attempt at each object of a table: what Q_1, Q° and V° are made of."""

    chances: Chances
    worth: Float[Array, "*B N"]
    """Of an attempt to WASH, the penalty that it avoids included."""
    attempt_s: Float[Array, "*B N"]
    """Expected duration of an attempt with its transport [s]."""
    left: Float[Array, "*B"]
    """Price of leaving all."""
    tries: Tries
    """As `summed_tries` has them."""


def outlook_of(config: WorldConfig, belief: Belief, setting: Setting | None = None) -> Outlook:
    """Look one attempt ahead, at each object; by how they stand, where that is known."""
    setting = setting_of(config, belief) if setting is None else setting
    is_dirty, weights = expit(belief.log_odds), softmax(belief.grip.log_weights)
    label = setting.if_dirty, setting.if_clean
    by_way = _ONE - (weights[..., None, :, :] * setting.missing).sum(axis=-1)
    probability = by_way[..., 0, :]
    tries = tries_after_label(
        config,
        is_dirty[..., None, None, :],
        label_of_tries(is_dirty, *label),
        probabilities_of_tries(by_way, *once_more(weights, _ONE - setting.missing[..., 0, :, :])[1:]),
    )
    return Outlook(
        chances=Chances(is_dirty, setting.occluded, label, setting.failed, probability),
        worth=wash_worth(config, is_dirty, probability, counts_penalty=True),
        attempt_s=config.transport_s + (weights * setting.attempt_s).sum(axis=-1),
        left=_all_left(config, is_dirty, belief.is_on_table),
        tries=summed_tries(tries, belief.is_on_table),
    )


def once_more(
    weights: Float[Array, "*S G"], held: Float[Array, "*S G"], then: Float[Array, "*S G"] | None = None
) -> tuple[Float[Array, "*S"], Float[Array, "*S"], Float[Array, "*S"]]:
    """P(an attempt succeeds), and P(the next one does) after a success and after a failure.

    `held` and `then` are P(this, and the next attempt succeeds) at each node of the grip offset; one where both are
    made alike.
    """
    xp = library_of(weights)
    this = weights * held
    probability, both = this.sum(axis=-1), (this * (held if then is None else then)).sum(axis=-1)
    next_one = probability if then is None else (weights * then).sum(axis=-1)
    if_missed = (next_one - both) / xp.maximum(_ONE - probability, _TINY)
    return probability, both / xp.maximum(probability, _TINY), if_missed


def _all_left(
    config: WorldConfig, is_dirty: Float[Array, "*B N"], is_on_table: Bool[Array, "*B N"]
) -> Float[Array, "*B"]:
    """Expected price of the dirty objects on the table."""
    xp = library_of(is_dirty)
    return config.reward_dirty_left * xp.where(is_on_table, is_dirty, _ZERO).sum(axis=-1)


def one_step_q(config: WorldConfig, belief: Belief) -> Float[Array, "*B A"]:
    """Q_1 of every action, in closed form; −∞ where an action is impossible."""
    return rule_and_control(config, belief, outlook_of(config, belief))[0]


def rule_and_control(
    config: WorldConfig, belief: Belief, outlook: Outlook
) -> tuple[Float[Array, "*B A"], Float[Array, "*B A"]]:
    """Q_1 and Q°; with one step to go, both are Q_1, which is exact there."""
    xp, steps = library_of(belief.hides), belief.steps_to_go - 1
    probability, left, gain = outlook.chances.probability, outlook.left, outlook.tries.gain
    rule = left_or_tried(_ZERO, outlook.tries, steps[..., None, None])
    control = gain * (steps > 0).astype(np.float32)[..., None, None]
    gains = xp.concatenate([rule[None], control[None]])
    after_miss = (_ONE - probability) * gains[..., 0, :] + left[..., None]
    wash = outlook.worth + probability * gains[..., 1, :] + after_miss
    look = config.reward_lift_per_s * outlook.attempt_s
    lift = look + probability * gains[..., 2, :] + after_miss
    values = ActionSpace(probability.shape[-1]).join(
        xp.concatenate([left[None]] * 2), {Verb.WASH: wash, Verb.LIFT: lift}
    )
    values = xp.where(possible_actions(belief), values, _NEVER)
    return values[0], values[1]


def control_value(belief: Belief, outlook: Outlook) -> Float[Array, "*B"]:
    """V°: every object is left where it stands, or tried once if that is worth more, however few steps remain."""
    xp = library_of(outlook.worth)
    return outlook.left + xp.where(belief.is_on_table, xp.maximum(outlook.worth, _ZERO), _ZERO).sum(axis=-1)


def leaf_value(config: WorldConfig, belief: Belief) -> Float[Array, "*B"]:
    """V_0: every object is left where it stands, or tried once if that is worth more."""
    xp, is_dirty = library_of(belief.hides), expit(belief.log_odds)
    occluded = occlusion_without(belief, xp.zeros_like(belief.is_on_table))
    probability = grasp_probability(config, occluded, belief.grip)
    worth = wash_worth(config, is_dirty, probability, counts_penalty=True)
    tries = Tries(xp.maximum(worth, _ZERO), (worth > _ZERO).astype(np.float32)).among(belief.is_on_table)
    return left_or_tried(_all_left(config, is_dirty, belief.is_on_table), tries, belief.steps_to_go)
