"""Which of two policies a log speaks for, where it contradicts the laws: fitted Q evaluation, and a lower bound.

Q of each policy is fitted by eq. 3 with its own action in place of the best one, in the linear class without laws, to
all trajectories and to all but each of some groups; the delete-a-group jackknife tells the standard error of the
difference of their values. Importance ratios of whole trajectories would say nothing here: each deviation from what was
logged divides by a probability of some 3 %.
"""

from dataclasses import replace

import numpy as np

from halfseen.learning.judging import judged
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float
from halfseen.tables.policy import table_probabilities
from halfseen.workers.threads import one_thread
from halfseen.world.policy import Policy
from halfseen.world.state import TableState

NUM_GROUPS = 8
LEVEL = 0.99
"""Of the one-sided bound."""
FEWEST = 20
"""Trajectories below which nothing is chosen by them."""


def gain_of(
    policy: Policy, over: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState
) -> tuple[float, float]:
    """By how much a policy is worth more than another, and the lower bound of it.

    Parameters
    ----------
    policy, over
        The policies.
    model
        Of eq. 3 in the linear class, fitted to the log but for Q.
    trajectories, states
        The log.
    """
    from scipy.special import stdtrit

    if trajectories.num_trajectories < FEWEST:
        return 0.0, -np.inf
    group = np.random.default_rng([model.random_state, 5]).permutation(trajectories.num_trajectories) % NUM_GROUPS
    value, other = (_values(each, model, trajectories, states, group) for each in (policy, over))
    gain = value - other
    without = np.array([gain[k][group != k].mean() for k in range(NUM_GROUPS)])
    error = np.sqrt((NUM_GROUPS - 1) / NUM_GROUPS * np.sum((without - without.mean()) ** 2))
    found = float(gain[-1].mean())
    return found, found - float(stdtrit(NUM_GROUPS - 1, LEVEL)) * float(error)


def _values(
    policy: Policy, model: QModel, trajectories: TrajectoryArrays, states: TableState, group: np.ndarray
) -> Float[np.ndarray, "G1 n"]:
    """V̂_1(S_1) of every trajectory, by Qs that were fitted without each group, and last to all."""
    log = model.transitions(trajectories)._replace(policy=table_probabilities(policy, states))
    regression = replace(model, pessimism=0.0).regression(*log.is_possible.shape[::2])
    found = []
    with one_thread():
        for k in range(NUM_GROUPS + 1):
            q = fit_q(log.counted((group != k).astype(np.float64)), regression)
            found.append(judged(q, log, regression.block_of_action, regression.stages, log.reward).value[:, 0])
    return np.stack(found)
