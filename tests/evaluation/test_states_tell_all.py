"""What went before a stage: it is found where it matters, and not where states tell all."""

from functools import cache

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, trial, truth

from halfseen.evaluation import evaluate
from halfseen.evaluation.off_policy import HISTORY_COUNTS, default_q, default_targets, q_model_of
from halfseen.evaluation.problem import problem_of
from halfseen.evaluation.states import CLEARLY, history_deviate, wald
from halfseen.evaluation.weights import begun_weights
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))
CARRIED = 2.0
"""What a first action B adds to the reward of the second stage."""


@cache
def with_history(seed, num_trajectories=400):
    """The trial, but a first action B is paid for in the second stage, too, which no covariate of it tells."""
    logs = trial(seed, num_trajectories=num_trajectories, cut_rate=0.05)
    first = logs.stages.groupby("trajectory")["action"].transform("first")
    is_paid = (logs.stages["stage"] == 2) & (first == "B")
    return Logs(logs.stages.assign(reward=logs.stages["reward"] + CARRIED * is_paid), logs.trajectories)


def true_gain():
    """A first action B is worth as much more, for it ends no trajectory."""

    def value(chance_b):
        return truth(chance_b) + CARRIED * sum(0.5 * chance for chance in chance_b)

    return value(TARGET.chance_b) - value(tuple(CHANCE_B))


def problem(logs):
    spec, widened = default_q(TARGET, logs)
    model = q_model_of(TARGET, widened, default_targets(logs), spec)
    return problem_of(TARGET, widened, model, "logged", np.random.default_rng(0), 5)


def test_where_states_tell_all_it_is_a_normal_deviate():
    found = []
    given = problem(trial(0, num_trajectories=300))
    for seed in range(200):
        rng = np.random.default_rng(seed)
        # What trajectories share, and what is theirs in a stage.
        residual = rng.normal(size=(300, 1)) + rng.normal(size=(300, 2)) * (1.0 + given.trajectories.action)
        found.append(history_deviate(residual, given.trajectories.is_begun, given.trajectories, given.beyond))
    assert np.mean(found) == pytest.approx(0.0, abs=0.25)
    assert np.std(found) == pytest.approx(1.0, abs=0.15)


def test_the_statistic_is_its_definition_and_directions_without_scores_do_not_count():
    score = np.random.default_rng(0).normal(size=(50, 3)) + 0.2
    total = score.sum(axis=0)
    found, freedom = wald(score)
    assert (found, freedom) == (pytest.approx(total @ np.linalg.inv(score.T @ score) @ total), 3)
    assert wald(np.column_stack([score, score[:, 0]])) == (pytest.approx(found), 3)
    assert wald(score[:, :0]) == (0.0, 0)


def test_a_trajectory_of_one_stage_has_no_history():
    logs = trial(1, num_trajectories=60)
    given = problem(logs)
    trajectories = given.trajectories
    assert (
        history_deviate(np.ones((60, 2)), trajectories.is_begun & [True, False], trajectories, given.beyond) == -np.inf
    )


def test_a_past_that_matters_is_found_and_then_products_weigh():
    given = problem(with_history(0))
    judged = given.judged(given.nuisances[:-1])
    assert given.history_deviate(judged) > CLEARLY
    settled = given.settled(judged)
    assert (settled.marginal, settled.has_history) == (None, True)
    products = begun_weights(given.ratio, given.nuisances[-1].uncut, given.trajectories)
    np.testing.assert_allclose(settled.stage_weights[-1].weight, products.weight, rtol=1e-9)
    np.testing.assert_allclose(settled.stage_weights[-1].standing, products.standing, rtol=1e-9)
    found = evaluate(TARGET, with_history(0), against="logging")
    assert HISTORY_COUNTS in found.notes
    assert found.difference.low < true_gain() < found.difference.high


def test_a_past_that_does_not_is_not():
    logs = trial(2, num_trajectories=400, cut_rate=0.05)
    given = problem(logs)
    assert given.settled(given.judged(given.nuisances[:-1])) is given
    assert HISTORY_COUNTS not in evaluate(TARGET, logs, against="logging").notes
