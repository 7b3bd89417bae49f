"""How much better separate stages predict what is held out, beside least squares in loops."""

import numpy as np
from trials import log_of

from halfseen.learning import CensoredQLearner
from halfseen.learning.judging import NUM_FOLDS, gains_of_separate


def fitted(x, action, target):
    """Least squares of each action."""
    return {a: np.polynomial.polynomial.polyfit(x[action == a], target[action == a], 1) for a in "AB"}


def q_of(fit, x, action):
    """Q of each row, for an action or for the one of each row."""
    return np.array([fit[a] @ [1.0, each] for a, each in zip(np.broadcast_to(action, x.shape), x, strict=True)])


def test_gains_of_separate_stages_are_those_of_loops():
    rng = np.random.default_rng(0)
    x, action, reward = rng.normal(size=(60, 2)), rng.choice(["A", "B"], (60, 2)), rng.normal(size=(60, 2))
    log = log_of(action.ravel(), reward.ravel(), num_stages=2, x=x.ravel())
    settings = {"q_function": "linear", "censoring": "none", "stages": "pooled", "pessimism": 0.0, "reg": 0.0}
    found = gains_of_separate(*CensoredQLearner(2, ["A", "B"], ["x"], **settings).compose(log).fitted(log))
    fold, expected = np.random.default_rng([0, 2]).permutation(60) % NUM_FOLDS, np.zeros(60)
    for k in range(NUM_FOLDS):
        some = fold != k
        last = fitted(x[some].ravel(), action[some].ravel(), reward[some].ravel())
        value = np.maximum(q_of(last, x[:, 1], "A"), q_of(last, x[:, 1], "B"))
        target = np.column_stack([reward[:, 0] + value, reward[:, 1]])
        pooled = fitted(x[some, 0], action[some, 0], target[some, 0]), last
        for t in range(2):
            separate = fitted(x[some, t], action[some, t], target[some, t])
            errors = [(q_of(fit, x[:, t], action[:, t]) - target[:, t]) ** 2 for fit in (pooled[t], separate)]
            expected[~some] += (errors[0] - errors[1])[~some]
    np.testing.assert_allclose(found, expected, atol=1e-8)
