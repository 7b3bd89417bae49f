"""Q at its lower confidence bound: by hand, in eq. 3 and in what the policy takes."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, QuadraticQ

REG = 0.02
COVARIATES = ["x1", "x2"]


def trial(num_trajectories=60, seed=0, horizon=1):
    """Two stages or one; A is common, B is rare, and rewards are noisy."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(num_trajectories * horizon):
        x1, x2 = rng.normal(size=2) * [1.0, 5.0]
        action = "B" if rng.random() < 0.25 else "A"
        reward = (x1 if action == "A" else 0.3 * x2) + rng.normal()
        rows.append((action, reward, x1, x2))
    return log_of(**pd.DataFrame(rows, columns=["action", "reward", *COVARIATES]), num_stages=horizon)


def fitted_by_hand(x, y, reg, num_trajectories):
    """Ridge with a free offset on scaled features: its predictions, and its standard errors as Bayes has them."""
    mean, scale = x.mean(axis=0), x.std(axis=0)
    z = (x - mean) / scale
    penalised = z.T @ z + reg * num_trajectories * np.eye(z.shape[1])
    beta = np.linalg.solve(penalised, z.T @ (y - y.mean()))
    used = 1.0 + np.trace(np.linalg.solve(penalised, z.T @ z))
    variance = ((y - y.mean() - z @ beta) ** 2).sum() / (len(y) - used)

    def at(new):
        apart = (new - mean) / scale
        leverage = 1.0 / len(y) + np.einsum("if,fg,ig->i", apart, np.linalg.inv(penalised), apart)
        return y.mean() + apart @ beta, np.sqrt(variance * leverage)

    return at


def by_hand(logs, strength, reg=REG):
    """Lower bounds of both actions in the last stage, and Q of the stage before by the largest of them."""
    frame, n = logs.stages, logs.num_trajectories
    horizon, after = logs.horizon, np.zeros(n)
    for stage in range(horizon, 0, -1):
        rows = frame[frame["stage"] == stage]
        x, y = rows[COVARIATES].to_numpy(), rows["reward"].to_numpy() + after
        q, s = np.empty((n, 2)), np.empty((n, 2))
        for column, name in enumerate("AB"):
            mine = (rows["action"] == name).to_numpy()
            q[:, column], s[:, column] = fitted_by_hand(x[mine], y[mine], reg, n)(x)
        after = (q - strength * s).max(axis=1)
    return q, q - strength * s


@pytest.mark.parametrize("horizon", [1, 2])
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_bounds_are_those_of_a_bayesian_ridge_in_every_stage(horizon, strength):
    logs = trial(horizon=horizon)
    learner = CensoredQLearner.of_paper(horizon, ["A", "B"], COVARIATES, reg=REG, pessimism=strength).fit(logs)
    first = logs.stages[logs.stages["stage"] == 1]
    q, low = by_hand(logs, strength)
    np.testing.assert_allclose(learner.q_values(first, 1), q, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(learner.policy_.lower_bounds(first, 1), low, rtol=1e-9, atol=1e-9)
    by_bounds = replace(learner.policy_, behaviour=None)
    np.testing.assert_array_equal(by_bounds.decide(first, 1), np.where(low[:, 0] >= low[:, 1], "A", "B"))


def test_without_pessimism_equation_three_is_as_it_stands():
    logs = trial(horizon=2)
    fixed, plain = (
        CensoredQLearner.of_paper(2, ["A", "B"], COVARIATES, reg=REG, **given).fit(logs)
        for given in ({"pessimism": 0.0}, {"pessimism": "auto"})
    )
    np.testing.assert_array_equal(fixed.q_functions_.coefficients, plain.q_functions_.coefficients)
    assert fixed.policy_.margin is None
    first = logs.stages[logs.stages["stage"] == 1]
    np.testing.assert_array_equal(fixed.policy_.lower_bounds(first, 1), fixed.q_values(first, 1))


def test_what_one_lucky_stage_speaks_for_is_not_taken():
    """B was tried three times, and brought much by luck; A is well known."""
    rng = np.random.default_rng(0)
    n = 100
    action = np.where(np.arange(n) < 3, "B", "A")
    reward = np.where(action == "B", [1.5, -3.0, 4.5, *[0.0] * (n - 3)], rng.normal(size=n) * 0.1 + 0.5)
    bold, wary = (
        CensoredQLearner(1, ["A", "B"], pessimism=each, q_function="linear").fit(log_of(action, reward))
        for each in (0, "auto")
    )
    here = pd.DataFrame(index=[0])
    assert bold.decide(here, 1).tolist() == ["B"]
    assert wary.decide(here, 1).tolist() == ["A"]


def test_cut_stages_count_as_nothing_seen():
    """Imputed targets of cut stages make the bound no narrower than the completed stages alone."""
    logs = trial(200)
    is_cut = (logs.stages["action"] == "B").to_numpy() & (np.arange(200) % 2 == 0)
    cut = log_of(**logs.stages[["action", "reward", *COVARIATES]], ends_s=np.where(is_cut, 0.5, 1.0), is_seen=~is_cut)
    imputed, completed = (
        CensoredQLearner.of_paper(1, ["A", "B"], COVARIATES, reg=REG, pessimism=1.0, censoring=each).fit(cut)
        for each in ("buckley-james", "none")
    )
    here = logs.stages.iloc[:20]
    gaps = [each.q_values(here, 1) - each.policy_.lower_bounds(here, 1) for each in (imputed, completed)]
    np.testing.assert_allclose(gaps[0], gaps[1], rtol=0.05)


@pytest.mark.parametrize("strength", [-1.0, np.nan, "much", True])
def test_a_strength_that_is_none_is_refused(strength):
    with pytest.raises(ArgumentError, match="pessimism is"):
        CensoredQLearner(1, ["A", "B"], pessimism=strength).fit(trial())


def test_a_quadratic_q_is_least_squares_on_products():
    logs = trial(200)
    learner = CensoredQLearner.of_paper(1, ["A", "B"], COVARIATES, reg=0.0, q_function=QuadraticQ()).fit(logs)
    x = logs.stages[COVARIATES].to_numpy()
    design = np.column_stack([np.ones(200), x, x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2])
    mine = (logs.stages["action"] == "B").to_numpy()
    answer = np.linalg.lstsq(design[mine], logs.stages["reward"].to_numpy()[mine], rcond=None)[0]
    np.testing.assert_allclose(learner.q_values(logs.stages, 1)[:, 1], design @ answer, rtol=1e-8, atol=1e-8)
