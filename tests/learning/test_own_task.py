"""A task of a user's own, with nothing but what the protocol asks for, goes wherever named actions go."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.evaluation import QSpec, evaluate
from halfseen.learning import CensoredQLearner, Task, bootstrap
from halfseen.learning.rows import stage_places
from halfseen.learning.task import Encoded
from halfseen.logs import LogStream

DOSES = np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True, eq=False)
class DosePolicy:
    """argmax over doses of one quadratic for all of them."""

    coefficients: np.ndarray

    def dose(self, need, stage):
        beta = self.coefficients[len(self.coefficients) - stage, 0]
        return np.argmax(beta[0] + features_of(need) @ beta[1:], axis=-1)


def features_of(need):
    """Of each dose: itself, its square, and itself by need."""
    each = np.broadcast_to(DOSES, (*np.shape(need), len(DOSES)))
    return np.stack([each, each**2, each * np.asarray(need)[..., None]], axis=-1)


@dataclass(frozen=True)
class DoseTask:
    """Doses are numbers: all share one block of coefficients, and actions differ by their features."""

    block_names = ("dose",)
    end_action = None
    is_shared = False

    def fitted(self, logs, horizon):
        return self

    def encode(self, logs, horizon):
        at, shape = stage_places(logs), (logs.num_trajectories, horizon)
        features, action = np.zeros((*shape, len(DOSES), 3)), np.zeros(shape, dtype=np.int64)
        features[at] = features_of(logs.stages["need"])
        action[at] = logs.stages["action"].fillna(0)
        return Encoded(features, np.ones((*shape, len(DOSES)), dtype=bool), action)

    def block_of_action(self, num_actions):
        return np.zeros(num_actions, dtype=np.int64)

    def outcome_features(self, names):
        return np.isin(["dose", "square", "need"], list(names)).astype(float)

    def censoring_covariates(self, logs, names, is_by_trajectory):
        return logs.stages[["need"] if names is None else list(names)].astype(float)

    def fitted_to_rewards(self, parts):
        return self

    def reduce_variance(self, stages):
        return stages.reward, None

    def policy(self, learned):
        return DosePolicy(learned.coefficients)

    def target_probabilities(self, policy, logs, horizon):
        probabilities = np.zeros((logs.num_trajectories, horizon, len(DOSES)))
        for trajectory, stage, need in zip(*stage_places(logs), logs.stages["need"], strict=True):
            probabilities[trajectory, stage, policy.dose(need, stage + 1)] = 1.0
        return probabilities


def trial(seed, num_trajectories=300):
    """What a dose brings is most where it equals the need; the higher the dose, the sooner a trajectory is cut."""
    rng, rows = np.random.default_rng(seed), []
    for trajectory in range(num_trajectories):
        clock = 0.0
        for stage in (1, 2):
            need, action = rng.uniform(), int(rng.integers(3))
            took, cut_s = rng.exponential(1.0), rng.exponential(8.0 * np.exp(-DOSES[action]))
            reward = 1.0 - 4.0 * (DOSES[action] - need) ** 2 + 4.0 * need**2 + 0.1 * rng.normal()
            clock, is_seen = clock + min(took, cut_s), took <= cut_s
            rows.append((trajectory, stage, action, reward, clock, is_seen, need, 1 / 3))
            if not is_seen:
                break
    columns = ["trajectory", "stage", "action", "reward", "ends_s", "is_seen", "need", "probability"]
    return log_of(**pd.DataFrame(rows, columns=columns))


@pytest.fixture(scope="module")
def logs():
    return trial(0)


@pytest.fixture(scope="module")
def learner(logs):
    return CensoredQLearner.of_paper(2, DoseTask(), reg=1e-6).fit(logs)


def test_it_is_learned_and_needs_nothing_but_the_protocol(learner):
    assert isinstance(DoseTask(), Task)
    best = learner.policy_.dose(np.array([0.1, 0.45, 0.9]), 1)
    assert DOSES[best].tolist() == [0.0, 0.5, 1.0]
    assert learner.q_functions_.coefficients[-1, 0] == pytest.approx([1.0, 0.0, -4.0, 8.0], abs=0.15)


def test_it_is_evaluated(learner):
    found = evaluate(learner.policy_, trial(1), censoring="cox", q=QSpec(DoseTask()))
    assert found.verdict == "better"
    assert found.support[0] > 0.2


def test_its_intervals_hold_what_was_learned(learner, logs):
    draws = bootstrap(learner, logs, num_replicates=5)
    assert isinstance(draws.replicates, DosePolicy)
    spread = draws.replicates.coefficients.std(axis=0)
    assert draws.replicates.coefficients.shape == (5, 2, 1, 4)
    assert (spread > 0).all()
    assert (spread < 1.0).all()
    with pytest.raises(ArgumentError, match="a DosePolicy does not decide by covariates alone"):
        draws.q_interval(logs.stages, 1)


def test_it_is_streamed(learner, logs, tmp_path):
    logs.write(tmp_path / "logs")
    streamed = CensoredQLearner.of_paper(2, DoseTask(), reg=1e-6).fit(LogStream(tmp_path / "logs", 90))
    np.testing.assert_allclose(
        streamed.q_functions_.coefficients, learner.q_functions_.coefficients, rtol=1e-8, atol=1e-8
    )
