"""The bin, what policies of it are worth, and its recorded logs."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "bin_cell"
sys.path.insert(0, str(FOLDER))

import bin_cell  # noqa: E402
from bin_cell import CUT_SHARE, HORIZON, STATES, Bin  # noqa: E402

from halfseen.logs import read_logs  # noqa: E402

LOGS = {"logs": 400, "later_logs": 800}
SEEDS = {"logs": 7, "later_logs": 8}


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


def test_no_policy_of_one_change_is_better_than_the_optimum(cell):
    frame = pd.DataFrame(STATES.astype(float), columns=list(Bin.covariates))
    for stage in range(1, HORIZON + 1):
        for action in range(4):

            def changed(rows, at, stage=stage, action=action):
                chances = cell.best(rows, at)
                return np.tile(np.eye(4)[action], (len(rows), 1)) if at == stage else chances

            assert cell.value(changed) <= cell.optimum + 1e-12
    assert cell.best(frame, 1).sum() == len(frame)
    assert cell.optimum > cell.value(cell.plain) + 0.3


def test_chances_of_what_may_happen_add_up():
    for action in range(4):
        chances = sum(chance for chance, *_ in bin_cell.outcomes(STATES, action))
        np.testing.assert_allclose(chances, 1.0)


@pytest.mark.parametrize("name", LOGS)
def test_the_shipped_logs_are_those_that_it_draws(cell, name):
    again, shipped = cell.log(LOGS[name], SEEDS[name], CUT_SHARE), read_logs(FOLDER / name)
    pd.testing.assert_frame_equal(again.stages, shipped.stages, rtol=1e-9)
    pd.testing.assert_frame_equal(again.trajectories, shipped.trajectories, rtol=1e-9)
    assert shipped.cut_share == pytest.approx(CUT_SHARE, abs=0.05)
    assert sum(path.stat().st_size for path in (FOLDER / name).iterdir()) < 100_000


def test_the_script_prints_values(capsys):
    bin_cell.main()
    assert "its rule               0.240 net parts a trajectory" in capsys.readouterr().out
