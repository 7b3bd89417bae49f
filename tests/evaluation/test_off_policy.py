"""Each estimator against a loop, an enumeration, and a model that is wrong on purpose."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, specified, trial, truth

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import FixedSequence, QSpec, evaluate, held_out_verdict
from halfseen.learning import CensoredQLearner, DoublyRobust, NamedActions, Unweighted
from halfseen.logs import Logs
from refusals import refused_type

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
    assert (
        f"in {share:.0%} of the stages the policy deviates from the log where the log took its action" in other.reason
    )
    # As the log does, but in one stage of a hundred.
    assert found_of(StatePolicy((0.0, 0.99)), logs).verdict != "inconclusive"
    assert "something else" not in found_of(StatePolicy((0.0, 1.0)), logs).reason


def by_threshold(seed, num_trajectories, exploring):
    """One stage without probabilities: A above a threshold, where it pays, and B below, but for a share."""
    rng = np.random.default_rng(seed)
    x, rows = rng.normal(size=num_trajectories), np.arange(num_trajectories)
    takes_a = (x > 0) != (rng.random(num_trajectories) < exploring)
    reward = np.where(takes_a, np.where(x > 0, 2.0 - x, -3.0), 0.5) + 0.3 * rng.normal(size=num_trajectories)
    action, end_s = np.where(takes_a, "A", "B"), 1.0 + rng.random(num_trajectories)
    stages = {"trajectory": rows, "stage": 1, "action": action, "x": x, "elapsed_s": end_s, "reward": reward}
    return Logs(pd.DataFrame(stages), pd.DataFrame({"trajectory": rows, "end_s": end_s, "ending": "finished"}))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_an_unlogged_rule_that_never_explores_makes_nothing_better(seed):
    # Above the threshold A pays more the lower x is, and a line through that is far off below, where A was not tried.
    logs = by_threshold(seed, 400, exploring=0.0)
    found = evaluate(FixedSequence(("A",)), logs, propensity="estimated", against="logging")
    assert found.fitted_q.low > found.logging.high
    assert found.verdict == "inconclusive"
    assert "of the stages the policy deviates from the log where the log seems never to do so" in found.reason
    learner = CensoredQLearner.of_paper(1, ["A", "B"], ["x"]).fit(logs)
    assert set(learner.decide(pd.DataFrame({"x": [-1.0, -0.5]}), 1)) == {"A"}
    assert held_out_verdict(learner, logs).verdict == "inconclusive"


def test_chance_in_many_covariates_is_no_lack_of_exploration():
    # A model of the actions with many coefficients fits the actions that it was fitted to too well.
    rng, rows = np.random.default_rng(0), np.arange(200)
    action = np.where(rng.random(200) < 0.3, rng.choice(["B", "C", "D"], 200), "A")
    x = {f"x{k}": rng.normal(size=200) for k in range(5)}
    stages = {"trajectory": rows, "stage": 1, "action": action, "elapsed_s": 1.0, "reward": rng.normal(size=200), **x}
    logs = Logs(pd.DataFrame(stages), pd.DataFrame({"trajectory": rows, "end_s": 1.0, "ending": "finished"}))
    policy = CensoredQLearner.of_paper(1, ["A", "B", "C", "D"], list(x)).fit(logs).policy_
    found = evaluate(policy, logs, propensity="estimated", against="logging")
    assert "the outcome is unknown" not in found.reason


def test_an_unlogged_rule_that_explores_is_judged():
    logs = by_threshold(0, 400, exploring=0.2)
    found = evaluate(FixedSequence(("A",)), logs, propensity="estimated", against="logging")
    assert found.verdict == "not better"


@dataclass(frozen=True)
class GivenChances:
    """Gives each state of a stage the same row, or an array of any other shape."""

    row: tuple[float, ...] = ()
    shape: tuple[int, ...] = ()
    horizon: int = 2
    actions: tuple[str, ...] = ("A", "B")

    def probabilities(self, frame, stage):
        return np.full(self.shape, 0.5) if self.shape else np.tile(self.row, (len(frame), 1))


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (
            GivenChances((0.45, 0.45)),
            r"GivenChances.probabilities, stage 1, row 0: \[0.45, 0.45\] for A, B are no prob",
        ),
        (GivenChances((1.0, 1.0)), "give numbers ≥ 0 that add up to 1"),
        (GivenChances((1.5, -0.5)), r"\[1.5, -0.5\] for A, B"),
        (GivenChances((0.0, 0.0)), "that add up to 1"),
        (GivenChances(shape=(2, 100)), r"stage 1: the shape is \(2, 100\); give one row a state.*: \(100, 2\)"),
        (GivenChances(shape=(100,)), r"the shape is \(100,\)"),
        (GivenChances(shape=(1, 2)), r"the shape is \(1, 2\)"),
    ],
)
@pytest.mark.parametrize("is_baseline", [False, True])
def test_probabilities_that_are_none_are_refused_rather_than_weighted(policy, message, is_baseline):
    given = (TARGET, policy) if is_baseline else (policy, None)
    with pytest.raises(ArgumentError, match=message):
        found_of(given[0], log(16, num_trajectories=100), against=given[1])


def test_probabilities_in_single_precision_are_as_good():
    single = GivenChances(tuple(np.float32([0.3, 0.7])))
    logs = log(16, num_trajectories=100)
    assert found_of(single, logs).doubly_robust.value == pytest.approx(
        found_of(GivenChances((0.3, 0.7)), logs).doubly_robust.value, rel=1e-5
    )


def test_a_fixed_sequence_is_worth_what_enumeration_says():
    found = found_of(FixedSequence(("B", "B")), trial(10, num_trajectories=2000))
    assert is_within(found.doubly_robust, truth((1.0, 1.0)), 3.0)


@pytest.mark.parametrize("stage", [-1, 0, 3])
def test_a_fixed_sequence_has_no_action_for_a_stage_that_it_does_not_name(stage):
    with pytest.raises(ArgumentError, match=f"stage is {stage}; it lies in 1 to the horizon, 2"):
        FixedSequence(("A", "B")).probabilities(pd.DataFrame(index=[0]), stage)


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
        (TARGET, {"random_state": -1}, "random_state is -1; it is a seed, a whole number ≥ 0"),
        (StatePolicy((0.0, 1.0), horizon=1), {}, "but a trajectory has 2 stages"),
        (FixedSequence(("A", "C")), {}, "takes 'C', which is not an action"),
        ("no policy", {}, "str does not decide about named actions; give a policy with actions, horizon and prob"),
        (TARGET, {"censoring": "none"}, "censoring is 'none', which gives no weights"),
        (FixedSequence(("B", "B")), {"actions": {1: ["A", "B"], 2: ["A"]}}, "action 'B' was not possible"),
    ],
)
def test_what_does_not_fit_is_reported_in_one_line(policy, options, message):
    with pytest.raises((ArgumentError, LogError), match=message) as refusal:
        found_of(policy, log(16), **options)
    assert "\n" not in str(refusal.value)


def test_a_function_class_is_no_task():
    with refused_type("task is 'linear'; give a Task, or None for that of the policy"):
        QSpec("linear")


def test_a_sequence_of_no_names_and_a_stage_in_between_are_refused():
    for sequence in (None, 3, (name for name in "AB")):
        with refused_type("sequence is .*; give a tuple of names, one for each stage"):
            FixedSequence(sequence)
    with refused_type("stage is 1.5; it lies in 1 to the horizon, 2"):
        FixedSequence(("A", "B")).probabilities(pd.DataFrame(index=[0]), 1.5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"logs": pd.DataFrame({"trajectory": [0]})}, "logs is a DataFrame; give Logs, as read_logs returns"),
        ({"q": "linear"}, "q is 'linear'; give QSpec"),
        ({"workers": 4}, "workers is 4; give Workers of halfseen.workers, such as Workers"),
        ({"level": None}, "level is None; give a number above 0"),
        ({"trust": 3}, "trust is 3; give a list of some of"),
        (
            {"trust": "covariates"},
            "trust is 'covariates'; give a list of some of probabilities, covariates, endings",
        ),
    ],
)
def test_arguments_of_another_type_are_refused_in_one_line(changed, message):
    given = {"logs": log(16, num_trajectories=100)} | changed
    with refused_type(message):
        evaluate(TARGET, **given)


@pytest.mark.parametrize("sequence", [(), "AB"])
def test_a_sequence_that_is_empty_or_text_is_refused(sequence):
    with refused_type("give a tuple of names, one for each stage"):
        FixedSequence(sequence)


def test_the_order_in_which_actions_are_given_changes_nothing():
    rng, n, names = np.random.default_rng(4), 120, ["wait", "act", "stop"]
    x, action, ended_s = rng.random(n), rng.choice(names, n), rng.exponential(2.0, n)
    stages = {"trajectory": np.arange(n), "stage": 1, "x": x, "action": action, "probability": 1 / 3}
    cut_s = rng.exponential(np.where(action == "wait", 2.0, 6.0))
    stages |= {"elapsed_s": np.where(ended_s <= cut_s, ended_s, np.nan)}
    stages |= {"reward": np.where(ended_s <= cut_s, x + (action == "act") + rng.normal(size=n), np.nan)}
    ends = {"end_s": np.minimum(ended_s, cut_s), "ending": np.where(ended_s <= cut_s, "finished", "cut")}
    logs = Logs(pd.DataFrame(stages), pd.DataFrame({"trajectory": np.arange(n)} | ends))
    found = []
    for actions in (names, names[::-1]):
        policy = CensoredQLearner(1, actions, ["x"], q_function="linear", reg=0.1).fit(logs).policy_
        found.append(evaluate(policy, logs, against="logging"))
    assert found[0].doubly_robust.value == pytest.approx(found[1].doubly_robust.value, rel=1e-9)
    assert found[0].verdict == found[1].verdict
