"""The worlds and the bookkeeping of the benchmark of learners; no learner of ours is fitted here."""

import learners
import numpy as np
import pandas as pd
import pytest
from peers.behaviour_cloning import cloned
from peers.completed import begun
from peers.fitted_q import iterated
from worlds.examples import Cell, Trial
from worlds.haze import Haze
from worlds.policies import policies_of
from worlds.wide import Wide


def rows_of(scores, method, cpu_s=1.0):
    case = {"world": "cell", "num_trajectories": 1000, "share": 0.33}
    return [{**case, "seed": k, "method": method, "score": s, "cpu_s": cpu_s} for k, s in enumerate(scores)]


@pytest.mark.parametrize("world", [Haze(), Wide()], ids=["haze", "wide"])
def test_a_value_is_what_uncut_trajectories_of_the_policy_earn(world):
    earned = world.log(20_000, 3, 0.0).stages.groupby("trajectory")["reward"].sum()
    assert earned.mean() == pytest.approx(world.value(world.logging), abs=4.0 * earned.sem() + 0.02)


@pytest.mark.parametrize("world", [Haze(), Wide()], ids=["haze", "wide"])
def test_the_share_asked_for_is_cut(world):
    assert world.log(4000, 1, 0.4).cut_share == pytest.approx(0.4, abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("world", [Haze(), Wide()], ids=["haze", "wide"])
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
@pytest.mark.parametrize("world", [Cell(), Trial(), Haze(), Wide()], ids=["cell", "trial", "haze", "wide"])
def test_null_policies_are_worth_what_the_logging_policy_is(world):
    own, judged = world.value(world.logging), policies_of(world)
    for name in ("null, near", "null, far", "null, split"):
        assert world.value(judged[name].chances) == pytest.approx(own, abs=0.01)
    assert world.value(judged["best"].chances) == pytest.approx(world.optimum, rel=0.01)
