"""How much better other stages than pooled ones predict what is held out, beside least squares in loops."""

import numpy as np
from trials import log_of

from halfseen.learning import CensoredQLearner
from halfseen.learning.judging import NUM_FOLDS, gains_over_pooled


def design(x, late):
    return np.column_stack([np.ones_like(x), x, late, late * x] if late is not None else [np.ones_like(x), x])


def fitted(x, action, target, late=None):
    """Least squares of each action; with a trend, if it is said which rows are late (1) or early (−1)."""
    rows = design(x, late)
    return {a: np.linalg.lstsq(rows[action == a], target[action == a], rcond=None)[0] for a in "AB"}


def q_of(fit, x, action, late=None):
    """Q of each row, for an action or for the one of each row."""
    each = np.array([fit[a] for a in np.broadcast_to(action, x.shape)])
    return (design(x, late) * each).sum(axis=1)


def test_gains_over_pooled_stages_are_those_of_loops():
    rng = np.random.default_rng(0)
    x, action, reward = rng.normal(size=(60, 2)), rng.choice(["A", "B"], (60, 2)), rng.normal(size=(60, 2))
    log = log_of(action.ravel(), reward.ravel(), num_stages=2, x=x.ravel())
    settings = {"q_function": "linear", "censoring": "none", "stages": "pooled", "pessimism": 0.0, "reg": 0.0}
    found = gains_over_pooled(*CensoredQLearner(2, ["A", "B"], ["x"], **settings).compose(log).fitted(log))
    fold, expected = np.random.default_rng([0, 2]).permutation(60) % NUM_FOLDS, np.zeros((2, 60))
    late = np.broadcast_to([-1.0, 1.0], (60, 2))
    for k in range(NUM_FOLDS):
        some = fold != k
        last = fitted(x[some].ravel(), action[some].ravel(), reward[some].ravel())
        value = np.maximum(q_of(last, x[:, 1], "A"), q_of(last, x[:, 1], "B"))
        target = np.column_stack([reward[:, 0] + value, reward[:, 1]])
        pooled = fitted(x[some, 0], action[some, 0], target[some, 0]), last
        # With two steps to go there are rows of the first stage alone, so a trend changes nothing.
        trend = fitted(x[some].ravel(), action[some].ravel(), reward[some].ravel(), late[some].ravel())
        for t in range(2):
            separate = fitted(x[some, t], action[some, t], target[some, t])
            q = [q_of(fit, x[:, t], action[:, t]) for fit in (pooled[t], separate)]
            q.insert(1, q[0] if t == 0 else q_of(trend, x[:, t], action[:, t], late[:, t]))
            errors = [(each - target[:, t]) ** 2 for each in q]
            expected[:, ~some] += np.array([errors[0] - errors[1], errors[0] - errors[2]])[:, ~some]
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_the_action_of_a_cut_stage_has_no_say_in_how_stages_are_pooled():
    rng = np.random.default_rng(1)
    action, reward, x = rng.choice(["A", "B"], 120), rng.normal(size=120), rng.normal(size=120)
    is_seen = (np.arange(120) % 2 == 0) | (rng.random(120) < 0.6)
    other = np.where(is_seen, action, np.where(action == "A", "B", "A"))
    found = []
    for each in (action, other):
        log = log_of(each, reward, num_stages=2, x=x, is_seen=is_seen)
        found.append(gains_over_pooled(*CensoredQLearner(2, ["A", "B"], ["x"], pessimism=0.0).compose(log).fitted(log)))
    np.testing.assert_allclose(*found, atol=1e-9)
    assert np.ptp(found[0]) > 0.1


def test_a_half_life_that_predicts_worse_than_none_is_not_chosen(monkeypatch):
    """The longest one is worse, though not clearly, as its gains are uncertain."""
    gains = np.stack([np.tile([-101.0, 99.0], 50), np.tile([0.0, 1.0], 50), np.zeros(100), np.zeros(100)])
    monkeypatch.setattr("halfseen.learning.judging._gains_of_recency", lambda model, trajectories: gains)
    log = log_of(np.resize(["A", "B"], 100), np.arange(100.0), x=np.arange(100.0) % 7)
    learner = CensoredQLearner(1, ["A", "B"], ["x"], half_life="auto").fit(log)
    assert learner.model_.half_life == 25.0
    assert "better (0.5 ± 0.05 squared error a trajectory)" in learner.chosen_[-1]
