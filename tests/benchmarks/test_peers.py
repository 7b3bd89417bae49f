"""The peer's model against ours: it must meet the same world."""

import random

import numpy as np
import pytest
from scipy.special import expit

from halfseen.arrays import mapped
from halfseen.planners import GreedyPolicy
from halfseen.planners.belief import belief_of, grasp_probability
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.actions import ActionSpace
from halfseen.world.rollout import play
from halfseen.world.state import HiddenState, pad_scenes
from halfseen.world.transition import start, step

# It needs pomdp-py, which is optional.
table = pytest.importorskip("peers.table")
CONFIG = WorldConfig()
HIDES = np.array([[0.0, 0.6, 0.1], [0.3, 0.0, 0.0], [0.0, 0.5, 0.0]])
MODEL = table.TableModel(CONFIG, HIDES)
BEST = GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True)
FINISH, WASH_0, WASH_1, WASH_2, LIFT_0, LIFT_1, LIFT_2 = range(7)
NUM = 8_000


@pytest.fixture(scope="module")
def states():
    """States along random paths, past attempts included."""
    episodes = play(CONFIG, pad_scenes([Scene(HIDES)]), UniformPolicy(), random.key_of(0), 60)
    return mapped(lambda leaf: leaf[np.asarray(episodes.is_taken)], episodes.states)


def one_of(states, k):
    return mapped(lambda leaf: leaf[k], states)


def drawn(seen, num_draws=NUM):
    return MODEL.states(seen, np.random.default_rng(1), num_draws)


def hidden_of(states):
    """The hidden parts that the peer has drawn, as ours."""
    is_dirty = [[state.dirty >> i & 1 for i in range(3)] for state in states]
    grip_offset = np.log([state.ease for state in states])
    return HiddenState(np.asarray(is_dirty, dtype=bool), np.asarray(grip_offset, dtype=np.float32))


def ours(seen, hidden, actions):
    """Rewards, labels and grasps of each step, and what the best heuristic would do then; zeros once it is over."""

    seen = mapped(lambda leaf: np.broadcast_to(leaf, (NUM, *np.shape(leaf))), seen)
    keys, is_over, shown = random.keys_of(random.key_of(2), NUM), np.zeros(NUM, dtype=bool), []
    for t, action in enumerate(actions):
        taken = np.full(NUM, action, dtype=np.int32)
        after, _, outcome = step(CONFIG, seen, hidden, taken, random.fold_in(keys, t))
        now = CONFIG.horizon - seen.steps_to_go[0]
        bits = np.column_stack([after.log_odds > seen.log_odds, after.attempt_succeeded[:, now]])
        choice = np.eye(7)[BEST.decide(after, keys).action]
        is_last = is_over | outcome.is_over
        told = np.where(is_last[:, None], 0.0, np.concatenate([bits, choice], axis=1))
        shown.append(np.column_stack([told, np.where(is_over, 0.0, outcome.reward)]))
        seen, is_over = after, is_last
    return np.stack(shown, axis=1)


def theirs(states, actions):
    named = {action.number: action for action in MODEL.actions[7]}
    policy, result = table.HeuristicPolicy(MODEL), np.zeros((NUM, len(actions), 12))
    for row, state in zip(result, states, strict=True):
        for t, action in enumerate(actions):
            state, observation, reward, num_steps = MODEL.sample(state, named[action])
            row[t, 11] = reward
            if num_steps == table.OVER:
                break
            row[t, :4] = [observation.bits >> bit & 1 for bit in range(4)]
            row[t, 4 + policy.rollout(state).number] = 1.0
    return result


def assert_same_means(one, other):
    error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / NUM)
    assert np.all(np.abs(one.mean(axis=0) - other.mean(axis=0)) <= 4.0 * error + 1e-6)


@pytest.mark.parametrize(
    "actions",
    [
        (LIFT_0, WASH_1, LIFT_2, FINISH),
        (WASH_0, WASH_1, WASH_2, FINISH),
        (LIFT_1, LIFT_0, LIFT_1, WASH_1),
    ],
)
@pytest.mark.parametrize("steps_to_go", [10, 4])
def test_the_table_is_the_same_world(actions, steps_to_go):
    layout = one_of(pad_scenes([Scene(HIDES)]), 0)
    seen, hidden = start(CONFIG, layout, random.key_of(3))
    for t, action in enumerate((LIFT_1, LIFT_1, LIFT_0, LIFT_2, LIFT_1, LIFT_2)[: CONFIG.horizon - steps_to_go]):
        seen, _ = step(CONFIG, seen, hidden, action, random.key_of(t))
    random.seed(0)

    states = drawn(seen)
    shown = np.asarray(ours(seen, hidden_of(states), np.array(actions)), dtype=float)
    assert_same_means(shown, theirs(states, actions))


def test_hidden_parts_are_drawn_from_the_belief(states):
    for k in range(0, len(states.steps_to_go), 40):
        seen = one_of(states, k)
        hidden, belief = hidden_of(drawn(seen, 20_000)), belief_of(CONFIG, seen)
        noise = 4 * 0.5 / np.sqrt(20_000)
        np.testing.assert_allclose(hidden.is_dirty.mean(axis=0), expit(seen.log_odds), atol=noise)
        there = np.zeros(3)
        grasped = -np.expm1(CONFIG.grasping.log_failure(there[None], hidden.grasp_trait)).mean(axis=0)
        np.testing.assert_allclose(grasped, grasp_probability(CONFIG, there, belief.grip), atol=noise + 0.01)


def test_rollouts_are_our_best_heuristic(states):
    policy, decide = table.HeuristicPolicy(MODEL), BEST.decide
    for k in range(len(states.steps_to_go)):
        seen = one_of(states, k)
        (state,) = drawn(seen, num_draws=1)
        assert policy.rollout(state).number == decide(seen, random.key_of(0)).action


@pytest.mark.parametrize(("rollouts", "visits"), [("random", 0), ("heuristic", 3)])
def test_it_takes_possible_actions_only(states, rollouts, visits):
    shortest_s = np.inf
    for k in range(0, len(states.steps_to_go), 20):
        seen = one_of(states, k)
        action, num_simulations, elapsed_s = table.decided(
            MODEL, drawn(seen, num_draws=100), budget_s=0.002, rollouts=rollouts, exploration=10.0, visits=visits
        )
        assert action == FINISH or seen.is_on_table[ActionSpace(3).target(action)]
        assert num_simulations > 0
        assert elapsed_s >= 0.002
        shortest_s = min(shortest_s, elapsed_s)
    assert shortest_s < 0.5
