"""One agent that decides for whichever robot is free."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from halfseen import gym_registration
from halfseen.errors import ArgumentError, SceneError
from halfseen.world import Robot, Scene, Team, UniformPolicy, WorldConfig, random
from halfseen.world.envs import CupsEnv, TeamCupsEnv
from halfseen.world.rollout import play
from halfseen.world.table_in_play import default_scene, default_team

ONE = Team((Robot((0.0, 0.0), 5.0),))
FRAIL = Team((Robot((-0.5, 0.0), 0.8, drop_out_rate=0.1), Robot((0.5, 0.0), 0.8)))
SMALL = Scene(np.array([[0.0, 0.5], [0.0, 0.0]]), places_m=np.array([[-0.2, 0.0], [0.2, 0.0]]))


def possible(rng, info):
    return int(rng.choice(np.flatnonzero(info["action_mask"])))


def equal(left, right):
    return all(np.array_equal(left[name], right[name]) for name in left)


@pytest.mark.parametrize(
    "options",
    [
        {"render_mode": "ansi"},
        {"scenes": [default_scene(), SMALL], "num_objects": 8, "cut_rate": 0.01, "team": FRAIL},
    ],
)
def test_gymnasium_finds_no_fault(options):
    check_env(gymnasium.make(gym_registration.TEAM_ENV_ID, **options).unwrapped)


def test_seconds_that_rounding_makes_too_many_are_in_the_space():
    """There a robot that fails is at it for 7.0000005 of 7 s, as its time was added up over another's drop-out."""
    frail = Team((*FRAIL.robots, Robot((0.0, -0.5), 0.8)))
    env, rng, seed = TeamCupsEnv(team=frail, cut_rate=0.02), np.random.default_rng(1120), 1120
    seen, info = env.reset(seed=seed)
    is_over, longest_s = False, 0.0
    while not is_over:
        seen, _, is_ended, is_cut, info = env.step(possible(rng, info))
        is_over, longest_s = is_ended or is_cut, max(longest_s, float(seen["since_s"].max()))
        assert env.observation_space.contains(seen)
    assert longest_s > 7.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cut_rate", [0.0, 0.03])
def test_a_team_of_one_is_the_table_of_one_robot(seed, cut_rate):
    """Also where its actions are not possible: whatever is sampled."""
    one, team = CupsEnv(default_scene(), cut_rate=cut_rate), TeamCupsEnv(team=ONE, cut_rate=cut_rate)
    rng = np.random.default_rng(seed)
    seen, info = one.reset(seed=seed)
    same, of_team = team.reset(seed=seed)
    for _ in range(20):
        assert equal(seen, same)
        assert of_team["action_mask"].tolist() == [*info["action_mask"], 0]
        assert of_team["elapsed_s"] == info["elapsed_s"]
        action = int(rng.integers(1, 13))
        seen, *ends, info = one.step(action)
        same, *of_same, of_team = team.step(action)
        assert ends == of_same
        if ends[1] or ends[2]:
            break
    assert ends[1] or ends[2]


@pytest.mark.parametrize("team", [default_team(), FRAIL])
@pytest.mark.parametrize("seed", range(2))
def test_it_is_the_world_that_play_plays(team, seed):
    env = TeamCupsEnv(team=team)
    _, info = env.reset(seed=seed)
    layouts = team.layouts(env.table.scenes)
    played = play(team.config(WorldConfig()), layouts, UniformPolicy(), random.key_of(info["episode_seed"]), 1)
    for t in range(20):
        assert info["robot"] == int(played.states.decider[0, t])
        observation, reward, terminated, _, info = env.step(int(played.action[0, t]))
        assert reward == pytest.approx(float(played.reward[0, t]), abs=1e-6)
        assert info["elapsed_s"] == pytest.approx(float(played.elapsed_s[0, t]), rel=1e-6)
        if terminated:
            break
    assert terminated
    assert t + 1 == int(played.is_taken.sum())
    assert observation["decisions_to_go"].sum() >= 0


def test_it_tells_what_the_others_are_at():
    env = TeamCupsEnv(config=WorldConfig(horizon=3))
    env.reset(seed=0)
    seen, *_, info = env.step(2)
    assert info["robot"] == 1
    assert (seen["is_busy"].tolist(), seen["verb"].tolist(), seen["target"].tolist()) == ([1, 0], [1, 0], [1, 0])
    assert seen["decisions_to_go"].tolist() == [2, 3]
    # Cup 1 is in the other's hand, cup 0 out of reach; all others are farther than the clearance. WAIT is possible.
    mask = info["action_mask"]
    assert mask[-1] == 1
    assert np.flatnonzero(mask[1:7]).tolist() == [2, 3, 4, 5]
    assert TeamCupsEnv(render_mode="ansi").render() is None if env.table.is_ended else True


def test_what_is_not_possible_closes_on_nothing():
    env = TeamCupsEnv()
    before, info = env.reset(seed=0)
    env.step(1)
    out_of_reach = 1
    assert info["action_mask"][out_of_reach]
    rewards, seen = [], before
    env.reset(seed=0)
    out_of_reach = 3  # cup 2, which only the right robot reaches
    seen, reward, *_, info = env.step(out_of_reach)
    rewards.append(reward)
    while info["robot"] != 0:
        seen, reward, *_, info = env.step(len(info["action_mask"]) - 1)
        rewards.append(reward)
    assert seen["is_on_table"].tolist() == before["is_on_table"].tolist()
    assert sum(rewards) == -1.0
    assert info["elapsed_s"] == pytest.approx(7.0)
    assert seen["failures"].tolist() == [0, 0, 1, 0, 0, 0]


def test_a_wait_for_nothing_takes_a_while_and_changes_nothing():
    env = TeamCupsEnv(team=ONE)
    before, info = env.reset(seed=0)
    assert info["action_mask"][-1] == 0
    seen, reward, terminated, _, info = env.step(13)
    assert (reward, terminated, info["elapsed_s"]) == (0.0, False, 1.0)
    assert seen["attempt_object"].tolist() == before["attempt_object"].tolist()
    assert seen["decisions_to_go"].tolist() == [9]


def test_a_robot_that_drops_out_ends_nothing_and_a_cut_all():
    num_out, num_cut = 0, 0
    for seed in range(12):
        env, rng = TeamCupsEnv(team=FRAIL, cut_rate=0.03), np.random.default_rng(seed)
        seen, info = env.reset(seed=seed)
        while True:
            seen, reward, terminated, truncated, info = env.step(possible(rng, info))
            num_out += bool(seen["is_out"][0]) and not (terminated or truncated)
            if truncated:
                assert (reward, info["cause"]) == (0.0, "operator")
                num_cut += 1
            if terminated or truncated:
                break
        with pytest.raises(ArgumentError, match="the path is over; call reset"):
            env.step(0)
    assert num_out > 3
    assert num_cut > 1


def test_a_text_for_people():
    env = TeamCupsEnv(SMALL, render_mode="ansi")
    env.reset(seed=1)
    env.step(1)
    lines = env.render().splitlines()
    assert lines[:3] == [
        "robot 1 decides, 0.0 s",
        "left: WASH 0 for 0.0 s, 9 decisions to go",
        "right: free, 10 decisions to go",
    ]
    assert lines[3].endswith("hidden 50%")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"cut_rate": -0.1}, ArgumentError, "cut_rate is -0.1"),
        ({"render_mode": "human"}, ArgumentError, "render_mode is 'human'"),
        ({"scenes": []}, SceneError, "no scenes"),
        ({"scenes": Scene(np.zeros((1, 1)))}, SceneError, "places_m is None"),
        ({"num_objects": 3}, SceneError, "more than num_objects=3"),
    ],
)
def test_nonsense_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        TeamCupsEnv(**options)


def test_steps_out_of_turn_are_refused():
    env = TeamCupsEnv()
    with pytest.raises(ArgumentError, match="has not begun; call reset"):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="action is 14; it lies in 0 to 13"):
        env.step(14)
    with pytest.raises(ArgumentError, match="scene is 2; there are scenes 0 to 0"):
        env.reset(options={"scene": 2})
