"""Rewards that eq. 3 runs on at a table: less noise, the same mean; and, of a team, measured from leaving it as it is.

What S_{t+1} tells takes randomness out of the targets.

*What a WASH pays.* One that succeeds pays for a dirty object and costs for a clean one, and which it was is a coin that
no state shows. The states before and after tell whether the object left the table, and how dirty it looked; given
these, the reward is replaced by its regression

    R̂_t = b_0 + b_1·left + b_2·left·p,    p = P(DIRTY) in S_t,

weighted as all else. As E[R_t + V(S_{t+1}) | S_t, A_t] = E[E(R_t | S_t, A_t, S_{t+1}) + V(S_{t+1}) | S_t, A_t], the
target keeps its mean where the regression holds. A stage that ended its trajectory keeps its own reward, for no state
after it was seen.

*What labels say.* The next labels move each p up or down, and its mean stays. So Σ_j (p'_j − p_j)·m_j has mean 0 given
(S_t, A_t), whatever multiplier m_j is taken from S_t. These are control variates of the recursion.

Both rest on p being a probability: of the objects at p, the share p is dirty. Where log-odds are too sure of
themselves, Q is learned without a bias from them by ``reduces_variance=False``.

**Of a team.**

*What is left.* What is left dirty is paid when a trajectory ends, however long before it was given up: that a robot
parks costs nothing then. So rewards are shaped [NgHaradaRussell1999]_,

    R_t + β·(Σ p' − Σ p),    p = P(DIRTY) in S_t, p' in S_{t+1}, over what stands on the table, β the price of one left,

with Σ p' = 0 after a trajectory's own end, where what was left has been paid for. Every Q is then lower by β·Σ p,
whatever the action: what is chosen stays, and 0 is to leave the table as it is. That is what the horizon forces upon a
trajectory, too, so Q̂_0 ≡ 0.

*Less noise.* Which of the objects that left the table were dirty is a coin that no state shows
(above). Where none left, the reward is certain, and its regression on

    1 for each WASH that failed, the seconds of each LIFT, those of the stage

tells the prices of these. What is paid beside them where objects left is replaced by its regression on their number
and their Σ p; and where a FINISH ended a trajectory, by its regression on the Σ p that it left, whose coefficient is β
(0 where none did). A trajectory that the horizon or a clear table ended keeps its last reward, for no state after it
was seen.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.learning.task import Encoded, RewardedStages
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.features import WASH_DIRTY, WASH_EASE
from halfseen.world.actions import ActionSpace, Verb, is_decider
from halfseen.world.state import TableState

FAILED, LIFTED_S, LASTED_S, NUM_LEFT, DIRT_LEFT, DIRT_BEFORE = range(6)
"""Columns of `outcomes_of`."""
NUM_OUTCOMES = 6
_CERTAIN, _WASHED, _LEFT = slice(FAILED, NUM_LEFT), slice(NUM_LEFT, DIRT_BEFORE), slice(DIRT_BEFORE, NUM_OUTCOMES)
"""Which outcomes tell rewards that are certain, what objects that left pay, and what is left costs."""


def wash_outcomes(encoded: Encoded) -> Float[np.ndarray, "n T 3"]:
    """1, left, left·p of every WASH, zeros for any other action; `left` means something where S_{t+1} was seen."""
    verb, action = _space(encoded).verbs[encoded.action], encoded.action[..., None]
    is_dirty = np.take_along_axis(encoded.features[..., WASH_DIRTY], action, axis=2)[..., 0]
    after = np.take_along_axis(encoded.is_possible[:, 1:], action[:, :-1], axis=2)[..., 0]
    left = np.pad(~after, ((0, 0), (0, 1)))
    outcome = np.stack([np.ones_like(left), left, left * is_dirty], axis=-1)
    return np.where((verb == Verb.WASH)[..., None], outcome, 0.0)


def wash_pay(parts: Iterable[RewardedStages]) -> tuple[float, ...]:
    """Regress the rewards of WASH on what became of it, weighted: b_0, b_1 and b_2."""
    kept = np.zeros((0, 4))
    for stages in parts:
        outcome = wash_outcomes(stages.encoded)
        kept = _with_rows(kept, outcome, stages, _is_reduced(stages, outcome))
    return _least_squares(kept[:, :-1], kept[:, -1])


def expected_rewards(stages: RewardedStages, pays: Sequence[float]) -> Float[np.ndarray, "n T"]:
    """Replace the reward of each WASH by what is expected of it; where its trajectory came to its own end it stays."""
    outcome = wash_outcomes(stages.encoded)
    return np.where(_is_reduced(stages, outcome), outcome @ np.array(pays), stages.reward)


def _is_reduced(stages: RewardedStages, outcome: Float[np.ndarray, "n T 3"]) -> Bool[np.ndarray, "n T"]:
    return (stages.weight > 0) & ~stages.is_last & (outcome[..., 0] != 0)


def _with_rows(
    kept: Float[np.ndarray, "K Z1"],
    outcome: Float[np.ndarray, "n T Z"],
    stages: RewardedStages,
    use: Bool[np.ndarray, "n T"],
) -> Float[np.ndarray, "K2 Z1"]:
    """Add rows (numbers, reward)·√w to a regression; few of those before are kept, with the same normal equations."""
    rows = np.column_stack([outcome[use], stages.reward[use]]) * np.sqrt(stages.weight[use])[:, None]
    return np.vstack([np.linalg.qr(kept, mode="r"), rows]) if len(kept) else rows


def _least_squares(numbers: Float[np.ndarray, "K Z"], reward: Float[np.ndarray, " K"]) -> tuple[float, ...]:
    """0 where there are no rows."""
    return tuple(np.linalg.lstsq(numbers, reward, rcond=None)[0].tolist())


def label_control_variates(encoded: Encoded) -> Float[np.ndarray, "n T 8"]:
    """Control variates of a log of one robot's tables (`label_moves`).

    What the log tells of stages after which no state was seen means nothing.
    """
    space = _space(encoded)
    washed = encoded.features[:, :, space.of(Verb.WASH)]
    is_dirty, ease = washed[..., WASH_DIRTY].astype(np.float64), washed[..., WASH_EASE]
    is_there = encoded.is_possible[:, :, space.of(Verb.WASH)]
    return label_moves(is_dirty, ease, is_there, space.target(encoded.action), encoded.action > 0)


def label_moves(
    is_dirty: Float[np.ndarray, "n T N"],
    ease: Float[np.ndarray, "n T N"],
    is_there: Bool[np.ndarray, "n T N"],
    target: Int[np.ndarray, "n T"],
    has_target: Bool[np.ndarray, "n T"],
) -> Float[np.ndarray, "n T 8"]:
    """Σ_j (p'_j − p_j)·m_j over what stays on the table, and the same of the target alone, for some multipliers m.

    They are 1 and ease, and ease where p is above ¼, ½ or ¾: the table has all five, the target 1, ease and the one
    above ½.

    Parameters
    ----------
    is_dirty
        p.
    ease
        Of a grasp.
    is_there
        Whether it stands on the table.
    target, has_target
        Of the action, if it has one.
    """
    plain = np.zeros_like(is_dirty)
    plain[:, :-1] = np.where(is_there[:, :-1] & is_there[:, 1:], np.diff(is_dirty, axis=1), 0.0)
    within_reach = plain * ease
    likely = [within_reach * (is_dirty > knot) for knot in (0.25, 0.5, 0.75)]
    of_table = [values.sum(axis=-1) for values in (plain, within_reach, *likely)]
    of_target = [
        np.where(has_target, np.take_along_axis(values, target[..., None], axis=-1)[..., 0], 0.0)
        for values in (plain, within_reach, likely[1])
    ]
    return np.stack(of_table + of_target, axis=-1)


def _space(encoded: Encoded) -> ActionSpace:
    return ActionSpace.of_size(encoded.is_possible.shape[-1])


def outcomes_of(
    states: TableState,
    verb: Int[np.ndarray, "n T"],
    target: Int[np.ndarray, "n T"],
    duration_s: Float[np.ndarray, "n T"],
) -> Float[np.ndarray, "n T 6"]:
    """What ended in each stage: failed WASHes, seconds of LIFTs, its own; objects that left, their Σ p; Σ p before.

    What is no state of the team holds no object; durations are 0 where they are not known [s].
    """
    robots, begins = states.robots, is_decider(states)
    assert robots is not None
    doing = np.where(begins, verb[..., None], np.where(robots.is_busy, robots.verb, -1))
    at = np.where(begins, target[..., None], robots.target)
    since_s = np.where(begins, 0.0, robots.since_s) + duration_s[..., None]
    has_ended = (doing > 0) & ~following(robots.is_busy)
    if robots.is_out is not None:
        # What a robot was at when it dropped out was abandoned.
        has_ended &= ~following(robots.is_out)
    is_there = states.is_on_table
    is_dirty = np.where(is_there, expit(states.log_odds.astype(np.float64)), 0.0)
    has_left = is_there & ~following(is_there)
    target_left = np.take_along_axis(has_left, at, axis=-1)
    columns = [
        (has_ended & (doing == Verb.WASH) & ~target_left).sum(axis=-1),
        np.where(has_ended & (doing == Verb.LIFT), since_s, 0.0).sum(axis=-1),
        duration_s,
        has_left.sum(axis=-1),
        (has_left * is_dirty).sum(axis=-1),
        is_dirty.sum(axis=-1),
    ]
    return np.stack(columns, axis=-1).astype(np.float64)


def following(flags: Bool[np.ndarray, "n T *K"]) -> Bool[np.ndarray, "n T *K"]:
    """What each stage is followed by; False after the last."""
    return np.concatenate([flags[:, 1:], np.zeros_like(flags[:, :1])], axis=1)


class Pays(NamedTuple):
    """Coefficients of a team's three regressions."""

    certain: tuple[float, ...]
    washed: tuple[float, ...]
    left: tuple[float, ...]


class _Uses(NamedTuple):
    """Stages whose reward is certain, those in which objects left, and those in which the last robot parked."""

    certain: Bool[np.ndarray, "n T"]
    washed: Bool[np.ndarray, "n T"]
    left: Bool[np.ndarray, "n T"]


def _as_arrays(stages: RewardedStages) -> tuple[Float[np.ndarray, "n T 6"], _Uses]:
    """What ended in the stages of a team, and what tells what."""
    assert stages.encoded.outcome is not None, "TeamTask.encode tells what ended"
    outcome = stages.encoded.outcome[..., :NUM_OUTCOMES]
    is_whole, has_left = stages.weight > 0, outcome[..., NUM_LEFT] > 0
    goes_on, parks = is_whole & ~stages.is_last, is_whole & stages.is_last & (stages.encoded.action == 0)
    return outcome, _Uses(goes_on & ~has_left, goes_on & has_left, parks)


def pays_of(parts: Iterable[RewardedStages]) -> Pays:
    """Regress rewards on what ended, weighted, in one pass."""
    kept = [np.zeros((0, NUM_OUTCOMES + 1))] * len(_Uses._fields)
    for part in parts:
        outcome, uses = _as_arrays(part)
        kept = [_with_rows(rows, outcome, part, use) for rows, use in zip(kept, uses, strict=True)]
    where_certain, where_washed, where_left = kept
    certain = _least_squares(where_certain[:, _CERTAIN], where_certain[:, -1])

    def beside_that(rows: Float[np.ndarray, "K Z"], columns: slice) -> tuple[float, ...]:
        return _least_squares(rows[:, columns], rows[:, -1] - rows[:, _CERTAIN] @ np.array(certain))

    return Pays(certain, beside_that(where_washed, _WASHED), beside_that(where_left, _LEFT))


def expected(stages: RewardedStages, pays: Pays) -> Float[np.ndarray, "n T"]:
    """Rewards of a team, replaced by what is expected of them where that is less noisy."""
    outcome, uses = _as_arrays(stages)
    certain = outcome[..., _CERTAIN] @ np.array(pays.certain)
    reward = np.where(uses.washed, certain + outcome[..., _WASHED] @ np.array(pays.washed), stages.reward)
    return np.where(uses.left, certain + outcome[..., _LEFT] @ np.array(pays.left), reward)


def shaped(stages: RewardedStages, pays: Pays, reward: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Measure rewards from leaving the table as it is."""
    left = _as_arrays(stages)[0][..., DIRT_BEFORE]
    after = np.where(stages.is_last, 0.0, np.pad(left[:, 1:], ((0, 0), (0, 1))))
    return np.where(stages.weight > 0, reward + pays.left[0] * (after - left), 0.0)
