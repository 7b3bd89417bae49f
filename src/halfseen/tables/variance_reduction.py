"""Less noise in the targets of eq. 3 on a table, the same mean: what S_{t+1} tells takes randomness out of them.

*What a WASH pays.* One that succeeds pays for a dirty object and costs for a clean one, and which it was is a coin that
no state shows. The states before and after tell whether the object left the table, and how dirty it looked; given
these, the reward is replaced by its regression

    R̂_t = b_0 + b_1·left + b_2·left·p,    p = P(DIRTY) in S_t,

weighted as all else. As E[R_t + V(S_{t+1}) | S_t, A_t] = E[E(R_t | S_t, A_t, S_{t+1}) + V(S_{t+1}) | S_t, A_t], the
target keeps its mean where the regression holds. A stage that ended its path keeps its own reward, for no state after
it was seen.

*What labels say.* The next labels move each p up or down, and its mean stays. So Σ_j (p'_j − p_j)·m_j has mean 0 given
(S_t, A_t), whatever multiplier m_j is taken from S_t. These are control variates of the recursion.

Both rest on p being a probability: of the objects at p, the share p is dirty. Where log-odds are too sure of
themselves, Q is learned without a bias from them by ``reduces_variance=False``.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.learning.task import Encoded, RewardedStages
from halfseen.tables.features import WASH_DIRTY, WASH_EASE
from halfseen.world.actions import ActionSpace, Verb

NUM_OUTCOMES = 3


def wash_outcomes(encoded: Encoded) -> Float[np.ndarray, "n T 3"]:
    """1, left, left·p of every WASH, and zeros for every other action; `left` means something where S_{t+1} was seen.

    Parameters
    ----------
    encoded
        A log of tables.
    """
    verb, action = _space(encoded).verbs[encoded.action], encoded.action[..., None]
    is_dirty = np.take_along_axis(encoded.features[..., WASH_DIRTY], action, axis=2)[..., 0]
    after = np.take_along_axis(encoded.is_possible[:, 1:], action[:, :-1], axis=2)[..., 0]
    left = np.pad(~after, ((0, 0), (0, 1)))
    outcome = np.stack([np.ones_like(left), left, left * is_dirty], axis=-1)
    return np.where((verb == Verb.WASH)[..., None], outcome, 0.0)


def label_control_variates(encoded: Encoded) -> Float[np.ndarray, "n T 8"]:
    """Control variates of a log of tables (`label_moves`).

    Parameters
    ----------
    encoded
        A log of tables; what it tells of stages after which no state was seen means nothing.
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


def wash_pay(parts: Iterable[RewardedStages]) -> tuple[float, ...]:
    """Regress the rewards of WASH on what became of it, weighted: b_0, b_1 and b_2.

    Parameters
    ----------
    parts
        A log, whole or in parts.
    """
    kept = no_rows(NUM_OUTCOMES)
    for stages in parts:
        outcome = wash_outcomes(stages.encoded)
        use = _is_reduced(stages, outcome)
        kept = with_rows(kept, outcome[use], stages.reward[use], stages.weight[use])
    return coefficients_of(kept[:, :-1], kept[:, -1])


def no_rows(num_columns: int) -> Float[np.ndarray, "0 Z1"]:
    """Begin a regression whose rows come in parts."""
    return np.zeros((0, num_columns + 1))


def with_rows(
    kept: Float[np.ndarray, "K Z1"],
    numbers: Float[np.ndarray, "R Z"],
    told: Float[np.ndarray, " R"],
    weight: Float[np.ndarray, " R"],
) -> Float[np.ndarray, "K2 Z1"]:
    """Add rows to a regression, and keep few of those before, with the same normal equations.

    Parameters
    ----------
    kept
        Of the parts before: numbers and, last, what they foretell, weighted.
    numbers, told, weight
        Of the rows that are added.
    """
    rows = np.column_stack([numbers, told]) * np.sqrt(weight)[:, None]
    return np.vstack([np.linalg.qr(kept, mode="r"), rows]) if len(kept) else rows


def coefficients_of(numbers: Float[np.ndarray, "K Z"], told: Float[np.ndarray, " K"]) -> tuple[float, ...]:
    """Least squares; 0 where there are no rows."""
    return tuple(np.linalg.lstsq(numbers, told, rcond=None)[0].tolist())


def expected_rewards(stages: RewardedStages, pays: Sequence[float]) -> Float[np.ndarray, "n T"]:
    """Replace the reward of each WASH by what is expected of it; where its path came to its own end it stays.

    Parameters
    ----------
    stages
        What stages paid.
    pays
        The coefficients of `wash_pay`.
    """
    outcome = wash_outcomes(stages.encoded)
    return np.where(_is_reduced(stages, outcome), outcome @ np.array(pays), stages.reward)


def _is_reduced(stages: RewardedStages, outcome: Float[np.ndarray, "n T 3"]) -> Bool[np.ndarray, "n T"]:
    return (stages.weight > 0) & ~stages.is_last & (outcome[..., 0] != 0)


def _space(encoded: Encoded) -> ActionSpace:
    return ActionSpace.of_size(encoded.is_possible.shape[-1])
