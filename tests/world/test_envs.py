import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from random_scenes import random_scene

from halfseen import gym_registration
from halfseen.errors import ArgumentError, SceneError
from halfseen.world import AssumedGrasping, Scene, WorldConfig, random
from halfseen.world.envs import CupsEnv
from halfseen.world.policy import UniformPolicy
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes
from halfseen.world.table_in_play import default_scene


def follow(env, actions, seed=0):
    """Every answer of the environment to these actions, until the path ends."""
    answers = [env.reset(seed=seed)]
    for action in actions:
        answers.append(env.step(action))
        if answers[-1][2] or answers[-1][3]:
            break
    return answers


def equal(left, right):
    return all(np.array_equal(left[name], right[name]) for name in left)


@pytest.mark.parametrize(
    "options",
    [
        {"render_mode": "ansi"},
        {"scenes": [default_scene(), random_scene(3, 0)], "num_objects": 8, "cut_rate": 0.01},
    ],
)
def test_gymnasium_finds_no_fault(options):
    check_env(gymnasium.make(gym_registration.ENV_ID, **options).unwrapped)


def test_it_is_registered_without_a_time_limit():
    gym_registration.register()
    env = gymnasium.make(gym_registration.ENV_ID)
    assert env.spec.max_episode_steps is None
    wrappers = repr(env)
    assert "TimeLimit" not in wrappers
    assert isinstance(env.unwrapped, CupsEnv)


@pytest.mark.parametrize("policy_seed", range(3))
def test_it_is_the_world_that_play_plays(policy_seed):
    env = CupsEnv(random_scene(4, 3))
    _, info = env.reset(seed=policy_seed)
    key = random.key_of(info["episode_seed"])
    played = play(WorldConfig(), pad_scenes(env.table.scenes), UniformPolicy(), key, 1)
    for t in range(10):
        observation, reward, terminated, truncated, info = env.step(int(played.action[0, t]))
        assert reward == float(played.reward[0, t])
        assert info["elapsed_s"] == pytest.approx(float(played.elapsed_s[0, t]), rel=1e-6)
        assert not truncated
        if terminated:
            assert not np.asarray(played.is_taken)[0, t + 1 :].any()
            return
        assert np.array_equal(observation["log_odds"], played.states.log_odds[0, t + 1])
        assert np.array_equal(observation["is_on_table"], played.states.is_on_table[0, t + 1])
    raise AssertionError("a path outlived the horizon")


def test_a_seed_fixes_everything():
    actions = [1, 2, 8, 3, 4, 0]
    first, again = (follow(CupsEnv(cut_rate=0.05), actions, seed=5) for _ in range(2))
    other = follow(CupsEnv(cut_rate=0.05), actions, seed=6)
    assert len(first) == len(again)
    for left, right in zip(first, again, strict=True):
        assert equal(left[0], right[0])
        assert left[1:-1] == right[1:-1]
    assert not equal(first[0][0], other[0][0])


def test_terminated_is_the_tables_own_end():
    finished = follow(CupsEnv(), [0])
    assert finished[-1][2:4] == (True, False)
    assert "cause" not in finished[-1][4]
    by_horizon = follow(CupsEnv(config=WorldConfig(horizon=3)), [7, 7, 7, 7])
    assert len(by_horizon) == 4
    assert by_horizon[-1][2:4] == (True, False)
    one = Scene(np.zeros((1, 1)))
    cleared = follow(CupsEnv(one, config=WorldConfig(grasping=AssumedGrasping(limit_s=1e9))), [1, 1])
    assert len(cleared) == 2
    assert cleared[-1][2:4] == (True, False)
    assert cleared[-1][1] in (5.0, -10.0)


def test_truncated_is_a_cut_and_loses_the_stage():
    env = CupsEnv(cut_rate=0.3)
    num_cut_late = 0
    for seed in range(20):
        answers = follow(env, [7] * 10, seed=seed)
        observation, reward, terminated, truncated, info = answers[-1]
        if not truncated:
            continue
        assert not terminated
        assert reward == 0.0
        assert info["cause"] == "operator"
        assert equal(observation, answers[-2][0])
        before_s = answers[-2][-1]["elapsed_s"]
        assert before_s < info["elapsed_s"] <= before_s + 7.0 + 1e-5
        with pytest.raises(ArgumentError, match="the path is over; call reset"):
            env.step(0)
        num_cut_late += len(answers) > 2
    assert num_cut_late > 3


def test_cuts_come_at_their_rate():
    env = CupsEnv(cut_rate=0.1)
    watched_s, num_cut = 0.0, 0
    for seed in range(300):
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
    assert reward == -1.0
    assert info["elapsed_s"] == pytest.approx(7.0)
    assert after["steps_to_go"][0] == 9
    assert np.array_equal(after["is_on_table"], observation["is_on_table"])
    assert after["failures"].tolist() == [0, 0, 0, 1]
    _, reward, *_, info = env.step(padding_lift)
    assert reward == pytest.approx(-0.7)
    assert info["elapsed_s"] == pytest.approx(14.0)


def test_what_is_washed_leaves_the_mask():
    env = CupsEnv(Scene(np.zeros((2, 2))), config=WorldConfig(grasping=AssumedGrasping(limit_s=1e9)))
    env.reset(seed=0)
    observation, *_, info = env.step(1)
    assert observation["is_on_table"].tolist() == [0, 1]
    assert info["action_mask"].tolist() == [1, 0, 1, 0, 1]


def test_scenes_are_drawn_or_chosen():
    env = CupsEnv([random_scene(2, 0), random_scene(5, 1)])
    drawn = {int(env.reset(seed=seed)[0]["is_object"].sum()) for seed in range(12)}
    assert drawn == {2, 5}
    assert env.reset(seed=0, options={"scene": 1})[0]["is_object"].sum() == 5
    with pytest.raises(ArgumentError, match="scene is 2; there are scenes 0 to 1"):
        env.reset(options={"scene": 2})


def test_a_text_for_people():
    env = CupsEnv(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), render_mode="ansi")
    env.reset(seed=1)
    lines = env.render().splitlines()
    assert lines[0] == "10 steps to go, 0.0 s"
    assert lines[1].startswith("cup 0: dirty ")
    assert lines[1].endswith("hidden 50%")
    assert len(lines) == 3


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
    ("options", "error", "message"),
    [
        ({"cut_rate": -0.1}, ArgumentError, "cut_rate is -0.1"),
        ({"cut_rate": float("inf")}, ArgumentError, "cut_rate is inf"),
        ({"render_mode": "human"}, ArgumentError, "render_mode is 'human'"),
        ({"scenes": []}, SceneError, "no scenes"),
        ({"num_objects": 3}, SceneError, "more than num_objects=3"),
    ],
)
def test_nonsense_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        CupsEnv(**options)


def test_steps_out_of_turn_are_refused():
    env = CupsEnv()
    with pytest.raises(ArgumentError, match="has not begun; call reset"):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="action is 13; it lies in 0 to 12"):
        env.step(13)
