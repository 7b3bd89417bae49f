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


def cut_log(num_trajectories, seed=0, noise=1.0):
    """Three stages in which A is worth x times the stage before; a quarter of the last ones is cut."""
    rng = np.random.default_rng(seed)
    x, stage = rng.normal(size=3 * num_trajectories), np.tile([1.0, 2.0, 3.0], num_trajectories)
    action = rng.choice(["A", "B"], len(x))
    reward = x * (action == "A") * (stage - 1.0) + noise * rng.normal(size=len(x))
    late = centred_stages(3)[(stage - 1).astype(int)]
    is_seen = np.arange(len(x)) % 12 != 11
    return log_of(action, reward, num_stages=3, is_seen=is_seen, x=x, late=late, late_x=late * x)


@pytest.mark.parametrize("changed", [{"reg": 0.0}, {"pessimism": 0.7}, {"reg": 0.1, "half_life": 20}], ids=str)
def test_it_is_one_more_covariate_with_its_products(changed):
    """Those are columns of the log here, of pooled stages."""
    log = cut_log(60)
    settings = {"q_function": "linear", "censoring": "kaplan-meier", **changed}
    trend = CensoredQLearner(3, ["A", "B"], ["x"], stages="trend", **settings).fit(log)
    column = CensoredQLearner(3, ["A", "B"], ["x", "late", "late_x"], stages="pooled", **settings).fit(log)
    for stage in (1, 2, 3):
        rows = log.stages[log.stages["stage"] == stage]
        for name in ("q_values", "lower_bounds"):
            found, expected = (getattr(each.policy_, name)(rows, stage) for each in (trend, column))
            np.testing.assert_allclose(found, expected, atol=1e-8)


def test_outcomes_are_imputed_with_it():
    """Without noise, what is cut is known from the rest, if it may depend on the stage."""
    log = cut_log(60, noise=0.0)
    settings = {"q_function": "linear", "censoring": "buckley-james", "pessimism": 0.0, "reg": 0.0}
    learner = CensoredQLearner(3, ["A", "B"], ["x"], stages="trend", **settings).fit(log)
    asked = pd.DataFrame({"x": [-1.0, 0.0, 2.0]})
    np.testing.assert_allclose(learner.q_values(asked, 3), np.outer(asked["x"], [2.0, 0.0]), atol=1e-6)


def test_resampled_logs_impute_with_it():
    log = cut_log(40)
    learner = CensoredQLearner(3, ["A", "B"], ["x"], stages="trend").fit(log)
    low, high = bootstrap(learner, log, num_replicates=3).q_interval(log.stages[:5], 2)
    assert np.isfinite(low).all()
    assert (low <= high).all()


def test_tables_have_no_trend():
    with pytest.raises(ArgumentError, match="stages is 'trend', which tables do not have; give 'pooled' or 'separate'"):
        CensoredQLearner.for_table(10, stages="trend").compose()
