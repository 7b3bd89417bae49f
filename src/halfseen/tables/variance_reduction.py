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

import numpy as np
from jaxtyping import Bool, Float

from halfseen.learners.q_learning.task import Encoded
from halfseen.tables.features import WASH_DIRTY, WASH_EASE
from halfseen.world.action_space import ActionSpace, Verb


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
    """Σ_j (p'_j − p_j)·m_j over what stays on the table, and the same of the target alone, for some multipliers m.

    They are 1 and ease, and ease where p is above ¼, ½ or ¾: the table has all five, the target 1, ease and the one
    above ½.

    Parameters
    ----------
    encoded
        A log of tables; what it tells of stages after which no state was seen means nothing.
    """
    space = _space(encoded)
    washed = encoded.features[:, :, space.of(Verb.WASH)]
    is_dirty, ease = washed[..., WASH_DIRTY].astype(np.float64), washed[..., WASH_EASE]
    is_there = encoded.is_possible[:, :, space.of(Verb.WASH)]
    moved = np.zeros_like(is_dirty)
    moved[:, :-1] = np.where(is_there[:, :-1] & is_there[:, 1:], np.diff(is_dirty, axis=1), 0.0)
    plain, within_reach = moved, moved * ease
    likely = [within_reach * (is_dirty > knot) for knot in (0.25, 0.5, 0.75)]
    of_table = [values.sum(axis=-1) for values in (plain, within_reach, *likely)]
    target = space.target(encoded.action)
    of_target = [
        np.where(encoded.action > 0, np.take_along_axis(values, target[..., None], axis=-1)[..., 0], 0.0)
        for values in (plain, within_reach, likely[1])
    ]
    return np.stack(of_table + of_target, axis=-1)


def expected_rewards(
    reward: Float[np.ndarray, "n T"],
    weight: Float[np.ndarray, "n T"],
    is_last: Bool[np.ndarray, "n T"],
    outcome: Float[np.ndarray, "n T Z"],
) -> Float[np.ndarray, "n T"]:
    """Replace each reward by its weighted regression on the stage's outcome, where there is one.

    Parameters
    ----------
    reward
        0 where not completed.
    weight
        δ_t / Ĝ(U_t⁻).
    is_last
        Completed stages after which a path had come to its own end; they keep their reward.
    outcome
        What the regression looks at, a constant first; zeros where the stage keeps its reward.

    Examples
    --------
    Two stages of the same kind share the mean of their rewards; the last one keeps its own.

    >>> outcome = np.array([[[1.0], [1.0], [1.0]]])
    >>> expected_rewards(np.array([[5.0, -10.0, 5.0]]), np.ones((1, 3)), np.array([[False, False, True]]), outcome)
    array([[-2.5, -2.5,  5. ]])
    """
    use = (weight > 0) & ~is_last & (outcome[..., 0] != 0)
    root = np.sqrt(weight[use])
    coefficients = np.linalg.lstsq(outcome[use] * root[:, None], reward[use] * root, rcond=None)[0]
    return np.where(use, outcome @ coefficients, reward)


def _space(encoded: Encoded) -> ActionSpace:
    return ActionSpace.of_size(encoded.is_possible.shape[-1])
