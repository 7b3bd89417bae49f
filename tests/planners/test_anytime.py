"""The same planner within a number of rollouts, or against a clock that the tests hold."""

from dataclasses import replace

import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import POMDPPolicy, plan, pomdp
from halfseen.planners.one_step import one_step_q
from halfseen.planners.pomdp import BATCH, LOOKS_PER_STEP
from halfseen.world import random
from halfseen.world.actions import FINISH
from tables import CUPS, THREE, state_of_few

KEY = random.key_of(0)
NUM, MANY = 64, 2048
LOOK_S, ROLLOUT_S = 0.01, 0.005


STATE = state_of_few()
GONE = state_of_few([Cup(0.9), Cup(0.6, is_on_table=False)], THREE[:2, :2])


class Clock:
    """Time passes by what is drawn alone: `LOOK_S` to open a search, and `ROLLOUT_S` for each rollout."""

    def __init__(self, monkeypatch, slower=1.0):
        self.now_s, self.chunks, self.slower = 100.0, [], slower
        monkeypatch.setattr(pomdp.time, "perf_counter", lambda: self.now_s)
        self.opened, self.grown = pomdp.opened, pomdp._grown
        monkeypatch.setattr(pomdp, "opened", self.open)
        monkeypatch.setattr(pomdp, "_grown", self.grow)

    def open(self, *args):
        self.now_s += LOOK_S
        return self.opened(*args)

    def grow(self, search, round_key, promising, num_left, batches, planning_horizon):
        # Every chunk is slower than the one before, if so asked.
        took_s = (batches[1] - batches[0]) * BATCH * ROLLOUT_S * self.slower ** len(self.chunks)
        self.now_s += took_s
        stage = self.chunks[-1][0] + (batches[0] == 0) if self.chunks else 0
        self.chunks.append((stage, num_left, batches[1] - batches[0], took_s))
        return self.grown(search, round_key, promising, num_left, batches, planning_horizon)


@pytest.mark.parametrize("seconds", [0.2, 1.0, 5.0])
@pytest.mark.slow
def test_a_time_is_kept_and_used(monkeypatch, seconds):
    clock = Clock(monkeypatch)
    found = plan(CONFIG, STATE, KEY, seconds=seconds)

    assert found.was_searched
    assert 0.5 * seconds < found.elapsed_s <= seconds
    assert found.num_rollouts.sum() == BATCH * sum(num for _, _, num, _ in clock.chunks)


@pytest.mark.parametrize("slower", [1.5, 3.0])
def test_on_a_machine_that_slows_down_a_time_is_missed_by_less_than_a_chunk(monkeypatch, slower):
    clock = Clock(monkeypatch, slower)
    found = plan(CONFIG, STATE, KEY, seconds=1.0)

    assert found.elapsed_s - 1.0 < clock.chunks[-1][-1]


def test_where_no_batch_fits_the_myopic_look_ahead_decides_and_the_plan_says_so(monkeypatch):
    clock = Clock(monkeypatch)
    found = plan(CONFIG, STATE, KEY, seconds=LOOK_S * (1.0 + 5 * LOOKS_PER_STEP) - 1e-6)

    assert not found.was_searched
    assert clock.chunks == []
    assert found.elapsed_s == pytest.approx(LOOK_S)
    np.testing.assert_allclose(found.values, one_step_q(CONFIG, STATE), rtol=1e-5)


def test_rounds_halve_what_is_drawn_from_and_have_equal_times(monkeypatch):
    clock = Clock(monkeypatch)
    plan(CONFIG, STATE, KEY, seconds=6.0)

    left = {stage: num_left for stage, num_left, _, _ in clock.chunks}
    assert left == {0: 2, 1: 6, 2: 3, 3: 2}
    times = [sum(took for at, _, _, took in clock.chunks if at == stage) for stage in (1, 2, 3)]
    np.testing.assert_allclose(times, 6.0 / 3, rtol=0.1)


@pytest.mark.slow
def test_rollouts_by_the_clock_are_worth_what_rollouts_by_number_are(monkeypatch):
    Clock(monkeypatch)
    timed = plan(CONFIG, STATE, KEY, seconds=10.0, planning_horizon=3)
    counted = plan(CONFIG, STATE, KEY, num_simulations=MANY, planning_horizon=3)

    best = np.argmax(counted.values)
    np.testing.assert_allclose(timed.values[best], counted.values[best], atol=0.25)
    assert best in np.argsort(-timed.num_rollouts)[:2]


def test_the_same_number_gives_the_same_bytes_and_another_key_does_not():
    first, again, other = (plan(CONFIG, STATE, random.key_of(k), num_simulations=NUM) for k in (0, 0, 1))

    assert first.values.tobytes() == again.values.tobytes()
    assert first.num_rollouts.tobytes() == again.num_rollouts.tobytes()
    assert first.values.tobytes() != other.values.tobytes()
    assert NUM / 2 < first.num_rollouts.sum() < 2 * NUM
    assert first.num_rollouts[FINISH] == 0


def test_a_number_is_spent_as_the_policy_spends_it():
    policy = POMDPPolicy(CONFIG, CONFIG.horizon, NUM)
    expected = policy.q_values(STATE, KEY)

    np.testing.assert_allclose(plan(CONFIG, STATE, KEY, num_simulations=NUM).values, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("state", "options"),
    [(state_of_few(steps_to_go=1), {}), (STATE, {"planning_horizon": 1})],
    ids=["last step", "horizon 1"],
)
@pytest.mark.parametrize("budget", [{"num_simulations": NUM}, {"seconds": 10.0}], ids=str)
def test_what_needs_no_rollout_has_none(state, options, budget):
    found = plan(CONFIG, state, KEY, **budget, **options)

    assert not found.was_searched
    np.testing.assert_allclose(found.values, one_step_q(CONFIG, state), rtol=1e-5)


@pytest.mark.parametrize("budget", [{"num_simulations": NUM}, {"seconds": 1.0}], ids=str)
def test_one_object_and_padding_and_what_has_left_are_never_drawn_from(monkeypatch, budget):
    Clock(monkeypatch)
    found = plan(CONFIG, GONE, KEY, **budget)

    np.testing.assert_array_equal(found.num_rollouts > 0, [False, True, False, False, True, False, False])
    np.testing.assert_array_equal(np.isfinite(found.values), [True, True, False, False, True, False, False])


@pytest.mark.parametrize(
    "state",
    [replace(STATE, steps_to_go=np.int32(0)), state_of_few([replace(cup, is_on_table=False) for cup in CUPS])],
    ids=["no step", "no object"],
)
def test_a_trajectory_that_is_over_is_refused(state):
    with pytest.raises(ArgumentError, match="the trajectory is over"):
        plan(CONFIG, state, KEY, num_simulations=NUM)


@pytest.mark.parametrize(
    ("budget", "said"),
    [
        ({}, "give one of the two"),
        ({"seconds": 1.0, "num_simulations": 3}, "give one of the two"),
        ({"seconds": 0.0}, "seconds is 0.0"),
        ({"seconds": float("nan")}, "seconds is nan"),
        ({"num_simulations": 0}, "num_simulations is 0; it is at least 1"),
        ({"seconds": 1.0, "planning_horizon": 0}, "planning_horizon is 0; it is at least 1"),
    ],
)
def test_a_wrong_number_is_refused(budget, said):
    with pytest.raises(ArgumentError, match=said):
        plan(CONFIG, STATE, KEY, **budget)
