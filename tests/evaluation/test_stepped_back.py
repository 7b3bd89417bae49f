"""A log of the service, with a category that the policy never saw: its rule decided there, or the log is refused."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError
from halfseen.evaluation import evaluate
from halfseen.evaluation.stepped_back import with_its_rule
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs


def cell(num, seed, decide=None, new=(), has_reason=True):
    """One stage: A suits red, B blue; where green comes, the rule takes A."""
    rng = np.random.default_rng(seed)
    colour = rng.choice(["blue", "red"], num)
    stages = pd.DataFrame({"trajectory": range(num), "stage": 1, "elapsed_s": 1.0, "colour": colour})
    own = rng.choice(["A", "B"], num) if decide is None else decide(stages, 1)
    is_drawn = rng.random(num) < 0.4
    action = np.where(is_drawn, rng.choice(["A", "B"], num), own)
    stages["probability"] = 0.5 if decide is None else np.where(action == own, 0.8, 0.2)
    stages["action"] = action.astype(object)
    stages["stepped_back"] = pd.Series([None] * num, dtype=object)
    at = list(new)
    stages.loc[at, ["colour", "action"]] = ["green", "A"]
    stages.loc[at, "probability"] = 1.0
    stages.loc[at, "stepped_back"] = "out-of-range" if has_reason else None
    suits = (stages["action"] == "A") == (stages["colour"] == "red")
    stages["reward"] = (rng.random(num) < np.where(suits, 0.9, 0.2)).astype(float)
    return Logs(stages, pd.DataFrame({"trajectory": range(num), "end_s": 1.0, "ending": "finished"}))


@pytest.fixture(scope="module")
def policy():
    return CensoredQLearner.of_paper(1, ["A", "B"], ["colour"], reg=1e-3).fit(cell(300, 0)).policy_


def test_where_the_policy_stepped_back_what_was_done_counts_as_its_own(policy):
    logs = cell(200, 1, policy.decide, [7, 90])
    together, known, (note,) = with_its_rule(policy, logs)
    taken = together.probabilities(known.stages, 1)
    np.testing.assert_array_equal(taken[[7, 90]], [[1.0, 0.0], [1.0, 0.0]])
    others = known.stages.drop(index=[7, 90])
    np.testing.assert_array_equal(taken[others.index], policy.probabilities(others, 1))
    assert note.startswith("in 2 stages colour is 'green', which the policy does not know")
    found, without = (
        evaluate(policy, one, against="logging")
        for one in (logs, logs.select([name for name in logs.trajectory_ids if name not in (7, 90)]))
    )
    assert found.notes[0] == note
    assert found.doubly_robust.value == pytest.approx(without.doubly_robust.value, abs=0.02)
    assert found.doubly_robust.standard_error < 1.2 * without.doubly_robust.standard_error


def test_what_nobody_stepped_back_from_is_refused(policy):
    logs = cell(200, 1, policy.decide, [7], has_reason=False)
    with pytest.raises(LogError, match=r"trajectory 7, stage 1: covariate 'colour' is 'green'.*give one of 'blue'"):
        evaluate(policy, logs)


def test_in_a_comparison_the_rules_arm_says_by_its_probability_that_the_policy_would_step_back_too(policy):
    logs = cell(200, 1, policy.decide, [7, 90], has_reason=False)
    dealt = logs.trajectories.assign(arm=np.where(np.arange(200) % 90 == 7, "rule", "policy"))
    dealt.loc[90, "arm"] = "rule"
    together, known, (note,) = with_its_rule(policy, Logs(logs.stages, dealt))
    np.testing.assert_array_equal(together.probabilities(known.stages, 1)[[7, 90]], [[1.0, 0.0], [1.0, 0.0]])
    assert note.startswith("in 2 stages colour is 'green'")
    # Where both arms need not agree, nobody knows what the policy would do.
    unsure = logs.stages.assign(probability=logs.stages["probability"].where(logs.stages["trajectory"] != 90, 0.4))
    with pytest.raises(LogError, match="trajectory 90, stage 1: covariate 'colour' is 'green'"):
        with_its_rule(policy, Logs(unsure, dealt))


def test_a_log_of_known_states_stays_as_it_is(policy):
    logs = cell(60, 1, policy.decide)
    assert with_its_rule(policy, logs) == (policy, logs, ())


def test_a_number_outside_the_policys_logs_counts_as_the_rules_where_the_log_says_so_and_the_policy_would_step_back():
    rng, num = np.random.default_rng(2), 120
    stages = pd.DataFrame({"trajectory": range(num), "stage": 1, "elapsed_s": 1.0, "x": rng.uniform(-1.0, 1.0, num)})
    stages["action"], stages["reward"] = np.where(stages["x"] > 0, "A", "B"), rng.random(num)
    ends = pd.DataFrame({"trajectory": range(num), "end_s": 1.0, "ending": "finished"})
    of_x = CensoredQLearner.of_paper(1, ["A", "B"], ["x"], reg=1e-3).fit(Logs(stages, ends)).policy_
    stages["action"], stages["probability"] = of_x.decide(stages, 1), 1.0
    stages["stepped_back"] = pd.Series([None] * num, dtype=object)
    other = np.where(of_x.decide(pd.DataFrame({"x": [5.0, 0.0]}), 1) == "A", "B", "A")
    # The rule decides in 5.0; in 0.0 another policy stepped back, and in 6.0 nobody did.
    stages.loc[[3, 4], ["x", "action"]] = [[5.0, other[0]], [0.0, other[1]]]
    stages.loc[[3, 4], "stepped_back"] = "out-of-range"
    stages.loc[8, "x"] = 6.0
    logs = Logs(stages, ends)
    together, known, (note,) = with_its_rule(of_x, logs, lambda rows: rows["x"].to_numpy() > 1.0)
    named = np.array(together.actions)[together.probabilities(known.stages, 1).argmax(axis=1)]
    rows = known.stages["trajectory"].to_numpy()
    expected = np.where(rows == 3, other[0], of_x.decide(known.stages, 1))
    assert named.tolist() == expected.tolist()
    assert note.startswith("in 1 stage the state lies outside the policy's logs, or beyond its horizon: the rule")
    assert with_its_rule(of_x, logs) == (of_x, logs, ())
