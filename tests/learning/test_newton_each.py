"""Newton steps on several functions at once, against SciPy on each."""

import numpy as np
import pytest
from scipy.optimize import minimize, rosen, rosen_der, rosen_hess

from halfseen.learning.behaviour import MAX_STEPS, minimise_each


def rosenbrocks(theta):
    return tuple(np.array([of(each) for each in theta]) for of in (rosen, rosen_der, rosen_hess))


def test_curved_valleys_are_followed_to_their_end():
    start = np.array([[-1.2, 1.0, 0.5], [2.0, -1.5, 0.0], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(minimise_each(rosenbrocks, start), 1.0, atol=1e-8)


def test_functions_that_bend_down_are_left_downhill():
    def wells(theta):
        """Two minima, and a top between them at which the first begins; the second is a bowl."""
        x = theta[:, 0]
        value = np.array([(x[0] ** 2 - 1.0) ** 2, (x[1] - 3.0) ** 2])
        slope = np.array([4.0 * x[0] * (x[0] ** 2 - 1.0), 2.0 * (x[1] - 3.0)])
        bend = np.array([12.0 * x[0] ** 2 - 4.0, 2.0])
        return value, slope[:, None], bend[:, None, None]

    np.testing.assert_allclose(minimise_each(wells, np.array([[0.1], [50.0]])), [[1.0], [3.0]], atol=1e-8)


def test_it_agrees_with_scipy_where_logits_saturate():
    rng = np.random.default_rng(1)
    design, sign = rng.normal(size=(60, 2)), np.where(rng.random((5, 60)) < 0.9, 1.0, -1.0)

    def logistic(theta, sign=sign):
        margin = sign * (theta @ design.T)
        wrong = 1.0 / (1.0 + np.exp(margin))
        value = np.logaddexp(0.0, -margin).sum(axis=1) + (theta**2).sum(axis=1) / 200.0
        bend = (wrong * (1.0 - wrong))[:, :, None, None] * design[:, :, None] * design[:, None, :]
        return value, theta / 100.0 - (sign * wrong) @ design, bend.sum(axis=1) + np.eye(2) / 100.0

    found = minimise_each(logistic, np.full((5, 2), 8.0))
    for k, theta in enumerate(found):
        of_one = [lambda at, i=i, k=k: logistic(at[None], sign[k : k + 1])[i][0] for i in range(2)]
        peer = minimize(of_one[0], np.zeros(2), jac=of_one[1], options={"gtol": 1e-9})
        np.testing.assert_allclose(theta, peer.x, atol=1e-6)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_what_cannot_be_lowered_ends(value):
    asked = []

    def cliff(theta):
        asked.append(1)
        is_start = theta[:, 0] == 0.0
        return np.where(is_start, 0.0, value), np.ones_like(theta), np.ones((len(theta), 1, 1))

    assert minimise_each(cliff, np.zeros((1, 1))).tolist() == [[0.0]]
    assert len(asked) < MAX_STEPS
