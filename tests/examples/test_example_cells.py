"""The cells of the examples: what policies of them are worth, their recorded logs, and what their scripts print."""

import re
import shlex
from pathlib import Path

import bin_cell
import cell_trajectories
import numpy as np
import pandas as pd
import pick_cell
import pytest
import record
from bin_cell import CUT_SHARE, STATES, Bin
from cell_comparison import METHODS, compare
from cell_optimum import AXES, best_order, optimum, policy_value
from cell_parts import ACTIONS, ACTIONS_ALL, CLUTTER, COVARIATES, HORIZON, attempt, new_parts
from cell_trajectories import RULE_SHARE, logging_chances, rule_of_thumb, simulate
from click.testing import CliRunner
from scipy import stats

from halfseen.censoring import Cox
from halfseen.cli import halfseen
from halfseen.logs import read_logs
from halfseen.logs.data_quality import data_warnings
from halfseen.world import TableWorld, read_team
from halfseen.world.logs import states_of

EXAMPLES = Path(__file__).parents[2] / "examples"


def assert_alike(again, shipped):
    pd.testing.assert_frame_equal(again.stages, shipped.stages, rtol=1e-9)
    pd.testing.assert_frame_equal(again.trajectories, shipped.trajectories, rtol=1e-9)


def num_bytes(folder):
    return sum(path.stat().st_size for path in folder.iterdir())


@pytest.fixture(scope="module")
def cell():
    return Bin()


def test_values_are_those_of_uncut_logs(cell):
    reward = cell.log(20_000, 3, 0.0).stages.groupby("trajectory")["reward"].sum()
    assert abs(reward.mean() - cell.value(cell.logging)) < 4 * reward.std() / np.sqrt(len(reward)) < 0.02


def test_weights_make_the_value_of_the_rule_from_uncut_logs(cell):
    stages = cell.log(20_000, 4, 0.0).stages
    is_ruled = stages["action"] == np.where(stages["jams"] > 1, "clear", "grasp")
    ratio = (is_ruled / stages["probability"]).groupby(stages["trajectory"]).cumprod()
    each = (ratio * stages["reward"]).groupby(stages["trajectory"]).sum()
    assert abs(each.mean() - cell.value(cell.plain)) < 4 * each.std() / np.sqrt(len(each)) < 0.04


def test_no_policy_of_one_change_is_better_than_the_optimum_and_chances_add_up(cell, capsys):
    frame = pd.DataFrame(STATES.astype(float), columns=list(Bin.covariates))
    for action in range(4):
        np.testing.assert_allclose(sum(chance for chance, *_ in bin_cell.outcomes(STATES, action)), 1.0)
        for stage in range(1, bin_cell.HORIZON + 1):

            def changed(rows, at, stage=stage, action=action):
                chances = cell.best(rows, at)
                return np.tile(np.eye(4)[action], (len(rows), 1)) if at == stage else chances

            assert cell.value(changed) <= cell.optimum + 1e-12
    assert cell.best(frame, 1).sum() == len(frame)
    assert cell.optimum > cell.value(cell.plain) + 0.3
    bin_cell.main()
    assert "its rule               0.240 net parts a trajectory" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "num", "seed"), [("logs", 400, 7), ("later_logs", 800, 8)])
def test_the_shipped_logs_are_those_that_it_draws(cell, name, num, seed):
    shipped = read_logs(EXAMPLES / "bin_cell" / name)
    assert_alike(cell.log(num, seed, CUT_SHARE), shipped)
    assert shipped.cut_share == pytest.approx(CUT_SHARE, abs=0.05)
    assert num_bytes(EXAMPLES / "bin_cell" / name) < 100_000


def optimal(parts, stage):
    """The optimum's action at the nearest grid point."""
    at = tuple(np.rint((parts[n] - a[0]) / (a[1] - a[0])).astype(int) for n, a in zip(COVARIATES, AXES, strict=True))
    return optimum()[1][stage - 1][at].argmax(axis=-1)


def simulated(decide, num_parts=40_000):
    """Mean reward of a trajectory that nobody cuts, and its standard error."""
    rng = np.random.default_rng(4)
    parts, part, total = new_parts(num_parts, rng), np.arange(num_parts), np.zeros(num_parts)
    for stage in range(1, HORIZON + 1):
        outcome = attempt(parts, decide(parts, stage), rng)
        total[part] += outcome.reward
        goes_on = ~outcome.is_over
        parts, part = parts.assign(clutter=outcome.clutter).loc[goes_on].reset_index(drop=True), part[goes_on]
    return total.mean(), stats.sem(total)


def test_values_are_those_of_simulated_parts():
    def ordered(parts, stage):
        return np.full(len(parts), ACTIONS_ALL.index((*best_order()[1], "stop", "stop", "stop")[stage - 1]))

    for decide, value in ((rule_of_thumb, policy_value(rule_of_thumb)), (optimal, optimum()[0])):
        mean, error = simulated(decide)
        assert abs(mean - value) < 4 * error < 0.02
    mean, error = simulated(ordered)
    assert abs(mean - best_order()[0]) < 4 * error
    assert optimum()[0] > policy_value(rule_of_thumb) + 0.05 > best_order()[0] + 0.1
    assert optimum()[0] == pytest.approx(policy_value(optimal), abs=1e-9)


def test_logged_probabilities_are_the_shares_of_the_actions():
    parts = new_parts(1, np.random.default_rng(1)).loc[np.zeros(40_000, dtype=int)].reset_index(drop=True)
    for stage in (1, 2, 3):
        chances = logging_chances(parts, stage)
        assert chances.sum(axis=1) == pytest.approx(1.0)
        assert set(np.array(ACTIONS_ALL)[chances[0] > 0]) == set(ACTIONS[stage])
        assert chances.max() == pytest.approx(RULE_SHARE + (1 - RULE_SHARE) / len(ACTIONS[stage]))
        action, chance = cell_trajectories.draw_action(parts, stage, np.random.default_rng(2))
        assert np.bincount(action, minlength=5) / len(parts) == pytest.approx(chances[0], abs=0.012)
        assert (chance == chances[0][action]).all()


def test_cuts_come_with_clutter_at_the_hazard_that_is_reported():
    logs = simulate(20_000, seed=3)
    assert logs.cut_share == pytest.approx(0.35, abs=0.02)
    first = logs.stages[logs.stages["stage"] == 1]
    is_completed = first["elapsed_s"].notna().to_numpy()
    watched_s = first["elapsed_s"].fillna(pd.Series(logs.end_s, index=first.index)).to_numpy()
    cox = Cox().fit(watched_s, is_completed, first[COVARIATES])
    assert cox.coefficients_ == pytest.approx([0.0, 0.0, CLUTTER], abs=0.15)
    assert simulate(200, seed=3, is_cut=False).is_finished.all()


@pytest.mark.slow
def test_the_shipped_logs_are_those_that_record_writes(tmp_path, capsys):
    record.main(["--out", str(tmp_path)])
    output = capsys.readouterr().out
    for name, num_trajectories in record.NUM_TRAJECTORIES.items():
        shipped = read_logs(record.HERE / name)
        assert_alike(read_logs(tmp_path / name), shipped)
        assert str(shipped.summary()) in output
        assert num_bytes(record.HERE / name) < 100_000
        assert (shipped.num_trajectories, shipped.horizon) == (num_trajectories, HORIZON)
        assert shipped.cut_share == pytest.approx(0.35, abs=0.07)
        assert shipped.stages["probability"].between(0.05, 1.0).all()


@pytest.mark.slow
def test_the_script_prints_values_and_the_recorded_logs_give_intervals(capsys):
    pick_cell.main(["--trajectories", "200", "--repetitions", "2", "--replicates", "3"])
    text = capsys.readouterr().out
    names = re.findall(
        r"^ *(default|Cox|Cox, doubly robust|Kaplan–Meier|uncut only) +0\.\d{3} +[\d.]+%", text, flags=re.MULTILINE
    )
    assert names == list(METHODS)
    assert text.count("best in") == 9
    head, _, *rows = pick_cell.intervals(read_logs(record.LOGS), num_replicates=4, seed=0).splitlines()
    assert head == "Q of the first stage, with 95 % intervals over 4 draws of the trajectories"
    found = [re.findall(r"(-?\d\.\d\d) \((-?\d\.\d\d) to (-?\d\.\d\d)\), best in (\d+)%", row) for row in rows]
    assert [len(each) for each in found] == [3, 3, 3]
    for each in found:
        assert sum(int(share) for *_, share in each) == 100
        assert all(float(low) < float(high) for _, low, high, _ in each)
        assert all(-1.0 < float(q) < 1.5 for q, *_ in each)


@pytest.mark.slow
def test_cox_by_stage_beats_uncut_trajectories():
    """Cox and Kaplan–Meier do not differ in ten logs (+1 % of the optimum, standard error 1 %): printed only."""
    found = compare(1000, 10, seed=100, methods=("Cox", "Kaplan–Meier", "uncut only"))
    ratios = found.pivot_table(index="log", columns="method", values="value") / optimum()[0]
    print(ratios.agg(["mean", "sem"]))
    for other in ("Kaplan–Meier", "uncut only"):
        difference = ratios["Cox"] - ratios[other]
        print(f"Cox − {other}: {difference.mean():+.2%}, standard error {difference.sem():.2%}")
    gain = ratios["Cox"] - ratios["uncut only"]
    assert gain.mean() > 2 * gain.sem()


def test_values_and_differences_are_reported():
    assert pick_cell.plain_policies() == (
        "Expected reward of a part: optimum 0.706; rule of thumb 0.641; best fixed order (parallel, suction, hand "
        "over) 0.535."
    )
    values = {"default": [0.60, 0.64], "uncut only": [0.50, 0.56]}
    rows = [
        {"log": r, "method": m, "value": v, "cut_share": 0.35} for m, vs in values.items() for r, v in enumerate(vs)
    ]
    lines = [line.split() for line in pick_cell.table(pd.DataFrame(rows)).splitlines()]
    assert lines[1] == ["default", "0.620", "87.8%"]
    # Differences 0.10 and 0.08: mean 0.09, standard error 0.01, and t(0.975, 1) = 12.706.
    assert lines[2] == ["uncut", "only", "0.530", "75.0%", "+0.090", "±", "0.127"]
    assert lines[3][:5] == ["rule", "of", "thumb", "0.641", "90.7%"]


TWO_ROBOTS = EXAMPLES / "two_robots"
MOST_BYTES = 200_000


@pytest.fixture(scope="module")
def logs():
    return read_logs(TWO_ROBOTS / "logs")


def test_they_are_small_and_of_the_robots_beside_them(logs):
    assert num_bytes(TWO_ROBOTS / "logs") <= MOST_BYTES
    world = TableWorld.of(read_team(TWO_ROBOTS / "robots.toml"))
    assert states_of(logs, logs.horizon).robots.num_robots == world.played_config.num_robots == 2
    assert "attempt_by" in logs.objects.columns
    assert [each.sentence for each in data_warnings(logs)] == []


@pytest.mark.slow
def test_the_command_beside_them_makes_them(logs, tmp_path, monkeypatch):
    monkeypatch.chdir(EXAMPLES.parent)
    command = re.findall(r"^halfseen (.*)$", (TWO_ROBOTS / "README.md").read_text(), flags=re.MULTILINE)[0]
    words = shlex.split(command)
    words[words.index("--out") + 1] = str(tmp_path / "logs")
    assert CliRunner().invoke(halfseen, words, catch_exceptions=False).exit_code == 0
    again = read_logs(tmp_path / "logs")
    for column in ("trajectory", "stage", "robot", "action", "0_does", "1_does"):
        assert again.stages[column].tolist() == logs.stages[column].tolist()
    for column in ("elapsed_s", "reward", "probability"):
        ours, theirs = (one.stages[column].astype(float) for one in (again, logs))
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6)
