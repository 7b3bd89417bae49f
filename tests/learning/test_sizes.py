"""Many covariates of many actions: a linear Q where a smooth one would take minutes, and nothing beyond memory."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, KernelQ, behaviour
from halfseen.logs import Logs


def log_of(num_actions, num_covariates, num_texts=0, n=120):
    rng, each = np.random.default_rng(0), np.arange(n)
    stages = {"trajectory": each, "stage": np.ones(n, int), "elapsed_s": np.ones(n), "reward": rng.normal(size=n)}
    stages["action"] = [f"a{k % num_actions}" for k in each]
    stages |= {f"x{j}": rng.normal(size=n) for j in range(num_covariates)}
    stages |= {f"t{j}": [f"c{k % 17}" for k in rng.permutation(n)] for j in range(num_texts)}
    covariates = [name for name in stages if name[0] in "xt" and name[1:].isdigit()]
    trajectories = {"trajectory": each, "end_s": np.ones(n), "ending": ["finished"] * n}
    return Logs(stages=pd.DataFrame(stages), trajectories=trajectories), covariates


def learner_of(num_actions, covariates, **how):
    return CensoredQLearner(1, [f"a{k}" for k in range(num_actions)], covariates, **how)


@pytest.mark.parametrize(
    ("num_actions", "num_covariates", "num_texts", "is_linear"),
    [(16, 8, 0, False), (3, 20, 0, False), (16, 32, 0, True), (16, 8, 2, True)],
)
def test_too_many_products_give_way_and_it_is_said(num_actions, num_covariates, num_texts, is_linear):
    log, covariates = log_of(num_actions, num_covariates, num_texts)
    learner = learner_of(num_actions, covariates).fit(log)
    assert (learner.policy_.kernel_map is None) == is_linear
    assert any("Q is linear" in why for why in learner.chosen_) == is_linear


def test_what_is_asked_for_is_kept_or_refused_before_it_fills_the_memory():
    log, covariates = log_of(16, 60)
    with pytest.raises(ArgumentError, match=r"1890 features for each of 16 actions take .* GB"):
        learner_of(16, covariates, q_function="quadratic").fit(log)
    assert learner_of(16, covariates, q_function=KernelQ(num_landmarks=20)).fit(log).policy_.kernel_map is not None


def test_a_choice_of_many_coefficients_is_found_without_its_curvature(monkeypatch):
    rng = np.random.default_rng(1)
    features = np.repeat(rng.normal(size=(300, 1, 5)), 4, axis=1)
    possible, taken, blocks = np.ones((300, 4), bool), rng.integers(0, 4, 300), np.arange(4)
    by_newton = behaviour.conditional_logit(features, possible, taken, blocks)
    monkeypatch.setattr(behaviour, "MOST_FOR_NEWTON", 1)
    np.testing.assert_allclose(behaviour.conditional_logit(features, possible, taken, blocks), by_newton, atol=1e-4)
