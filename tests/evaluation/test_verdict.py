"""What is said where nothing can be said, and how many paths would do."""

import json

import numpy as np
import pandas as pd
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, trial

from halfseen.evaluation import FixedSequence, evaluate, held_out_verdict
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.held_out import learn_by_folds
from halfseen.evaluation.off_policy import default_q, default_targets, q_model_of
from halfseen.evaluation.problem import as_logged, problem_of
from halfseen.evaluation.targets import CrossFitted
from halfseen.evaluation.verdict import verdict_of, why_unknown
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.workers import Workers


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


LAST = "(said of policies learned the same way from four fifths of the log and judged on the rest)."


def learner(**parameters):
    return CensoredQLearner.of_paper(2, ["A", "B"], ["x"], reg=1e-3, **parameters)


def with_rewards_of(logs, path, reward):
    stages = logs.stages.copy()
    stages.loc[(stages["path"] == path) & stages["reward"].notna(), "reward"] = reward
    return Logs(stages, logs.paths)


def test_a_path_has_no_say_in_the_policy_that_decides_for_it():
    logs = trial(0, num_paths=202, cut_rate=0.05)
    before = learn_by_folds(learner(), logs, 5)
    shaken = with_rewards_of(logs, 7, 1e4)
    after = learn_by_folds(learner(), shaken, 5)
    own = before.fold[7]
    is_same = [
        np.array_equal(a.coefficients, b.coefficients) for a, b in zip(before.policies, after.policies, strict=True)
    ]
    # 202 paths are no five times as many, so one of the others may be left out of a fold's log.
    assert is_same[own]
    assert sum(is_same) <= 2
    assert np.bincount(before.fold).tolist() == [41, 41, 40, 40, 40]


def test_each_fold_is_learned_as_the_learner_would_from_the_other_paths():
    logs = trial(1, num_paths=200, cut_rate=0.05)
    crossed = learn_by_folds(learner(), logs, 5)
    alone = learner().fit(logs.select(logs.path_ids[crossed.fold != 2])).policy_
    np.testing.assert_array_equal(crossed.policies[2].coefficients, alone.coefficients)


@pytest.mark.slow
def test_workers_come_to_the_same_verdict():
    logs = trial(1, num_paths=200, cut_rate=0.05)
    fitted = learner(censoring="buckley-james").fit(logs)
    alone, together = (held_out_verdict(fitted, logs, workers=Workers(num)) for num in (1, 2))
    assert alone == together
    assert alone.evaluation is not None


def test_each_path_is_decided_by_the_policy_of_its_fold():
    logs = trial(2, num_paths=60)
    fold = np.arange(60) % 2
    task = learner().compose().task
    crossed = CrossFitted((FixedSequence(("A", "A")), FixedSequence(("B", "B"))), fold, 2)
    chances = crossed.target_probabilities(logs, 2, task)
    assert (chances[fold == 0, 0] == [1.0, 0.0]).all()
    assert (chances[fold == 1, 0] == [0.0, 1.0]).all()


def test_what_helps_is_better_and_the_folds_are_pooled():
    logs = trial(3, num_paths=200, cut_rate=0.05)
    steps = []
    found = held_out_verdict(learner().fit(logs), logs, against="logging", on_progress=lambda: steps.append(1))
    assert (found.verdict, len(steps)) == ("better", 6)
    assert found.sentence.startswith("Better: it earns ")
    assert found.sentence.endswith(LAST)
    assert found.evaluation.num_paths == 200
    seen_all = evaluate(learner().fit(logs).policy_, logs, against="logging", censoring="kaplan-meier")
    assert found.evaluation.difference.value < seen_all.difference.value + seen_all.difference.standard_error
    kept = json.loads(json.dumps(found.as_dict()))
    assert kept["verdict"] == "better"
    assert kept["comparisons"][0]["opponent"] == "the logging policy"


def test_where_nothing_is_to_be_learned_nothing_is_claimed():
    logs = trial(4, num_paths=200)
    rng = np.random.default_rng(4)
    stages = logs.stages.assign(
        reward=np.where(logs.stages["reward"].notna(), rng.normal(size=logs.num_stages), np.nan)
    )
    noise = Logs(stages, logs.paths)
    found = held_out_verdict(learner().fit(noise), noise, against="logging")
    assert found.verdict != "better"
    low, high = found.evaluation.difference.low, found.evaluation.difference.high
    assert low < 0 < high


def test_too_few_paths_are_said_to_be_too_few():
    logs = trial(5, num_paths=12)
    found = held_out_verdict(learner().fit(logs), logs)
    assert found.evaluation is None
    assert found.sentence.startswith("Cannot be said: the log has 12 path(s), and 10 folds need 20; record more (said")
    few = logs.select(logs.path_ids[:3])
    assert "3 path(s) for 5 folds" in held_out_verdict(learner().fit(few), few).reason


def test_a_fold_that_cannot_be_learned_is_a_reason_and_no_error():
    """One path finished: without it, every path was cut."""
    paths = pd.DataFrame({"path": range(30), "end_s": 2.0, "ending": ["finished"] + ["cut"] * 29})
    stages = pd.DataFrame(
        {"path": range(30), "stage": 1, "elapsed_s": np.nan, "action": "A", "reward": np.nan, "x": 0.0}
    )
    stages.loc[0, ["elapsed_s", "reward"]] = [2.0, 1.0]
    logs = Logs(stages.assign(action=["A", "B"] * 15), paths)
    found = held_out_verdict(learner().set_params(horizon=1).fit(logs), logs)
    assert (found.verdict, found.evaluation) == ("cannot be said", None)
    assert "cut" in found.reason
