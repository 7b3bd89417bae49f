"""Each estimator against a loop, an enumeration, and a model that is wrong on purpose."""

from functools import cache

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, specified, trial, truth

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import FixedSequence, QSpec, evaluate
from halfseen.learning import DoublyRobust, NamedActions, Unweighted
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))
VALUE, LOGGED = truth(TARGET.chance_b), truth(CHANCE_B)


@cache
def log(seed=5, **options):
    return trial(seed, **({"cut_rate": 0.1} | options))


def found_of(policy=TARGET, logs=None, censoring="kaplan-meier", **options):
    """An evaluation beside the logging policy alone, with a Q that is saturated."""
    spec = {name: options.pop(name) for name in ("actions", "covariates") if name in options}
    against = {"against": "logging"} | options
    return evaluate(policy, log() if logs is None else logs, **specified(censoring, **spec), **against)


def is_within(estimate, value, errors):
    return abs(estimate.value - value) < errors * estimate.standard_error


def naive_importance_sampling(logs, chance_b):
    """Σ over stages of Σ w R / Σ w, in loops; a trajectory that has ended keeps its last weight."""
    survival = KaplanMeier().fit(logs.end_s, logs.is_finished).survival
    kept = {trajectory: frame.sort_values("stage") for trajectory, frame in logs.stages.groupby("trajectory")}
    value = 0.0
    for stage in (1, 2):
        mass = total = 0.0
        for trajectory, is_finished in zip(logs.trajectory_ids, logs.is_finished, strict=True):
            weight, reward = 1.0, 0.0
            for row in kept[trajectory].itertuples():
                if row.stage > stage:
                    break
                chance = chance_b[int(row.x)] if row.action == "B" else 1.0 - chance_b[int(row.x)]
                weight *= chance / row.probability
                reward = row.reward if row.stage == stage else 0.0
                is_seen, elapsed_s = not np.isnan(row.elapsed_s), row.elapsed_s
            if not is_seen or (len(kept[trajectory]) < stage and not is_finished):
                continue
            weight /= survival(np.array([elapsed_s]))[0]
            mass, total = mass + weight, total + weight * reward
        value += total / mass
    return value


def test_importance_sampling_is_the_loop():
    logs = log(0, cut_rate=0.12)
    assert 0.3 < logs.summary().cut_share < 0.6
    found = found_of(logs=logs)
    assert found.importance_sampling.value == pytest.approx(naive_importance_sampling(logs, TARGET.chance_b), rel=1e-9)
    assert found.logging.value == pytest.approx(naive_importance_sampling(logs, CHANCE_B), rel=1e-9)


def test_the_logging_policy_on_uncut_logs_earns_the_mean_reward_exactly():
    logs = log(1, cut_rate=0.0)
    found = found_of(StatePolicy(tuple(CHANCE_B)), logs)
    sampled, totals = found.importance_sampling, logs.stages.groupby("trajectory")["reward"].sum()
    assert sampled.value == pytest.approx(totals.mean(), rel=1e-12)
    assert sampled.standard_error == pytest.approx(totals.std() / np.sqrt(len(totals)), rel=1e-9)
    assert sampled.effective_sample_size == pytest.approx(len(totals))
    assert found.logging.value == sampled.value
    # The interval is the wider one of that by trajectories and that of the jackknife.
    assert found.logging.high >= sampled.high


@pytest.mark.parametrize("censoring", [DoublyRobust(), "kaplan-meier"], ids=["doubly robust", "weighted"])
@pytest.mark.slow
def test_all_three_find_the_value_on_a_long_log(censoring):
    found = found_of(logs=log(2, num_trajectories=3000, cut_rate=0.12), censoring=censoring)
    for estimate in (found.importance_sampling, found.fitted_q, found.doubly_robust):
        assert is_within(estimate, VALUE, 3.0)
        assert estimate.standard_error < 0.15
    assert is_within(found.logging, LOGGED, 3.0)
    assert is_within(found.difference, VALUE - LOGGED, 3.0)
    assert found.verdict == "better"


@pytest.mark.slow
def test_a_wrong_q_leaves_the_doubly_robust_value_right():
    found = found_of(logs=log(3, num_trajectories=3000, cut_rate=0.12), censoring=DoublyRobust(), covariates=())
    assert not is_within(found.fitted_q, VALUE, 5.0)
    assert is_within(found.doubly_robust, VALUE, 2.0)


@pytest.mark.slow
def test_wrong_cuts_leave_the_doubly_robust_value_right_and_bias_the_weighted_one():
    # It believes that half of what goes on is cut every other second, so what took long weighs far too much.
    wrong = KaplanMeier().fit(np.array([2.0] * 8 + [4.0] * 4 + [6.0] * 2 + [9.0] * 2), np.arange(16) > 13)
    logs = log(4, num_trajectories=3000, cut_rate=0.15)
    right_q, by_weights = (found_of(logs=logs, censoring=each) for each in (DoublyRobust(wrong), wrong))
    assert is_within(right_q.doubly_robust, VALUE, 2.0)
    assert is_within(right_q.logging, LOGGED, 2.0)
    assert not is_within(by_weights.logging, LOGGED, 3.0)


def test_what_changes_nothing():
    """The order of trajectories, what is not looked at, a horizon that no trajectory reaches, the global seed."""
    logs = log()
    found = found_of(random_state=1)
    shuffled = Logs(logs.stages.sample(frac=1, random_state=0), logs.trajectories.assign(colour="red"))
    for other in (
        found_of(logs=shuffled, random_state=1),
        found_of(StatePolicy(TARGET.chance_b, horizon=4), random_state=1),
    ):
        assert other.doubly_robust.value == pytest.approx(found.doubly_robust.value, rel=1e-9)
        assert other.importance_sampling.value == pytest.approx(found.importance_sampling.value, rel=1e-9)
    np.random.seed(3)  # noqa: NPY002
    assert found_of(random_state=1) == found
    assert found_of(random_state=2).doubly_robust != found.doubly_robust


def test_a_log_without_cuts_needs_no_model_of_them():
    by_weights, alike = (found_of(logs=log(19, cut_rate=0.0), censoring=one) for one in ("kaplan-meier", Unweighted()))
    assert by_weights.doubly_robust.value == pytest.approx(alike.doubly_robust.value, rel=1e-12)


def test_estimated_propensity_needs_no_column_and_is_as_good():
    logs = log(8, num_trajectories=2000, has_probability=False)
    assert is_within(found_of(logs=logs, propensity="estimated").doubly_robust, VALUE, 3.0)
    with pytest.raises(LogError, match="trajectory 0, stage 1: the probability of its action was not logged"):
        found_of(logs=logs)


def test_the_action_of_the_cut_stage_is_needed_by_pseudo_outcomes_alone():
    logs = log(9, cut_rate=0.15, knows_last_action=False)
    assert np.isfinite(found_of(logs=logs).doubly_robust.value)
    with pytest.raises(ArgumentError, match="its action is null"):
        found_of(logs=logs, censoring=DoublyRobust())


def test_verdicts_of_all_three_kinds():
    logs = log(11, num_trajectories=1000)
    assert found_of(StatePolicy((0.0, 1.0)), logs).verdict == "better"
    worse = found_of(StatePolicy((1.0, 0.0)), logs)
    assert worse.verdict == "not better"
    assert worse.sentence.startswith("Not better: it earns ")
    assert found_of(StatePolicy((0.31, 0.59)), trial(12, num_trajectories=50)).verdict == "inconclusive"
    few = found_of(StatePolicy((1.0, 0.0)), trial(20, num_trajectories=20, cut_rate=0.15))
    assert few.doubly_robust.effective_sample_size < 2
    assert few.verdict == "inconclusive"
    assert "at least 2 are needed" in few.reason


def test_an_action_that_a_stage_never_saw_is_named():
    stages = log(14, cut_rate=0.0).stages
    only_a = stages.assign(action=np.where(stages["stage"] == 2, "A", stages["action"]))
    found = found_of(FixedSequence(("A", "B")), Logs(only_a, log(14, cut_rate=0.0).trajectories))
    assert found.support[1] == 0.0
    assert found.verdict == "inconclusive"
    assert "the policy takes B in stage 2, which no trajectory" in found.reason


def test_where_a_log_never_explored_q_alone_makes_nothing_better():
    whole = trial(15, num_trajectories=1500)
    is_rule = whole.stages["action"] == np.where(whole.stages["x"] == 0, "A", "B")
    followed = is_rule.groupby(whole.stages["trajectory"]).all()
    kept = whole.select(followed.index[followed].to_numpy())
    logs = Logs(kept.stages.assign(probability=1.0), kept.trajectories)
    other = found_of(StatePolicy((0.0, 0.0)), logs)
    assert other.verdict == "inconclusive"
    share = (logs.stages["x"] == 1)[logs.stages["elapsed_s"].notna()].mean()
    assert f"in {share:.0%} of the stages the policy does something else where the log took" in other.reason
    # As the log does, but in one stage of a hundred.
    assert found_of(StatePolicy((0.0, 0.99)), logs).verdict != "inconclusive"
    assert "something else" not in found_of(StatePolicy((0.0, 1.0)), logs).reason


def test_a_fixed_sequence_is_worth_what_enumeration_says():
    found = found_of(FixedSequence(("B", "B")), trial(10, num_trajectories=2000))
    assert is_within(found.doubly_robust, truth((1.0, 1.0)), 3.0)


def test_what_is_not_said_is_one_q_for_all_stages_and_cox_on_their_clock():
    # x has two values, so its square says nothing new.
    named = QSpec(NamedActions({1: ["B", "A"], 2: ["B", "A"]}, ["x", "stage"]), stages="pooled", reg=1e-3)
    by_cox, sequence = DoublyRobust("cox", by="pooled", truncate_at=10.0), FixedSequence(("B", "B"))
    for knows, censoring in ((True, by_cox), (False, "kaplan-meier")):
        logs = log(18, num_trajectories=100, knows_last_action=knows)
        said, unsaid = {"censoring": censoring, "q": named}, {"against": "logging"}
        assert evaluate(sequence, logs, **unsaid) == evaluate(sequence, logs, **unsaid, **said)


@pytest.mark.parametrize(
    ("policy", "options", "message"),
    [
        (TARGET, {"level": 1.0}, "level is 1.0"),
        (TARGET, {"level": 1.0 - 1e-12}, "give a number above 0 and at most 0.999999"),
        (TARGET, {"propensity": "guessed"}, "propensity is 'guessed'"),
        (TARGET, {"num_folds": 1}, "num_folds is 1"),
        (StatePolicy((0.0, 1.0), horizon=1), {}, "but a trajectory has 2 stages"),
        (FixedSequence(("A", "C")), {}, "takes 'C', which is not an action"),
        ("no policy", {}, "str does not decide about named actions"),
        (TARGET, {"censoring": "none"}, "censoring is 'none', which gives no weights"),
        (FixedSequence(("B", "B")), {"actions": {1: ["A", "B"], 2: ["A"]}}, "action 'B' was not possible"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(policy, options, message):
    with pytest.raises((ArgumentError, LogError), match=message) as refusal:
        found_of(policy, log(16), **options)
    assert "\n" not in str(refusal.value)
