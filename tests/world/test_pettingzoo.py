"""A team's table behind PettingZoo's interface: an agent a robot."""

import contextlib
import io

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.world import WorldConfig
from halfseen.world.envs import TeamCupsEnv
from world.world_cases import FRAIL3, ONE

OPTIONS = pytest.mark.parametrize("options", [{}, {"team": FRAIL3, "cut_rate": 0.02}, {"team": ONE, "cut_rate": 0.02}])


def agents(**options):
    pytest.importorskip("pettingzoo")
    from halfseen.world.pettingzoo_env import TeamCupsAEC

    return TeamCupsAEC(**options)


@OPTIONS
# Observations are dictionaries, as an action mask asks for; it would have arrays, and warns.
@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array:UserWarning")
@pytest.mark.filterwarnings("ignore:Observation space for each agent probably should be:UserWarning")
def test_pettingzoo_finds_no_fault_and_the_same_trajectory_for_the_same_seed(options):
    pettingzoo_test = pytest.importorskip("pettingzoo.test")
    with contextlib.redirect_stdout(io.StringIO()):
        pettingzoo_test.api_test(agents(**options), num_cycles=60)
        pettingzoo_test.seed_test(lambda: agents(**options), num_cycles=20)


def followed(env, seed):
    """Agents, actions, rewards of each, and how each ended."""
    rng, rows, ends = np.random.default_rng(seed), [], {}
    env.reset(seed=seed)
    returns = dict.fromkeys(env.possible_agents, 0.0)
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        returns[agent] += reward
        if terminated or truncated:
            ends[agent] = (terminated, truncated, info.get("cause"), len(rows))
            env.step(None)
            continue
        action = int(rng.choice(np.flatnonzero(observation["action_mask"])))
        rows.append((agent, action))
        env.step(action)
    return rows, returns, ends


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@OPTIONS
def test_its_agents_are_the_table_of_the_one_agent_that_decides_for_all(options, seed):
    env, one = agents(**options), TeamCupsEnv(**options)
    rows, returns, ends = followed(env, seed)
    _, info = one.reset(seed=seed)
    total, until_out = 0.0, {}
    for agent, action in rows:
        assert agent == f"robot_{info['robot']}"
        seen, reward, terminated, truncated, info = one.step(action)
        total += reward
        for r in np.flatnonzero(seen["is_out"]):
            until_out.setdefault(f"robot_{r}", total)
    assert terminated or truncated
    for agent in env.possible_agents:
        cause = "operator" if truncated else None
        end = (False, True, "battery") if agent in until_out else (terminated, truncated, cause)
        assert ends[agent][:3] == end
        assert returns[agent] == pytest.approx(until_out.get(agent, total))
    assert not env.agents


@pytest.mark.slow
def test_who_drops_out_ends_alone_and_the_others_go_on():
    went_on = 0
    for seed in range(10):
        rows, _, ends = followed(agents(team=FRAIL3), seed)
        if ends["robot_0"][2] == "battery":
            at = ends["robot_0"][3]
            assert all(agent != "robot_0" for agent, _ in rows[at:])
            went_on += at < len(rows)
    assert went_on > 2


def test_who_has_parked_stays_and_is_paid_until_the_table_ends():
    env = agents(config=WorldConfig(horizon=2))
    env.reset(seed=0)
    env.step(0)
    while env.agents and not env.last()[2]:
        assert env.agent_selection == "robot_1"
        assert env.agents == ["robot_0", "robot_1"]
        assert env.observe("robot_0")["action_mask"].sum() == 0
        env.step(0)
    assert env.terminations == {"robot_0": True, "robot_1": True}
    assert env.rewards["robot_0"] == env.rewards["robot_1"] < 0.0


def test_agents_out_of_turn_and_their_text():
    env = agents(render_mode="ansi")
    with pytest.raises(ArgumentError, match="has not begun; call reset"):
        env.step(0)
    env.reset(seed=0)
    assert env.render().startswith("robot 0 decides, 0.0 s\nleft: free")
    with pytest.raises(ArgumentError, match="action of robot_0 is None, but the agent is still active"):
        env.step(None)
    with pytest.raises(ArgumentError, match="render_mode is 'human'"):
        agents(render_mode="human")
