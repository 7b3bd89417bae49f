"""Each estimator against a loop, an enumeration, and a model that is wrong on purpose."""

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, model, trial, truth

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import FixedSequence, evaluate
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
    told = evaluate(TARGET, logs, model())
    assert told.importance_sampling.value == pytest.approx(naive_importance_sampling(logs, TARGET.chance_b), rel=1e-9)
    assert told.logging.value == pytest.approx(naive_importance_sampling(logs, CHANCE_B), rel=1e-9)


def test_the_logging_policy_on_uncut_logs_earns_the_mean_reward_exactly():
    logs = trial(1)
    told = evaluate(StatePolicy(tuple(CHANCE_B)), logs, model())
    totals = logs.stages.groupby("path")["reward"].sum()
    assert told.importance_sampling.value == pytest.approx(totals.mean(), rel=1e-12)
    assert told.importance_sampling.standard_error == pytest.approx(totals.std() / np.sqrt(len(totals)), rel=1e-9)
    assert told.importance_sampling.effective_sample_size == pytest.approx(len(totals))
    assert told.logging == told.importance_sampling


@pytest.mark.parametrize("augmented", [True, False])
def test_all_three_find_the_value_on_a_long_log(augmented):
    told = evaluate(TARGET, trial(2, num_paths=3000, cut_rate=0.12), model(augmented=augmented))
    value = truth(TARGET.chance_b)
    for estimate in (told.importance_sampling, told.fitted_q, told.doubly_robust):
        assert abs(estimate.value - value) < 3.0 * estimate.standard_error
        assert estimate.standard_error < 0.15
    assert abs(told.logging.value - truth(CHANCE_B)) < 3.0 * told.logging.standard_error
    gain = value - truth(CHANCE_B)
    assert abs(told.difference.value - gain) < 3.0 * told.difference.standard_error
    assert told.verdict == "better"


def test_a_wrong_q_leaves_the_doubly_robust_value_right():
    told = evaluate(TARGET, trial(3, num_paths=3000, cut_rate=0.12), model(covariates=(), augmented=True))
    value = truth(TARGET.chance_b)
    assert abs(told.fitted_q.value - value) > 5.0 * told.fitted_q.standard_error
    assert abs(told.doubly_robust.value - value) < 2.0 * told.doubly_robust.standard_error


def test_wrong_cuts_leave_the_augmented_value_right_and_bias_the_weighted_one():
    # It believes that half of what goes on is cut every other second, so what took long weighs far too much.
    wrong = KaplanMeier().fit(np.array([2.0] * 8 + [4.0] * 4 + [6.0] * 2 + [9.0] * 2), np.arange(16) > 13)
    logs, value = trial(4, num_paths=3000, cut_rate=0.15), truth(TARGET.chance_b)
    right_q = evaluate(TARGET, logs, model(censoring=wrong, augmented=True))
    by_weights = evaluate(TARGET, logs, model(censoring=wrong))
    assert abs(right_q.doubly_robust.value - value) < 2.0 * right_q.doubly_robust.standard_error
    assert abs(right_q.logging.value - truth(CHANCE_B)) < 2.0 * right_q.logging.standard_error
    assert abs(by_weights.logging.value - truth(CHANCE_B)) > 3.0 * by_weights.logging.standard_error


def test_order_of_paths_and_what_is_not_looked_at_change_nothing():
    logs = trial(5, cut_rate=0.1)
    shuffled = Logs(logs.stages.sample(frac=1, random_state=0), logs.paths.assign(colour="red"))
    one, other = (evaluate(TARGET, each, model()) for each in (logs, shuffled))
    assert one.doubly_robust.value == pytest.approx(other.doubly_robust.value, rel=1e-9)


def test_a_horizon_that_no_path_reaches_changes_nothing():
    logs = trial(6, cut_rate=0.1)
    short = evaluate(TARGET, logs, model())
    long = evaluate(StatePolicy(TARGET.chance_b, horizon=4), logs, model(horizon=4))
    assert long.doubly_robust.value == pytest.approx(short.doubly_robust.value, rel=1e-9)
    assert long.importance_sampling.value == pytest.approx(short.importance_sampling.value, rel=1e-9)


def test_the_seed_deals_the_folds_and_the_global_one_does_not():
    logs = trial(7, cut_rate=0.1)
    first = evaluate(TARGET, logs, model(), random_state=1)
    np.random.seed(3)  # noqa: NPY002
    assert evaluate(TARGET, logs, model(), random_state=1) == first
    assert evaluate(TARGET, logs, model(), random_state=2).doubly_robust != first.doubly_robust


def test_estimated_propensity_needs_no_column_and_is_as_good():
    logs = trial(8, num_paths=2000, cut_rate=0.1, has_probability=False)
    told = evaluate(TARGET, logs, model(), propensity="estimated")
    assert abs(told.doubly_robust.value - truth(TARGET.chance_b)) < 3.0 * told.doubly_robust.standard_error
    with pytest.raises(LogError, match="path 0, stage 1: its probability was not logged"):
        evaluate(TARGET, logs, model())


def test_the_action_of_the_cut_stage_is_needed_by_augmentation_alone():
    logs = trial(9, cut_rate=0.15, knows_last_action=False)
    assert np.isfinite(evaluate(TARGET, logs, model()).doubly_robust.value)
    with pytest.raises(ArgumentError, match="its action is null"):
        evaluate(TARGET, logs, model(augmented=True))


def test_a_fixed_sequence_is_worth_what_enumeration_says():
    told = evaluate(FixedSequence(("B", "B")), trial(10, num_paths=2000), model())
    assert abs(told.doubly_robust.value - truth((1.0, 1.0))) < 3.0 * told.doubly_robust.standard_error


def test_verdicts_of_all_three_kinds():
    logs = trial(11, num_paths=1000, cut_rate=0.1)
    assert evaluate(StatePolicy((0.0, 1.0)), logs, model()).verdict == "better"
    worse = evaluate(StatePolicy((1.0, 0.0)), logs, model())
    assert worse.verdict == "not better"
    assert worse.sentence.startswith("Not better: it earns ")
    assert evaluate(StatePolicy((0.31, 0.59)), trial(12, num_paths=50), model()).verdict == "cannot be said"


def test_too_few_paths_that_follow_the_policy_are_no_evidence():
    told = evaluate(StatePolicy((1.0, 0.0)), trial(13, num_paths=40, cut_rate=0.15), model())
    assert told.doubly_robust.effective_sample_size < 10
    assert told.verdict == "cannot be said"
    assert "fewer than 10" in told.reason


def test_a_stage_in_which_the_log_never_does_as_the_policy_is_named():
    logs = trial(14)
    only_a = logs.stages.assign(action=np.where(logs.stages["stage"] == 2, "A", logs.stages["action"]))
    told = evaluate(FixedSequence(("A", "B")), Logs(only_a, logs.paths), model())
    assert told.support[1] == 0.0
    assert told.verdict == "cannot be said"
    assert "no logged action of stage 2" in told.reason


def test_text_and_json_tell_the_same():
    told = evaluate(TARGET, trial(15), model(), level=0.9)
    lines = str(told).splitlines()
    assert lines[0] == told.sentence
    assert "90% interval" in lines[2]
    assert f"{told.doubly_robust.value:.4g}" in lines[3]
    assert told.as_dict()["doubly_robust"]["low"] == told.doubly_robust.low
    wide = evaluate(TARGET, trial(15), model(), level=0.99)
    assert wide.doubly_robust.high > told.doubly_robust.high


@pytest.mark.parametrize(
    ("policy", "parameters", "options", "message"),
    [
        (TARGET, {}, {"level": 1.0}, "level is 1.0"),
        (TARGET, {}, {"propensity": "guessed"}, "propensity is 'guessed'"),
        (TARGET, {}, {"num_folds": 1}, "num_folds is 1"),
        (TARGET, {"horizon": 3}, {}, "the policy is for 2 stages and the model for 3"),
        (StatePolicy((0.0, 1.0), horizon=1), {"horizon": 1}, {}, "but a path has 2 stages"),
        (FixedSequence(("A", "C")), {}, {}, "takes 'C', which is none of the actions"),
        ("no policy", {}, {}, "str decides nothing about named actions"),
        (TARGET, {"censoring": "none"}, {}, "censoring is 'none', which gives no weights"),
        (FixedSequence(("B", "B")), {"actions": {1: ["A", "B"], 2: ["A"]}}, {}, "action 'B' was not possible"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(policy, parameters, options, message):
    with pytest.raises((ArgumentError, LogError), match=message) as refusal:
        evaluate(policy, trial(16, cut_rate=0.1), model(**parameters), **options)
    assert "\n" not in str(refusal.value)


def test_a_policy_that_takes_what_is_not_possible_is_refused():
    logs = trial(17)
    only_a = logs.stages.assign(action=np.where(logs.stages["stage"] == 2, "A", logs.stages["action"]))
    with pytest.raises(ArgumentError, match="stage 2: the policy takes action number 2, which is not possible"):
        evaluate(FixedSequence(("B", "B")), Logs(only_a, logs.paths), model(actions={1: ["A", "B"], 2: ["A"]}))
