"""Finite worlds and tabular peers: exact values by hand and by simulation, and each peer's own rule."""

from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest
from peers.side_by_side import SKIPPED, stored
from peers.tabular import (
    behaviour_cloning,
    certainty_equivalence,
    counts_of,
    discrete_bcq,
    discrete_cql,
    pessimistic,
)
from published import icu_sepsis, icu_verdicts, open_bandit
from worlds.mdp import FiniteWorld, Steps, random_world

from halfseen.evaluation.tabular import gain_of
from halfseen.evaluation.targets import CrossFitted
from halfseen.learning import CensoredQLearner

EVEN = np.full((4, 2), 0.5)


@pytest.fixture(scope="module")
def world():
    """From the start to the middle; there a0 survives nine times in ten, a1 goes back or dies."""
    chance = np.zeros((4, 2, 4))
    chance[0, :, 1] = 1.0
    chance[1, 0, 2:] = 0.9, 0.1
    chance[1, 1, [0, 3]] = 0.5, 0.5
    chance[2:, :, 2:] = np.eye(2)[:, None]
    severity = np.array([-1.0, 1.0, 0.0, 0.0])
    return FiniteWorld(chance, np.array([0.0, 0.0, 1.0, 0.0]), np.eye(4)[0], np.arange(4) > 1, severity)


def test_values_are_those_by_hand(world):
    np.testing.assert_allclose(world.values(np.eye(2)[[0, 0, 0, 0]]), [0.9, 0.9, 0.0, 0.0])
    # v = 0.5·0.9 + 0.5·0.5·v
    np.testing.assert_allclose(world.worth(EVEN), 0.45 / 0.75)
    assert world.best()[1].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_simulated_trajectories_bring_and_are_cut_as_often_as_they_should(world, share):
    steps = world.simulate(20_000, EVEN, world.hazard(EVEN, share), np.random.default_rng(0))
    is_last = np.append(np.diff(steps.trajectory) > 0, True)
    assert np.mean(steps.successor[is_last] < 0) == pytest.approx(share, abs=0.015)
    if share == 0:
        assert np.mean(steps.successor[is_last] == 2) == pytest.approx(0.6, abs=0.015)
    log = world.log(steps, EVEN)
    assert (log.num_trajectories, log.num_stages) == (20_000, len(steps.state))
    assert np.mean(~log.is_finished) == pytest.approx(np.mean(steps.successor[is_last] < 0))


def counted(world, cells):
    """Counts of (state, action, successor, times)."""
    state, action, successor = np.repeat(np.array(cells)[:, :3], np.array(cells)[:, 3], axis=0).T
    return counts_of(world, Steps(np.arange(len(state)), np.ones(len(state)), state, action, successor))


def test_each_peer_goes_by_its_own_rule(world):
    counts = counted(world, [(0, 0, 1, 40), (1, 0, 2, 36), (1, 0, 3, 14), (1, 1, 2, 1), (1, 1, -1, 9)])
    assert counts.n[1].tolist() == [50, 1]
    np.testing.assert_allclose(behaviour_cloning(counts)[1], [50 / 51, 1 / 51])
    chosen = {
        "lucky": certainty_equivalence(counts),
        "seen often": certainty_equivalence(counts, 10),
        "cautious": pessimistic(counts, 1.0),
        "likely": discrete_bcq(counts),
        "conservative": discrete_cql(counts, 0.1),
    }
    assert {name: int(policy[1].argmax()) for name, policy in chosen.items()} == {
        "lucky": 1,
        "seen often": 0,
        "cautious": 0,
        "likely": 0,
        "conservative": 0,
    }


def test_with_much_data_all_that_maximise_find_the_best(world):
    counts = counts_of(world, world.simulate(20_000, EVEN, world.hazard(EVEN, 0.5), np.random.default_rng(1)))
    for policy in (certainty_equivalence(counts), pessimistic(counts, 0.1), discrete_bcq(counts)):
        assert world.worth(policy) == pytest.approx(0.9)


@pytest.mark.slow
def test_random_worlds_are_worlds():
    world, expert = random_world(0)
    np.testing.assert_allclose(world.chance.sum(axis=-1), 1.0)
    np.testing.assert_allclose(expert.sum(axis=1), 1.0)
    assert world.worth(world.best()) > world.worth(expert)


@pytest.mark.parametrize("module", [icu_sepsis, icu_verdicts, open_bandit], ids=lambda module: module.__name__)
def test_kept_results_make_tables(module):
    printed = module.tables(stored(module.__name__.removeprefix("published.")))
    assert printed.count("\n") >= 7
    assert "nan" not in printed


def test_what_is_reported_all_of_a_state_but_its_best_action_finds_it_and_a_rule_decides_where_none_knows(world):
    counts = counted(world, [(0, 0, 1, 40), (1, 0, 2, 36), (1, 0, 3, 14), (1, 1, 3, 9)])
    policy = icu_sepsis.informed(world, counts, EVEN)
    assert policy[1].tolist() == [1.0, 0.0]
    nothing = np.zeros_like(policy)
    assert icu_sepsis.judged(world, nothing, EVEN) == world.worth(EVEN)
    assert icu_sepsis.judged(world, policy, EVEN) == pytest.approx(0.9)


def test_the_learner_as_shipped_finds_the_best_of_a_small_world():
    world, expert = small()
    steps = world.simulate(3000, expert, world.hazard(expert, 0.3), np.random.default_rng(0))
    found = icu_sepsis.ours(world, steps, expert)
    assert world.worth(np.where(found.sum(axis=1, keepdims=True) > 0, found, expert)) > 0.98 * world.worth(world.best())


def test_a_package_that_is_missing_is_named_with_what_installs_it(monkeypatch, capsys):
    monkeypatch.setattr(icu_sepsis, "distribution", lambda name: (_ for _ in ()).throw(PackageNotFoundError(name)))
    monkeypatch.setattr(open_bandit.importlib, "import_module", lambda name: (_ for _ in ()).throw(missing("obp")))
    for load, words in (
        (icu_sepsis.icu, "pip install --no-deps icu-sepsis==2.0.1"),
        (open_bandit.loaded, "obp is not installed: pip install --no-deps"),
    ):
        with pytest.raises(SystemExit, match=str(SKIPPED)):
            load()
        assert words in capsys.readouterr().err


def missing(name):
    return ModuleNotFoundError(f"No module named {name!r}", name=name)


def small():
    """Twenty-five states of three actions."""
    rng = np.random.default_rng(0)
    chance = np.append(rng.dirichlet(np.full(27, 0.3), size=(25, 3)), np.zeros((2, 3, 27)), axis=0)
    chance[25:, :, 25:] = np.eye(2)[:, None]
    is_end, severity = np.arange(27) > 24, rng.normal(size=27)
    world = FiniteWorld(chance, (np.arange(27) == 25) * 1.0, np.append(np.full(25, 0.04), [0, 0]), is_end, severity)
    return world, rng.dirichlet(np.full(3, 3.0), size=27)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_what_a_policy_earns_more_than_the_log_is_reported_without_bias_and_intervals_hold(share):
    world, rule = small()
    other = np.eye(3)[np.random.default_rng(1).integers(3, size=27)]
    truth, found = world.worth(other) - world.worth(rule), []
    for seed in range(30):
        steps = world.simulate(1000, rule, world.hazard(rule, share), np.random.default_rng([seed, 1]))
        log = world.log(steps, rule)
        learner = CensoredQLearner(log.horizon, world.actions, ["state"]).fit(log)
        coefficients = np.repeat(other[None, :25].swapaxes(-1, -2), log.horizon, axis=0)
        coefficients[..., 1:] -= coefficients[..., :1]
        policy = type(learner.policy_)(**{**vars(learner.policy_), "coefficients": coefficients})
        fold = np.arange(log.num_trajectories) % 2
        found.append(gain_of(CrossFitted((policy, policy), fold, log.horizon), learner.model_, log, 20.0))
    value, low, high, _ = np.array(found).T
    assert abs(value.mean() - truth) < 4.0 * value.std() / np.sqrt(len(value))
    assert np.mean((low <= truth) & (truth <= high)) >= 0.83
