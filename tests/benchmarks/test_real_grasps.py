"""Trials of a real robot, and peers that need packages of their own: data as published, and each rule by hand."""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from peers import sequential_ope as peer
from peers.side_by_side import SKIPPED, stored
from published import icu_deep, real_grasps, sequential_ope
from worlds.examples import Cell
from worlds.mdp import FiniteWorld
from worlds.policies import policies_of

from halfseen.evaluation import FixedSequence, evaluate

ORIGINAL = {
    "tilted-angled": "tilted_angled",
    "tilted-vertical": "tilted_vertical_skewer",
    "vertical": "vertical_skewer",
}


def test_written_out_again_the_data_are_as_long_as_the_file_they_come_from():
    lines = [
        f"{ORIGINAL[row.approach]}_{row.place}+{row.food}-angle-{row.angle}-trial-{k}, {failed}\n"
        for row in pd.read_csv(real_grasps.DATA, dtype={"failed": str}).itertuples()
        for k, failed in enumerate(row.failed)
    ]
    assert (len(lines), len("".join(lines))) == (2490, 131_045)


def test_eleven_foods_were_tried_in_six_ways_in_three_places_and_the_design_is_the_probability():
    trials, log = real_grasps.trials(), real_grasps.log_of(real_grasps.trials())
    each = trials.groupby(["food", "place", "way"]).size()
    assert (len(trials), len(each), each.min(), each.max()) == (1990, 11 * 3 * 6, 10, 15)
    weight = 1.0 / log.stages["probability"]
    # Σ 1/p over the trials of a context is the number of ways times that of trials.
    assert weight.groupby(log.stages["state"]).mean().to_numpy() == pytest.approx(6.0)
    assert log.stages["reward"].mean() == trials["success"].mean()


@pytest.mark.slow
def test_a_way_for_all_is_worth_the_mean_of_its_trials_and_evaluation_says_so():
    trials = real_grasps.trials()
    choice = real_grasps.one_way(trials)
    rate = trials.groupby("way")["success"].mean()
    name = real_grasps.ways()[choice[0]]
    assert len(set(choice)) == 1
    assert name == rate.idxmax() == "vertical across"
    assert real_grasps.success(trials, choice) == pytest.approx(rate.max())
    found = evaluate(FixedSequence((name,)), real_grasps.log_of(trials), against="logging").doubly_robust
    # Strawberries were tried more often, so that contexts do not count alike.
    assert found.value == pytest.approx(rate.max(), abs=0.003)
    assert found.low < rate.max() < found.high


def some(*rows):
    return pd.DataFrame(rows, columns=["food", "place", "way", "success"])


def test_most_seen_takes_the_best_of_each_context_and_elsewhere_the_best_of_all():
    up, down, other = real_grasps.ways()[:3]
    seen = some(
        ("apple", "wall", up, 1.0),
        ("apple", "wall", down, 0.0),
        ("carrot", "wall", down, 1.0),
        ("carrot", "wall", other, 1.0),
        ("carrot", "wall", up, 0.0),
        ("tomato", "wall", other, 1.0),
    )
    choice, contexts = real_grasps.most_seen(seen), real_grasps.contexts()
    chosen = dict(zip(contexts["state"], np.array(real_grasps.ways())[choice], strict=True))
    assert (chosen["apple, wall"], chosen["carrot, wall"], chosen["celery, lettuce"]) == (up, down, other)
    held_out = some(("apple", "wall", up, 0.0), ("apple", "wall", down, 1.0), ("celery", "lettuce", other, 1.0))
    assert real_grasps.success(held_out, choice) == 0.5


@pytest.mark.parametrize("module", [real_grasps, icu_deep, sequential_ope], ids=lambda module: module.__name__)
def test_kept_results_make_tables(module):
    printed = module.tables(stored(module.__name__.removeprefix("published.")))
    assert printed.count("\n") >= 5
    assert "nan" not in printed


def test_the_page_says_of_real_trials_and_of_cuts_what_the_results_do():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "published.md").read_text(encoding="utf-8")
    *some, whole = stored("real_grasps")["rows"]
    ahead = {(row["size"], name): lead for row in some for name, lead in row["ahead of ours"].items()}
    for key in ((400, "logistic"), (400, "ours, one λ"), (1600, "ours, one λ")):
        mean, error = (100.0 * each for each in ahead[key])
        assert f"{abs(mean):.1f} ± {error:.1f}".replace(" 0.", " .") in page
    gains = [100.0 * (one["value"][0] - whole["logged"]) for one in whole["of"].values()]
    assert f"by {min(gains):.0f} to {max(gains):.0f} points" in page
    assert [name for name, one in whole["of"].items() if one["verdict"] == "better"] == ["our SVM"]
    biases = [{name: each["bias"] for name, each in row["of"].items()} for row in stored("sequential_ope")["rows"][2:]]
    ours, theirs = [each.pop("ours") for each in biases], [bias for each in biases for bias in each.values()]
    assert [round(min(ours), 2), round(max(ours), 2)] == [0.03, 0.05]
    assert [round(min(theirs), 1), round(max(theirs), 1)] == [0.2, 0.3]


@pytest.mark.skipif(find_spec("scope_rl") is not None, reason="scope-rl is installed")
def test_a_benchmark_whose_package_is_missing_names_it_and_is_passed_over(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("sys.argv", ["sequential_ope", "--out", str(tmp_path / "found.json")])
    with pytest.raises(SystemExit) as left:
        sequential_ope.main()
    assert left.value.code == SKIPPED
    assert "scope-rl is not installed: pip install scope-rl==0.2.1" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def cell():
    world = Cell()
    return world, policies_of(world), world.log(400, 0, 0.0)


@pytest.mark.slow
def test_stages_as_scope_rl_has_them_give_the_weighted_value_of_evaluate(cell):
    world, policies, log = cell
    given = peer.arranged(world, policies["plain"], log)
    rows = np.arange(len(given["action"]))
    ratio = given["evaluation_policy_action_dist"][rows, given["action"]] / given["pscore"]
    weight = ratio.reshape(400, -1).cumprod(axis=1)
    value = (weight / weight.mean(axis=0) * given["reward"].reshape(400, -1)).sum(axis=1).mean()
    weighted = evaluate(policies["plain"], log, against="logging").importance_sampling
    assert value == pytest.approx(weighted.value, abs=0.1 * weighted.standard_error)
    assert given["evaluation_policy_action_dist"].sum(axis=1) == pytest.approx(1.0)


def test_q_of_a_peer_finds_a_quadratic_reward(cell):
    world, _, log = cell
    rows = log.stages[log.stages["stage"] == 1]
    target = rows["weight_kg"] * rows["shine"]
    found = peer.q_of_stage(world, rows, target)(rows)
    often = rows["action"].value_counts().reindex(world.actions, fill_value=0).to_numpy() >= peer.FEWEST
    assert often.sum() >= 3
    np.testing.assert_allclose(found[:, often], np.repeat(target.to_numpy()[:, None], often.sum(), axis=1), atol=0.02)
    np.testing.assert_allclose(found[:, ~often], target.mean())


def test_bias_error_and_share_of_intervals_are_those_by_hand():
    found = sequential_ope.summed(np.array([[1.0, 0.0, 1.5], [3.0, 2.5, 4.0]]), 1.0)
    assert found == {"bias": 1.0, "error": 1.0, "rmse": round(2**0.5, 5), "held": 0.5, "width": 1.5}


def test_a_cut_stage_is_a_truncated_step_of_d3rlpy_and_one_that_is_cut_at_once_is_none():
    deep = pytest.importorskip("peers.deep_table")
    chance = np.zeros((3, 2, 3))
    chance[0, :, 1], chance[1, :, 2], chance[2, :, 2] = 1.0, 1.0, 1.0
    world = FiniteWorld(chance, np.array([0.0, 0.0, 1.0]), np.eye(3)[0], np.arange(3) == 2, np.zeros(3))
    even = np.full((3, 2), 0.5)
    steps = world.simulate(50, even, world.hazard(even, 0.5), np.random.default_rng(0))
    episodes = deep.episodes(world, steps, np.eye(3, dtype=np.float32)).episodes
    assert sum(each.terminated for each in episodes) == np.sum(steps.successor == 2)
    assert sum(not each.terminated for each in episodes) == np.sum((steps.successor < 0) & (steps.stage == 2))


@pytest.mark.slow
def test_a_benchmark_of_real_trials_stores_and_prints_what_it_found(tmp_path, monkeypatch, capsys):
    quick = {name: real_grasps.METHODS[name] for name in ("ours", "most seen", "one way")}
    monkeypatch.setattr(real_grasps, "METHODS", quick)
    out = tmp_path / "found.json"
    monkeypatch.setattr("sys.argv", ["real_grasps", "--out", str(out), "--repetitions", "2", "--sizes", "300"])
    real_grasps.main()
    few, whole = (found := json.loads(out.read_text(encoding="utf-8")))["rows"]
    assert (few["deals"], few["ahead of ours"]["ours"]) == (2, [0.0, 0.0])
    assert whole["of"]["ours"]["value"][0] > 0.75 > 0.6 > whole["logged"]
    assert capsys.readouterr().out == real_grasps.tables(found) + "\n"
