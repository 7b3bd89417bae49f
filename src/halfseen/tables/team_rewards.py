"""What eq. 3 runs on where a team was paid: less noise, and measured from leaving the table as it is.

*What is left.* What is left dirty is paid when a path ends, however long before it was given up: that a robot parks
costs nothing then. So rewards are shaped [NgHaradaRussell1999]_,

    R_t + β·(Σ p' − Σ p),    p = P(DIRTY) in S_t, p' in S_{t+1}, over what stands on the table, β the price of one left,

with Σ p' = 0 after a path's own end, where what was left has been paid for. Every Q is then lower by β·Σ p, whatever
the action: what is chosen stays, and 0 is to leave the table as it is. That is what the horizon forces upon a path,
too, so Q̂_0 ≡ 0.

*Less noise.* Which of the objects that left the table were dirty is a coin that no state shows
(`tables.variance_reduction`). Where none left, the reward is certain, and its regression on

    1 for each WASH that failed, the seconds of each LIFT, those of the stage

tells the prices of these. What is paid beside them where objects left is replaced by its regression on their number
and their Σ p; and where a FINISH ended a path, by its regression on the Σ p that it left, whose coefficient is β (0
where none did). A path that the horizon or a clear table ended keeps its last reward, for no state after it was seen.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import expit
from halfseen.learning.task import RewardedStages
from halfseen.tables.variance_reduction import coefficients_of, no_rows, with_rows
from halfseen.world.actions import Verb
from halfseen.world.others import is_decider
from halfseen.world.state import TableState

NUM_OUTCOMES = 6
_CERTAIN, _WASHED, _LEFT = slice(0, 3), slice(3, 5), slice(5, 6)
"""Which outcomes tell rewards that are certain, what objects that left pay, and what is left costs."""


class Pays(NamedTuple):
    """Coefficients of the three regressions."""

    certain: tuple[float, ...]
    washed: tuple[float, ...]
    left: tuple[float, ...]


def outcomes_of(
    states: TableState,
    verb: Int[np.ndarray, "n T"],
    target: Int[np.ndarray, "n T"],
    duration_s: Float[np.ndarray, "n T"],
) -> Float[np.ndarray, "n T 6"]:
    """What ended in each stage: failed WASHes, seconds of LIFTs, its own; objects that left, their Σ p; Σ p before.

    Parameters
    ----------
    states
        S_t; what is no state holds no object.
    verb, target
        What was begun.
    duration_s
        Of each stage; 0 where it is not known [s].
    """
    robots, begins = states.robots, is_decider(states)
    assert robots is not None
    doing = np.where(begins, verb[..., None], np.where(robots.is_busy, robots.verb, -1))
    at = np.where(begins, target[..., None], robots.target)
    since_s = np.where(begins, 0.0, robots.since_s) + duration_s[..., None]
    has_ended = (doing > 0) & ~_next(robots.is_busy)
    if robots.is_out is not None:
        # What a robot was at when it dropped out was abandoned.
        has_ended &= ~_next(robots.is_out)
    is_there = states.is_on_table
    is_dirty = np.where(is_there, expit(states.log_odds.astype(np.float64)), 0.0)
    has_left = is_there & ~_next(is_there)
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


def _next(flags: Bool[np.ndarray, "n T *K"]) -> Bool[np.ndarray, "n T *K"]:
    return np.concatenate([flags[:, 1:], np.zeros_like(flags[:, :1])], axis=1)


def pays_of(parts: Iterable[RewardedStages]) -> Pays:
    """Regress rewards on what ended, weighted, in one pass.

    Parameters
    ----------
    parts
        A log, whole or in parts.
    """
    kept = [no_rows(NUM_OUTCOMES)] * 3
    for part in parts:
        outcome, uses = _outcome(part), (_is_certain(part), _is_washed(part), _is_left(part))
        kept = [
            with_rows(rows, outcome[use], part.reward[use], part.weight[use])
            for rows, use in zip(kept, uses, strict=True)
        ]
    where_certain, where_washed, where_left = kept
    certain = coefficients_of(where_certain[:, _CERTAIN], where_certain[:, -1])

    def beside_that(rows: Float[np.ndarray, "K Z"], columns: slice) -> tuple[float, ...]:
        return coefficients_of(rows[:, columns], rows[:, -1] - rows[:, _CERTAIN] @ np.array(certain))

    return Pays(certain, beside_that(where_washed, _WASHED), beside_that(where_left, _LEFT))


def _outcome(part: RewardedStages) -> Float[np.ndarray, "n T 6"]:
    assert part.encoded.outcome is not None, "TeamTask.encode tells what ended"
    return part.encoded.outcome[..., :NUM_OUTCOMES]


def control_variates_of(stages: RewardedStages) -> Float[np.ndarray, "n T Z"]:
    """What labels moved (`tables.variance_reduction.label_moves`), which follows the outcomes."""
    assert stages.encoded.outcome is not None, "TeamTask.encode tells what labels moved"
    return stages.encoded.outcome[..., NUM_OUTCOMES:]


def _is_certain(part: RewardedStages) -> Bool[np.ndarray, "n T"]:
    return (part.weight > 0) & ~part.is_last & (_outcome(part)[..., 3] == 0)


def _is_washed(part: RewardedStages) -> Bool[np.ndarray, "n T"]:
    return (part.weight > 0) & ~part.is_last & (_outcome(part)[..., 3] > 0)


def _is_left(part: RewardedStages) -> Bool[np.ndarray, "n T"]:
    """Stages in which the last robot parked."""
    return (part.weight > 0) & part.is_last & (part.encoded.action == 0)


def expected(stages: RewardedStages, pays: Pays) -> Float[np.ndarray, "n T"]:
    """Rewards, replaced by what is expected of them where that is less noisy.

    Parameters
    ----------
    stages
        What stages paid.
    pays
        As `pays_of` gives them.
    """
    outcome = _outcome(stages)
    certain = outcome[..., _CERTAIN] @ np.array(pays.certain)
    reward = np.where(_is_washed(stages), certain + outcome[..., _WASHED] @ np.array(pays.washed), stages.reward)
    return np.where(_is_left(stages), certain + outcome[..., _LEFT] @ np.array(pays.left), reward)


def shaped(stages: RewardedStages, pays: Pays, reward: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Measure rewards from leaving the table as it is.

    Parameters
    ----------
    stages, pays
        As `expected` takes them.
    reward
        What is measured.
    """
    left = _outcome(stages)[..., 5]
    after = np.where(stages.is_last, 0.0, np.pad(left[:, 1:], ((0, 0), (0, 1))))
    return np.where(stages.weight > 0, reward + pays.left[0] * (after - left), 0.0)
