"""What is said where nothing can be said, how many would decide, verdicts by folds, and what a log vouches for."""

import json
from dataclasses import replace
from functools import cache
from statistics import NormalDist

import numpy as np
import pandas as pd
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, problem, trial, truth

from halfseen.evaluation import FixedSequence, evaluate, held_out_verdict
from halfseen.evaluation.comparison import Contender, compared
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.evaluation import claim_of, guess_of, more_trajectories
from halfseen.evaluation.held_out import CAUTIONS, learn_by_folds, level_of_each, vouched
from halfseen.evaluation.problem import as_logged
from halfseen.evaluation.targets import CrossFitted
from halfseen.evaluation.verdict import needed, verdict_of, why_unknown
from halfseen.learning import CensoredQLearner
from halfseen.learning.discrete_policy import more_cautious, more_cautious_learner
from halfseen.logs import Logs
from halfseen.workers import Workers
from refusals import refused_type

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


NONE_WOULD = "no log of practical size would do"


@pytest.mark.parametrize(
    ("trajectories_for_one", "said"),
    [
        (231.0, "about 3,000 trajectories like these would do"),
        (41.0, "about 500 trajectories like these would do"),
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
        (0.0, 0.0, "earns as much a trajectory as the logging policy, between 0 and 0 parts less"),
    ],
)
def test_ends_of_the_interval_are_reported_as_more_and_less_without_a_sign(low, high, words):
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
    assert found.of_best.sentence.endswith(said)
    assert replace(found, caution=2.0).sentence.endswith(said.replace("policies", "more cautious policies"))
    assert found.evaluation.num_trajectories == 200
    seen_all = evaluate(fitted.policy_, logs, against="logging", censoring="kaplan-meier")
    assert found.evaluation.difference.value < seen_all.difference.value + seen_all.difference.standard_error
    kept = json.loads(json.dumps(found.as_dict()))
    assert (kept["verdict"], kept["comparisons"][0]["baseline"]) == ("better", "the logging policy")


@pytest.mark.slow
def test_an_action_that_the_log_does_not_have_changes_no_verdict():
    logs = log(3, num_trajectories=100, cut_rate=0.05)
    found, other = (
        held_out_verdict(learner().set_params(actions=actions).fit(logs), logs, against="logging")
        for actions in (["A", "B"], ["A", "Z", "B"])
    )
    assert (other.reason, other.claims) == (found.reason, found.claims)
    assert other.evaluation is not None


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
        "Inconclusive: the log has 12 trajectories, but 10 folds need 20; record more (said"
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


def contender(values, name="the policy", **rest):
    return Contender(name, values, None, np.zeros((len(values), 2)), effective_sample_size=float(len(values)), **rest)


def test_the_choice_is_that_of_the_largest_lower_bound_over_all_baselines():
    rng = np.random.default_rng(0)
    each = [contender(one) for one in rng.normal([0.1, 0.15, 0.2], [0.3, 0.8, 2.0], size=(100, 3)).T]
    theirs = [contender(rng.normal(size=100), "first"), contender(rng.normal(0.3, 1.0, size=100), "second")]
    found = vouched(each, theirs, 0.95)
    bounds = [min(one.less(other, found.level).low for other in theirs) for one in each]
    assert found.chosen == np.argmax(bounds)


def test_the_level_of_each_is_sidak_s_without_correlation_and_that_of_one_with():
    rng = np.random.default_rng(0)
    apart, same = np.linalg.qr(rng.normal(size=(5000, 9)) + 1e-9)[0].T[1:], rng.normal(size=100)
    apart -= apart.mean(axis=1, keepdims=True)
    assert 1.0 - level_of_each(apart, 0.95) == pytest.approx(2.0 * (1.0 - 0.975 ** (1 / 8)), rel=0.1)
    assert level_of_each(np.stack([same, 2.0 * same + 1.0]), 0.95) == pytest.approx(0.95, abs=0.001)
    assert level_of_each(np.stack([same, np.zeros(100)]), 0.95) == 0.95


@pytest.mark.slow
@pytest.mark.parametrize("shared", [0.0, 0.9])
def test_what_was_chosen_among_equals_is_seldom_claimed_to_be_better(shared):
    """The largest of eight lower bounds lies above 0 more often than one log in forty; the claim does not."""
    claims, largest, theirs = [], [], contender(np.zeros(80), "theirs")
    for seed in range(400):
        rng = np.random.default_rng(seed)
        common = rng.normal(size=80)
        each = [contender(np.sqrt(shared) * common + np.sqrt(1 - shared) * one) for one in rng.normal(size=(8, 80))]
        found = vouched(each, [theirs], 0.95)
        claims.append(each[found.chosen].less(theirs, found.level).low > 0)
        largest.append(max(one.less(theirs, 0.95).low for one in each) > 0)
    assert np.mean(largest) > 0.04
    assert np.mean(claims) <= 0.025 + 3 * np.sqrt(0.025 * 0.975 / 400)


@pytest.mark.slow
def test_choosing_by_some_folds_and_claiming_by_the_others_does_not_keep_the_level():
    """As the guide tells: in 11 % of logs a gain is claimed, where 2.5 % are due."""
    fold, theirs, claims = np.arange(80) % 5, contender(np.zeros(80), "theirs"), []
    for seed in range(400):
        each, mixed = np.random.default_rng(seed).normal(size=(8, 80)), np.empty(80)
        for k in range(5):
            kept = fold != k
            others = contender(np.zeros(kept.sum()))
            best = np.argmax([contender(one[kept]).less(others, 0.95).low for one in each])
            mixed[~kept] = each[best, ~kept]
        claims.append(contender(mixed).less(theirs, 0.95).low > 0)
    assert np.mean(claims) == pytest.approx(0.11, abs=0.005)


def test_nothing_is_chosen_where_nothing_is_known():
    unknown = Contender("the policy", why_unknown="no trajectory of the log was seen to complete it")
    assert vouched([unknown, unknown], [contender(np.zeros(60), "theirs")], 0.95) == (0, 0.95)
    assert vouched([contender(np.ones(60))], [], 0.95) == (0, 0.95)


def test_more_caution_is_the_same_q_with_a_larger_margin_and_in_the_end_what_the_log_does():
    logs = trial(1, num_trajectories=300, cut_rate=0.05)
    learner = CensoredQLearner(2, ["A", "B"], ["x"]).fit(logs)
    frame = pd.DataFrame({"x": [0.0, 1.0]})
    often, plain = more_cautious(learner.policy_, 3.0), learner.policy_
    np.testing.assert_allclose(often.q_values(frame, 1), plain.q_values(frame, 1))
    margin = plain.q_values(frame, 1) - plain.lower_bounds(frame, 1)
    np.testing.assert_allclose(often.q_values(frame, 1) - often.lower_bounds(frame, 1), 3.0 * margin)
    mostly = logs.stages[logs.stages["stage"] == 1].groupby("x")["action"].agg(lambda taken: taken.mode()[0])
    assert more_cautious(plain, 1e6).decide(frame, 1).tolist() == mostly.loc[[0.0, 1.0]].tolist()
    cautious = more_cautious_learner(learner, 3.0)
    assert cautious.model_.pessimism == 3.0 * learner.model_.pessimism
    assert learner.policy_ is plain
    fixed = CensoredQLearner(2, ["A", "B"], ["x"], pessimism=0.0).fit(logs)
    assert more_cautious(fixed.policy_, 3.0) is fixed.policy_


@pytest.mark.slow
def test_the_claim_is_of_the_policy_that_is_kept():
    logs = trial(3, num_trajectories=400, cut_rate=0.05)
    learner = CensoredQLearner(2, ["A", "B"], ["x"]).fit(logs)
    found = held_out_verdict(learner, logs, against="logging")
    assert found.verdict == "better"
    assert found.caution in CAUTIONS
    assert found.claims[0] == f"Vouched for: {claim_of(found.evaluation)}."
    assert found.claims[0].startswith(
        f"Vouched for: at least {found.evaluation.difference.low:.3g} more a trajectory than"
    )
    assert (found.of_best.evaluation, found.of_best.caution) == (found.best, 1.0)
    kept = more_cautious(learner.policy_, found.caution)
    chance_b = tuple(kept.probabilities(pd.DataFrame({"x": [0.0, 1.0]}), 1)[:, 1])
    assert truth(StatePolicy(chance_b).chance_b) > truth((0.5, 0.5))
    # A guess that is better on its own says so.
    best = replace(found.of_best, verdict="inconclusive")
    assert best.claims[1].endswith("; it is better if tested alone (--trust best).")


NOISE = Estimate(0.2, -0.2, 0.6, 0.2, 50.0, bias=0.1)


def test_so_many_trajectories_decide_as_the_formula_says():
    z = NormalDist().inv_cdf(0.975) + NormalDist().inv_cdf(0.8)
    found = needed(NOISE, -0.5, 0.95)
    assert found.times == pytest.approx(((0.1 + z * 0.2) / 0.5) ** 2)
    assert found.low == pytest.approx(max(((0.1 + z * 0.2) / 0.7) ** 2, 1.0))
    assert found.high == pytest.approx(((0.1 + z * 0.2) / 0.3) ** 2)
    assert needed(NOISE, -0.5, 0.95, 0.1).times == pytest.approx(max(((0.1 + z * 0.115) / 0.5) ** 2, 1.0))
    assert np.isinf([needed(NOISE, 0.0, 0.95).times, needed(NOISE, 0.1, 0.95).high]).all()
    assert np.isinf(needed(NOISE, 1e-200, 0.95).times)


def test_so_many_trajectories_do_decide():
    """Of differences that are normal, four logs of five of n* trajectories show it."""
    rng, gain, spread = np.random.default_rng(0), 0.3, 2.0
    first = spread / np.sqrt(100)
    times = needed(Estimate(gain, 0.0, 1.0, first, 100.0), gain, 0.95).times
    error = spread / np.sqrt(100 * times)
    assert np.mean(rng.normal(gain, error, size=20_000) > 1.96 * error) == pytest.approx(0.8, abs=0.01)


def test_what_is_still_to_be_recorded_is_said():
    own = contender(np.random.default_rng(2).normal(size=100), by_model=0.0)
    values = own.values + np.random.default_rng(3).normal(0.1, 1.0, size=100)
    (one,) = compared(contender(values, by_model=0.4), [own._replace(name="theirs")], 0.95)
    assert (one.verdict, one.needed.gain) == ("inconclusive", pytest.approx(0.4))
    assert "most logs of this size would show the 0.4 more that Q says, so Q may be wrong" in one.reason
    assert more_trajectories(one.needed, 100).endswith("so Q may be wrong")
    (one,) = compared(contender(values, by_model=0.2), [own._replace(name="theirs")], 0.95)
    assert "if it truly is the 0.2 more that Q says, about" in one.reason
    said = more_trajectories(one.needed, 100)
    assert said.startswith("about ")
    assert "more trajectories like these would decide (" in said
    assert more_trajectories(replace(one.needed, times=np.inf), 100).startswith("no log of practical size")


@pytest.mark.slow
def test_a_guess_of_which_nothing_is_known_says_why():
    logs = trial(4, num_trajectories=200)
    noise = Logs(logs.stages.assign(reward=np.random.default_rng(4).normal(size=logs.num_stages)), logs.trajectories)
    learner = CensoredQLearner(2, ["A", "B"], ["x"]).fit(noise)
    found = held_out_verdict(learner, noise, against="logging")
    assert found.claims[0].startswith("Vouched for: nothing")
    assert "not yet provable" in found.claims[1]
    main = found.best.comparisons[0]
    hidden = replace(found.best, comparisons=(replace(main, p=None, reason="no action is known"),))
    assert guess_of(hidden) == "unknown; no action is known"
    doubted = guess_of(replace(found.best, doubt="the log cannot be true"))
    assert doubted.endswith(" a trajectory than the logging policy, not provable while the log is in doubt")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"logs": None}, "logs is a NoneType; give Logs"),
        ({"num_folds": 2.5}, "num_folds is 2.5"),
        ({"workers": 4}, "workers is 4; give Workers"),
        ({"level": 95}, "level is 95; give a number above 0 and at most"),
    ],
)
def test_arguments_that_cannot_be_are_refused_and_no_verdict(changed, message):
    logs = log(5, num_trajectories=12)
    with refused_type(message):
        held_out_verdict(**{"learner": learner().fit(logs), "logs": logs} | changed)


def test_a_policy_in_place_of_a_learner_is_refused():
    with refused_type("learner is a StatePolicy; give a CensoredQLearner"):
        held_out_verdict(POLICY, log(16, num_trajectories=100))
