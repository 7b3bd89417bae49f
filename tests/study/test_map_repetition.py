"""The map on two small places."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from example_map import TINY_MAP

from halfseen.study.map_cells import random_tables
from halfseen.study.map_repetition import map_cut_rates, run_map_cell, run_map_repetition
from halfseen.study.map_table import finish_reward
from halfseen.study.policies import HEURISTICS
from halfseen.world.action_space import FINISH
from halfseen.world.episodes import evaluate
from halfseen.world.policy import surely
from halfseen.world.state import pad_scenes


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FinishPolicy:
    def decide(self, state, key):
        return surely(jnp.asarray(FINISH, dtype=jnp.int32))


@pytest.fixture(scope="module")
def rates(tiny_design):
    return map_cut_rates(tiny_design, TINY_MAP)


@pytest.fixture(scope="module")
def piece(tiny_design, rates):
    return run_map_repetition(tiny_design, TINY_MAP, rates, 0)


def test_every_place_has_the_reward_of_every_policy(piece):
    assert piece["repetition"] == 0
    assert [(row["num_objects"], row["grip_offset_std"]) for row in piece["map"]] == [
        (2, 1),
        (3, 1),
        (2, 0.5),
        (3, 0.5),
    ]
    for row in piece["map"]:
        assert set(row["rewards"]) == {"cql", *HEURISTICS}
        # No path can earn more than a clean table or cost more than ten washed cups and two or three dirty ones left.
        assert all(-115 <= reward <= 15 for reward in row["rewards"].values())


def test_a_place_is_the_same_again_and_knows_nothing_of_the_others(tiny_design, rates, piece):
    backwards = run_map_repetition(tiny_design, TINY_MAP, dict(reversed(rates.items())), 0)
    assert backwards["map"][::-1] == piece["map"]
    cell = list(rates)[2]
    fewer = replace(TINY_MAP, num_objects=(3, 2), grip_offset_stds=(0.5, 2.0))
    assert run_map_cell(tiny_design, fewer, cell, map_cut_rates(tiny_design, TINY_MAP)[cell], 0) == piece["map"][2]


def test_repetitions_and_seeds_differ(tiny_design, rates, piece):
    cell, rate = next(iter(rates.items()))
    other = run_map_cell(tiny_design, TINY_MAP, cell, rate, 1)
    reseeded = run_map_cell(replace(tiny_design, seed=1), TINY_MAP, cell, rate, 0)
    rewards = [row["rewards"] for row in (piece["map"][0], other, reseeded)]
    assert all(rewards[j] != rewards[k] for j, k in [(0, 1), (0, 2), (1, 2)])


def test_what_finish_earns_is_exact(tiny_design):
    world, num_episodes = tiny_design.world, 20_000
    layouts = pad_scenes(random_tables(3, 0.4, 5, np.random.default_rng(0)), 4)
    totals = evaluate(world, layouts, FinishPolicy(), jax.random.key(0), num_episodes)
    spread = 5.0 * np.sqrt(3 * 0.6 * 0.4 / num_episodes)
    assert finish_reward(3, world) == pytest.approx(-9.0)
    assert float(np.mean(np.asarray(totals.reward))) == pytest.approx(finish_reward(3, world), abs=4 * spread)
