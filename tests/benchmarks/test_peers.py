"""The peer's model against ours: it must meet the same world."""

import random

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners import GreedyPolicy
from halfseen.planners.belief import belief_of, grasp_probability
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.action_space import ActionSpace
from halfseen.world.dynamics import start, step
from halfseen.world.episodes import play
from halfseen.world.state import HiddenState, pad_scenes

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
    episodes = play(CONFIG, pad_scenes([Scene(HIDES)]), UniformPolicy(), jax.random.key(0), 60)
    return jax.tree.map(lambda leaf: leaf[np.asarray(episodes.is_taken)], episodes.states)


def one_of(states, k):
    return jax.tree.map(lambda leaf: leaf[k], states)


def drawn(seen, num_draws=NUM):
    return MODEL.states(seen, np.random.default_rng(1), num_draws)


def hidden_of(states):
    """The hidden parts that the peer has drawn, as ours."""
    is_dirty = [[state.dirty >> i & 1 for i in range(3)] for state in states]
    grip_offset = np.log([state.ease for state in states])
    return HiddenState(jnp.asarray(is_dirty, dtype=bool), jnp.asarray(grip_offset, dtype=jnp.float32))


@jax.jit
def ours(seen, hidden, actions):
    """Rewards, labels and grasps of each step, and what the best heuristic would do then; zeros once it is over."""

    def run(hidden, key):
        def advance(carry, t):
            seen, is_over = carry
            after, _, outcome = step(CONFIG, seen, hidden, actions[t], jax.random.fold_in(key, t))
            now = CONFIG.horizon - seen.steps_to_go
            bits = jnp.append(after.log_odds > seen.log_odds, after.attempt_succeeded[now])
            choice = jax.nn.one_hot(BEST.decide(after, key).action, 7)
            is_last = is_over | outcome.is_over
            shown = jnp.where(is_last, 0.0, jnp.concatenate([bits, choice]))
            return (after, is_last), jnp.append(shown, jnp.where(is_over, 0.0, outcome.reward))

        return jax.lax.scan(advance, (seen, jnp.asarray(False)), jnp.arange(len(actions)))[1]

    return jax.vmap(run)(hidden, jax.random.split(jax.random.key(2), NUM))


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
    seen, hidden = jax.jit(start)(CONFIG, layout, jax.random.key(3))
    for t, action in enumerate((LIFT_1, LIFT_1, LIFT_0, LIFT_2, LIFT_1, LIFT_2)[: CONFIG.horizon - steps_to_go]):
        seen, _ = jax.jit(step)(CONFIG, seen, hidden, action, jax.random.key(t))
    random.seed(0)

    states = drawn(seen)
    shown = np.asarray(ours(seen, hidden_of(states), jnp.array(actions)), dtype=float)
    assert_same_means(shown, theirs(states, actions))


def test_hidden_parts_are_drawn_from_the_belief(states):
    for k in range(0, len(states.steps_to_go), 40):
        seen = one_of(states, k)
        hidden, belief = hidden_of(drawn(seen, 20_000)), belief_of(CONFIG, seen)
        noise = 4 * 0.5 / np.sqrt(20_000)
        np.testing.assert_allclose(hidden.is_dirty.mean(axis=0), jax.nn.sigmoid(seen.log_odds), atol=noise)
        there = jnp.zeros(3)
        grasped = -jnp.expm1(CONFIG.grasping.log_failure(there[None], hidden.grasp_trait)).mean(axis=0)
        np.testing.assert_allclose(grasped, grasp_probability(CONFIG, there, belief.grip), atol=noise + 0.01)


def test_rollouts_are_our_best_heuristic(states):
    policy, decide = table.HeuristicPolicy(MODEL), jax.jit(BEST.decide)
    for k in range(len(states.steps_to_go)):
        seen = one_of(states, k)
        (state,) = drawn(seen, num_draws=1)
        assert policy.rollout(state).number == decide(seen, jax.random.key(0)).action


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
