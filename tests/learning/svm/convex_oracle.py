"""The censored SVM's objective, written down once more for cvxpy, and logs to try it on."""

import cvxpy as cp
import numpy as np

REGRESSION = ("squared", "absolute", "pinball", "epsilon-insensitive", "huber")
CLASSIFICATION = ("hinge", "squared-hinge", "logistic")
QUANTILE, EPSILON, DELTA = 0.3, 0.1, 0.7

LOSSES = {
    "squared": lambda y, f: cp.square(y - f),
    "absolute": lambda y, f: cp.abs(y - f),
    "pinball": lambda y, f: cp.maximum(QUANTILE * (y - f), (1 - QUANTILE) * (f - y)),
    "epsilon-insensitive": lambda y, f: cp.pos(cp.abs(y - f) - EPSILON),
    "huber": lambda y, f: 0.5 * cp.huber(y - f, DELTA),
    "hinge": lambda y, f: cp.pos(1 - cp.multiply(y, f)),
    "squared-hinge": lambda y, f: cp.square(cp.pos(1 - cp.multiply(y, f))),
    "logistic": lambda y, f: cp.logistic(-cp.multiply(y, f)),
}


def optimum(gram, y, mass, loss, reg, has_offset):
    """Least reg·‖g‖² + Σ mass L(y, g + b), and f = g + b there.

    `loss` is a name, or a function of y and the expression f.
    """
    eigenvalues, vectors = np.linalg.eigh(gram)
    is_kept = eigenvalues > 1e-12 * eigenvalues.max()
    root = vectors[:, is_kept] * np.sqrt(eigenvalues[is_kept])
    theta, offset = cp.Variable(root.shape[1]), cp.Variable()
    f = root @ theta + offset if has_offset else root @ theta
    each = (LOSSES[loss] if isinstance(loss, str) else loss)(y, f)
    problem = cp.Problem(cp.Minimize(reg * cp.sum_squares(theta) + mass @ each))
    tight = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
    problem.solve(solver=cp.CLARABEL, **tight)
    assert problem.status == cp.OPTIMAL
    return problem.value, f.value


def tied_rows(num_rows=40, num_features=3, seed=0):
    """Rows, rounded targets (so that many tie), labels ±1 and weights, a quarter of them 0."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(num_rows, num_features))
    y = np.round(np.sin(rows[:, 0]) + rows[:, 1] + 0.4 * rng.standard_t(3, size=num_rows), 1)
    labels = np.where(rows[:, 0] + 0.7 * rng.normal(size=num_rows) > 0, 1.0, -1.0)
    weights = rng.exponential(size=num_rows) * (np.arange(num_rows) % 4 > 0)
    return rows, y, labels, weights


def cut_log(num_rows=80, num_features=3, seed=0):
    """Rows, observed ends and whether they were seen; about a third is cut."""
    rng = np.random.default_rng(seed)
    rows = rng.uniform(-1, 1, size=(num_rows, num_features))
    time = np.exp(rows[:, 0] + 0.3 * rng.normal(size=num_rows))
    cut = rng.exponential(3.0, size=num_rows)
    return rows, np.minimum(time, cut), time <= cut
