"""Regrets on small tables: what is learned and valued, and that it follows from the seed."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners.optimum_decisions import _decide_each
from halfseen.study.policies import HEURISTICS
from halfseen.study.regret import run_regret_baselines, run_regret_repetition, small_tables
from halfseen.study.regret_table import COLUMNS, regret_table
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb
from halfseen.world.episodes import evaluate
from halfseen.world.state import pad_scenes

SIZES = (25, 50)


@pytest.fixture(scope="module")
def tables(tiny_design):
    return small_tables(replace(tiny_design, planning_horizons=(1,)), num_tables=2, horizon=3)


@pytest.fixture(scope="module")
def baselines(tables):
    return run_regret_baselines(tables)


@pytest.fixture(scope="module")
def pieces(tables):
    return [run_regret_repetition(tables, SIZES, repetition) for repetition in (0, 1)]


def test_tables_are_of_three_cups_one_behind_another_and_follow_from_the_seed(tiny_design, tables):
    again, other = small_tables(tiny_design, 2, 3), small_tables(replace(tiny_design, seed=1), 2, 3)
    shares = np.array([scene.hides for scene in small_tables(tiny_design, 40, 3).scenes])

    assert [scene.hides.tolist() for scene in again.scenes] == [scene.hides.tolist() for scene in tables.scenes]
    assert [scene.hides.tolist() for scene in other.scenes] != [scene.hides.tolist() for scene in tables.scenes]
    assert tables.design.world.horizon == 3
    assert shares.shape == (40, 3, 3)
    assert not np.triu(shares).any()
    assert 0.5 < shares.max() <= 0.8
    # The first tables stay the same when there are more.
    np.testing.assert_array_equal(shares[:2], [scene.hides for scene in tables.scenes])


def test_nobody_is_better_than_the_optimum(baselines, pieces):
    regrets = [*baselines["regrets"].values(), *(row["regrets"] for row in pieces[0]["rows"] if "cut_share" in row)]

    assert set(baselines["regrets"]) == set(HEURISTICS)
    assert np.min(regrets) > 0.0
    assert np.all(np.array(baselines["optimum"]) > baselines["finish"])
    assert baselines["finish"] == [-9.0, -9.0]


def test_a_repetition_is_the_same_again_and_another_is_another(tables, pieces):
    assert run_regret_repetition(small_tables(tables.design, 2, 3), SIZES, 0) == pieces[0]
    assert [row["regrets"] for row in pieces[0]["rows"]] != [row["regrets"] for row in pieces[1]["rows"]]
    learned = [(row["num_paths"], row["cut_share"]) for row in pieces[0]["rows"] if row["policy"] == "cql"]
    assert learned == [(size, share) for size in SIZES for share in tables.design.cut_shares]


def test_the_exact_regret_is_that_of_simulated_episodes(tables):
    policy = LinearTablePolicy(jax.random.normal(jax.random.key(5), (3, len(Verb), NUM_FEATURES + 1)))
    for scene, optimum in zip(tables.scenes, tables.optima, strict=True):
        layouts, key = pad_scenes([scene]), jax.random.key(1)
        rewards = np.asarray(evaluate(tables.design.world, layouts, policy, key, 20_000).reward, dtype=np.float64)

        error = rewards.std() / np.sqrt(len(rewards))
        assert optimum.regret(policy) == pytest.approx(optimum.value - rewards.mean(), abs=float(4 * error))
        assert 0.0 < error < 0.08


def test_learned_policies_share_one_compilation(tables):
    """A policy's numbers are arguments of the compiled call, not parts of it."""
    decide: Any = _decide_each
    sizes = []
    for k in range(3):
        policy = LinearTablePolicy(jnp.full((3, len(Verb), NUM_FEATURES + 1), float(k)))
        tables.optima[0].policy_value(policy, max_states=8)
        sizes.append(decide._cache_size())
    assert sizes[0] == sizes[1] == sizes[2] > 0


def test_the_table_of_a_run_has_every_policy_once(tables, baselines, pieces):
    table = regret_table(baselines, pieces)

    assert list(table.columns) == COLUMNS
    assert not table.duplicated(["policy", "num_paths", "cut_share"]).any()
    assert list(dict.fromkeys(table["policy"])) == ["cql", "pomdp-1", *HEURISTICS, "optimum"]
    assert len(table) == len(SIZES) * len(tables.design.cut_shares) + 1 + len(HEURISTICS) + 1
    assert np.isfinite(table[["regret", "se", "regret_share", "optimum"]].to_numpy(dtype=float)).all()
