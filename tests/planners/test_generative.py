import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import GenerativeProblem, TableProblem, updated_particles
from halfseen.planners.belief import belief_of, grasp_chance
from halfseen.planners.one_step import one_step_q
from halfseen.world.state import occlusion
from tables import state_of

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from tiger import LISTEN, OPEN_LEFT, TigerProblem

HIDES = np.array([[0.0, 0.6], [0.1, 0.0]])
CUPS = [Cup(0.85, ((0.6, False), (0.6, True))), Cup(0.4, ((0.1, False),))]
STATE = state_of(CUPS, HIDES, steps_to_go=7)
TABLE = TableProblem(CONFIG, STATE)
WASH_0, LIFT_0 = 1, 3
NUM = 20_000


@partial(jax.jit, static_argnums=1)
def drawn(problem, num_draws=NUM):
    return jax.vmap(problem.initial_state)(jax.random.split(jax.random.key(0), num_draws))


@jax.jit
def stepped(problem, states, action):
    keys = jax.random.split(jax.random.key(1), NUM)
    return jax.vmap(lambda state, key: problem.step(state, action, key))(states, keys)


@jax.jit
def log_chances(problem, observations, states, action):
    return jax.vmap(lambda o, s: problem.log_likelihood(o, s, action))(observations, states)


def chances_of_all(problem, state, action):
    states = jax.tree.map(lambda leaf: jnp.repeat(leaf[None], 8, axis=0), state)
    return np.exp(log_chances(problem, jnp.arange(8), states, action), dtype=float)


@pytest.mark.parametrize("problem", [TigerProblem(), TABLE], ids=["tiger", "table"])
def test_a_problem_keeps_the_protocol(problem):
    state = jax.tree.map(lambda leaf: leaf[0], drawn(problem))
    is_possible, rule = problem.is_possible(state), jax.jit(problem.rule_values)(state)

    assert isinstance(problem, GenerativeProblem)
    assert is_possible.shape == rule.shape == (problem.num_actions,)
    assert is_possible.any()
    after = jax.tree.map(lambda leaf: leaf[0], stepped(problem, drawn(problem), jnp.argmax(is_possible)))
    assert jax.tree.structure(after.state) == jax.tree.structure(state)
    assert int(after.observation) >= 0


@pytest.mark.parametrize("problem", [TigerProblem(), TABLE], ids=["tiger", "table"])
@pytest.mark.parametrize("action", [0, 1, 2])
def test_what_was_observed_could_be(problem, action):
    after = stepped(problem, drawn(problem), action)
    assert np.isfinite(log_chances(problem, after.observation, after.state, action)).all()


@pytest.mark.parametrize("action", [0, WASH_0, LIFT_0])
def test_chances_of_what_a_table_shows_sum_to_one(action):
    after = jax.tree.map(lambda leaf: leaf[0], stepped(TABLE, drawn(TABLE), action)).state
    assert chances_of_all(TABLE, after, action).sum() == pytest.approx(1.0, abs=1e-5)


def test_a_table_shows_labels_as_often_as_their_likelihood_says():
    one = jax.tree.map(lambda leaf: jnp.repeat(leaf[:1], NUM, axis=0), drawn(TABLE))
    after = stepped(TABLE, one, LIFT_0)
    grasped = np.asarray(after.observation) >= 4
    first = jax.tree.map(lambda leaf: leaf[int(np.argmax(grasped))], after.state)

    shares = np.bincount(np.asarray(after.observation)[grasped], minlength=8) / grasped.sum()
    expected = chances_of_all(TABLE, first, LIFT_0)
    np.testing.assert_allclose(shares, expected, atol=4 * 0.5 / np.sqrt(grasped.sum()))


def test_hidden_parts_are_drawn_from_the_belief():
    hidden = drawn(TABLE).hidden
    np.testing.assert_allclose(np.mean(hidden.is_dirty, axis=0), [0.85, 0.4], atol=4 * 0.5 / np.sqrt(NUM))

    after = stepped(TABLE, drawn(TABLE), WASH_0)
    belief = belief_of(CONFIG, STATE)
    expected = float(grasp_chance(CONFIG, occlusion(STATE), belief.grip)[0])
    assert np.mean(np.asarray(after.observation) >= 4) == pytest.approx(expected, abs=4 * 0.5 / np.sqrt(NUM) + 0.01)


@pytest.mark.parametrize("steps_to_go", [1, 2, 7])
@pytest.mark.parametrize("action", [0, WASH_0, LIFT_0])
def test_the_control_of_an_action_is_the_mean_of_its_reward_and_of_the_control_after_it(action, steps_to_go):
    problem = TableProblem(CONFIG, state_of(CUPS, HIDES, steps_to_go))
    situations = drawn(problem)
    after = stepped(problem, situations, action)
    beyond = np.where(after.is_over, 0.0, jax.jit(jax.vmap(problem.control))(after.state).value)
    worth = np.asarray(after.reward + beyond, dtype=float)

    expected = problem.control(jax.tree.map(lambda leaf: leaf[0], situations)).action_values[action]
    assert worth.mean() == pytest.approx(float(expected), abs=4 * worth.std() / np.sqrt(NUM))


def test_the_rule_of_a_table_is_the_look_one_step_ahead():
    state = jax.tree.map(lambda leaf: leaf[0], drawn(TABLE))
    expected = jax.jit(one_step_q)(CONFIG, belief_of(CONFIG, STATE))
    np.testing.assert_allclose(jax.jit(TABLE.rule_values)(state), expected, rtol=1e-5)


def test_too_many_objects_are_refused():
    with pytest.raises(ArgumentError, match="31 objects"):
        TableProblem(CONFIG, state_of([Cup(0.5)] * 31, np.zeros((31, 31))))


def test_particles_follow_the_rule_of_bayes():
    problem = TigerProblem()
    particles = drawn(problem)
    for heard in (0, 0):
        particles = updated_particles(
            problem, particles, jnp.asarray(LISTEN), jnp.asarray(heard), jax.random.key(heard)
        )
    odds = (0.85 / 0.15) ** 2
    assert np.mean(np.asarray(particles) == 0) == pytest.approx(odds / (1 + odds), abs=0.01)

    anew = updated_particles(problem, particles, jnp.asarray(OPEN_LEFT), jnp.asarray(0), jax.random.key(3))
    assert np.mean(np.asarray(anew) == 0) == pytest.approx(0.5, abs=0.02)
