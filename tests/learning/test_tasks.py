"""A task of a user's own goes wherever named actions go; what was never completed has no value."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.evaluation import FixedSequence, QSpec, evaluate
from halfseen.learning import CensoredQLearner, NamedActions, Task, bootstrap
from halfseen.learning.rows import stage_places
from halfseen.learning.task import Encoded
from halfseen.logs import Logs, LogStream

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


ACTIONS = ["A", "B"]


def always_cut(num_trajectories=200, num_cut=20, horizon=1, seed=0):
    """B is begun in the last stage of `num_cut` trajectories, and cut each time; A costs between 1 and 2."""
    rng, rows = np.random.default_rng(seed), []
    for trajectory in range(num_trajectories):
        clock = 0.0
        for stage in range(1, horizon + 1):
            takes_b = trajectory < num_cut and stage == horizon
            clock += rng.uniform(1.0, 2.0)
            x, reward = rng.normal(), np.nan if takes_b else -1.0 - rng.random()
            taken, chance = ("B", 0.1) if takes_b else ("A", 0.9)
            rows.append((taken, reward, clock - 0.5 * takes_b, not takes_b, x, chance))
    columns = ["action", "reward", "ends_s", "is_seen", "x", "probability"]
    return log_of(**pd.DataFrame(rows, columns=columns), num_stages=horizon)


@pytest.mark.parametrize("stages", ["separate", "pooled"])
@pytest.mark.parametrize("censoring", ["kaplan-meier", "none", "buckley-james"])
@pytest.mark.parametrize("q_function", ["linear", "kernel"])
def test_an_action_that_was_cut_each_time_is_never_chosen(stages, censoring, q_function):
    learner = CensoredQLearner.of_paper(1, ACTIONS, ["x"], stages=stages, censoring=censoring, q_function=q_function)
    learner.fit(always_cut())
    assert set(learner.decide(pd.DataFrame({"x": np.linspace(-5, 5, 50)}), 1)) == {"A"}
    (result,) = learner.unseen_
    assert result.startswith("B was never completed")
    assert "(begun 20 times and cut each time)" in result


@pytest.mark.slow
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_no_verdict_is_given_on_it(stages):
    logs, q = always_cut(horizon=2), QSpec(NamedActions(ACTIONS, ["x"]), stages=stages)
    found = evaluate(FixedSequence(("A", "B")), logs, q=q, against="logging")
    assert found.verdict == "inconclusive"
    where = "B" if stages == "pooled" else "B in stage 2"
    assert f"the policy takes {where}, which no trajectory of the log completed" in found.reason
    assert evaluate(FixedSequence(("A", "A")), logs, q=q, against="logging").verdict != "better"


def test_the_maximum_of_equation_three_is_over_what_was_seen():
    logs = always_cut(horizon=2)
    fitted = CensoredQLearner.of_paper(2, ACTIONS, ["x"], reg=0.0, censoring="none").fit(logs)
    alone = CensoredQLearner.of_paper(2, ["A"], ["x"], reg=0.0, censoring="none").fit(logs_of_a(logs))
    states = pd.DataFrame({"x": [-1.0, 0.0, 2.0]})
    np.testing.assert_allclose(fitted.q_values(states, 1)[:, 0], alone.q_values(states, 1)[:, 0], rtol=1e-12)
    # The value of B, had it been 0, would be above that of A, which costs at least 1.
    assert np.all(fitted.q_values(states, 1)[:, 0] < -1.5)


def logs_of_a(logs):
    """The same log, in which nobody says what was begun and cut."""
    stages = logs.stages.assign(action=logs.stages["action"].where(logs.stages["action"] == "A"))
    return Logs(stages=stages, trajectories=logs.trajectories)


def test_an_action_may_be_seen_in_one_stage_alone():
    logs = always_cut(horizon=2)
    stages = logs.stages.copy()
    stages.loc[(stages["stage"] == 1) & (stages["trajectory"] % 2 == 0), "action"] = "B"
    logs = Logs(stages=stages, trajectories=logs.trajectories)
    separate, pooled = (
        CensoredQLearner.of_paper(2, ACTIONS, ["x"], stages=stages, censoring="none").fit(logs)
        for stages in ("separate", "pooled")
    )
    assert separate.policy_.is_possible.tolist() == [[True, True], [True, False]]
    assert pooled.policy_.is_possible.all()
    assert "in stage 2 (begun 20 times" in separate.unseen_[0]
    assert pooled.unseen_ == []


@pytest.mark.slow
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_a_stream_sees_what_memory_does(tmp_path, stages):
    logs = always_cut(horizon=2, num_trajectories=60, num_cut=50)
    logs.write(tmp_path / "logs")
    whole, parts = (
        CensoredQLearner.of_paper(2, ACTIONS, ["x"], stages=stages, reg=0.1).fit(each)
        for each in (logs, LogStream(tmp_path / "logs", 7))
    )
    assert parts.unseen_ == whole.unseen_ != []
    np.testing.assert_array_equal(parts.policy_.is_possible, whole.policy_.is_possible)
    np.testing.assert_allclose(parts.q_functions_.coefficients, whole.q_functions_.coefficients, atol=1e-9)


def test_where_nobody_came_all_actions_stay():
    learner = CensoredQLearner.of_paper(3, ACTIONS, ["x"], censoring="none").fit(always_cut())
    assert learner.policy_.is_possible.tolist() == [[True, False], [True, True], [True, True]]
    assert learner.unseen_[-1].startswith("no trajectory completed stage 2, 3, so no action has a value there")
