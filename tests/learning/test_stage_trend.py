"""A trend over pooled stages beside least squares, and the policy that it becomes."""

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, bootstrap
from halfseen.learning.q_space import SMOOTH, KernelQ, LinearQ, QuadraticQ
from halfseen.learning.recursion import QFunctions
from halfseen.learning.stage_trend import centred_stages, stage_trend_of


@pytest.mark.parametrize("horizon", [1, 2, 3, 10])
def test_stages_have_mean_0_and_variance_1(horizon):
    stages = centred_stages(horizon)
    assert stages.mean() == pytest.approx(0.0, abs=1e-15)
    assert stages.std() == pytest.approx(float(horizon > 1))
    assert (np.diff(stages) > 0).all()


@pytest.mark.parametrize("has_root", [False, True])
@pytest.mark.parametrize("space", [LinearQ(), QuadraticQ(), SMOOTH, KernelQ(8)], ids=lambda space: space.name)
def test_in_its_stage_each_q_is_a_function_of_the_state_alone(space, has_root):
    rng, horizon, num_actions, num_batches = np.random.default_rng(0), 3, 2, 4
    x = rng.normal(size=(20, horizon, 1, 3))
    kernel_map = space.features(x.reshape(-1, 3), 0)
    trend = stage_trend_of(kernel_map, 3)
    assert trend.num_linear == (0 if space == KernelQ(8) else 3)
    own = x if kernel_map is None else kernel_map(x)
    every = np.concatenate([np.ones((20, horizon, 1, 1)), own, trend.of(own)], axis=-1)
    size = every.shape[-1]
    shape = (num_batches, horizon, num_actions, size)
    root = rng.normal(size=(*shape, size)) if has_root else None
    q = QFunctions(rng.normal(size=shape), np.ones(shape[:-1]), root=root)
    found = trend.at_stages(q)
    plain = every[..., : 1 + own.shape[-1]]
    for stage in range(horizon):
        to_go = horizon - 1 - stage
        for each, features in ((q, every), (found, plain)):
            assert each.coefficients.shape[-1] == features.shape[-1]
        values = [each.coefficients[:, to_go] @ f[:, stage, 0].T for each, f in ((q, every), (found, plain))]
        np.testing.assert_allclose(*values, atol=1e-10)
        if has_root:
            along = [
                np.swapaxes(each.root[:, to_go], -1, -2) @ f[:, stage, 0].T for each, f in ((q, every), (found, plain))
            ]
            np.testing.assert_allclose(*(np.linalg.norm(each, axis=-2) for each in along), atol=1e-10)


def three_stages(num_trajectories=60, seed=0):
    rng = np.random.default_rng(seed)
    x, action = rng.normal(size=(num_trajectories, 3)), rng.choice(["A", "B"], (num_trajectories, 3))
    return x, action, rng.normal(size=(num_trajectories, 3)) + x * (action == "A") * np.arange(3)


def design(x, stage):
    late = np.full_like(x, (stage - 2) / np.sqrt(2 / 3))
    return np.column_stack([np.ones_like(x), x, late, late * x])


def test_without_a_penalty_it_is_least_squares_backwards():
    """Rows that the horizon ended say nothing of a longer future."""
    x, action, reward = three_stages()
    log = log_of(action.ravel(), reward.ravel(), num_stages=3, x=x.ravel())
    plain = {"q_function": "linear", "censoring": "none", "pessimism": 0.0, "reg": 0.0}
    learner = CensoredQLearner(3, ["A", "B"], ["x"], stages="trend", **plain).fit(log)
    value, asked = np.zeros((len(x), 3)), np.array([-1.0, 0.0, 2.0])
    for to_go in (1, 2, 3):
        num_stages = 3 if to_go == 1 else 2
        target = reward + np.column_stack([value[:, 1:], np.zeros(len(x))])
        rows = [design(x[:, t], t + 1) for t in range(num_stages)]
        fit = {}
        for a in "AB":
            taken = [action[:, t] == a for t in range(num_stages)]
            y = np.concatenate([target[rows_of, t] for t, rows_of in enumerate(taken)])
            of_a = np.concatenate([row[rows_of] for row, rows_of in zip(rows, taken, strict=True)])
            fit[a] = np.linalg.lstsq(of_a, y, rcond=None)[0]
        stage = 4 - to_go
        expected = np.column_stack([design(asked, stage) @ fit[a] for a in "AB"])
        np.testing.assert_allclose(learner.q_values(pd.DataFrame({"x": asked}), stage), expected, atol=1e-8)
        value = np.column_stack(
            [np.maximum(design(x[:, t], t + 1) @ fit["A"], design(x[:, t], t + 1) @ fit["B"]) for t in range(3)]
        )


def test_an_imputed_outcome_has_the_trend_too():
    """With nothing cut, imputation changes nothing."""
    x, action, reward = three_stages(30)
    log = log_of(action.ravel(), reward.ravel(), num_stages=3, x=x.ravel())
    settings = {"q_function": "smooth", "pessimism": 0.0, "reg": 1e-3, "stages": "trend"}
    q = [
        CensoredQLearner(3, ["A", "B"], ["x"], censoring=censoring, **settings).fit(log).q_values(log.stages, 1)
        for censoring in ("none", "buckley-james")
    ]
    np.testing.assert_allclose(*q, atol=1e-8)


def test_resampling_and_a_half_life_keep_the_trend():
    """Rows of the bootstrap have weights and imputation of their own."""
    x, action, reward = three_stages(40)
    log = log_of(action.ravel(), reward.ravel(), num_stages=3, is_seen=np.arange(120) % 12 != 11, x=x.ravel())
    learner = CensoredQLearner(3, ["A", "B"], ["x"], stages="trend", half_life="auto").fit(log)
    low, high = bootstrap(learner, log, num_replicates=3).q_interval(log.stages[:5], 2)
    assert np.isfinite(low).all()
    assert (low <= high).all()


def test_tables_have_no_trend():
    with pytest.raises(ArgumentError, match="stages is 'trend', which tables do not have; give 'pooled' or 'separate'"):
        CensoredQLearner.for_table(10, stages="trend").compose()
