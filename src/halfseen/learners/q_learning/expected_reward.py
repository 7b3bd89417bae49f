"""What a WASH was worth on average, given what came of it: less noise in the targets of eq. 3, the same mean.

A WASH that succeeds pays for a dirty object and costs for a clean one, and which it was is a coin that no state shows.
In R_t + max_a' Q̂_{t+1}(S_{t+1}, a') that coin is most of the noise. The states before and after tell whether the object
left the table, and how dirty it looked; given these, the reward is replaced by its regression

    R̂_t = b_0 + b_1·left + b_2·left·p,    p = P(DIRTY) in S_t,

weighted as all else. By E[R_t + V(S_{t+1}) | S_t, A_t] = E[E(R_t | S_t, A_t, S_{t+1}) + V(S_{t+1}) | S_t, A_t] the
target keeps its mean where the regression holds, and with a calibrated p it does: dirty and clean each have one reward.
A stage that ended its path keeps its own reward, for no state after it was seen.
"""

import numpy as np
from jaxtyping import Bool, Float

from halfseen.learners.q_learning.encoding import Encoded
from halfseen.learners.q_learning.table_features import WASH_DIRTY, block_of_action
from halfseen.world.actions import Verb


def wash_outcomes(encoded: Encoded) -> Float[np.ndarray, "n T 3"]:
    """1, left, left·p of every WASH, and zeros for every other action; `left` means something where S_{t+1} was seen.

    Parameters
    ----------
    encoded
        A log of tables.
    """
    action = encoded.action
    verb = np.asarray(block_of_action((encoded.is_possible.shape[-1] - 1) // 2))[action]
    taken = np.take_along_axis(encoded.features, action[..., None, None], axis=2)[:, :, 0]
    after = np.take_along_axis(encoded.is_possible[:, 1:], action[:, :-1, None], axis=2)[..., 0]
    left = np.pad(~after, ((0, 0), (0, 1)))
    outcome = np.stack([np.ones_like(left), left, left * taken[..., WASH_DIRTY]], axis=-1)
    return np.where((verb == Verb.WASH)[..., None], outcome, 0.0)


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
