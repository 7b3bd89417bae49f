import numpy as np
import pytest
from naive_q_learning import naive_backward
from random_logs import Blocks, random_log

from halfseen.errors import ArgumentError
from halfseen.learning.judging import judged
from halfseen.learning.recursion import Regression, fit_q
from halfseen.learning.rows import Transitions, q_values

BLOCKS = (0, 1, 1, 2)
FLAT, ENDING = Blocks(BLOCKS), Blocks(BLOCKS, end_action=0)
MODES = [("separate", FLAT), ("pooled", FLAT), ("pooled", ENDING)]


def fit(log, task, stages, reg=0.1, num_folds=1):
    log = log._replace(fold=log.fold % num_folds)
    end_action, regs = task.end_action if stages == "pooled" else None, np.atleast_1d(np.asarray(reg, dtype=float))
    return fit_q(log, Regression(np.array(task.blocks), task.num_blocks, regs, num_folds, stages, end_action))


def of_trajectories(change, *logs):
    """Change every array of logs, each of which has a row a trajectory."""
    leaves = zip(*logs, strict=True)
    return Transitions(*(None if each[0] is None else change(*each) for each in leaves))


def log_for(task, seed=0, **options):
    return random_log(seed, blocks=BLOCKS, ends_with=task.end_action, **options)


@pytest.mark.parametrize("num_features", [3, 0])
@pytest.mark.parametrize("blocks", [(2, 0, 1), (1, 0, 1, 0), (0, 0)])
def test_q_is_that_of_the_block_of_each_action(blocks, num_features):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(5, 2, len(blocks), num_features))
    coefficients = rng.normal(size=(max(blocks) + 1, 1 + num_features))
    q = np.asarray(q_values(coefficients, features, np.array(blocks)))
    assert q.shape == features.shape[:-1]
    for at in np.ndindex(q.shape):
        own = coefficients[blocks[at[-1]]]
        assert q[at] == pytest.approx(own[0] + features[at] @ own[1:], abs=1e-5)


@pytest.mark.parametrize("is_cut", [True, False], ids=["weighted", "ordinary Q-learning"])
@pytest.mark.parametrize("reg", [0.0, 0.1])
@pytest.mark.parametrize(("stages", "task"), MODES)
def test_equation_three_by_loops(stages, task, reg, is_cut):
    log = log_for(task, is_cut=is_cut)
    assert is_cut or set(np.unique(log.weight)) == {0.0, 1.0}
    expected = naive_backward(log, BLOCKS, 3, reg, stages, task.end_action)
    fitted = fit(log, task, stages, reg)
    assert fitted.coefficients == pytest.approx(expected, abs=1e-8)
    assert (fitted.reg == reg).all()
    assert np.ptp(expected, axis=0).max() > 0.1, "the stages differ, or the test shows nothing"


@pytest.mark.parametrize(("stages", "task"), MODES)
def test_cross_validation_by_loops(stages, task):
    regs = np.array([1e-3, 0.03, 0.3, 3.0])
    log = log_for(task, seed=2)
    expected = naive_backward(log, BLOCKS, 3, regs, stages, task.end_action, num_folds=4)
    fitted = fit(log, task, stages, regs, num_folds=4)
    assert fitted.coefficients == pytest.approx(expected, abs=1e-8)
    assert len(np.unique(fitted.reg)) > 1


@pytest.mark.parametrize(("stages", "task"), MODES)
def test_what_does_not_count_may_hold_anything(stages, task):
    log = log_for(task)
    is_seen = (np.abs(log.features).sum(axis=(2, 3)) > 0)[..., None, None]
    is_completed = log.weight > 0
    poisoned = log._replace(
        features=np.where(is_seen, log.features, 1e6),
        is_possible=log.is_possible & is_seen[..., 0],
        reward=np.where(is_completed, log.reward, 1e6),
        action=np.where(is_completed, log.action, 3),
    )
    clean = fit(log, task, stages).coefficients
    assert fit(poisoned, task, stages).coefficients == pytest.approx(clean, abs=1e-9)
    unused = of_trajectories(lambda leaf: np.concatenate([leaf, leaf[:5]]), poisoned)
    unused.weight[-5:] = 0.0
    unused.reward[-5:] = -1e6
    at_zero = fit(log, task, stages, 0.0).coefficients
    assert fit(unused, task, stages, 0.0).coefficients == pytest.approx(at_zero, abs=1e-8)


@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_what_a_policy_never_does_may_hold_anything(stages):
    log = log_for(FLAT)
    seen = log.is_possible & (np.abs(log.features).sum(axis=-1) > 0)
    policy = seen / np.maximum(seen.sum(axis=-1, keepdims=True), 1)
    poison = np.where((policy > 0) | (np.arange(4) == log.action[..., None]), 0.0, np.nan)[..., None]
    clean, poisoned = log._replace(policy=policy), log._replace(policy=policy, features=log.features + poison)
    assert np.isnan(poisoned.features).any()
    found, again = (
        judged(fit(one, FLAT, stages, 1.0), one, np.array(BLOCKS), stages, one.reward) for one in (clean, poisoned)
    )
    np.testing.assert_array_equal(again.value, found.value)
    np.testing.assert_array_equal(again.target, found.target)
    assert np.isfinite(again.value).all()


@pytest.mark.parametrize(("stages", "task"), MODES)
def test_q_of_a_policy_that_draws_is_that_of_a_loop(stages, task):
    log = log_for(task)
    seen = log.is_possible & (np.abs(log.features).sum(axis=-1) > 0)
    policy = np.where(seen, np.random.default_rng(6).uniform(size=seen.shape), 0.0)
    policy = policy / np.maximum(policy.sum(axis=-1, keepdims=True), 1e-9)
    expected = naive_backward(log, BLOCKS, 3, 0.1, stages, task.end_action, policy=policy)
    assert fit(log._replace(policy=policy), task, stages).coefficients == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(("stages", "task"), MODES)
def test_the_order_of_trajectories_is_irrelevant(stages, task):
    log = log_for(task)
    order = np.random.default_rng(5).permutation(len(log.action))
    shuffled = of_trajectories(lambda leaf: leaf[order], log)
    clean = fit(log, task, stages).coefficients
    assert fit(shuffled, task, stages).coefficients == pytest.approx(clean, abs=1e-10)


def test_a_trajectory_in_no_fold_is_refused():
    with pytest.raises(ArgumentError, match="fold 3 of 2: folds are 0 to 1"):
        fit_q(log_for(FLAT), Regression(np.array(BLOCKS), 3, np.ones(1), 2, "separate"))


@pytest.mark.parametrize(
    "changed",
    [
        lambda log: log._replace(weight=(log.weight > 0).astype(float)),
        lambda log: log._replace(is_possible=np.ones_like(log.is_possible)),
    ],
    ids=["weights", "what is possible"],
)
def test_it_matters(changed):
    log = log_for(FLAT)
    before, after = (fit(each, FLAT, "separate").coefficients for each in (log, changed(log)))
    assert np.abs(before - after).max() > 0.01


@pytest.mark.parametrize(("stages", "task"), MODES)
def test_what_a_control_variate_adds_to_a_reward_changes_nothing(stages, task):
    log = log_for(task, num_trajectories=150)
    variates = np.random.default_rng(7).normal(size=(*log.action.shape, 2))
    seen = np.where(log.is_last[..., None], 0.0, variates)
    noisy = log._replace(reward=log.reward + seen @ np.array([3.0, -5.0]))
    calm, quiet = (fit(one._replace(control_variates=variates), task, stages, 0.0) for one in (log, noisy))
    if stages == "separate":
        assert quiet.coefficients[-1] == pytest.approx(calm.coefficients[-1], abs=1e-8)
    loud, plain = fit(noisy, task, stages, 0.0), fit(log, task, stages, 0.0)
    assert loud.coefficients.shape == quiet.coefficients.shape
    error = [np.abs(one.coefficients - plain.coefficients).mean() for one in (quiet, loud)]
    assert error[0] < 0.5 * error[1]
