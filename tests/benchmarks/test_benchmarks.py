"""What benchmarks count, compare and keep, and under slow that each of them still runs."""

import json
import subprocess
import sys
from pathlib import Path

import against
import learners
import numpy as np
import pandas as pd
import pytest
from half_seen import LOGS, beside_truth, fresh, groups, washed
from peers.behaviour_cloning import cloned
from peers.completed import begun
from peers.fitted_q import iterated
from scipy.special import logit
from two_arms import ONE, TWO, print_summary, ratio, runs_in, summary_of
from worlds.examples import Cell, Trial
from worlds.haze import Haze
from worlds.policies import policies_of
from worlds.wide import Wide

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.cell.table_state import Belief
from halfseen.logs import read_logs


@pytest.fixture(scope="module")
def belief():
    law = read_law(shipped_law()).law
    return Belief(law.config(), law.grip)


def labels_of(said, is_dirty, cups):
    return pd.DataFrame({"log_odds": logit(said), "is_dirty": is_dirty, "table": 0, "cup": cups})


def test_cups_that_are_there_once_count_as_independent_and_many_sets_of_stains_on_one_cup_as_that_cup():
    found = beside_truth(labels_of(np.full(4, 0.5), [True, True, True, False], range(4)))
    assert (found["cups"], found["said"], found["found"]) == (4, 0.5, 0.75)
    assert found["z"] == pytest.approx(1.0 / np.sqrt(4 * 0.25))
    found = beside_truth(labels_of(np.full(4, 0.5), [True, True, False, True], [0, 0, 1, 1]))
    assert (found["labels"], found["cups"]) == (4, 2)
    assert found["z"] == pytest.approx(1.0 / np.sqrt(1.0**2 + 0.0**2))


def test_what_was_lifted_and_what_was_seen_whole_is_not_half_seen():
    rows = labels_of(np.full(3, 0.5), [True, False, True], range(3)).assign(
        is_lying=False,
        glance_occlusions=[[0.4], [0.4, 0.0], [0.4, 0.0]],
        glance_held=[[False], [False, False], [False, True]],
        glance_dirty=[[False], [False, False], [False, True]],
    )
    found = groups(rows)
    counts = {name: found[name]["labels"] for name in ("all", "whole", "half-seen", "held up")}
    assert counts == {"all": 3, "whole": 1, "half-seen": 1, "held up": 1}


def test_rewards_tell_what_was_dirty(belief):
    rows = washed(read_logs(LOGS), belief)
    assert (len(rows), int(rows["is_dirty"].sum())) == (1611, 1179)


@pytest.mark.slow
def test_what_is_said_of_half_seen_cups_is_found_on_fresh_tables(belief):
    rows = pd.concat([fresh(index, 40, 10, 1, belief) for index in range(4)], ignore_index=True)
    found = groups(rows)
    print(pd.DataFrame(found).T.round(3))
    assert found["half-seen"]["labels"] > 100
    for name in ("all", "whole", "half-seen", "half-seen, nothing found", "half-seen, found"):
        assert abs(found[name]["z"]) < 3.5, name
        assert found[name]["found"] == pytest.approx(found[name]["said"], abs=0.08), name


@pytest.mark.slow
def test_sets_of_stains_are_drawn_apart_and_each_cup_is_dirty_as_often_as_the_prior_says(belief):
    rows = fresh(0, 41, 5, 0, belief)
    assert rows.groupby("cup")["is_dirty"].mean().tolist() == [0.6] * rows["cup"].nunique()
    assert rows.groupby("stains")["is_dirty"].mean().nunique() > 1
    assert rows.groupby("cup")["glance_occlusions"].agg(lambda each: len({tuple(one) for one in each})).eq(1).all()


MADE_UP = pytest.mark.parametrize("world", [Haze(), Wide()], ids=["haze", "wide"])


def rows_of(scores, method, cpu_s=1.0):
    case = {"world": "cell", "num_trajectories": 1000, "share": 0.33}
    return [{**case, "seed": k, "method": method, "score": s, "cpu_s": cpu_s} for k, s in enumerate(scores)]


@MADE_UP
def test_a_value_is_what_uncut_trajectories_of_the_policy_earn_and_the_share_asked_for_is_cut(world):
    earned = world.log(20_000, 3, 0.0).stages.groupby("trajectory")["reward"].sum()
    assert earned.mean() == pytest.approx(world.value(world.logging), abs=4.0 * earned.sem() + 0.02)
    assert world.log(4000, 1, 0.4).cut_share == pytest.approx(0.4, abs=0.04)


@pytest.mark.slow
@MADE_UP
def test_the_optimum_is_above_greed_and_every_plain_policy(world):
    def greedy(frame, stage):
        x = frame[list(world.covariates)].to_numpy()
        return np.eye(3)[np.stack([world.pays(x, action) for action in range(3)], axis=1).argmax(axis=1)]

    assert world.optimum > max(world.value(greedy), world.value(world.plain))


def test_the_last_begun_stage_of_a_cut_trajectory_is_not_completed():
    logs = Haze().log(200, 2, 0.4)
    rows = begun(logs, Haze())
    ends = dict(zip(rows.trajectory[rows.is_last], rows.is_completed[rows.is_last], strict=True))
    assert [ends[trajectory] for trajectory in logs.trajectory_ids] == logs.is_finished.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("peer", [cloned, lambda world, logs: iterated("boosting", world, logs)])
def test_peers_take_possible_actions_only(peer):
    world = Cell()
    chances = peer(world, world.log(300, 0, 0.33))
    parts = pd.DataFrame(np.random.default_rng(0).random((50, 3)), columns=pd.Index(world.covariates))
    first = chances(parts, 1)
    assert first.shape == (50, 5)
    assert first.sum(axis=1).tolist() == [1.0] * 50
    assert not first[:, 3:].any()


def test_the_summary_pairs_logs():
    rows = rows_of([0.9, 0.8], "default", 6.0) + rows_of([0.95, 0.87], learners.ONE_FIT, 2.0)
    found = learners.summary(rows).set_index("method")
    assert found.loc[learners.ONE_FIT, "difference"] == pytest.approx(0.06)
    assert found.loc[learners.ONE_FIT, "difference_error"] == pytest.approx(0.01)
    assert found.loc["default", "times"] == pytest.approx(3.0)
    assert any(line.startswith("missed") and learners.ONE_FIT in line for line in learners.bars(rows))


def test_what_is_done_is_not_done_again():
    case = learners.Case("cell", 1000, 0.33)
    rows = [{**row, "seed": learners.FIRST_SEED + row["seed"]} for row in rows_of([0.9], "default")]
    left = list(learners.wanted([case], 2, ["default"], rows))
    assert left == [(case, learners.FIRST_SEED + 1, ["default"])]


@pytest.mark.slow
@pytest.mark.parametrize("world", [Cell(), Trial(), Wide()], ids=["cell", "trial", "wide"])
def test_null_policies_are_worth_what_the_logging_policy_is(world):
    own, judged = world.value(world.logging), policies_of(world)
    for name in ("null, near", "null, far", "null, split"):
        assert world.value(judged[name].chances) == pytest.approx(own, abs=0.01)
    assert world.value(judged["best"].chances) == pytest.approx(world.optimum, rel=0.01)


def runs(*seconds, cut=()):
    counts = {"num_cups": 1, "num_racked": 1, "num_toppled": 0, "num_fallen": 0}
    return [
        {"seconds": each, "cause": "deadlock" if k in cut else None, "reward": 0.0, "luck": 0.0, **counts}
        for k, each in enumerate(seconds)
    ]


def test_what_another_call_has_found_is_kept_if_it_is_of_the_same_tables(tmp_path):
    file, of = tmp_path / "found.json", {"seed": 1, "rule": "everything"}
    assert runs_in(file, of) == {}
    plans = {ONE: summary_of(runs(10.0, 20.0), None), TWO: summary_of(runs(5.0), None)}
    file.write_text(json.dumps({**of, "plans": plans}))
    assert runs_in(file, of) == {ONE: runs(10.0, 20.0), TWO: runs(5.0)}
    with pytest.raises(SystemExit, match=r"holds tables of .*'seed': 1.*choose another --out"):
        runs_in(file, of | {"seed": 2})


def test_tables_that_both_have_cleared_are_compared():
    found = ratio(runs(5.0, 1.0, 8.0), runs(10.0, 40.0, 10.0, 99.0, cut=(1,)))
    assert found is not None
    assert (found["tables"], found["value"], found["largest"]) == (2, 13.0 / 20.0, 0.8)
    assert ratio(runs(5.0, cut=(0,)), runs(10.0)) is None


def test_tables_that_were_cut_are_printed_and_are_in_no_time(capsys):
    result = summary_of(runs(5.0, 100.0, 7.0, cut=(1,)), runs(10.0, 10.0, 12.0))
    print_summary(TWO, result)
    printed = capsys.readouterr().out
    assert "cut 1 by deadlock" in printed
    assert "6.0 s a table" in printed
    assert result["ratio"]["value"] == 12.0 / 22.0


BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("planning.py", "--episodes", "1"),
        ("looking.py", "--tables", "2", "--runs", "1"),
        ("world_steps.py", "--steps", "2", "--runs", "1"),
        ("calibration.py", "--tables", "1", "--states", "2", "--trajectories", "30"),
        ("coverage.py", "--logs", "2", "--row", "cut 1/3"),
        ("verdicts.py", "--logs", "2", "--world", "trial", "--share", "1/3", "--setting", "default"),
        ("repetition.py", "--repetitions", "1", "--trajectories", "25"),
        ("serve.py", "--seconds", "3"),
        ("running_cell.py", "--seconds", "3", "--kills", "1"),
        ("opcua.py", "--stages", "3"),
        ("closed_loop.py", "--tables", "1", "--only", "greedy"),
        ("half_seen.py", "--tables", "1", "--washes", "1", "--stains", "2"),
        ("two_arms.py", "--tables", "1", "--rule", "greedy", "--only", "one arm", "two arms"),
        ("team_regret.py", "--horizon", "1", "--futures", "4"),
        ("teams.py", "--robots", "2", "--price", "-0.05", "--trajectories", "60", "--logs", "1", "--episodes", "50"),
        ("recorder.py", "--trajectories", "3"),
        ("sqlite_journal.py", "--events", "300"),
        ("control_variate.py", "--blocks", "1"),
        ("against_planner.py", "--sizes", "25", "--logs", "1"),
        ("lies.py", "--logs", "1", "--trajectories", "60"),
        ("wrong_laws.py", "--cases", "news", "--sizes", "30", "--logs", "1"),
        ("many_actions.py", "--sizes", "50", "--logs", "1", "--loggers", "half tried"),
        ("relearning.py", "--logs", "2", "--unchanged", "2", "--only", "none", "--after", "100"),
        (
            "service.py",
            "--lifetimes",
            "1",
            "--trajectories",
            "60",
            "--changes",
            "1",
            "--policies",
            "1",
            "--only",
            "bin",
        ),
        ("learners.py", "--logs", "1", "--worlds", "trial", "--shares", "0.3", "--methods", "quadratic, imputed"),
    ],
    ids=lambda words: words[0],
)
def test_it_runs_and_stores_what_it_found(words, tmp_path):
    script, *options = words
    out = tmp_path / "found.json"
    command = [sys.executable, str(BENCHMARKS / script), "--out", str(out), *options]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert out.stat().st_size > 100


def test_lifetimes_of_a_comparison_are_dealt_from_both_arms_and_a_better_policy_is_promoted(monkeypatch):
    monkeypatch.setattr(against, "NUM_DRAWN", 150)
    rule, policy = (against.Arm(name).courses(0.0, 1, is_success=True) for name in ("plain", "best"))
    dealt = against.dealt(rule, policy, 200, 0.5, np.random.default_rng(1))
    totals = dealt.totals()
    for arm, pool in ((False, rule), (True, policy)):
        mean = pool.totals().mean()
        assert totals[dealt.is_policy == arm].mean() == pytest.approx(mean, abs=4.0 * np.sqrt(0.25 / 80))
    assert against.promoted_at(dealt, 0.025) < 200
    assert against.fixed_size(rule, policy, 0.025) == pytest.approx(45, abs=20)
