"""Intervals and chances of being best: exact, by a naive Monte Carlo, and as `act` says them of tables."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies import NamedObservation, decider_of, read_policy
from halfseen.policies.decision import certainty, lead
from halfseen.policies.folder import write_policy
from halfseen.policies.folder.log_facts import stage_counts, stages_left
from halfseen.tables.present import first_state
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig
from halfseen.world.actions import ActionSpace
from small_logs import flat_log

EVERY, BOTH = np.ones(3, dtype=bool), np.ones(2, dtype=bool)
TWO = np.array([0, 1])
Z = 1.959963985


def naive_chances(q, roots, designs, blocks, num_draws=100_000):
    """Draw the coefficients of every block, one after the other, and count who is best."""
    rng = np.random.default_rng(11)
    centred = {block: rng.normal(size=(num_draws, root.shape[1])) @ root.T for block, root in roots.items()}
    worth = np.stack([q[a] + centred[blocks[a]] @ designs[a] for a in range(len(q))], axis=1)
    return np.bincount(worth.argmax(axis=1), minlength=len(q)) / num_draws


def test_actions_of_one_block_err_together():
    rng = np.random.default_rng(0)
    roots = {block: 0.5 * rng.normal(size=(4, 4)) for block in (0, 1)}
    blocks, designs = np.array([0, 0, 1]), rng.normal(size=(3, 4))
    q = np.array([0.3, 0.0, 0.5])
    deviations = np.stack([roots[block].T @ design for block, design in zip(blocks, designs, strict=True)])
    found = certainty(q, deviations, blocks, EVERY)
    error = [np.sqrt(x @ roots[k] @ roots[k].T @ x) for k, x in zip(blocks, designs, strict=True)]
    np.testing.assert_allclose([found.high - q, q - found.low], Z * np.array([error, error]), rtol=1e-6)
    np.testing.assert_allclose(found.chance_best, naive_chances(q, roots, designs, blocks), atol=0.012)
    # One state has one answer, and the global seed changes nothing.
    np.random.seed(4)  # noqa: NPY002
    np.testing.assert_array_equal(found.chance_best, certainty(q, deviations, blocks, EVERY).chance_best)


def test_a_common_error_is_no_reason_to_doubt_which_is_best():
    common, better = np.array([[5.0], [5.0]]), np.array([0.1, 0.0])
    assert certainty(better, common, np.array([0, 0]), BOTH).chance_best.tolist() == [1.0, 0.0]
    apart = certainty(better, common, TWO, BOTH).chance_best
    np.testing.assert_allclose(apart[0], norm.cdf(0.1 / np.hypot(5.0, 5.0)), atol=0.012)


def test_of_independent_actions_the_chance_is_the_integral():
    q, error = np.array([1.0, 0.5, 0.0]), np.array([0.5, 1.0, 2.0])
    found = certainty(q, error[:, None], np.arange(3), EVERY)

    def is_best(x, a):
        rivals = np.arange(3) != a
        return norm.pdf(x, q[a], error[a]) * np.prod(norm.cdf(x, q[rivals], error[rivals]))

    for a in range(3):
        assert found.chance_best[a] == pytest.approx(quad(is_best, -12.0, 12.0, args=(a,))[0], abs=0.012)


def test_equals_are_all_the_best_and_the_impossible_never_is():
    q, deviations = np.array([2.0, 2.0, np.nan]), np.array([[1.0, 0.5], [1.0, 0.5], [np.nan, np.nan]])
    found = certainty(q, deviations, np.zeros(3, dtype=int), np.array([True, True, False]))
    assert found.chance_best.tolist() == [1.0, 1.0, 0.0]
    assert found.low[2] == found.high[2] == -np.inf
    assert list(found.by_name(["a", "b", "c"])[0]) == ["a", "b"]


@pytest.mark.parametrize("unit", [1e-9, 1e-4, 1e6])
def test_the_unit_of_rewards_changes_no_chance_and_hides_no_difference(unit):
    q, deviations = np.array([0.30, 0.29, 0.19]), np.diag([0.02, 0.03, 0.1])
    found, usual = (certainty(each * q, each * deviations, np.arange(3), EVERY) for each in (unit, 1.0))
    np.testing.assert_array_equal(found.chance_best, usual.chance_best)
    said = lead(["a", "b", "c"], unit * q, 0, {})
    assert float(said.removeprefix("a: worth ").removesuffix(" more than b")) == pytest.approx(0.01 * unit)
    assert lead(["a", "b", "c"], unit * q[[0, 0, 1]], 0, {}) == "a: worth as much as b"


def test_stages_to_come_widen_by_their_number_draws_by_its_root_and_what_no_log_takes_away_both():
    q = np.array([1.0, 0.0])
    found = certainty(q, np.array([[1.0], [1.0]]), TWO, BOTH, 4.0)
    np.testing.assert_allclose(found.high, q + 4.0 * Z, rtol=1e-6)
    np.testing.assert_allclose(found.chance_best[0], norm.cdf(1.0 / np.hypot(2.0, 2.0)), atol=0.012)
    found = certainty(q, np.array([[0.6], [0.8]]), TWO, BOTH, 4.0, 3.0)
    np.testing.assert_allclose(found.high - q, Z * np.sqrt([2.4**2 + 9.0, 3.2**2 + 9.0]), rtol=1e-6)
    together = np.sqrt(4.0 + 9.0 / 0.5) * np.hypot(0.6, 0.8)
    np.testing.assert_allclose(found.chance_best[0], norm.cdf(1.0 / together), atol=0.012)


def test_stages_to_come_are_counted_as_if_nothing_had_been_cut():
    """Trajectories go on with a chance of 0.6 at each of four stages; half of some are cut away at random."""
    rng, stages, trajectories = np.random.default_rng(2), [], []
    for trajectory in range(4000):
        num = 1 + int(np.argmax([*(rng.random(3) > 0.6), True]))
        cut_in = int(rng.integers(1, 5)) if rng.random() < 0.5 else 9
        for stage in range(1, min(num, cut_in) + 1):
            done = stage < cut_in
            stages.append((trajectory, stage, "A", float(stage) if done else np.nan, 0.0 if done else np.nan))
        is_cut = cut_in <= num
        trajectories.append((trajectory, cut_in - 0.5 if is_cut else float(num), "cut" if is_cut else "finished"))
    exact = [1 + 0.6 + 0.36 + 0.216, 1 + 0.6 + 0.36, 1.6, 1.0]
    logs = Logs(
        pd.DataFrame(stages, columns=["trajectory", "stage", "action", "elapsed_s", "reward"]),
        pd.DataFrame(trajectories, columns=["trajectory", "end_s", "ending"]),
    )
    np.testing.assert_allclose(stages_left(stage_counts(logs)), exact, atol=0.06)


SEEN = NamedObservation(pd.DataFrame({"x1": [0.1], "x2": [1]}), 1)


def test_what_was_learned_holds_how_sure_it_is(stored):
    logs = flat_log(num_trajectories=60)
    learner = CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], q_function="linear", reg=0.1)
    policy = stored(learner, logs)
    decision, known = decider_of(policy).decide(SEEN), policy.q_error
    assert known is not None
    assert 1.0 < known.stages_left[0] <= 2.0
    assert known.pessimism == pytest.approx(2.0 / np.sqrt(2.0))
    design = np.array([1.0, 0.1, 1.0])
    for k, name in enumerate(("A", "B")):
        q = float(learner.policy_.coefficients[0, k] @ design)
        error = np.linalg.norm(learner.policy_.margin[0, k].T @ design) / known.pessimism
        half = Z * np.hypot(known.stages_left[0] * error, 0.2 * np.nanstd(logs.stages["reward"].astype(float)))
        np.testing.assert_allclose(decision.intervals[name], (q - half, q + half), rtol=1e-5)
    assert list(decision.chance_best) == ["A", "B"]
    assert sum(decision.chance_best.values()) == pytest.approx(1.0, abs=1e-3)
    assert f"best with a chance of {decision.chance_best[decision.action]:.0%}" in decision.reason


@pytest.mark.slow
def test_without_pessimism_nobody_knows(kept):
    policy = read_policy(kept / "flat")
    decision = decider_of(policy).decide(SEEN)
    assert (policy.q_error, decision.intervals, decision.chance_best) == (None, {}, {})
    assert "chance" not in decision.reason


HORIZON = 4
CONFIG = WorldConfig(horizon=HORIZON)
SCENE = Scene(np.array([[0.0, 0.6, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]))
NOW = first_state(SCENE, HORIZON, CONFIG.dirty_share)
NAMES = ActionSpace(3).names


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """Gives the policy that was learned from so many trajectories, read from its folder."""

    def learn(num_trajectories):
        folder = tmp_path_factory.mktemp("certainty") / "policy"
        logs = TableWorld(CONFIG).simulate(
            SCENE, ExploringPolicy(UniformPolicy()), num_trajectories, seed=0, cut_share=0.3
        )
        write_policy(CensoredQLearner.for_table(HORIZON, laws=None).fit(logs), logs, folder)
        return read_policy(folder)

    return learn


@pytest.fixture(scope="module")
def of_sixty(learned):
    return learned(60)


def said(stored, **changed):
    """Low, high, chance of being best and value of every action; NaN where it is impossible."""
    decision = decider_of(stored, extrapolates=True).decide(replace(NOW, state=replace(NOW.state, **changed)))
    nothing = (np.nan, np.nan)
    low, high = np.array([decision.intervals.get(name, nothing) for name in NAMES]).T
    chance = np.array([decision.chance_best.get(name, np.nan) for name in NAMES])
    return low, high, chance, np.array([decision.q_values[name] for name in NAMES], dtype=float)


def test_intervals_are_about_q_and_not_about_its_lower_bound(of_sixty):
    low, high, chance, values = said(of_sixty)
    q = np.asarray(of_sixty.policy.estimates(NOW.state))
    assert of_sixty.policy.margin is not None
    np.testing.assert_allclose((low + high) / 2.0, q, rtol=1e-5, atol=1e-5)
    assert (values <= q + 1e-5).all()
    assert chance.sum() == pytest.approx(1.0, abs=0.01)


def test_the_more_trajectories_the_less_doubt(of_sixty, learned):
    width, surer = (high - low for low, high, *_ in map(said, (of_sixty, learned(480))))
    assert (surer < 0.9 * width).all()


def test_objects_that_nothing_tells_apart_are_equally_good(of_sixty):
    low, high, chance, values = said(
        of_sixty, hides=np.zeros((3, 3), dtype=np.float32), log_odds=np.float32([2.0, 2.0, 0.0])
    )
    for pair in ((1, 2), (4, 5)):  # WASH 0 and 1, LIFT 0 and 1
        for each in (low, high, chance, values):
            assert each[pair[0]] == pytest.approx(each[pair[1]], abs=1e-5)
    assert values[4] != values[6]


def test_new_numbers_for_the_objects_only_permute_what_is_said(of_sixty):
    order = np.array([2, 0, 1])
    found = said(of_sixty)
    moved = said(of_sixty, hides=NOW.state.hides[np.ix_(order, order)], log_odds=NOW.state.log_odds[order])
    actions = np.concatenate([[0], 1 + order, 4 + order])
    for one, other, tolerance in zip(moved, found, (1e-4, 1e-4, 0.015, 1e-4), strict=True):
        np.testing.assert_allclose(one, other[actions], rtol=1e-4, atol=tolerance)


def test_of_what_is_off_the_table_nothing_is_said(of_sixty):
    expected = [True, True, False, True, True, False, True]
    for each in said(of_sixty, is_on_table=np.array([True, False, True])):
        np.testing.assert_array_equal(np.isfinite(each), expected)
