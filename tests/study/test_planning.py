"""Playing the planners: the same episodes as all others, whoever plays them and in whatever order."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from halfseen.study.planning import (
    FEWEST_TIMED,
    episodes_in_turn,
    headline_policy,
    learning_time_s,
    planner_times_ms,
    planning_contenders,
    play_singly,
    run_planning_repetition,
)
from halfseen.study.policies import HEURISTICS, heuristics, logging_policy
from halfseen.study.repetition import EVALUATION, cut_rates, random_key, run_repetition
from halfseen.world.episodes import evaluate, play
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

pytestmark = pytest.mark.slow

BUDGETS = (("1 ms", 16, 2),)


@pytest.fixture(scope="module")
def layouts():
    hides = np.tril(np.full((4, 4), 0.3), -1)
    return pad_scenes([Scene(share * hides, name=f"table-{share}") for share in (0.0, 0.3, 0.6, 0.9)])


@pytest.fixture(scope="module")
def rates(tiny_design, layouts):
    return cut_rates(tiny_design, layouts)


@pytest.fixture(scope="module")
def planners(tiny_design):
    return planning_contenders(tiny_design.world, (1,), 8, BUDGETS)


@pytest.fixture(scope="module")
def pieces(tiny_design, planners, layouts, rates):
    return [run_planning_repetition(tiny_design, planners, layouts, rates, repetition) for repetition in (0, 1)]


def by_policy(piece):
    return {row["policy"]: row for row in piece["played"]}


def test_contenders_are_named_after_what_bounds_them(tiny_design, planners):
    assert list(planners) == ["pomdp-1", "search-16"]
    assert [planner.num_episodes for planner in planners.values()] == [None, 2]
    search = planners["search-16"].policy
    assert (search.planning_horizon, search.num_simulations) == (tiny_design.world.horizon, 16)
    assert planners["pomdp-1"].policy.planning_horizon == 1


def test_slow_planners_meet_all_episodes_in_turn():
    assert episodes_in_turn(3, None, 5) == [0, 1, 2, 3, 4]
    assert episodes_in_turn(3, 7, 5) == [0, 1, 2, 3, 4]
    assert [episodes_in_turn(k, 2, 5) for k in range(4)] == [[0, 1], [2, 3], [0, 4], [1, 2]]


def test_single_episodes_are_those_that_others_play_many_at_once(tiny_design, layouts, planners):
    key, world = random_key(tiny_design, EVALUATION, 1), tiny_design.world
    for policy in (heuristics(tiny_design)["history-penalty"], planners["pomdp-1"].policy):
        together = evaluate(world, layouts, policy, key, 6)
        singly = play_singly(world, layouts, policy, key, [1, 4, 5])
        np.testing.assert_allclose(singly.reward, np.asarray(together.reward)[[1, 4, 5]], atol=1e-4)
        np.testing.assert_allclose(singly.robot_s, np.asarray(together.robot_s)[[1, 4, 5]], atol=1e-4)


def test_a_repetition_has_every_policy_on_its_episodes(pieces):
    for k, piece in enumerate(pieces):
        rows = by_policy(piece)
        assert list(rows) == ["cql", *HEURISTICS, "pomdp-1", "search-16"]
        assert rows["search-16"]["episodes"] == [2 * k, 2 * k + 1]
        for name, row in rows.items():
            assert row["episodes"] == list(range(4)) or name == "search-16"
            assert len(row["reward"]) == len(row["robot_s"]) == len(row["episodes"])
            assert np.isfinite([row["reward"], row["robot_s"]]).all()


def test_it_is_the_same_again_and_another_is_another(tiny_design, planners, layouts, rates, pieces):
    assert run_planning_repetition(tiny_design, planners, layouts, rates, 0) == pieces[0]
    assert by_policy(pieces[0])["pomdp-1"]["reward"] != by_policy(pieces[1])["pomdp-1"]["reward"]


def test_policies_are_those_of_the_main_repetition(tiny_design, layouts, rates, pieces):
    main = run_repetition(replace(tiny_design, planning_horizons=(1,)), layouts, rates, 1)
    rows = by_policy(pieces[1])
    for name in HEURISTICS:
        assert np.mean(rows[name]["reward"]) == pytest.approx(main["baselines"][name]["reward"], abs=1e-5)
        assert np.mean(rows[name]["robot_s"]) == pytest.approx(main["baselines"][name]["robot_s"], abs=1e-4)
    (learned,) = (
        row
        for row in main["learned"]
        if (row["treatment"], row["cut_kind"], row["cut_share"], row["num_paths"])
        == ("weighted", "independent", tiny_design.table_cut_share, tiny_design.table_num_paths)
    )
    assert np.mean(rows["cql"]["reward"]) == pytest.approx(learned["reward"], abs=1e-5)


def test_the_headline_policy_is_of_its_own_repetition(tiny_design, layouts, rates):
    first, second = (np.asarray(headline_policy(tiny_design, layouts, rates, k).coefficients) for k in (0, 1))
    assert first.shape[0] == tiny_design.world.horizon
    assert not np.allclose(first, second)


def test_times_are_measured_on_fewer_states_the_slower_the_planner(tiny_design, layouts, planners, monkeypatch):
    episodes = play(tiny_design.world, layouts, logging_policy(tiny_design), random_key(tiny_design, EVALUATION), 8)
    states = jax.tree.map(lambda leaf: leaf[:, 0], episodes.states)
    times = planner_times_ms(planners, states)
    assert {name: len(values) for name, values in times.items()} == dict.fromkeys(planners, 8)
    assert all((values > 0.0).all() for values in times.values())

    monkeypatch.setattr("halfseen.study.planning.MOST_TIMED_S", 0.0)
    assert all(len(values) == FEWEST_TIMED for values in planner_times_ms(planners, states).values())


def test_learning_takes_time(tiny_design, layouts, rates):
    assert 0.0 < learning_time_s(tiny_design, layouts, rates) < 60.0
