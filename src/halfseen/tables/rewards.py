"""Rewards for eq. 3 at a table: less noise, the same mean; for a team, relative to leaving the table as it is.

Conditioning on S_{t+1} removes randomness from the targets.

*Reward of a WASH.* A successful WASH pays for a dirty object and costs for a clean one. Which it was is random given
the states. The states before and after show whether the object left the table and how dirty it looked. The reward is
replaced by its regression on these,

    R̂_t = b_0 + b_1·left + b_2·left·p,    p = P(DIRTY) in S_t,

with the usual weights. As E[R_t + V(S_{t+1}) | S_t, A_t] = E[E(R_t | S_t, A_t, S_{t+1}) + V(S_{t+1}) | S_t, A_t], the
target keeps its mean where the regression holds. A stage that ended its trajectory keeps its own reward, because no
state was observed after it.

*Labels.* The next labels move each p up or down, but not its mean. So Σ_j (p'_j − p_j)·m_j has mean 0 given
(S_t, A_t), for any multiplier m_j that depends on S_t. These sums are control variates of the recursion.

Both require calibrated p: a share p of the objects at p is dirty. Where log-odds are overconfident,
``reduces_variance=False`` avoids the bias that they would cause in Q.

**Teams.**

*Shaping.* Objects left dirty are paid for when a trajectory ends, however long before they were given up. So parking a
robot costs nothing at the time. Rewards are therefore shaped [NgHaradaRussell1999]_,

    R_t + β·(Σ p' − Σ p),    p = P(DIRTY) in S_t, p' in S_{t+1}, over objects on the table, β the price of one left,

with Σ p' = 0 after a trajectory's own end, where the objects left have been paid for. This lowers every Q by β·Σ p,
whatever the action. So the choice of action does not change, and Q = 0 means leaving the table as it is. The horizon
forces that outcome too, so Q̂_0 ≡ 0.

*Less noise.* Which of the objects that left the table were dirty is random given the states (see above). Where none
left, the reward is deterministic, and its regression on

    1 for each WASH that failed, the seconds of each LIFT, those of the stage

gives their prices. Where objects left, the remaining reward is replaced by its regression on their number and their
Σ p. Where a FINISH ended a trajectory, it is replaced by its regression on the Σ p of the objects left, whose
coefficient is β (0 if no trajectory ended so). A trajectory that ended by the horizon or a clear table keeps its last
reward, because no state was observed after it.
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
"""Outcomes that determine certain rewards, rewards of objects that left, and the price of objects left on the table."""


def wash_outcomes(encoded: Encoded) -> Float[np.ndarray, "n T 3"]:
    """1, left, left·p of every WASH, zeros for any other action; `left` is valid only where S_{t+1} was observed."""
    verb, action = _space(encoded).verbs[encoded.action], encoded.action[..., None]
    is_dirty = np.take_along_axis(encoded.features[..., WASH_DIRTY], action, axis=2)[..., 0]
    after = np.take_along_axis(encoded.is_possible[:, 1:], action[:, :-1], axis=2)[..., 0]
    left = np.pad(~after, ((0, 0), (0, 1)))
    outcome = np.stack([np.ones_like(left), left, left * is_dirty], axis=-1)
    return np.where((verb == Verb.WASH)[..., None], outcome, 0.0)


def wash_pay(parts: Iterable[RewardedStages]) -> tuple[float, ...]:
    """Regress the rewards of WASH on its outcome, weighted: b_0, b_1 and b_2."""
    kept = np.zeros((0, 4))
    for stages in parts:
        outcome = wash_outcomes(stages.encoded)
        kept = _with_rows(kept, outcome, stages, _is_reduced(stages, outcome))
    return _least_squares(kept[:, :-1], kept[:, -1])


def expected_rewards(stages: RewardedStages, pays: Sequence[float]) -> Float[np.ndarray, "n T"]:
    """Replace the reward of each WASH by its expectation, except where its trajectory came to its own end."""
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
    """Add rows (numbers, reward)·√w to a regression; earlier rows are reduced to few with the same normal equations."""
    rows = np.column_stack([outcome[use], stages.reward[use]]) * np.sqrt(stages.weight[use])[:, None]
    return np.vstack([np.linalg.qr(kept, mode="r"), rows]) if len(kept) else rows


def _least_squares(numbers: Float[np.ndarray, "K Z"], reward: Float[np.ndarray, " K"]) -> tuple[float, ...]:
    """Least-squares coefficients; 0 where there are no rows."""
    return tuple(np.linalg.lstsq(numbers, reward, rcond=None)[0].tolist())


def label_control_variates(encoded: Encoded) -> Float[np.ndarray, "n T 8"]:
    """Control variates of a log of one robot's tables (`label_moves`).

    Values are meaningless for stages after which no state was observed.
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
    """Σ_j (p'_j − p_j)·m_j over objects that stay on the table, and for the target alone, for some multipliers m.

    The multipliers are 1, ease, and ease where p is above ¼, ½ or ¾. The table uses all five; the target uses 1, ease
    and the one for ½.

    Parameters
    ----------
    is_dirty
        p.
    ease
        Ease of a grasp.
    is_there
        Whether the object is on the table.
    target, has_target
        Target of the action, and whether it has one.
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
    """Outcomes of each stage: failed WASHes, seconds of LIFTs, its own; objects that left, their Σ p; Σ p before.

    Padding states hold no object; unknown durations are 0 [s].
    """
    robots, begins = states.robots, is_decider(states)
    assert robots is not None
    doing = np.where(begins, verb[..., None], np.where(robots.is_busy, robots.verb, -1))
    at = np.where(begins, target[..., None], robots.target)
    since_s = np.where(begins, 0.0, robots.since_s) + duration_s[..., None]
    has_ended = (doing > 0) & ~following(robots.is_busy)
    if robots.is_out is not None:
        # An action under way when its robot dropped out was abandoned.
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
    """Flags of the following stage; False after the last."""
    return np.concatenate([flags[:, 1:], np.zeros_like(flags[:, :1])], axis=1)


class Pays(NamedTuple):
    """Coefficients of a team's three regressions."""

    certain: tuple[float, ...]
    washed: tuple[float, ...]
    left: tuple[float, ...]


class _Uses(NamedTuple):
    """Stages with a certain reward, those in which objects left, and those in which the last robot parked."""

    certain: Bool[np.ndarray, "n T"]
    washed: Bool[np.ndarray, "n T"]
    left: Bool[np.ndarray, "n T"]


def _as_arrays(stages: RewardedStages) -> tuple[Float[np.ndarray, "n T 6"], _Uses]:
    """Outcomes of the stages of a team, and the regression that each stage is used in."""
    assert stages.encoded.outcome is not None, "TeamTask.encode sets the outcomes"
    outcome = stages.encoded.outcome[..., :NUM_OUTCOMES]
    is_whole, has_left = stages.weight > 0, outcome[..., NUM_LEFT] > 0
    goes_on, parks = is_whole & ~stages.is_last, is_whole & stages.is_last & (stages.encoded.action == 0)
    return outcome, _Uses(goes_on & ~has_left, goes_on & has_left, parks)


def pays_of(parts: Iterable[RewardedStages]) -> Pays:
    """Regress rewards on outcomes, weighted, in one pass."""
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
    """Rewards of a team, replaced by their expectations where these are less noisy."""
    outcome, uses = _as_arrays(stages)
    certain = outcome[..., _CERTAIN] @ np.array(pays.certain)
    reward = np.where(uses.washed, certain + outcome[..., _WASHED] @ np.array(pays.washed), stages.reward)
    return np.where(uses.left, certain + outcome[..., _LEFT] @ np.array(pays.left), reward)


def shaped(stages: RewardedStages, pays: Pays, reward: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Shape rewards: they become relative to leaving the table as it is."""
    left = _as_arrays(stages)[0][..., DIRT_BEFORE]
    after = np.where(stages.is_last, 0.0, np.pad(left[:, 1:], ((0, 0), (0, 1))))
    return np.where(stages.weight > 0, reward + pays.left[0] * (after - left), 0.0)
