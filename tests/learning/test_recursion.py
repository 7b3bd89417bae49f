import numpy as np
import pytest
from naive_q_learning import naive_backward
from random_logs import Blocks, random_log
from sklearn.linear_model import Ridge

from halfseen.errors import ArgumentError
from halfseen.learning.judging import judged
from halfseen.learning.recursion import Regression, fit_q
from halfseen.learning.ridge import ridge_of, solve, standard_errors, with_prior
from halfseen.learning.rows import Transitions

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


def test_a_trajectory_in_no_fold_is_refused():
    with pytest.raises(ArgumentError, match="fold 3 of 2: folds are 0 to 1"):
        fit_q(log_for(FLAT), Regression(np.array(BLOCKS), 3, np.ones(1), 2, "separate"))


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


NUM_TRAJECTORIES, NUM_FOLDS = 50, 5
REGS = np.logspace(-3, 2, 11)


def sums(features, block, weight, fold, target, num_blocks=3, num_folds=1):
    """Σ w x xᵀ and Σ w x y by fold and block, by a loop."""
    size = features.shape[1] + 1
    gram, cross = np.zeros((num_folds, num_blocks, size, size)), np.zeros((num_folds, num_blocks, size))
    for x, k, w, v, y in zip(np.insert(features, 0, 1.0, axis=1), block, weight, fold, target, strict=True):
        gram[v, k] += w * np.outer(x, x)
        cross[v, k] += w * x * y
    return gram, cross


@pytest.fixture
def rows():
    rng = np.random.default_rng(0)
    num_rows = 150
    trajectory = rng.integers(0, NUM_TRAJECTORIES, num_rows)
    return {
        "features": rng.normal(size=(num_rows, 4)) * [1.0, 10.0, 0.01, 3.0] + [0.0, 50.0, 1.0, -2.0],
        "block": rng.integers(0, 3, num_rows),
        "weight": np.where(rng.random(num_rows) < 0.2, 0.0, rng.uniform(1.0, 4.0, num_rows)),
        "fold": (trajectory % NUM_FOLDS),
    }


def target_of(rows):
    rng = np.random.default_rng(1)
    return rows["features"] @ [0.5, 0.1, 30.0, 0.0] * (1 + rows["block"]) + rng.normal(size=len(rows["block"])) * 3.0


def fitted(rows, target, regs, num_folds=1):
    given = dict(rows) if num_folds > 1 else {**rows, "fold": np.zeros_like(rows["fold"])}
    gram, cross = sums(**given, target=target, num_folds=num_folds)
    return solve(ridge_of(gram, np.asarray(regs, dtype=float), NUM_TRAJECTORIES), cross)


@pytest.mark.parametrize("reg", [1e-3, 0.1, 10.0])
def test_it_is_scikit_learns_ridge_on_scaled_features(rows, reg):
    target = target_of(rows)
    coefficients, _ = fitted(rows, target, [reg])
    for block in range(3):
        mine = rows["block"] == block
        x, w = rows["features"][mine], rows["weight"][mine]
        spread = np.sqrt(np.average((x - np.average(x, axis=0, weights=w)) ** 2, axis=0, weights=w))
        ridge = Ridge(alpha=reg * NUM_TRAJECTORIES, solver="svd").fit(x / spread, target[mine], sample_weight=w)
        assert coefficients[block, 1:] * spread == pytest.approx(ridge.coef_, rel=1e-7)
        assert coefficients[block, 0] == pytest.approx(ridge.intercept_, rel=1e-7)


@pytest.mark.parametrize("reg", [0.0, 0.1])
@pytest.mark.parametrize("num_rows", [1, 2, 6, 11, 12, 30])
def test_fewer_rows_than_features_give_the_smallest_coefficients(num_rows, reg):
    rng = np.random.default_rng(num_rows)
    x, y = rng.normal(size=(num_rows, 20)) * rng.uniform(0.1, 10.0, 20), rng.normal(size=num_rows)
    gram, cross = sums(x, np.zeros(num_rows, int), np.ones(num_rows), np.zeros(num_rows, int), y, 1)
    found = solve(ridge_of(gram, np.array([reg]), num_rows), cross)[0][0]
    spread = np.where(num_rows > 1, x.std(axis=0), 1.0)
    scaled, centred = (x - x.mean(axis=0)) / spread, y - y.mean()
    beta = scaled.T @ np.linalg.pinv(scaled @ scaled.T + num_rows * reg * np.eye(num_rows), rcond=1e-9) @ centred
    np.testing.assert_allclose(found[1:] * spread, beta, atol=1e-8)
    assert found[0] == pytest.approx(y.mean() - x.mean(axis=0) @ found[1:])


@pytest.mark.parametrize("num_rows", [2, 6, 7, 12, 30])
def test_standard_errors_grow_where_no_row_is(num_rows):
    rng = np.random.default_rng(num_rows)
    x, asked = rng.normal(size=(2, num_rows, 20)) * rng.uniform(0.1, 10.0, 20)
    gram, _ = sums(x, np.zeros(num_rows, int), np.ones(num_rows), np.zeros(num_rows, int), x[:, 0], 1)
    counts = np.array([[num_rows], [num_rows], [num_rows]], dtype=float)
    errors = standard_errors(ridge_of(gram, np.array([0.1]), num_rows), np.array([2.0]), np.array([5.0]), counts)
    z, apart = ((each - x.mean(axis=0)) / x.std(axis=0) for each in (x, asked))
    inverse = np.linalg.inv(z.T @ z + 2.0 * np.eye(20))
    expected = np.sqrt(1.0 / num_rows + np.einsum("rf,fg,rg->r", apart, inverse, apart))
    found = np.linalg.norm(np.insert(asked, 0, 1.0, axis=1) @ errors.root[0], axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("num_folds", [1, NUM_FOLDS])
def test_a_prior_of_one_row_is_a_penalty_of_one(num_folds):
    """Two rows that lie a hair beyond 0 do not decide a slope of thousands; one that is well known stays."""
    rng = np.random.default_rng(2)
    x = np.column_stack([rng.normal(size=200), np.zeros(200)])
    x[:2, 1] = 1e-3
    y = 3.0 * x[:, 0] + 1e3 * x[:, 1] + 0.1 * rng.normal(size=200)
    gram, cross = sums(x, np.zeros(200, int), np.ones(200), np.arange(200) % num_folds, y, 1, num_folds)
    found = solve(ridge_of(with_prior(gram, 1), np.zeros(1), 200), cross)[0][0]
    given = np.column_stack([np.ones(200), x])
    expected = np.linalg.solve(given.T @ given + np.diag([0.0, 0.0, 1.0]), given.T @ y)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert abs(found[2]) < 0.01


def test_without_a_penalty_collinear_features_still_fit(rows):
    x = rows["features"][:, :2]
    collinear = np.column_stack([x, x[:, 0] + x[:, 1], np.ones(len(x))])
    target = target_of(rows)
    coefficients, _ = fitted({**rows, "features": collinear}, target, [0.0])
    assert np.isfinite(coefficients).all()
    assert (coefficients[:, 4] == 0.0).all()
    for block in range(3):
        mine = (rows["block"] == block) & (rows["weight"] > 0)
        root = np.sqrt(rows["weight"][mine])
        design = np.column_stack([np.ones(mine.sum()), x[mine]])
        beta = np.linalg.lstsq(design * root[:, None], target[mine] * root, rcond=None)[0]
        values = coefficients[block, 0] + collinear[mine] @ coefficients[block, 1:]
        assert values == pytest.approx(design @ beta, rel=1e-7)


def test_a_block_without_rows_is_zero_and_disturbs_no_other(rows):
    target = target_of(rows)
    before, _ = fitted(rows, target, REGS, NUM_FOLDS)
    gone, _ = fitted({**rows, "weight": np.where(rows["block"] == 1, 0.0, rows["weight"])}, target, REGS, NUM_FOLDS)
    assert (gone[1] == 0.0).all()
    assert gone[[0, 2]] == pytest.approx(before[[0, 2]], rel=1e-10)


def test_fewer_rows_than_features(rows):
    few = {name: values[:2] for name, values in rows.items()} | {"block": np.array([0, 0]), "weight": np.ones(2)}
    coefficients, _ = fitted(few, np.array([1.0, 3.0]), [0.0])
    assert coefficients[0, 0] + few["features"] @ coefficients[0, 1:] == pytest.approx([1.0, 3.0], abs=1e-8)
