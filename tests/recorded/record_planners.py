"""What planners say in recorded states, and exact values of small tables; ran at commit a5c2804.

python tests/recorded/record_planners.py
"""

import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from halfseen.planners.optimum_bound import REVEALED
from halfseen.team.config import TeamConfig
from halfseen.team.grid_grasping import GridGrasping
from halfseen.team.myopic import MyopicTeam
from halfseen.team.optimum import solve_team
from halfseen.team.rollout import RolloutTeam, team_future_rewards
from halfseen.team.rules import OneAtATime, ReservingTeam, RoundRobin, TeamOfRules
from halfseen.team.state import Workspace
from halfseen.world.episodes import play

from halfseen.planners import POMDPPolicy, information_relaxation_bound, solve_table
from halfseen.planners.belief import belief_of, grasp_probability, occlusion_without
from halfseen.planners.heuristics import GreedyPolicy, TrueGrasp
from halfseen.planners.named import HEURISTICS
from halfseen.planners.one_step import leaf_value, one_step_q, rule_and_control
from halfseen.planners.rollout import sampled_values
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.state import pad_scenes
from recorded.world_cases import CONFIGS, played, some_states, states_at

HERE = Path(__file__).parent
KEY, ROLLOUTS, FUTURES = 3, 128, 16
TWO = np.array([[0.0, 0.4], [0.1, 0.0]])
THREE = np.array([[0.0, 0.4, 0.0], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def of_one_robot(config, states):
    """All that is said of tables of one robot, by name."""

    @jax.jit
    def closed(state):
        belief = belief_of(config, state)
        occluded = occlusion_without(belief, jnp.zeros_like(belief.is_on_table))
        rules = {f"worth {name}": GreedyPolicy(config, *how).worth(state) for name, how in HEURISTICS.items()}
        return {
            "one_step_q": one_step_q(config, belief),
            "control_q": rule_and_control(config, belief)[1],
            "leaf_value": leaf_value(config, belief),
            "grip_log_weights": belief.grip.log_weights,
            "grasp_probability": grasp_probability(config, occluded, belief.grip),
            "true_grasp": TrueGrasp(config).probability(state),
            **rules,
        }

    key = jax.random.key(KEY)
    found = jax.vmap(closed)(states)
    for horizon in (2, 10):
        planner = POMDPPolicy(config, horizon, ROLLOUTS)
        found[f"pomdp_q {horizon}"] = jax.jit(jax.vmap(lambda state, each=planner: each.q_values(state, key)))(states)
    first = jax.tree.map(lambda leaf: leaf[:8], states)
    found["sampled_values"] = jax.jit(jax.vmap(lambda state: sampled_values(config, state, key, 8)))(first)
    return found


def of_team(config, states):
    """All that is said of tables of a team, by name; futures of the first 15."""
    rule, key = GreedyPolicy(config.world, uses_history=True, counts_penalty=True), jax.random.key(KEY)
    rules = {
        "TeamOfRules": TeamOfRules(rule),
        "ReservingTeam": ReservingTeam(config, rule),
        "RoundRobin": RoundRobin(rule),
        "OneAtATime": OneAtATime(rule),
    }

    @jax.jit
    def closed(state):
        decided = {f"action {name}": policy.decide(state, key).action for name, policy in rules.items()}
        return {"myopic_q": MyopicTeam(config).q_values(state), **decided}

    found, some = jax.vmap(closed)(states), jax.tree.map(lambda leaf: leaf[:30:2], states)
    by_rule = rules["ReservingTeam"]
    future = partial(team_future_rewards, config, rule=by_rule, key=key, num_futures=FUTURES)
    found["future_rewards"] = jax.jit(jax.vmap(lambda state: future(state)))(some)
    rollout = RolloutTeam(config, by_rule, FUTURES)
    found["action RolloutTeam"] = jax.jit(jax.vmap(lambda state: rollout.decide(state, key).action))(some)
    return found


def exact():
    """Optima of small tables, of one robot and of a team, and bounds."""
    found = {}
    for name, config in CONFIGS.items():
        optimum = solve_table(TWO, config, horizon=4)
        episodes = play(
            WorldConfig(**(vars(config) | {"horizon": 4})),
            pad_scenes([Scene(TWO)]),
            UniformPolicy(),
            jax.random.key(7),
            20,
        )
        at = some_states(episodes, 15)
        states = states_at(episodes, at)
        each = [jax.tree.map(lambda leaf, k=k: leaf[k], states) for k in range(len(at))]
        rules = [GreedyPolicy(config, *how) for how in HEURISTICS.values()]
        found |= {
            f"optimum/{name}/value": optimum.value,
            f"optimum/{name}/num_states": optimum.num_states,
            f"optimum/{name}/at": at,
            f"optimum/{name}/q_values": np.stack([optimum.q_values(state) for state in each]),
            f"optimum/{name}/action": np.array([optimum.action(state) for state in each]),
            f"optimum/{name}/policy_values of heuristics": optimum.policy_values(rules),
            f"optimum/{name}/policy_value of POMDPPolicy 1": optimum.policy_value(POMDPPolicy(config, 1)),
        }
        for reveals in REVEALED:
            if reveals == "everything" and name != "assumed":
                continue
            bound = information_relaxation_bound(THREE, config, num_samples=200, seed=0, reveals=reveals)
            found[f"bound/{name}/{reveals}"] = np.array(bound)
    law = GridGrasping(held_s=(1.0, 3.0), held_share=(0.25, 0.75), limit_s=3.0)
    config = TeamConfig(WorldConfig(horizon=1, grasping=law), (1.0, 2.0), -0.2)
    reach = np.array([[True, True, False], [True, True, True]])
    space = Workspace(jnp.asarray(reach), jnp.asarray(np.eye(3, dtype=bool)))
    optimum = solve_team(THREE, config, space, num_grip_nodes=3)
    rule = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)
    return found | {
        "team optimum/value": optimum.value,
        "team optimum/num_states": optimum.num_states,
        "team optimum/policy_value of ReservingTeam": optimum.policy_value(ReservingTeam(config, rule)),
        "team optimum/policy_value of MyopicTeam": optimum.policy_value(MyopicTeam(config)),
    }


def main():
    """Ask all, and write planners.npz."""
    arrays, episodes = {f"exact/{what}": np.asarray(value) for what, value in exact().items()}, played()
    for name, (config, of_name) in episodes.items():
        if not name.endswith("greedy") or name.startswith("team1") or "nothing" in name:
            continue
        at = some_states(of_name, 30)
        states = states_at(of_name, at)
        said = of_team(config, states) if name.startswith("team") else of_one_robot(config, states)
        arrays |= {f"{name}/at": at, **{f"{name}/{what}": np.asarray(value) for what, value in said.items()}}
        print(name, flush=True)
    np.savez_compressed(HERE / "planners.npz", **arrays)
    print(len(arrays), (HERE / "planners.npz").stat().st_size)


if __name__ == "__main__":
    main()
