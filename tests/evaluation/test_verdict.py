"""What is said where nothing can be said, and how many paths would do."""

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, trial

from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.off_policy import default_q, default_targets, q_model_of
from halfseen.evaluation.problem import as_logged, problem_of
from halfseen.evaluation.verdict import verdict_of, why_unknown


def problem(policy, logs):
    spec, widened = default_q(policy, logs)
    model = q_model_of(policy, widened, default_targets(logs), spec)
    return problem_of(policy, widened, model, "logged", np.random.default_rng(0), 2)


def test_of_uncut_paths_as_many_are_worth_one_as_their_mean_squared_ratio():
    """States are fair coins, so stages have nothing to do with one another but that some paths end after the first."""
    chance_b = np.array([0.9, 0.2])
    stage = 0.5 * (chance_b**2 / CHANCE_B + (1.0 - chance_b) ** 2 / (1.0 - CHANCE_B)).sum()
    leaves = 0.5 * (1.0 - CHANCE_B[1])
    found = problem(StatePolicy(tuple(chance_b)), trial(0, num_paths=4000))
    assert found.paths_for_one == pytest.approx(leaves * stage + (1.0 - leaves) * stage**2, rel=0.1)
    assert as_logged(found).paths_for_one == pytest.approx(1.0)


def test_cuts_take_more_paths():
    policy = StatePolicy((0.9, 0.2))
    uncut, cut = (problem(policy, trial(0, num_paths=400, cut_rate=rate)) for rate in (0.0, 0.2))
    by_cuts = as_logged(cut).effective_sample_size / 400
    assert cut.paths_for_one == pytest.approx(cut.squared_ratio / by_cuts)
    assert cut.paths_for_one > 1.2 * uncut.paths_for_one


@pytest.mark.parametrize(
    ("paths_for_one", "said"),
    [
        (231.0, "some 3,000 paths like these would do"),
        (41.0, "some 500 paths like these would do"),
        (30.0, "record more paths, or some of a logging policy"),
        (np.inf, "no log of a size that can be recorded would do"),
        (np.nan, "no log of a size that can be recorded would do"),
        (1e9, "no log of a size that can be recorded would do"),
    ],
)
def test_it_says_how_many_paths_would_do(paths_for_one, said):
    why = why_unknown("the policy", np.ones(2), 2.6, None, 400, paths_for_one)
    assert "the effective sample size is 2.6" in why
    assert said in why
    assert why_unknown("the policy", np.ones(2), 10.0, None, 400, paths_for_one) is None


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (-0.2, 0.03, "earns between 0.2 less and 0.03 parts more a path than"),
        (0.1, 0.3, "more a path than the logging policy, between 0.1 and 0.3 parts more"),
        (-0.3, -0.1, "less a path than the logging policy, between 0.1 and 0.3 parts less"),
        (-0.3, 0.0, "less a path than the logging policy, between 0 and 0.3 parts less"),
    ],
)
def test_ends_of_the_interval_are_told_as_more_and_less_without_a_sign(low, high, words):
    _, reason = verdict_of(Estimate((low + high) / 2.0, low, high, (high - low) / 4.0, 50.0), unit="parts")
    assert words in reason
