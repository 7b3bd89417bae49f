"""Each estimator against a loop, an enumeration, and a model that is wrong on purpose."""

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, specified, trial, truth

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import FixedSequence, QSpec, evaluate
from halfseen.learning import DoublyRobust, NamedActions, Unweighted
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))


def naive_importance_sampling(logs, chance_b):
    """Σ over stages of Σ w R / Σ w, in loops; a path that has ended keeps its last weight."""
    survival = KaplanMeier().fit(logs.end_s, logs.is_finished).survival
    kept = {path: frame.sort_values("stage") for path, frame in logs.stages.groupby("path")}
    value = 0.0
    for stage in (1, 2):
        mass = total = 0.0
        for path, is_finished in zip(logs.path_ids, logs.is_finished, strict=True):
            weight, reward = 1.0, 0.0
            for row in kept[path].itertuples():
                if row.stage > stage:
                    break
                chance = chance_b[int(row.x)] if row.action == "B" else 1.0 - chance_b[int(row.x)]
                weight *= chance / row.probability
                reward = row.reward if row.stage == stage else 0.0
                is_seen, elapsed_s = not np.isnan(row.elapsed_s), row.elapsed_s
            if not is_seen or (len(kept[path]) < stage and not is_finished):
                continue
            weight /= survival(np.array([elapsed_s]))[0]
            mass, total = mass + weight, total + weight * reward
        value += total / mass
    return value


def test_importance_sampling_is_the_loop():
    logs = trial(0, cut_rate=0.12)
    assert 0.3 < logs.summary().cut_share < 0.6
    found = evaluate(TARGET, logs, **specified())
    assert found.importance_sampling.value == pytest.approx(naive_importance_sampling(logs, TARGET.chance_b), rel=1e-9)
    assert found.logging.value == pytest.approx(naive_importance_sampling(logs, CHANCE_B), rel=1e-9)


def test_the_logging_policy_on_uncut_logs_earns_the_mean_reward_exactly():
    logs = trial(1)
    found = evaluate(StatePolicy(tuple(CHANCE_B)), logs, **specified())
    totals = logs.stages.groupby("path")["reward"].sum()
    assert found.importance_sampling.value == pytest.approx(totals.mean(), rel=1e-12)
    assert found.importance_sampling.standard_error == pytest.approx(totals.std() / np.sqrt(len(totals)), rel=1e-9)
    assert found.importance_sampling.effective_sample_size == pytest.approx(len(totals))
    assert found.logging.value == found.importance_sampling.value
    # The interval is the wider one of that by paths and that of the jackknife.
    assert found.logging.high >= found.importance_sampling.high


@pytest.mark.parametrize("censoring", [DoublyRobust(), "kaplan-meier"], ids=["doubly robust", "weighted"])
@pytest.mark.slow
def test_all_three_find_the_value_on_a_long_log(censoring):
    found = evaluate(TARGET, trial(2, num_paths=3000, cut_rate=0.12), against="logging", **specified(censoring))
    value = truth(TARGET.chance_b)
    for estimate in (found.importance_sampling, found.fitted_q, found.doubly_robust):
        assert abs(estimate.value - value) < 3.0 * estimate.standard_error
        assert estimate.standard_error < 0.15
    assert abs(found.logging.value - truth(CHANCE_B)) < 3.0 * found.logging.standard_error
    gain = value - truth(CHANCE_B)
    assert abs(found.difference.value - gain) < 3.0 * found.difference.standard_error
    assert found.verdict == "better"


@pytest.mark.slow
def test_a_wrong_q_leaves_the_doubly_robust_value_right():
    found = evaluate(TARGET, trial(3, num_paths=3000, cut_rate=0.12), **specified(DoublyRobust(), covariates=()))
    value = truth(TARGET.chance_b)
    assert abs(found.fitted_q.value - value) > 5.0 * found.fitted_q.standard_error
    assert abs(found.doubly_robust.value - value) < 2.0 * found.doubly_robust.standard_error


@pytest.mark.slow
def test_wrong_cuts_leave_the_doubly_robust_value_right_and_bias_the_weighted_one():
    # It believes that half of what goes on is cut every other second, so what took long weighs far too much.
    wrong = KaplanMeier().fit(np.array([2.0] * 8 + [4.0] * 4 + [6.0] * 2 + [9.0] * 2), np.arange(16) > 13)
    logs, value = trial(4, num_paths=3000, cut_rate=0.15), truth(TARGET.chance_b)
    right_q = evaluate(TARGET, logs, **specified(DoublyRobust(wrong)))
    by_weights = evaluate(TARGET, logs, **specified(wrong))
    assert abs(right_q.doubly_robust.value - value) < 2.0 * right_q.doubly_robust.standard_error
    assert abs(right_q.logging.value - truth(CHANCE_B)) < 2.0 * right_q.logging.standard_error
    assert abs(by_weights.logging.value - truth(CHANCE_B)) > 3.0 * by_weights.logging.standard_error


def test_order_of_paths_and_what_is_not_looked_at_change_nothing():
    logs = trial(5, cut_rate=0.1)
    shuffled = Logs(logs.stages.sample(frac=1, random_state=0), logs.paths.assign(colour="red"))
    one, other = (evaluate(TARGET, each, **specified()) for each in (logs, shuffled))
    assert one.doubly_robust.value == pytest.approx(other.doubly_robust.value, rel=1e-9)


def test_a_horizon_that_no_path_reaches_changes_nothing():
    logs = trial(6, cut_rate=0.1)
    short = evaluate(TARGET, logs, **specified())
    long = evaluate(StatePolicy(TARGET.chance_b, horizon=4), logs, **specified())
    assert long.doubly_robust.value == pytest.approx(short.doubly_robust.value, rel=1e-9)
    assert long.importance_sampling.value == pytest.approx(short.importance_sampling.value, rel=1e-9)


def test_the_seed_deals_the_folds_and_the_global_one_does_not():
    logs = trial(7, cut_rate=0.1)
    first = evaluate(TARGET, logs, **specified(), random_state=1)
    np.random.seed(3)  # noqa: NPY002
    assert evaluate(TARGET, logs, **specified(), random_state=1) == first
    assert evaluate(TARGET, logs, **specified(), random_state=2).doubly_robust != first.doubly_robust


def test_estimated_propensity_needs_no_column_and_is_as_good():
    logs = trial(8, num_paths=2000, cut_rate=0.1, has_probability=False)
    found = evaluate(TARGET, logs, **specified(), propensity="estimated")
    assert abs(found.doubly_robust.value - truth(TARGET.chance_b)) < 3.0 * found.doubly_robust.standard_error
    with pytest.raises(LogError, match="path 0, stage 1: its probability was not logged"):
        evaluate(TARGET, logs, **specified())


def test_the_action_of_the_cut_stage_is_needed_by_pseudo_outcomes_alone():
    logs = trial(9, cut_rate=0.15, knows_last_action=False)
    assert np.isfinite(evaluate(TARGET, logs, **specified()).doubly_robust.value)
    with pytest.raises(ArgumentError, match="its action is null"):
        evaluate(TARGET, logs, **specified(DoublyRobust()))


def test_verdicts_of_all_three_kinds():
    logs = trial(11, num_paths=1000, cut_rate=0.1)
    assert evaluate(StatePolicy((0.0, 1.0)), logs, against="logging", **specified()).verdict == "better"
    worse = evaluate(StatePolicy((1.0, 0.0)), logs, against="logging", **specified())
    assert worse.verdict == "not better"
    assert worse.sentence.startswith("Not better: it earns ")
    assert (
        evaluate(StatePolicy((0.31, 0.59)), trial(12, num_paths=50), against="logging", **specified()).verdict
        == "cannot be said"
    )


def test_too_few_paths_that_follow_the_policy_are_no_evidence():
    found = evaluate(StatePolicy((1.0, 0.0)), trial(13, num_paths=40, cut_rate=0.15), **specified())
    assert found.doubly_robust.effective_sample_size < 10
    assert found.verdict == "cannot be said"
    assert "fewer than 10" in found.reason


def test_an_action_that_a_stage_never_saw_is_named():
    logs = trial(14)
    only_a = logs.stages.assign(action=np.where(logs.stages["stage"] == 2, "A", logs.stages["action"]))
    found = evaluate(FixedSequence(("A", "B")), Logs(only_a, logs.paths), **specified())
    assert found.support[1] == 0.0
    assert found.verdict == "cannot be said"
    assert "the policy takes B in stage 2, which no path" in found.reason


@pytest.mark.parametrize(
    ("policy", "parameters", "options", "message"),
    [
        (TARGET, {}, {"level": 1.0}, "level is 1.0"),
        (TARGET, {}, {"level": 1.0 - 1e-12}, "it lies between 0 and 1, and is 0.999999 at most"),
        (TARGET, {}, {"propensity": "guessed"}, "propensity is 'guessed'"),
        (TARGET, {}, {"num_folds": 1}, "num_folds is 1"),
        (StatePolicy((0.0, 1.0), horizon=1), {}, {}, "but a path has 2 stages"),
        (FixedSequence(("A", "C")), {}, {}, "takes 'C', which is none of the actions"),
        ("no policy", {}, {}, "str decides nothing about named actions"),
        (TARGET, {"censoring": "none"}, {}, "censoring is 'none', which gives no weights"),
        (FixedSequence(("B", "B")), {"actions": {1: ["A", "B"], 2: ["A"]}}, {}, "action 'B' was not possible"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(policy, parameters, options, message):
    with pytest.raises((ArgumentError, LogError), match=message) as refusal:
        evaluate(policy, trial(16, cut_rate=0.1), **specified(**parameters), **options)
    assert "\n" not in str(refusal.value)


def test_what_is_not_said_is_one_q_for_all_stages_and_cox_on_their_clock():
    logs = trial(18, cut_rate=0.1)
    # x has two values, so its square says nothing new.
    named = QSpec(NamedActions({1: ["B", "A"], 2: ["B", "A"]}, ["x", "stage"]), stages="pooled", reg=1e-3)
    by_cox = DoublyRobust("cox", by="pooled", truncate_at=10.0)
    sequence = FixedSequence(("B", "B"))
    assert evaluate(sequence, logs) == evaluate(sequence, logs, censoring=by_cox, q=named)
    last_unknown = trial(18, cut_rate=0.1, knows_last_action=False)
    assert evaluate(sequence, last_unknown) == evaluate(sequence, last_unknown, censoring="kaplan-meier", q=named)
    with pytest.raises(ArgumentError, match="str decides nothing about named actions, which the log is of"):
        evaluate("no policy", logs)


def test_a_fixed_sequence_is_worth_what_enumeration_says():
    found = evaluate(FixedSequence(("B", "B")), trial(10, num_paths=2000), **specified())
    assert abs(found.doubly_robust.value - truth((1.0, 1.0))) < 3.0 * found.doubly_robust.standard_error


def test_a_log_without_cuts_needs_no_model_of_them():
    logs = trial(19)
    by_weights, alike = (evaluate(TARGET, logs, **specified(one)) for one in ("kaplan-meier", Unweighted()))
    assert by_weights.doubly_robust.value == pytest.approx(alike.doubly_robust.value, rel=1e-12)
