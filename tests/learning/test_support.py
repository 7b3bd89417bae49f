"""What was never seen completed has no value: it is not chosen, and nothing is promised of it."""

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.evaluation import FixedSequence, QSpec, evaluate
from halfseen.learning import CensoredQLearner, NamedActions
from halfseen.logs import Logs, LogStream

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
    (told,) = learner.unseen_
    assert told.startswith("B was never seen completed")
    assert "(begun 20 times and cut each time)" in told


@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_no_verdict_is_given_on_it(stages):
    logs, q = always_cut(horizon=2), QSpec(NamedActions(ACTIONS, ["x"]), stages=stages)
    found = evaluate(FixedSequence(("A", "B")), logs, q=q)
    assert found.verdict == "inconclusive"
    where = "B" if stages == "pooled" else "B in stage 2"
    assert f"the policy takes {where}, which no trajectory of the log was seen to complete" in found.reason
    assert evaluate(FixedSequence(("A", "A")), logs, q=q).verdict != "better"


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
