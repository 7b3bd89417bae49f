import numpy as np
import pytest
from naive_q_learning import naive_choice
from sklearn.linear_model import Ridge

from halfseen.learning.ridge import ridge_of, solve, with_prior

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


def test_the_unit_of_a_feature_is_irrelevant(rows):
    target = target_of(rows)
    coefficients, _ = fitted(rows, target, [0.1])
    in_millimetres, _ = fitted({**rows, "features": rows["features"] * 1000.0}, target, [0.1])
    assert in_millimetres[:, 1:] * 1000.0 == pytest.approx(coefficients[:, 1:], rel=1e-8)
    assert in_millimetres[:, 0] == pytest.approx(coefficients[:, 0], rel=1e-8)


def test_cross_validation_chooses_what_a_loop_chooses(rows):
    target = target_of(rows)
    coefficients, reg = fitted(rows, target, REGS, NUM_FOLDS)
    for block in range(3):
        mine = rows["block"] == block
        given = (rows[name][mine] for name in ("weight", "fold"))
        assert reg[block] == naive_choice(
            rows["features"][mine], target[mine], *given, REGS, NUM_TRAJECTORIES, NUM_FOLDS
        )
        alone, _ = fitted(rows, target, [reg[block]])
        assert coefficients[block] == pytest.approx(alone[block], rel=1e-9)
    assert len(set(reg)) > 1


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
