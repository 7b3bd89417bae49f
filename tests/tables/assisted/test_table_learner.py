"""The learner of tables: what it reads off a log, what it builds on, and what becomes of a wrong recorder."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import PRICES, SCENES, logs_of

from fitted_laws import FITTED
from halfseen.arrays import expit
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.tables import AssistedPolicy, LinearTablePolicy, RulePolicy, TableLearner
from halfseen.tables import learner as learning
from halfseen.tables.encoding import states_alone
from halfseen.tables.evidence import evidence_of
from halfseen.tables.laws import dirty_and_clean, fitted_laws, paid_in, price_of_each
from halfseen.tables.recorder import mending_of
from halfseen.world import AssumedGrasping, AssumedSeeing, WorldConfig
from halfseen.world.random import key_of
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes

HORIZON = FITTED.horizon


def left_in(logs):
    states = states_alone(logs, HORIZON)
    return np.where(states.is_on_table, expit(states.log_odds), 0.0).sum(axis=-1)[stage_places(logs)]


@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_prices_and_times_are_read_off_the_log(config):
    logs = logs_of(150, replace(config, **PRICES))
    found = paid_in(logs, HORIZON, left_in(logs))
    assert {name: getattr(found, name) for name in PRICES} == pytest.approx(PRICES, rel=1e-4)
    assert found.grasping.limit_s == pytest.approx(config.grasping.limit_s, rel=0.05)


@pytest.mark.parametrize(
    ("paid", "expected"),
    [
        ([], {}),
        ([5.0] * 3, {"reward_wash_dirty": 5.0}),
        ([-10.0] * 3, {"reward_wash_clean": -10.0}),
        ([2.0] * 30, {"reward_wash_dirty": 2.0, "reward_wash_clean": 2.0}),
        ([5.1, 4.9, -9.0, -10.0, -11.0], {"reward_wash_dirty": 5.0, "reward_wash_clean": -10.0}),
    ],
)
def test_the_dirty_are_reported_from_the_clean_by_what_they_pay(paid, expected):
    assert dirty_and_clean(np.array(paid)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("paid", "left", "expected"),
    [
        ([-5.0, -10.0, 0.0], [1.2, 1.9, 0.3], -5.0),
        ([-10.0, -20.0, -10.0], [1.8, 4.1, 2.2], -5.0),
        ([-4.6, -11.0, -0.2], [1.0, 2.2, 0.1], -4.928),
        ([0.0, 0.0], [4.0, 3.0], 0.0),
        ([0.0, 0.0], [0.2, 0.3], None),
        ([], [], None),
    ],
)
def test_the_price_of_what_is_left_is_that_of_one(paid, left, expected):
    found = price_of_each(np.array(paid), np.array(left))
    assert found == (expected if expected is None else pytest.approx(expected, abs=1e-2))


def test_a_log_that_does_not_tell_what_became_of_attempts_is_learned_without_laws():
    logs = logs_of(30)
    unknown = Logs(logs.stages, logs.trajectories, logs.objects.drop(columns=["successes"]))
    learner = CensoredQLearner.for_table(HORIZON).fit(unknown)
    assert learner.assisted_ is None
    assert isinstance(learner.policy_, LinearTablePolicy)
    assert "Q is linear eq. 3 without laws: objects: there is no column 'successes'" in learner.chosen_[-1]


def test_it_learns_with_laws_unless_something_is_said_of_linear_q():
    assert type(CensoredQLearner.for_table(5)) is TableLearner
    assert type(CensoredQLearner.for_table(5, censoring="cox", random_state=3)) is TableLearner
    for given in ({"laws": None}, {"q_function": "linear"}, {"reg": 0.1}, {"pessimism": 0.0}, {"stages": "pooled"}):
        assert type(CensoredQLearner.for_table(5, **given)) is CensoredQLearner
    with pytest.raises(ArgumentError, match="laws is 'mine'; give 'auto', or None"):
        CensoredQLearner.for_table(5, laws="mine")


@pytest.mark.slow
def test_the_same_log_gives_the_same_bytes_again_and_the_parameters_are_scikit_learns():
    logs = logs_of(30)
    learner = CensoredQLearner.for_table(HORIZON, random_state=4).fit(logs)
    again = learner.unfitted().fit(logs)
    assert isinstance(learner.policy_, AssistedPolicy)
    assert isinstance(learner.linear_policy_, LinearTablePolicy)
    assert again.policy_.excess.coefficients.tobytes() == learner.policy_.excess.coefficients.tobytes()
    assert again.policy_.config == learner.policy_.config
    assert "prior_law" in learner.get_params()


@pytest.mark.slow
def test_few_logs_learn_more_than_linear_eq_3_does():
    logs = logs_of(40)
    learner = CensoredQLearner.for_table(HORIZON).fit(logs)
    layouts, key = pad_scenes(SCENES), key_of(1)
    own, linear = (
        evaluate(FITTED, layouts, policy, key, 3000).reward for policy in (learner.policy_, learner.linear_policy_)
    )
    assert (own - linear).mean() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        {"seeing": AssumedSeeing(0.5, 0.3, 1.0)},
        {"grasping": AssumedGrasping(offset_std=0.2, log_time=3.0, log_time_per_occlusion=0.0, limit_s=8.0)},
    ],
)
def test_where_the_log_contradicts_the_laws_it_builds_on_a_rule_or_on_linear_eq_3(monkeypatch, wrong):
    def forced(*given):
        found = fitted_laws(*given)
        return found._replace(config=replace(found.config, **wrong))

    monkeypatch.setattr(learning, "fitted_laws", forced)
    learner = CensoredQLearner.for_table(HORIZON).fit(logs_of(120))
    assert learner.assisted_.test.is_rejected
    assert learner.assisted_.basis in ("rule", "linear")
    kind = RulePolicy if learner.assisted_.basis == "rule" else LinearTablePolicy
    assert isinstance(learner.policy_, kind)
    assert any("the log contradicts the laws" in sentence for sentence in learner.chosen_)


def test_log_odds_are_made_again_as_the_labels_say_them():
    """A recorder that doubles every step: half of what it says is right, and it is made right where it is."""
    logs, prior = logs_of(200), np.log(0.6 / 0.4)
    evidence, states = evidence_of(logs, FITTED), states_alone(logs, HORIZON)
    doubled = evidence.labels._replace(moved=2.0 * evidence.labels.moved)
    mending = mending_of(doubled, FITTED.seeing, 0.6)
    shown = states.is_on_table
    recorded = replace(
        states, log_odds=np.where(shown, prior + 2.0 * (states.log_odds - prior), 0.0).astype(np.float32)
    )
    np.testing.assert_allclose(mending(recorded).log_odds[shown], states.log_odds[shown], atol=0.25)
    error = np.abs(mending(recorded).log_odds - states.log_odds)[shown]
    assert error.mean() < 0.02
    none = type(evidence.labels)(*(values[:0] for values in evidence.labels))
    assert mending_of(none, FITTED.seeing, 0.6) is None


@pytest.mark.slow
def test_one_that_is_never_cut_and_one_whose_every_trajectory_is_one_stage_are_learned():
    assert CensoredQLearner.for_table(HORIZON).fit(logs_of(30, cut_share=0.0)).assisted_.basis == "model"
    short = replace(FITTED, horizon=1)
    assert CensoredQLearner.for_table(1).fit(logs_of(30, short)).policy_.horizon == 1
