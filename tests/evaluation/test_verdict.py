"""What is said where nothing can be said, how many trajectories would do, and verdicts by folds."""

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, problem, trial

from halfseen.evaluation import FixedSequence, evaluate, held_out_verdict
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.held_out import learn_by_folds
from halfseen.evaluation.problem import as_logged
from halfseen.evaluation.targets import CrossFitted
from halfseen.evaluation.verdict import verdict_of, why_unknown
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.workers import Workers

POLICY = StatePolicy((0.9, 0.2))
log = cache(trial)


def test_of_uncut_trajectories_as_many_are_worth_one_as_their_mean_squared_ratio_and_cuts_take_more():
    """States are fair coins, so stages have nothing to do with one another but that some end after the first."""
    chance_b = np.array(POLICY.chance_b)
    stage = 0.5 * (chance_b**2 / CHANCE_B + (1.0 - chance_b) ** 2 / (1.0 - CHANCE_B)).sum()
    leaves = 0.5 * (1.0 - CHANCE_B[1])
    by_state = problem(trial(0, num_trajectories=400), POLICY, num_folds=2)
    assert by_state.trajectories_for_one == pytest.approx(400 / by_state.effective_sample_size)
    logs = (trial(0, num_trajectories=4000), trial(0, num_trajectories=400, cut_rate=0.2))
    uncut, cut = (problem(each, POLICY, num_folds=2)._replace(marginal=None) for each in logs)
    assert uncut.trajectories_for_one == pytest.approx(leaves * stage + (1.0 - leaves) * stage**2, rel=0.1)
    assert as_logged(uncut).trajectories_for_one == pytest.approx(1.0)
    assert cut.trajectories_for_one == pytest.approx(cut.squared_ratio / (as_logged(cut).effective_sample_size / 400))
    assert cut.trajectories_for_one > 1.2 * uncut.trajectories_for_one


NONE_WOULD = "no log of a size that can be recorded would do"


@pytest.mark.parametrize(
    ("trajectories_for_one", "said"),
    [
        (231.0, "some 3,000 trajectories like these would do"),
        (41.0, "some 500 trajectories like these would do"),
        (30.0, "record more trajectories, or some of a logging policy"),
        *((trajectories, NONE_WOULD) for trajectories in (np.inf, np.nan, 1e9)),
    ],
)
def test_it_says_how_many_trajectories_would_do(trajectories_for_one, said):
    why = why_unknown("the policy", np.ones(2), 2.6, None, 400, trajectories_for_one)
    assert "the effective sample size is 2.6" in why
    assert said in why
    assert why_unknown("the policy", np.ones(2), 10.0, None, 400, trajectories_for_one) is None
    assert why_unknown("the policy", np.ones(2), 2.6, None, 400, trajectories_for_one, 2.0) is None


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (-0.2, 0.03, "earns between 0.2 less and 0.03 parts more a trajectory than"),
        (0.1, 0.3, "more a trajectory than the logging policy, between 0.1 and 0.3 parts more"),
        (-0.3, -0.1, "less a trajectory than the logging policy, between 0.1 and 0.3 parts less"),
        (-0.3, 0.0, "less a trajectory than the logging policy, between 0 and 0.3 parts less"),
    ],
)
def test_ends_of_the_interval_are_told_as_more_and_less_without_a_sign(low, high, words):
    _, reason = verdict_of(Estimate((low + high) / 2.0, low, high, (high - low) / 4.0, 50.0), unit="parts")
    assert words in reason


def learner(**parameters):
    return CensoredQLearner.of_paper(2, ["A", "B"], ["x"], reg=1e-3, **parameters)


def with_rewards(logs, rewards, trajectory=None):
    """The log with other rewards where it has some, of one trajectory or of all."""
    is_other = logs.stages["reward"].notna() & ((logs.stages["trajectory"] == trajectory) | (trajectory is None))
    return Logs(logs.stages.assign(reward=np.where(is_other, rewards, logs.stages["reward"])), logs.trajectories)


def test_a_trajectory_has_no_say_in_the_policy_that_decides_for_it_which_is_learned_from_the_others():
    logs = log(0, num_trajectories=202, cut_rate=0.05)
    before, after = (learn_by_folds(learner(), each, 5) for each in (logs, with_rewards(logs, 1e4, trajectory=7)))
    policies = zip(before.policies, after.policies, strict=True)
    is_same = [np.array_equal(one.coefficients, other.coefficients) for one, other in policies]
    # 202 trajectories are no five times as many, so one of the others may be left out of a fold's log.
    assert is_same[before.fold[7]]
    assert sum(is_same) <= 2
    assert np.bincount(before.fold).tolist() == [41, 41, 40, 40, 40]
    logs = log(1, num_trajectories=200, cut_rate=0.05)
    crossed = learn_by_folds(learner(), logs, 5)
    alone = learner().fit(logs.select(logs.trajectory_ids[crossed.fold != 2])).policy_
    np.testing.assert_array_equal(crossed.policies[2].coefficients, alone.coefficients)


def test_each_trajectory_is_decided_by_the_policy_of_its_fold():
    fold = np.arange(60) % 2
    crossed = CrossFitted((FixedSequence(("A", "A")), FixedSequence(("B", "B"))), fold, 2)
    chances = crossed.target_probabilities(log(2, num_trajectories=60), 2, learner().compose().task)
    np.testing.assert_array_equal(chances[:, 0], np.eye(2)[fold])


@pytest.mark.slow
def test_workers_come_to_the_same_verdict():
    logs = log(1, num_trajectories=200, cut_rate=0.05)
    fitted = learner(censoring="buckley-james").fit(logs)
    alone, together = (held_out_verdict(fitted, logs, workers=Workers(num)) for num in (1, 2))
    assert alone == together
    assert alone.evaluation is not None


def test_what_helps_is_better_and_the_folds_are_pooled():
    logs, steps = log(3, num_trajectories=200, cut_rate=0.05), []
    fitted = learner().fit(logs)
    found = held_out_verdict(fitted, logs, against="logging", on_progress=lambda: steps.append(1))
    assert (found.verdict, len(steps)) == ("better", 6)
    assert found.sentence.startswith("Better: it earns ")
    said = "(said of policies learned the same way from four fifths of the log and judged on the rest)."
    assert found.sentence.endswith(said)
    assert found.evaluation.num_trajectories == 200
    seen_all = evaluate(fitted.policy_, logs, against="logging", censoring="kaplan-meier")
    assert found.evaluation.difference.value < seen_all.difference.value + seen_all.difference.standard_error
    kept = json.loads(json.dumps(found.as_dict()))
    assert (kept["verdict"], kept["comparisons"][0]["baseline"]) == ("better", "the logging policy")


def test_where_nothing_is_to_be_learned_nothing_is_claimed():
    logs = log(4, num_trajectories=200)
    noise = with_rewards(logs, np.random.default_rng(4).normal(size=logs.num_stages))
    found = held_out_verdict(learner().fit(noise), noise, against="logging")
    assert found.verdict != "better"
    assert found.evaluation.difference.low < 0 < found.evaluation.difference.high


def test_too_few_trajectories_are_said_to_be_too_few():
    logs = log(5, num_trajectories=12)
    found = held_out_verdict(learner().fit(logs), logs)
    assert found.evaluation is None
    assert found.sentence.startswith(
        "Inconclusive: the log has 12 trajectories, and 10 folds need 20; record more (said"
    )
    few = logs.select(logs.trajectory_ids[:3])
    assert "3 trajectories for 5 folds" in held_out_verdict(learner().fit(few), few).reason


def test_a_fold_that_cannot_be_learned_is_a_reason_and_no_error():
    """One trajectory finished: without it, every trajectory was cut."""
    trajectories = pd.DataFrame({"trajectory": range(30), "end_s": 2.0, "ending": ["finished"] + ["cut"] * 29})
    stages = pd.DataFrame({"trajectory": range(30), "stage": 1, "action": ["A", "B"] * 15, "x": 0.0})
    only_first = np.where(stages["trajectory"] == 0, 1.0, np.nan)
    logs = Logs(stages.assign(elapsed_s=2.0 * only_first, reward=only_first), trajectories)
    found = held_out_verdict(learner().set_params(horizon=1).fit(logs), logs)
    assert (found.verdict, found.evaluation) == ("inconclusive", None)
    assert "cut" in found.reason
