"""The table behind Gymnasium's interface, for one robot and for a team."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

from fitted_laws import FITTED
from halfseen import gym_registration
from halfseen.errors import ArgumentError, SceneError
from halfseen.world import AssumedGrasping, Scene, TableWorld, Team, UniformPolicy, WorldConfig, random
from halfseen.world.envs import CupsEnv, TeamCupsEnv, default_scene, default_team
from halfseen.world.rollout import play
from other_laws import Nudging, Persisting
from own_laws import LOGISTIC, SCENE, robots
from world.world_cases import FITTED_SCENES, FRAIL, FRAIL3, ONE, random_scene

PLACES = np.array([[-0.2, 0.0], [0.2, 0.0]])
SMALL = Scene(np.array([[0.0, 0.5], [0.0, 0.0]]), places_m=PLACES)
SURE = WorldConfig(grasping=AssumedGrasping(limit_s=1e9))
FACES = pytest.mark.parametrize("face", [CupsEnv, TeamCupsEnv])


def possible(rng, info):
    return int(rng.choice(np.flatnonzero(info["action_mask"])))


def equal(left, right):
    return all(np.array_equal(left[name], right[name]) for name in left)


def follow(env, actions, seed=0):
    """Every answer of the environment to these actions, until the trajectory ends."""
    answers = [env.reset(seed=seed)]
    for action in actions:
        answers.append(env.step(action))
        if answers[-1][2] or answers[-1][3]:
            break
    return answers


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (gym_registration.ENV_ID, {"render_mode": "ansi"}),
        (gym_registration.ENV_ID, {"scenes": [default_scene(), SMALL], "num_objects": 8, "cut_rate": 0.01}),
        (gym_registration.TEAM_ENV_ID, {"render_mode": "ansi"}),
        (
            gym_registration.TEAM_ENV_ID,
            {"scenes": [default_scene(), SMALL], "num_objects": 8, "cut_rate": 0.01, "team": FRAIL},
        ),
    ],
)
def test_gymnasium_finds_no_fault(name, options):
    check_env(gymnasium.make(name, **options).unwrapped)


def test_it_is_registered_without_a_time_limit():
    gym_registration.register()
    env = gymnasium.make(gym_registration.ENV_ID)
    assert env.spec.max_episode_steps is None
    assert "TimeLimit" not in repr(env)
    assert isinstance(env.unwrapped, CupsEnv)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("team", "scene", "config"),
    [
        (None, random_scene(4, 3), WorldConfig()),
        (None, SCENE, WorldConfig(grasping=Nudging(), seeing=Persisting(), horizon=6)),
        (default_team(), default_scene(), WorldConfig()),
        (FRAIL, default_scene(), WorldConfig()),
    ],
    ids=["alone", "other laws", "team", "frail team"],
)
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_world_that_play_plays(team, scene, config, seed):
    env = CupsEnv(scene, config=config) if team is None else TeamCupsEnv(scene, team, config=config)
    seen, info = env.reset(seed=seed)
    world = TableWorld.of(team, config)
    key = random.key_of(info["episode_seed"])
    played = play(world.played_config, world.layouts([scene]), UniformPolicy(), key, 1)
    for t in range(int(played.is_taken.sum())):
        assert env.observation_space.contains(seen)
        for name in ("hides", "log_odds", "is_on_table"):
            assert np.array_equal(seen[name], getattr(played.states, name)[0, t])
        assert team is None or info["robot"] == int(played.states.decider[0, t])
        seen, reward, terminated, truncated, info = env.step(int(played.action[0, t]))
        assert reward == pytest.approx(float(played.reward[0, t]), abs=1e-6)
        assert info["elapsed_s"] == pytest.approx(float(played.elapsed_s[0, t]), rel=1e-6)
        assert not truncated
    assert terminated


def test_a_seed_fixes_everything():
    actions = [1, 2, 8, 3, 4, 0]
    first, again = (follow(CupsEnv(cut_rate=0.05), actions, seed=5) for _ in range(2))
    other = follow(CupsEnv(cut_rate=0.05), actions, seed=6)
    for left, right in zip(first, again, strict=True):
        assert equal(left[0], right[0])
        assert left[1:-1] == right[1:-1]
    assert not equal(first[0][0], other[0][0])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cut_rate", [0.0, 0.03])
def test_a_team_of_one_is_the_table_of_one_robot(seed, cut_rate):
    """Also where its actions are not possible: whatever is sampled."""
    one, team = CupsEnv(default_scene(), cut_rate=cut_rate), TeamCupsEnv(team=ONE, cut_rate=cut_rate)
    rng = np.random.default_rng(seed)
    seen, info = one.reset(seed=seed)
    same, of_team = team.reset(seed=seed)
    ends = [0.0, False, False]
    while not (ends[1] or ends[2]):
        assert equal(seen, same)
        assert of_team["action_mask"].tolist() == [*info["action_mask"], 0]
        assert of_team["elapsed_s"] == info["elapsed_s"]
        action = int(rng.integers(1, 13))
        seen, *ends, info = one.step(action)
        same, *of_same, of_team = team.step(action)
        assert ends == of_same


@pytest.mark.parametrize(
    ("options", "actions", "rewards"),
    [
        ({}, [0], None),
        ({"config": WorldConfig(horizon=3)}, [7, 7, 7], None),
        ({"scenes": Scene(np.zeros((1, 1))), "config": SURE}, [1], (5.0, -10.0)),
    ],
    ids=["finished", "by the horizon", "cleared"],
)
def test_terminated_is_the_tables_own_end(options, actions, rewards):
    answers = follow(CupsEnv(**options), [*actions, 7])
    assert len(answers) == 1 + len(actions)
    assert answers[-1][2:4] == (True, False)
    assert "cause" not in answers[-1][4]
    assert rewards is None or answers[-1][1] in rewards


def test_truncated_is_a_cut_and_loses_the_stage():
    env, num_cut_late = CupsEnv(cut_rate=0.3), 0
    for seed in range(20):
        answers = follow(env, [7] * 10, seed=seed)
        observation, reward, terminated, truncated, info = answers[-1]
        if not truncated:
            continue
        assert (terminated, reward, info["cause"]) == (False, 0.0, "operator")
        assert equal(observation, answers[-2][0])
        before_s = answers[-2][-1]["elapsed_s"]
        assert before_s < info["elapsed_s"] <= before_s + 7.0 + 1e-5
        with pytest.raises(ArgumentError, match="the trajectory is over; call reset"):
            env.step(0)
        num_cut_late += len(answers) > 2
    assert num_cut_late > 3


def test_cuts_come_at_their_rate():
    env, watched_s, num_cut = CupsEnv(cut_rate=0.1), 0.0, 0
    for seed in range(150):
        env.reset(seed=seed)
        *_, truncated, info = env.step(1)
        watched_s, num_cut = watched_s + info["elapsed_s"], num_cut + truncated
    assert abs(num_cut / watched_s - 0.1) < 4.0 * 0.1 / np.sqrt(num_cut)


def test_an_impossible_action_closes_on_nothing():
    env = CupsEnv(random_scene(2, 0), num_objects=4)
    observation, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [1, 1, 1, 0, 0, 1, 1, 0, 0]
    padding_wash, padding_lift = 4, 8
    after, reward, *_, info = env.step(padding_wash)
    assert (reward, info["elapsed_s"], after["steps_to_go"][0]) == (-1.0, pytest.approx(7.0), 9)
    assert np.array_equal(after["is_on_table"], observation["is_on_table"])
    assert after["failures"].tolist() == [0, 0, 0, 1]
    _, reward, *_, info = env.step(padding_lift)
    assert (reward, info["elapsed_s"]) == (pytest.approx(-0.7), pytest.approx(14.0))


def test_what_a_robot_does_not_reach_closes_on_nothing_too():
    env = TeamCupsEnv()
    before, info = env.reset(seed=0)
    assert not info["action_mask"][3]  # cup 2, which only the right robot reaches
    seen, total, *_, info = env.step(3)
    while info["robot"] != 0:
        seen, reward, *_, info = env.step(len(info["action_mask"]) - 1)
        total += reward
    assert (total, info["elapsed_s"]) == (-1.0, pytest.approx(7.0))
    assert seen["is_on_table"].tolist() == before["is_on_table"].tolist()
    assert seen["failures"].tolist() == [0, 0, 1, 0, 0, 0]


def test_a_wait_for_nothing_takes_a_while_and_changes_nothing():
    env = TeamCupsEnv(team=ONE)
    before, info = env.reset(seed=0)
    assert info["action_mask"][-1] == 0
    seen, reward, terminated, _, info = env.step(13)
    assert (reward, terminated, info["elapsed_s"]) == (0.0, False, 1.0)
    assert seen["attempt_object"].tolist() == before["attempt_object"].tolist()
    assert seen["decisions_to_go"].tolist() == [9]


def test_what_is_washed_leaves_the_mask():
    env = CupsEnv(Scene(np.zeros((2, 2))), config=SURE)
    observation, *_, info = follow(env, [1])[-1]
    assert observation["is_on_table"].tolist() == [0, 1]
    assert info["action_mask"].tolist() == [1, 0, 1, 0, 1]


def test_it_tells_what_the_others_are_at():
    env = TeamCupsEnv(config=WorldConfig(horizon=3))
    seen, *_, info = follow(env, [2])[-1]
    assert info["robot"] == 1
    assert (seen["is_busy"].tolist(), seen["verb"].tolist(), seen["target"].tolist()) == ([1, 0], [1, 0], [1, 0])
    assert seen["decisions_to_go"].tolist() == [2, 3]
    # Cup 1 is in the other's hand, cup 0 out of reach; all others are farther than the clearance. WAIT is possible.
    assert info["action_mask"][-1] == 1
    assert np.flatnonzero(info["action_mask"][1:7]).tolist() == [2, 3, 4, 5]


def test_it_tells_who_tried_where_robots_have_laws_of_their_own_and_how_long_that_may_take():
    env, shared = TeamCupsEnv(SCENE, Team(tuple(robots(None, LOGISTIC)))), TeamCupsEnv(SCENE)
    space, plain = env.observation_space, shared.observation_space
    assert isinstance(space, spaces.Dict)
    assert isinstance(plain, spaces.Dict)
    assert space["since_s"].contains(np.full(2, 10.0, dtype=np.float32))  # 9 s of the slower law, and transport
    assert not space["since_s"].contains(np.full(2, 10.1, dtype=np.float32))
    assert "attempt_robot" not in plain.spaces
    seen, *_, info = follow(env, [1, 2])[-1]
    for _ in range(3):
        seen, _, is_over, _, info = env.step(int(np.flatnonzero(info["action_mask"])[-1]))
        if is_over:
            break
    assert space.contains(seen)
    assert set(seen["attempt_robot"].tolist()) <= {0, 1}


def test_it_shows_what_shows_of_grips_and_surfaces():
    env = CupsEnv(FITTED_SCENES, config=FITTED)
    observation, _ = env.reset(seed=0, options={"scene": 1})
    assert observation["grip"].tolist() == [0.75, 0.0, 0.0]
    assert observation["seen"][2] == 0.0
    assert (observation["seen"][:2] >= 0.6 - 1e-6).all()
    assert env.observation_space.contains(observation)
    assert env.observation_space["log_odds"].high.max() == np.inf


def test_seconds_that_rounding_makes_too_many_are_in_the_space():
    """There a robot that fails is at it for 7.0000005 of 7 s, as its time was added up over another's drop-out."""
    env, rng = TeamCupsEnv(team=FRAIL3, cut_rate=0.02), np.random.default_rng(1120)
    seen, info = env.reset(seed=1120)
    is_over, longest_s = False, 0.0
    while not is_over:
        seen, _, is_ended, is_cut, info = env.step(possible(rng, info))
        is_over, longest_s = is_ended or is_cut, max(longest_s, float(seen["since_s"].max()))
        assert env.observation_space.contains(seen)
    assert longest_s > 7.0


def test_a_robot_that_drops_out_ends_nothing_and_a_cut_all():
    num_out, num_cut = 0, 0
    for seed in range(12):
        env, rng, is_ended = TeamCupsEnv(team=FRAIL, cut_rate=0.03), np.random.default_rng(seed), False
        _, info = env.reset(seed=seed)
        while not is_ended:
            seen, reward, terminated, truncated, info = env.step(possible(rng, info))
            is_ended = terminated or truncated
            num_out += bool(seen["is_out"][0]) and not is_ended
            num_cut += truncated and (reward, info["cause"]) == (0.0, "operator")
        with pytest.raises(ArgumentError, match="the trajectory is over; call reset"):
            env.step(0)
    assert num_out > 3
    assert num_cut > 1


def test_scenes_are_drawn_or_chosen():
    env = CupsEnv([random_scene(2, 0), random_scene(5, 1)])
    assert {int(env.reset(seed=seed)[0]["is_object"].sum()) for seed in range(12)} == {2, 5}
    assert env.reset(seed=0, options={"scene": 1})[0]["is_object"].sum() == 5


def test_a_vector_of_tables():
    envs = gymnasium.make_vec(gym_registration.ENV_ID, num_envs=3, vectorization_mode="sync", cut_rate=0.05)
    observation, info = envs.reset(seed=1)
    assert observation["hides"].shape == (3, 6, 6)
    ended = np.zeros(2, dtype=int)
    for _ in range(25):
        observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert reward.shape == (3,)
        assert not (terminated & truncated).any()
        ended += terminated.sum(), truncated.sum()
    assert (ended > 0).all()
    assert info["action_mask"].shape == (3, 13)
    envs.close()


@pytest.mark.parametrize(
    ("face", "lines"),
    [
        (CupsEnv, ["9 steps to go, "]),
        (
            TeamCupsEnv,
            ["robot 1 decides, 0.0 s", "left: WASH 0 for 0.0 s, 9 decisions to go", "right: free, 10 decisions to go"],
        ),
    ],
)
def test_a_text_for_people(face, lines):
    env = face(SMALL, render_mode="ansi")
    follow(env, [3 if face is CupsEnv else 1], seed=1)
    found = env.render().splitlines()
    assert all(line.startswith(start) for line, start in zip(found, lines, strict=False))
    assert found[len(lines)].startswith("cup 0: dirty ")
    assert found[len(lines)].endswith("hidden 50%")
    assert len(found) == len(lines) + 2
    assert face(SMALL).render() is None


@FACES
@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"cut_rate": -0.1}, ArgumentError, "cut_rate is -0.1"),
        ({"cut_rate": float("inf")}, ArgumentError, "cut_rate is inf"),
        ({"render_mode": "human"}, ArgumentError, "render_mode is 'human'"),
        ({"scenes": []}, SceneError, "no scenes"),
        ({"num_objects": 3}, SceneError, "more than num_objects=3"),
    ],
)
def test_nonsense_is_refused(face, options, error, message):
    with pytest.raises(error, match=message):
        face(**options)


@FACES
def test_steps_out_of_turn_are_refused(face):
    env = face()
    last = env.action_space.n - 1
    with pytest.raises(ArgumentError, match="has not begun; call reset"):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=f"action is {last + 1}; give 0 to {last}"):
        env.step(last + 1)
    with pytest.raises(ArgumentError, match="scene is 2; give 0 to 0"):
        env.reset(options={"scene": 2})
