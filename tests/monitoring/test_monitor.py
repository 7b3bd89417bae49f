"""A small cell in service: healthy, broken, with swapped columns; what never moved; and whether to learn again."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from halfseen.cli.act import lines
from halfseen.errors import LogError, NothingRecordedError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring import betting
from halfseen.monitoring.answer import FEWEST, num_needed, relearning
from halfseen.monitoring.diagnosis import broken_parts, clock_unit, differs, differs_at, part_words, swapped_or_changed
from halfseen.monitoring.foreign import unknown_actions
from halfseen.monitoring.monitor import ALPHAS, looks_at_of, monitored
from halfseen.monitoring.streams import input_streams, move_streams, part_streams, swap_streams, swapped_states
from halfseen.policies.folder import read_policy, write_policy
from halfseen.policies.folder.promised_parts import (
    FEWEST_STEPS,
    _unmoved,
    expanded_as,
    moves,
    outcome_rows,
    part_of,
    promised_parts,
    promised_states,
    residuals,
)
from small_logs import table_log

VALUE = {"value": 0.85, "low": 0.7, "high": 1.0, "standard_error": 0.07}
VERDICT = {"verdict": "better", "reason": "it is", "sentence": "It is.", "value": VALUE}


def cell(num, seed, chances=(0.9, 0.9), policy=None, swaps=False, are_alike=False):
    """One stage: A suits x < .5, B the others; an action that suits fetches with one of two chances, before and after.

    A quarter is cut. The policy, if one is given, sees what is recorded. z tells nothing, and may be distributed as x.
    """
    rng = np.random.default_rng(seed)
    x, z = rng.random(num), rng.random(num) if are_alike else 2.0 + rng.normal(size=num)
    seen = pd.DataFrame({"x": z, "z": x} if swaps else {"x": x, "z": z})
    action = rng.choice(["A", "B"], num) if policy is None else policy.decide(seen, 1)
    suits = (action == "A") == (x < 0.5)
    chance = np.where(np.arange(num) < num // 2, *chances) * np.where(suits, 1.0, 0.2)
    end_s, cut_s = rng.gamma(4.0, 1.0, num), rng.exponential(14.0, num)
    is_cut = cut_s < end_s
    done = {"elapsed_s": np.where(is_cut, np.nan, end_s), "reward": np.where(is_cut, np.nan, rng.random(num) < chance)}
    stages = pd.DataFrame({"trajectory": range(num), "stage": 1, "action": action, **done, **seen})
    ends = {"end_s": np.minimum(end_s, cut_s), "ending": np.where(is_cut, "cut", "finished")}
    return Logs(stages, pd.DataFrame({"trajectory": range(num), **ends, "cause": np.where(is_cut, "operator", None)}))


def learned(folder, logs):
    learner = CensoredQLearner.of_paper(1, ["A", "B"], logs.stage_covariates, reg=1e-3).fit(logs)
    write_policy(learner, logs, folder, verdict=VERDICT)
    return read_policy(folder)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return learned(tmp_path_factory.mktemp("policies") / "policy", cell(500, 0))


def test_a_healthy_cell_is_no_alarm_and_earns_what_it_does(stored):
    found = monitored(stored, cell(600, 1, policy=stored.policy))
    assert found.alarm_at is None
    assert found.earned["low"] < 0.88 < found.earned["high"]
    assert found.sentence.startswith("No alarm: in 600 trajectories nothing has changed; it earns 0.")
    assert "0.85 was promised (0.7 to 1)" in found.sentence


@pytest.mark.slow
def test_rewards_beyond_what_the_log_had_are_said_at_either_end(stored):
    logs = cell(600, 1, policy=stored.policy)
    is_first = (logs.stages["trajectory"] < 9) & logs.stages["reward"].notna()
    for brought, said in ((-500.0, "less than is possible by the log, counting as 0"), (500.0, "more than is")):
        other = Logs(logs.stages.assign(reward=logs.stages["reward"].mask(is_first, brought)), logs.trajectories)
        note, *_ = monitored(stored, other).notes
        assert f"{is_first.sum()} trajectories brought {said}" in note
    assert monitored(stored, logs).notes == ()


def test_a_part_that_broke_is_named_and_since_when(stored):
    logs = cell(600, 1, (0.9, 0.3), stored.policy)
    found = monitored(stored, logs)
    assert 300 < found.alarm_at < 400
    assert "less than" in found.sentence
    assert any(
        each.name.startswith("reward of") and each.since_low <= 301 <= each.since_high for each in found.findings
    )
    assert any("less than in the log in the same states" in each for each in found.causes)
    assert not any("swapped" in each for each in found.causes)


def test_of_a_change_the_name_in_the_log_is_reported_where_it_is_not_its_number(stored):
    logs = cell(200, 1, policy=stored.policy, swaps=True)
    tables = (each.assign(trajectory=each["trajectory"] + 701) for each in (logs.stages, logs.trajectories))
    found = monitored(stored, Logs(*tables))
    since = found.findings[0].since
    assert f"trajectories that count are numbered from 1; number {since} is {700 + since} in the log" in found.notes
    tables = (each.assign(trajectory=each["trajectory"] + 1) for each in (logs.stages, logs.trajectories))
    assert monitored(stored, Logs(*tables)).notes == ()


@pytest.mark.parametrize(("digits", "is_said"), [(1, True), (2, False)])
def test_names_whose_numbers_are_out_of_order_are_said(stored, digits, is_said):
    logs = cell(20, 1, policy=stored.policy)
    named = (
        each.assign(trajectory=[f"ep_{number:0{digits}}" for number in each["trajectory"]])
        for each in (logs.stages, logs.trajectories)
    )
    assert any("sorted by name as text" in note for note in monitored(stored, Logs(*named)).notes) == is_said


def test_no_change_lies_after_its_alarm(stored):
    logs = cell(400, 1, (0.6, 0.0), stored.policy)
    x = logs.stages["x"] + np.where(logs.stages["trajectory"] < 250, 0.15, 9.0)
    found = monitored(stored, Logs(logs.stages.assign(x=x), logs.trajectories)).findings
    assert {each.family for each in found} == {"rewards", "inputs", "parts"}
    assert all(1 <= each.since_low <= each.since <= each.since_high <= each.alarm_at for each in found)


def test_a_clock_in_milliseconds_is_reported_from_a_slow_cell(stored):
    logs = cell(200, 1, policy=stored.policy)
    stages = logs.stages.assign(elapsed_s=logs.stages["elapsed_s"] * 1000.0)
    found = monitored(stored, Logs(stages, logs.trajectories.assign(end_s=logs.trajectories["end_s"] * 1000.0)))
    unit = "as if in another unit (milliseconds for seconds): divide the clock by 1,000"
    assert unit in found.sentence
    assert any(unit in each for each in found.causes)
    assert found.relearning.startswith("Fix the recording")
    assert clock_unit(np.log(5.0)) == ""
    assert part_words("duration", "A", np.log(5.0)).startswith("A takes 400% more time than")
    assert part_words("duration", "A", np.log(500.0)).startswith("A takes 500 times more time than")
    assert part_words("duration", "A", 1e4).startswith("A takes over 1,000,000 times more time than")
    assert "the other way round): multiply the clock by 60" in clock_unit(-np.log(60.0))


def test_swapped_columns_are_named(stored):
    found = monitored(stored, cell(200, 1, policy=stored.policy, swaps=True))
    assert found.alarm_at < 60
    assert "covariates x and z look swapped" in found.causes
    assert {each.name for each in found.findings} >= {"x in stage 1", "z in stage 1"}


@pytest.mark.slow
def test_swapped_columns_that_are_distributed_alike_are_named_by_what_actions_bring(tmp_path):
    stored = learned(tmp_path / "policy", cell(500, 0, are_alike=True))
    assert monitored(stored, cell(400, 1, policy=stored.policy, are_alike=True)).alarm_at is None
    found = monitored(stored, cell(400, 1, policy=stored.policy, swaps=True, are_alike=True))
    assert found.alarm_at < 150
    assert "x and z swapped" in {each.name for each in found.findings}
    assert found.relearning.startswith("Fix the recording before you learn again")


ALIKE = Covariates(("x", "y", "z", "colour"), {"colour": ("blue", "red")})


def alike(num, seed, is_swapped=False):
    """x and y are distributed alike; z goes with x alone."""
    rng = np.random.default_rng(seed)
    x, y, noise = rng.normal(3.0, 0.01, size=(3, num))
    seen = {"x": y, "y": x} if is_swapped else {"x": x, "y": y}
    more = {"z": 100.0 * (x + noise), "colour": rng.choice(["blue", "red"], num), "trajectory": range(num), "stage": 1}
    stages = pd.DataFrame({**seen, **more, "action": "A", "elapsed_s": 1.0, "reward": 0.0})
    return Logs(stages, pd.DataFrame({"trajectory": range(num), "end_s": 1.0, "ending": "finished"}))


def test_states_are_compared_with_themselves_swapped_under_the_normal_distribution_of_others():
    log, logs = alike(201, 0), alike(50, 1)
    states = ALIKE.encode(log.stages)
    promise = {"stages": promised_states(log, ALIKE.columns), "first_states": states.tolist()}
    found = {each.about: each for each in swapped_states(promise, ALIKE, logs)}
    assert set(found) == {"x and y", "x and z", "y and z"}
    fitted, seen = states[::2], ALIKE.encode(logs.stages)
    covariance, share = np.cov(fitted.T, bias=True), 4 / (2 * 101 + 4)
    covariance = (1.0 - share) * covariance + share * np.diag(np.diag(covariance))
    normal = stats.multivariate_normal(fitted.mean(axis=0), covariance)
    expected = normal.logpdf(seen) - normal.logpdf(seen[:, [1, 0, 2, 3]])
    np.testing.assert_allclose(found["x and y"].values, expected, rtol=1e-8)
    assert found["x and y"].counts.sum() == 100


@pytest.mark.parametrize("is_swapped", [False, True])
def test_a_swap_of_columns_that_are_distributed_alike_shows_in_what_goes_with_them(is_swapped):
    log, logs = alike(400, 0), alike(150, 1, is_swapped)
    promise = {"stages": promised_states(log, ALIKE.columns), "first_states": ALIKE.encode(log.stages).tolist()}
    [found] = [each for each in swapped_states(promise, ALIKE, logs) if each.about == "x and y"]
    draws = np.random.default_rng(2).random(150)
    p = betting.rank_p_values(found.bins, len(found.counts), found.counts, draws)
    wealth = betting.log_wealth(betting.rank_payoffs(p[:, None], is_less=True))
    assert (betting.p_values(wealth)[-1, 0] < 1e-6) == is_swapped
    if is_swapped:
        assert swapped_or_changed("x and y", promise, logs, 0) == "covariates x and y look swapped"
        drifted = Logs(logs.stages.assign(x=logs.stages["x"] + 1.0), logs.trajectories)
        assert swapped_or_changed("x and y", promise, drifted, 0) == "covariates of stage 1 have changed together"


def test_too_few_states_and_a_covariate_that_does_not_vary_give_no_swap():
    log = alike(400, 0)
    states = ALIKE.encode(log.stages)
    promise = {"stages": promised_states(log, ALIKE.columns), "first_states": states[:38].tolist()}
    assert swapped_states(promise, ALIKE, log) == []
    constant = Logs(log.stages.assign(x=3.0), log.trajectories)
    promise = {"stages": promised_states(constant, ALIKE.columns), "first_states": (states * [0, 1, 1, 1]).tolist()}
    [found] = swapped_states(promise, ALIKE, constant)
    assert found.about == "y and z"
    assert np.isfinite(found.values).all()


def test_a_swap_is_asked_of_states_where_it_would_matter(stored):
    logs, promise, looks_at = cell(60, 3), stored.record["promise"], looks_at_of(stored.policy)
    parts = part_streams(promise["parts"], looks_at, logs)
    [found] = swap_streams(parts, promise["parts"], looks_at, logs, promise["stages"])
    models = {part["action"]: part for part in promise["parts"] if part["what"] == "reward"}
    due = []
    for row in outcome_rows(logs).itertuples():
        part = models[row.action]
        here, there = np.array([[row.x, row.z]]), np.array([[row.z, row.x]])
        [as_is], [turned] = (residuals(part, features, np.array([row.reward])) for features in (here, there))
        terms = np.append(1.0, expanded_as(part, here))
        bent = 0.1 * max(part["deviation"], 0.1 * max(one["deviation"] for one in models.values()))
        tolerance = stats.norm.ppf(1.0 - 0.01 / 2 / len(promise["parts"])) * np.sqrt(
            terms @ np.array(part["covariance"]) @ terms + bent**2
        )
        if abs(as_is - turned) > 2.0 * tolerance:
            due.append((row.trajectory, np.sign(as_is - turned) * as_is, tolerance))
    assert 5 < len(due) < 60
    np.testing.assert_allclose(np.column_stack([found.trajectory, found.residuals, found.tolerance]), due)


@pytest.mark.parametrize(("seen", "place"), [(-1.0, 0), (0.0, 1), (1.0, 2)])
def test_a_number_below_all_of_the_log_is_reported_from_its_lowest_as_one_above_is_from_its_highest(seen, place):
    logs = cell(100, 0)
    promised = promised_states(Logs(logs.stages.assign(z=0.0), logs.trajectories), ["z"])
    [found] = input_streams(promised, Logs(logs.stages.assign(z=seen), logs.trajectories))
    assert found.counts.tolist() == [0.0, 100.0, 0.0]
    assert set(found.bins) == {place}


@pytest.mark.parametrize(("longer", "is_noticed"), [(1.0005, False), (1.05, True)])
def test_the_jitter_of_a_clock_is_no_change_where_all_took_as_long_in_the_log(stored, longer, is_noticed):
    logs = cell(400, 0)
    done = logs.stages["elapsed_s"].notna()
    fixed = Logs(logs.stages.assign(elapsed_s=np.where(done, 1.0, np.nan)), logs.trajectories.assign(end_s=1.0))
    parts = promised_parts(fixed, stored.policy)["parts"]
    jitter = longer + 0.0003 * np.random.default_rng(1).normal(size=400)
    took, ends = np.where(done, jitter, np.nan), fixed.trajectories.assign(end_s=jitter)
    streams = part_streams(parts, looks_at_of(stored.policy), Logs(fixed.stages.assign(elapsed_s=took), ends))
    found = next(each for each in streams if each.kind == "duration")
    payoffs = betting.residual_payoffs(found.residuals, found.trajectory, 400, found.tolerance, found.reach)
    assert (betting.log_wealth(payoffs)[-1, 0] > np.log(20)) == is_noticed


def test_a_change_may_lie_before_the_first_stage_that_shows_it(stored):
    logs = cell(400, 0)
    place, done = logs.stages["trajectory"], logs.stages["elapsed_s"].notna()
    brought = {"action": np.where(place % 40 == 39, "A", "B"), "reward": np.where(place < 200, 0.9, -9.0)}
    some = Logs(logs.stages.assign(**brought).assign(reward=lambda rows: rows["reward"].where(done)), logs.trajectories)
    streams = part_streams(stored.record["promise"]["parts"], looks_at_of(stored.policy), some)
    part = next(each for each in streams if (each.kind, each.about) == ("reward", "A"))
    last, first = part.trajectory[part.trajectory < 200].max(), part.trajectory[part.trajectory >= 200].min()
    assert differs_at(part, 399) == (first, last + 1, first)


@pytest.mark.slow
def test_more_trajectories_take_nothing_back_and_one_in_progress_does_not_count(stored):
    logs = cell(400, 2, (0.9, 0.4), stored.policy)
    whole = monitored(stored, logs)
    first = monitored(stored, logs.select(logs.trajectory_ids[:300]))
    for family, p in first.p_values.items():
        np.testing.assert_allclose(whole.p_values[family][:300], p)
        assert (np.diff(p) <= 1e-15).all()
    trajectories = logs.trajectories.assign(cause=logs.trajectories["cause"].astype(object))
    trajectories.loc[399, ["ending", "cause"]] = ["cut", "still-running"]
    stages = logs.stages.copy()
    stages.loc[399, ["elapsed_s", "reward"]] = np.nan
    assert monitored(stored, Logs(stages, trajectories)).num_trajectories == 399
    with pytest.raises(NothingRecordedError, match="no trajectory has ended so far"):
        monitored(stored, Logs(stages, trajectories).select([399]))


def test_of_trajectories_that_were_all_cut_nothing_is_said_of_the_promise(stored):
    logs = cell(300, 2, policy=stored.policy)
    stages = logs.stages.assign(elapsed_s=np.nan, reward=np.nan)
    ends = {"end_s": 0.1, "ending": "cut", "cause": "operator"}
    found = monitored(stored, Logs(stages, logs.trajectories.assign(**ends)))
    assert (found.earned, found.findings) == (None, ())
    assert "no trajectory has finished, so what it earns is unknown" in found.notes
    # The first that finishes counts from the next estimate on.
    is_late = np.arange(300) >= 150
    some = Logs(
        logs.stages.assign(**{name: logs.stages[name].where(is_late) for name in ("elapsed_s", "reward")}),
        logs.trajectories.assign(**{name: logs.trajectories[name].where(is_late, at) for name, at in ends.items()}),
    )
    weighed = monitored(stored, some).outcomes.is_weighed
    assert not weighed[:150].any()
    assert weighed[225:].all()


def test_what_another_decided_says_nothing_of_the_promise(stored):
    found = monitored(stored, cell(300, 3))
    assert found.earned is None
    assert any("of the actions are the policy's" in each for each in found.notes)
    assert found.foreign == ""


def numbers_as_text(numbers):
    return SimpleNamespace(decide=lambda frame, stage: np.resize([str(n) for n in numbers.actions[::-1]], len(frame)))


class Opposite:
    """Takes what another policy does not."""

    def __init__(self, policy):
        self.policy = policy

    def decide(self, frame, stage):
        return np.where(self.policy.decide(frame, stage) == "A", "B", "A").astype(object)


def test_a_log_of_another_policy_is_not_judged_by_the_promise_of_this_one(stored):
    other = cell(200, 3, policy=Opposite(stored.policy))
    is_drawn = np.random.default_rng(0).random(200) < 0.1
    stages = other.stages.assign(probability=np.where(is_drawn, 0.1, 0.9))
    stages["action"] = np.where(is_drawn, stored.policy.decide(stages, 1), stages["action"])
    found = monitored(stored, Logs(stages, other.trajectories))
    assert found.sentence.startswith("Only 1")
    assert "% of the actions are the policy's: this log is not from its service, and is not" in found.sentence
    assert (found.promised, found.earned) == (None, None)


def test_where_most_is_explored_or_the_rule_decides_the_log_is_of_the_service(stored):
    logs = cell(200, 3, policy=Opposite(stored.policy))
    by_rule = Logs(logs.stages.assign(stepped_back="late"), logs.trajectories)
    found = monitored(stored, by_rule)
    assert found.foreign == ""
    assert found.notes[0] == "200 of 200 decisions are the rule's, in the policy's place (late 200)"
    drawn = Logs(logs.stages.assign(probability=0.5), logs.trajectories)
    assert monitored(stored, drawn).foreign == ""
    assert monitored(stored, logs).foreign.startswith("Only 0% of the actions are the policy's")


def test_numbers_that_came_as_text_are_to_be_written_as_numbers():
    numbers = SimpleNamespace(actions=(1, 20))
    (first, _) = unknown_actions(numbers, cell(9, 1, policy=numbers_as_text(numbers)))
    assert first.endswith("are '20', which the policy does not know (1, 20). Write 20 if that is meant.")


def test_actions_that_the_policy_does_not_know_are_named_first(stored):
    logs = cell(200, 1, policy=stored.policy)
    names = logs.stages["action"].replace({"A": "a"}).mask(logs.stages.index == 3, "C")
    found = monitored(stored, Logs(logs.stages.assign(action=names), logs.trajectories))
    num = int((names == "a").sum())
    assert found.doubts == (
        f"{num} of 200 actions are 'a', which the policy does not know (A, B). Write 'A' if that is meant.",
        "1 of 200 actions is 'C', which the policy does not know (A, B).",
    )
    assert lines(found)[:2] == list(found.doubts)


def test_a_log_of_which_it_knows_no_action_is_refused(stored):
    logs = cell(200, 1, policy=stored.policy)
    lower = Logs(logs.stages.assign(action=logs.stages["action"].str.lower()), logs.trajectories)
    with pytest.raises(
        LogError,
        match=r"none of its actions is the policy's\. \d+ of 200 actions are '[ab]', which the policy does "
        "not know",
    ):
        monitored(stored, lower)


def test_rewards_in_another_unit_are_no_swapped_columns(stored):
    logs = cell(400, 7, policy=stored.policy, are_alike=True)
    found = monitored(stored, Logs(logs.stages.assign(reward=100.0 * logs.stages["reward"]), logs.trajectories))
    message = "rewards are as if in another unit: a trajectory brings about 100, but at most 1 in the log"
    assert found.causes[0] == message
    assert not any("swapped" in each for each in (found.sentence, *found.causes))
    assert any(each.startswith("Fix the recording") for each in lines(found))


def test_of_covariates_in_another_unit_nothing_else_is_blamed(stored):
    logs = cell(300, 4, policy=stored.policy)
    found = monitored(stored, Logs(logs.stages.assign(x=100.0 * logs.stages["x"]), logs.trajectories))
    (cause,) = found.causes
    assert cause.startswith("covariate x is 100 times as large as in the training log")


def test_after_a_change_no_bounds_are_given_of_one_mean(stored):
    broken = monitored(stored, cell(600, 2, (0.9, 0.2), stored.policy))
    assert broken.findings
    result = broken.as_dict()["earned"]
    assert (result["low"], result["high"], result["since"]) == (None, None, broken.earned["since"])
    assert "an action brings" in " ".join(each.words for each in broken.findings)


def test_in_a_comparison_the_policys_trajectories_alone_say_what_it_earns(stored):
    own, rules = cell(300, 1, policy=stored.policy), cell(300, 5)
    of_both = pd.concat(
        [one.stages.assign(trajectory=one.stages["trajectory"] * 2 + k) for k, one in enumerate((own, rules))]
    )
    ends = pd.concat(
        [
            one.trajectories.assign(trajectory=one.trajectories["trajectory"] * 2 + k, arm=arm)
            for k, (one, arm) in enumerate(((own, "policy"), (rules, "rule")))
        ]
    )
    both = Logs(of_both.sort_values("trajectory"), ends.sort_values("trajectory"))
    found, alone = monitored(stored, both), monitored(stored, own)
    np.testing.assert_array_equal(found.outcomes.values[::2], alone.outcomes.values)
    assert np.isnan(found.outcomes.values[1::2]).all()
    assert found.earned["value"] == pytest.approx(alone.earned["value"])
    assert "not counted in what it earns: 300 trajectories of the rule" in found.notes
    of_rule = monitored(stored, Logs(rules.stages, rules.trajectories.assign(arm="rule")))
    assert of_rule.earned is None


def test_a_share_that_grows_is_no_change_of_the_cell(stored):
    """The rule comes first, and is never cut."""
    rules, own = cell(400, 5), cell(300, 1, policy=stored.policy)
    rules = rules.select(rules.trajectory_ids[rules.is_finished])
    ends = pd.concat([rules.trajectories, own.trajectories.assign(trajectory=own.trajectories["trajectory"] + 1000)])
    stages = pd.concat([rules.stages, own.stages.assign(trajectory=own.stages["trajectory"] + 1000)])
    assert monitored(stored, Logs(stages, ends)).findings
    dealt = ends.assign(arm=np.where(ends["trajectory"] < 1000, "rule", "policy"))
    assert monitored(stored, Logs(stages, dealt)).findings == ()


def test_a_folder_that_keeps_less_watches_less_and_one_that_keeps_nothing_is_refused(stored):
    promise = {name: stored.record["promise"][name] for name in ("stages", "value")}
    older = type(stored)(stored.policy, {**stored.record, "promise": promise})
    found = monitored(older, cell(200, 1, policy=stored.policy, swaps=True))
    assert found.alarm_at < 60
    assert sum("learn it again" in each for each in found.notes) == 2
    with pytest.raises(PolicyError, match="learn the policy again"):
        monitored(type(stored)(stored.policy, {**stored.record, "promise": None}), cell(20, 1))


def test_an_action_that_was_too_rare_for_a_model_is_named(stored):
    promise = stored.record["promise"]
    parts = [part for part in promise["parts"] if part["action"] == "A"]
    rare = type(stored)(stored.policy, {**stored.record, "promise": {**promise, "parts": parts}})
    logs = cell(60, 1, policy=stored.policy)
    num = int((logs.stages["action"] == "B").sum())
    found = f"not watched by itself, as the log it was learned from has too few: B ({num} stages)"
    assert monitored(rare, logs).notes == (found,)


def test_what_is_kept_of_parts_is_least_squares_and_the_range_by_hand(stored):
    logs = cell(500, 0)
    rows = logs.stages[logs.stages["reward"].notna() & (logs.stages["action"] == "A")]
    x, z = rows["x"].to_numpy(), rows["z"].to_numpy()
    design = np.column_stack([np.ones(len(x)), x, z, x * x, x * z, z * z])
    plain, *_ = np.linalg.lstsq(design, rows["reward"].to_numpy(), rcond=None)
    kept = promised_parts(logs, stored.policy)
    part = next(each for each in kept["parts"] if (each["action"], each["what"]) == ("A", "reward"))
    at = [[1.0, 0.2, 2.0, 0.04, 0.4, 4.0], [1.0, 0.8, 1.0, 0.64, 0.8, 1.0]]
    np.testing.assert_allclose(at @ np.array(part["coefficients"]), at @ plain, atol=0.03)
    left = rows["reward"] - design @ plain
    usual = np.linalg.inv(design.T @ design) * left.var(ddof=0)
    np.testing.assert_allclose(
        at @ np.array(part["covariance"]) @ np.transpose(at), at @ usual @ np.transpose(at), rtol=0.2
    )
    assert kept["brings"] == [0.0, 1.0]
    assert len(kept["first_states"]) == 400
    two = {"trajectory": [0, 0, 1, 2], "stage": [1, 2, 1, 1], "elapsed_s": [1.0, 2.0, 1.0, 1.0], "action": "A"}
    ends = {"trajectory": [0, 1, 2], "end_s": [2.0, 1.0, 1.0], "ending": "finished", "cause": None}
    two |= {"reward": [-0.1, 1.0, 0.5, -0.4]}
    assert promised_parts(Logs(pd.DataFrame(two), pd.DataFrame(ends)), None) == {"brings": [-0.4, 0.9]}


def test_a_covariate_that_is_always_one_tenth_leaves_the_error_of_a_part_as_it_is():
    """The mean of many 0.1 is not 0.1, so their deviation is rounding, and not 0."""
    rng = np.random.default_rng(0)
    x, values, found = rng.random((100, 1)), rng.random(100), []
    for features in (x, np.column_stack([x, np.full(100, 0.1)])):
        part = part_of("A", "reward", features, values)
        at = np.append(1.0, expanded_as(part, features[:1]))
        found.append((at @ part["coefficients"], at @ np.array(part["covariance"]) @ at))
    np.testing.assert_allclose(found[1], found[0], rtol=0.05)


def test_of_tables_only_what_is_earned_and_cuts_are_watched(tmp_path):
    logs = table_log()
    learner = CensoredQLearner.for_table(3, laws=None, reg=0.1).fit(logs)
    write_policy(learner, logs, tmp_path / "policy")
    found = monitored(read_policy(tmp_path / "policy"), table_log(seed=1))
    assert found.alarm_at is None
    assert found.notes[0] == "the policy is for tables: only what it earns and cuts are monitored"
    assert set(found.p_values) == {"inputs", "parts"}


@pytest.mark.slow
def test_lifetimes_without_a_change_are_seldom_alarmed_about(stored):
    num = 60
    alarms = sum(
        monitored(stored, cell(1500, 100 + k, policy=stored.policy), k).alarm_at is not None for k in range(num)
    )
    assert alarms <= sum(ALPHAS.values()) * num + 2.0 * np.sqrt(num * 0.05)


def coloured(num, seed, policy=None, new=()):
    """As `cell`, with a covariate of text that tells nothing; some trajectories have a colour that was never seen."""
    logs = cell(num, seed)
    colour = np.random.default_rng(seed + 1).choice(["blue", "red"], num)
    stages = logs.stages.assign(colour=colour)
    if policy is not None:
        is_done = stages["reward"].notna()
        suits = (policy.decide(stages, 1) == "A") == (stages["x"] < 0.5)
        draws = np.random.default_rng(seed + 2).random(num)
        brought = (draws < np.where(suits, 0.9, 0.18)).astype(float)
        stages = stages.assign(action=policy.decide(stages, 1), reward=np.where(is_done, brought, np.nan))
    stages.loc[list(new), "colour"] = "green"
    stages["stepped_back"] = np.where(stages["colour"] == "green", "out-of-range", None)
    return Logs(stages, logs.trajectories)


@pytest.fixture(scope="module")
def of_colours(tmp_path_factory):
    return learned(tmp_path_factory.mktemp("policies") / "coloured", coloured(500, 0))


def test_a_category_that_was_never_seen_is_named_and_stops_nothing(of_colours):
    found = monitored(of_colours, coloured(300, 1, of_colours.policy, [60]))
    assert found.alarm_at is None
    assert found.doubts[0].startswith("Covariate colour is 'green' in 1 stage, which never occurs in the training log")
    assert found.sentence.startswith("No alarm: in 300 trajectories nothing else has changed; it earns 0.")
    assert found.outcomes.is_weighed[60]


def test_a_category_that_is_never_seen_and_often_comes_is_an_alarm(of_colours):
    found = monitored(of_colours, coloured(300, 1, of_colours.policy, range(200, 300)))
    assert 200 < found.alarm_at < 300
    assert "colour in stage 1" in {each.name for each in found.findings}
    none_known = monitored(of_colours, coloured(100, 1, of_colours.policy, range(100)))
    assert none_known.earned is not None
    assert none_known.alarm_at < 60


LOOKS_AT = Covariates(("weight", "clutter"))


def two_stages(num, seed=0, is_swapped=False):
    """A part has one weight; the clutter around it grows."""
    rng = np.random.default_rng(seed)
    weight, clutter = np.repeat(rng.random(num), 2), np.repeat(rng.random(num), 2) + np.tile([0.0, 0.1], num)
    seen = {"weight": clutter, "clutter": weight} if is_swapped else {"weight": weight, "clutter": clutter}
    place = np.repeat(np.arange(num), 2)
    done = {"elapsed_s": np.tile([1.0, 2.0], num), "action": "A", "reward": 0.0}
    stages = pd.DataFrame({"trajectory": place, "stage": np.tile([1, 2], num), **done, **seen})
    return Logs(stages, pd.DataFrame({"trajectory": range(num), "end_s": 2.0, "ending": "finished"}))


def test_what_never_changed_is_kept_if_there_were_enough_steps():
    assert _unmoved(two_stages(60), LOOKS_AT.columns) == {"names": ["weight"], "num": 60}
    assert _unmoved(two_stages(FEWEST_STEPS - 1), LOOKS_AT.columns)["names"] == []


@pytest.mark.parametrize("values", [[1.0, 1.0, 1.0, 2.0], list("aaab")])
def test_steps_are_within_trajectories(values):
    logs = two_stages(2)
    place, has_moved = moves(Logs(logs.stages.assign(weight=values), logs.trajectories), "weight")
    assert (place.tolist(), has_moved.tolist()) == ([0, 1], [False, True])


def test_a_change_within_trajectories_is_noticed_and_the_swap_named():
    unmoved, usual, swapped = {"names": ["weight"], "num": 60}, two_stages(40, 1), two_stages(40, 1, is_swapped=True)
    for logs, is_noticed in ((usual, False), (swapped, True)):
        [found] = move_streams(unmoved, logs)
        payoffs = betting.residual_payoffs(found.residuals, found.trajectory, 40, found.tolerance, found.reach)
        assert (betting.log_wealth(payoffs)[-1, 0] > np.log(1000)) == is_noticed
    assert differs(found, 0) == "weight changes within a trajectory, as it never did in the log"
    promise = {"stages": [], "unmoved": unmoved}
    assert broken_parts(promise, LOOKS_AT, usual, 1) == ()
    assert "covariates weight and clutter look swapped" in broken_parts(promise, LOOKS_AT, swapped, 1)[0]


def test_text_that_changes_and_a_number_that_is_stuck_are_not_swapped():
    logs = two_stages(40, 1)
    stuck = logs.stages.assign(clutter=0.3, weight=np.tile(["light", "heavy"], 40))
    looks_at = Covariates(("weight", "clutter"), {"weight": ("heavy", "light")})
    promise = {"stages": [], "unmoved": {"names": ["weight"], "num": 60}}
    assert broken_parts(promise, looks_at, Logs(stuck, logs.trajectories), 1) == ()


PROMISED = {"value": 0.6, "standard_error": 0.1}


def test_so_many_are_needed_that_the_loss_is_two_standard_errors():
    needed = num_needed(PROMISED, 400, 0.35)
    assert PROMISED["standard_error"] * (400 / needed) ** 0.5 * 2.0 == pytest.approx(0.25, rel=1e-2)


def test_where_nothing_is_lost_none_are_needed_and_where_nothing_is_known_the_fewest():
    assert num_needed(PROMISED, 400, 0.7) is None
    assert num_needed(None, 400, 0.1) == num_needed(PROMISED, 400, None) == num_needed(PROMISED, 400, -9.0) == FEWEST


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            (80, 301, 100, 0.8),
            "Learning again will not pay yet: there are 80 trajectories since the change, and about",
        ),
        ((200, 301, 100, 0.8), "Learning again may pay: there are 200 trajectories since the change, and about 100"),
        ((200, 301, None, 0.8), "Learning again is not needed: nothing is lost in 200 trajectories since the change."),
        ((200, 301, 100, 1.0), "Learning again may pay"),
    ],
)
def test_it_is_reported_in_one_sentence(given, message):
    sentence = relearning(*given)
    assert sentence.startswith(message)
    assert ("serve with --explore first" in sentence) == (given[-1] == 1.0)
