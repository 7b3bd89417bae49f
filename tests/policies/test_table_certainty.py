"""How sure a learned Q of tables is, as `act` says it of a policy in its folder."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.learning import CensoredQLearner
from halfseen.policies import decider_of, read_policy
from halfseen.policies.folder import write_policy
from halfseen.tables.present import first_state
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig
from halfseen.world.actions import ActionSpace

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
