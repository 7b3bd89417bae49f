"""What is said where nothing can be said, and how many paths would do."""

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, trial

from halfseen.evaluation.off_policy import default_q, default_targets, q_model_of
from halfseen.evaluation.problem import as_logged, problem_of
from halfseen.evaluation.verdict import why_unknown


def problem(policy, logs):
    spec, widened = default_q(policy, logs)
    model = q_model_of(policy, widened, default_targets(logs), spec)
    return problem_of(policy, widened, model, "logged", np.random.default_rng(0), 2)


def test_paths_for_one_is_the_mean_squared_ratio():
    """States are fair coins, so stages have nothing to do with one another but that some paths end after the first."""
    chance_b = np.array([0.9, 0.2])
    stage = 0.5 * (chance_b**2 / CHANCE_B + (1.0 - chance_b) ** 2 / (1.0 - CHANCE_B)).sum()
    leaves = 0.5 * (1.0 - CHANCE_B[1])
    found = problem(StatePolicy(tuple(chance_b)), trial(0, num_paths=4000))
    assert found.paths_for_one == pytest.approx(leaves * stage + (1.0 - leaves) * stage**2, rel=0.1)
    assert as_logged(found).paths_for_one == 1.0


def test_it_says_how_many_paths_would_do():
    some = why_unknown("the policy", np.ones(2), 2.6, None, 231.0)
    assert "the effective sample size is 2.6" in some
    assert "some 3,000 paths like these would do" in some
    assert "some 90 paths" in why_unknown("the policy", np.ones(2), 9.9, None, 9.0)
    for never in (np.inf, np.nan, 1e9):
        assert "no log of a size that can be recorded would do" in why_unknown("it", np.ones(2), 0.1, None, never)
    assert why_unknown("the policy", np.ones(2), 10.0, None, np.inf) is None
