"""Shares of what is earned today, and what is earned in an hour: sums, enumerations, and clocks that tell nothing."""

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, leaves, specified, trial, truth
from scipy import stats

from halfseen.evaluation import evaluate
from halfseen.evaluation.comparison import Contender
from halfseen.evaluation.quotient import rate_of, share_of
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))


def true_duration_s(chance_b):
    """A stage lasts 2 s in the mean in state 0, and 3 s in state 1."""
    second_s = 2.5
    return sum(
        0.5 * chance * (2.0 + state + (0.0 if leaves(state, action) else second_s))
        for state in (0, 1)
        for action, chance in enumerate((1.0 - chance_b[state], chance_b[state]))
    )


def test_the_logging_policy_on_uncut_logs_earns_sums_by_sums():
    logs = trial(1)
    found = evaluate(TARGET, logs, **specified(), is_hourly=True).per_hour
    earned, took_s = logs.stages["reward"].sum(), logs.end_s.sum()
    assert found.why_unknown is None
    assert found.logging.per_hour.value == pytest.approx(3600.0 * earned / took_s, rel=1e-12)
    assert found.logging.duration_s.value == pytest.approx(logs.end_s.mean(), rel=1e-12)
    by_path = logs.stages.groupby("path")["reward"].sum().to_numpy()
    rate = earned / took_s
    error = 3600.0 * np.std(by_path - rate * logs.end_s, ddof=1) / np.sqrt(logs.num_paths) / logs.end_s.mean()
    by_paths = error * stats.t.ppf(0.975, logs.num_paths - 1.0)
    # The interval is the wider one of that by paths and that of the jackknife.
    reach = found.logging.per_hour.high - found.logging.per_hour.value
    assert by_paths * (1.0 - 1e-9) <= reach < 2.5 * by_paths


@pytest.mark.slow
@pytest.mark.parametrize("censoring", ["kaplan-meier", None])
def test_rates_and_shares_of_a_cut_log_hold_the_truth(censoring):
    chances = {"policy": TARGET.chance_b, "logging": tuple(CHANCE_B)}
    rate = {name: 3600.0 * truth(chance) / true_duration_s(chance) for name, chance in chances.items()}
    share = truth(TARGET.chance_b) / truth(tuple(CHANCE_B))
    held = {"policy": 0, "logging": 0, "share": 0}
    num_logs = 40
    for seed in range(num_logs):
        logs = trial(seed, num_paths=300, cut_rate=0.08)
        found = evaluate(TARGET, logs, **(specified() | {"censoring": censoring}), is_hourly=True)
        for name in chances:
            estimate = getattr(found.per_hour, name).per_hour
            held[name] += estimate.low <= rate[name] <= estimate.high
            assert estimate.value == pytest.approx(rate[name], rel=0.5)
        held["share"] += found.share.low <= share <= found.share.high
    # Of 40 intervals at 95 %, fewer than 34 hold with a chance of 2 %.
    assert min(held.values()) >= 33


def test_shares_are_paired():
    rng = np.random.default_rng(0)
    luck = rng.normal(size=80)
    today = Contender("today", 5.0 + luck, effective_sample_size=80.0)
    found = share_of(Contender("ours", 1.2 * (5.0 + luck), effective_sample_size=80.0), today, 0.95)
    assert found.value == pytest.approx(1.2)
    assert found.standard_error == pytest.approx(0.0, abs=1e-12)
    same = share_of(today, today, 0.95)
    assert (same.value, same.standard_error) == (1.0, 0.0)


@pytest.mark.parametrize("mean", [0.05, -3.0])
def test_nothing_is_a_share_of_what_may_be_nothing(mean):
    today = Contender("today", np.linspace(-1.0, 1.0, 40) + mean, effective_sample_size=40.0)
    ours = Contender("ours", np.linspace(1.0, 2.0, 40), effective_sample_size=40.0)
    assert share_of(ours, today, 0.95) is None
    assert rate_of(ours, today, 0.95) is None
    assert share_of(Contender("unknown"), ours, 0.95) is None


def test_shares_stand_beside_each_value():
    found = evaluate(TARGET, trial(0, cut_rate=0.1), against="logging", **specified())
    assert found.share.value == pytest.approx(found.doubly_robust.value / found.logging.value, rel=1e-12)
    assert found.comparisons[0].share.value == 1.0
    assert found.per_hour is None


def with_clock(logs, of_stage):
    """The same log on another clock."""
    stages = logs.stages.copy()
    stages["elapsed_s"] = of_stage(stages)
    return Logs(stages, logs.paths.assign(end_s=stages.groupby("path")["elapsed_s"].last().to_numpy()))


@pytest.mark.parametrize(
    ("of_stage", "why"),
    [
        (lambda stages: stages["stage"].astype(float), "count stages"),
        (lambda stages: 1e-7 * stages["stage"], "take no time"),
    ],
)
def test_a_clock_that_tells_nothing_is_said_to(of_stage, why):
    found = evaluate(TARGET, with_clock(trial(1), of_stage), **specified(), is_hourly=True).per_hour
    assert why in found.why_unknown
    assert found.policy is None
    assert found.logging is None


@pytest.mark.parametrize("scale", [1.0, 1.0 / 86400.0])
def test_rewards_that_are_times_have_no_rate(scale):
    logs = trial(1)
    before = logs.stages.groupby("path")["elapsed_s"].shift(fill_value=0.0)
    times = Logs(logs.stages.assign(reward=scale * (logs.stages["elapsed_s"] - before)), logs.paths)
    assert "is its duration" in evaluate(TARGET, times, **specified(), is_hourly=True).per_hour.why_unknown
