"""``halfseen simulate``, and several robots on the command line: simulate, learn, evaluate, and what is refused."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shell
from shell import BEHIND, LEFT, RIGHT, TABLE, run

from halfseen.cell.calibration.law import read_law, shipped_law, write_law
from halfseen.cli.inputs import policy_for, read_robots
from halfseen.errors import PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.logs import read_logs
from halfseen.perception import perceive, read_cloud
from halfseen.planners.heuristics import GreedyPolicy, ReservingPolicy
from halfseen.policies.folder import read_policy
from halfseen.scene import table_paths
from halfseen.world import AssumedGrasping, ExploringPolicy, TableWorld, WorldConfig, random, read_team
from halfseen.world.actions import VERB_NAMES, WAIT
from halfseen.world.log_checks import most_decisions, robots_in
from halfseen.world.logs import states_of
from halfseen.world.rollout import evaluate
from picked import leaves_of, picked

TWELVE = ["--episodes", 12, "--policy", "uniform", "--cut-share", 0.4, "--seed", 3]
simulated = partial(shell.run, "simulate", *table_paths()[5:8:2], *TWELVE)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate") / "logs"
    simulated("--out", folder)
    return read_logs(folder)


def test_the_logs_are_there_and_whole(recorded):
    assert recorded.num_trajectories == 12
    assert set(recorded.trajectories["scene"]) == {"table_05.pcd", "table_07.pcd"}
    assert recorded.objects is not None
    assert 0.0 < recorded.cut_share < 1.0


def test_one_seed_same_logs_and_json_for_programs(recorded, tmp_path):
    report = json.loads(simulated("--out", tmp_path / "again", "--json").stdout)
    assert (report["num_trajectories"], report["policy"], report["seed"]) == (12, "uniform", 3)
    assert report["scenes"] == {"table_05.pcd": 5, "table_07.pcd": 5}
    assert read_logs(tmp_path / "again").stages.equals(recorded.stages)
    simulated("--out", tmp_path / "again", "--overwrite")
    assert read_logs(tmp_path / "again").stages.equals(recorded.stages)


FEW = ["--episodes", 40, "--horizon", 3, "--cut-share", 0.4, "--seed", 3]


@pytest.mark.slow
def test_simulate_records_what_the_library_does(house, tmp_path):
    world = TableWorld.of(read_team(house / "two.toml"), WorldConfig(horizon=3))
    logs = read_logs(house / "team-logs")
    report = shell.report("simulate", TABLE, "--team", house / "two.toml", "--out", tmp_path / "again", *FEW)
    assert read_logs(tmp_path / "again").stages.equals(logs.stages)
    assert (report["team"], report["robots"]) == (str(house / "two.toml"), ["left", "right"])
    assert (robots_in(logs), most_decisions(logs, 2)) == (2, 3)
    assert 0.0 < logs.cut_share < 1.0
    rule = GreedyPolicy(world.config, uses_history=True, counts_penalty=True)
    team = ExploringPolicy(ReservingPolicy(world.played_config, rule), 0.5)
    same = world.simulate(perceive(read_cloud(TABLE)).scene(), team, 40, 3, 0.4)
    assert same.stages["action"].tolist() == logs.stages["action"].tolist()
    np.testing.assert_allclose(
        same.stages["elapsed_s"].astype(float), logs.stages["elapsed_s"].astype(float), rtol=1e-5, equal_nan=True
    )


@pytest.mark.slow
def test_a_cell_takes_the_policy_of_as_many_arms(house, learned):
    config, name = WorldConfig(horizon=3), str(house / "team-policy")
    stored = read_policy(name).policy
    for ours, theirs in zip(*map(leaves_of, (policy_for(name, 0.0, config, 2), stored)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    mixed = policy_for(name, 0.25, config, 2)
    assert isinstance(mixed, ExploringPolicy)
    assert mixed.random_share == 0.25
    with pytest.raises(
        PolicyError, match="decides for a team of 2 robots, but 3 arms clear the table; learn one from logs of 3"
    ):
        policy_for(name, 0.0, config, 3)


def test_a_robot_has_the_law_that_its_file_names(refused, tmp_path):
    law = read_law(shipped_law()).law
    write_law(replace(law, limit_s=11.0), tmp_path / "slow-law", {})
    (tmp_path / "laws.toml").write_text(LEFT + 'law = "slow-law"\n' + RIGHT + 'law = "assumed"\n' + BEHIND)
    team = read_robots(tmp_path / "laws.toml")
    assert team is not None
    own, *others = team.robots
    assert own.grasping == replace(law.grasping, limit_s=11.0)
    assert [each.grasping for each in others] == [AssumedGrasping(), None]
    few = ["--episodes", "4", "--horizon", "2", "--json"]
    result = run(
        "simulate", TABLE, "--team", tmp_path / "laws.toml", "--out", tmp_path / "by-law", "--law", "shipped", *few
    )
    assert json.loads(result.stdout)["robots"] == ["left", "right", "behind"]
    (tmp_path / "no-law.toml").write_text(LEFT + 'law = "asumed"\n')
    result = refused("simulate", TABLE, "--team", tmp_path / "no-law.toml", "--out", tmp_path / "none")
    assert f"{tmp_path / 'no-law.toml'}: robot 0: law: asumed: no such folder" in result
    assert "did you mean 'assumed'?" in result


def test_learn_says_for_how_many_robots_and_keeps_it(house, learned):
    lines = learned.stdout.splitlines()
    assert "looks at    tables of 2 robots, and what each is doing; it decides for the robot that is free" in lines
    assert "Q           linear, stages pooled, horizon 6, 3 decisions of each robot" in lines
    assert lines[-1] == f"Next: halfseen evaluate {house / 'team-policy'} --world --team ROBOTS"
    assert learned.stderr == ""
    stored = read_policy(house / "team-policy")
    assert (stored.num_robots, stored.horizon, stored.is_table) == (2, 6, False)


@pytest.mark.slow
def test_the_verdict_on_a_team_ends_what_learn_says_and_is_kept(house, tmp_path):
    result = run("learn", house / "team-logs", "--out", tmp_path / "policy", "--reg", "0.1")
    assert read_policy(tmp_path / "policy").verdict["sentence"] in result.stdout.splitlines()


def test_learn_learns_what_the_library_does_and_counts_what_it_takes(house, learned, tmp_path):
    logs, stored = read_logs(house / "team-logs"), read_policy(house / "team-policy")
    by_hand = CensoredQLearner.for_team(2, 3, reg=0.1).fit(logs).policy_
    # A folder says nothing of verbs where all were seen.
    assert np.asarray(by_hand.is_seen).all()
    by_hand = replace(by_hand, is_seen=None)
    for ours, theirs in zip(leaves_of(stored.policy), leaves_of(by_hand), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    report = shell.report("learn", house / "team-logs", "--out", tmp_path / "again", "--reg", "0.1", "--no-verdict")
    states, stages = states_of(logs, 6), logs.stages
    for row in report["actions"]:
        at = np.flatnonzero(stages["stage"] == row["stage"])
        trajectories = np.searchsorted(logs.trajectory_ids, stages["trajectory"].to_numpy()[at])
        num_objects = states.num_objects
        verbs = [0, *[1] * num_objects, *[2] * num_objects, WAIT]
        taken = [
            verbs[int(by_hand.decide(picked(states, (p, row["stage"] - 1)), random.key_of(0)).action)]
            for p in trajectories
        ]
        result = {name: np.mean([verb == k for verb in taken]) for k, name in enumerate(VERB_NAMES)}
        assert row["shares"] == pytest.approx(result)
        assert row["num_states"] == len(at)


def test_evaluate_plays_the_team_beside_the_rules(house, learned):
    options = ["--team", house / "two.toml", "--episodes", "30", "--seed", "1"]
    lines = run("evaluate", house / "team-policy", TABLE, "--world", *options).stdout.splitlines()
    assert lines[0].startswith("It earns ")
    assert lines[2].startswith("30 episodes on 1 tables of the simulated world, by 2 robots (left, right); ")
    assert len(lines) == 9
    report = shell.report("evaluate", house / "team-policy", TABLE, "--world", *options)
    assert report["robots"] == ["left", "right"]
    world = TableWorld.of(read_team(house / "two.toml"), WorldConfig(horizon=3))
    scene, policy = perceive(read_cloud(TABLE)).scene(), read_policy(house / "team-policy").policy
    layouts = world.team.layouts([scene])
    key = random.fold_in(random.key_of(1), 0)
    totals = evaluate(world.played_config, layouts, policy, key, 30)
    assert report["value"]["value"] == pytest.approx(float(np.mean(totals.reward)), rel=1e-5)
    assert report["robot_s"]["value"] == pytest.approx(float(np.mean(totals.robot_s)), rel=1e-5)
