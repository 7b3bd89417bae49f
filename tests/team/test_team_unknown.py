"""What is drawn of what nobody knows is drawn by what is seen alone, and has the law that it has given that."""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import ks_2samp

from halfseen.planners.belief import NUM_NODES
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM
from halfseen.team.planners.grid_grasping import GridGrasping
from halfseen.team.planners.unknown import sampled_hidden
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.state import pad_scenes

NUM_OBJECTS = 3
WASH = tuple(int(ActionSpace(NUM_OBJECTS).encode(Verb.WASH, i)) for i in range(NUM_OBJECTS))
LIFT_1 = int(ActionSpace(NUM_OBJECTS).encode(Verb.LIFT, 1))


def kstwo_p_value(one, other):
    told: Any = ks_2samp(one, other)
    return told.pvalue


def begun(team, key, first=WASH[0], second=LIFT_1):
    """A table in full view on which both robots have begun, and one is done."""
    tables = pad_scenes([Scene(np.zeros((NUM_OBJECTS, NUM_OBJECTS)))])
    space = Workspace(jnp.ones((2, NUM_OBJECTS), dtype=bool), jnp.eye(NUM_OBJECTS, dtype=bool))
    layout = TeamLayout(jax.tree.map(lambda leaf: leaf[0], tables), space)
    keys = jax.random.split(key, 3)
    state, hidden = TEAM.start(team, layout, keys[0])
    for action, at in ((first, keys[1]), (second, keys[2])):
        state, hidden, _ = TEAM.step(team, state, hidden, jnp.asarray(action), at)
    return state, hidden


def team_of(grasping=None):
    world = WorldConfig(horizon=4) if grasping is None else WorldConfig(horizon=4, grasping=grasping)
    return TeamConfig(world, (1.0, 1.0))


def drawn_at(team, since_s, num, decider=1):
    """What is drawn where robot 0 has been at object 0 for so long."""
    state, _ = begun(team, jax.random.key(0))
    robots = replace(
        state.robots,
        is_busy=jnp.array([True, False]),
        verb=jnp.array([int(Verb.WASH), 0]),
        target=jnp.zeros(2, dtype=jnp.int32),
        since_s=jnp.array([since_s, 0.0]),
    )
    table = replace(state.table, is_on_table=jnp.ones(NUM_OBJECTS, dtype=bool))
    fresh = replace(table, attempt_object=jnp.full_like(table.attempt_object, -1))
    state = replace(state, robots=robots, table=fresh, decider=jnp.asarray(decider))
    return jax.vmap(partial(sampled_hidden, team, state))(jax.random.split(jax.random.key(1), num))


def test_what_has_lasted_too_long_to_hold_misses():
    drawn = drawn_at(team_of(GridGrasping()), 5.0, 200)
    # Robot 0 decides before robot 1 where both end at once: 4 s of attempt and 1 s of transport are over.
    assert not np.asarray(drawn.pending.is_held[:, 0]).any()
    np.testing.assert_array_equal(drawn.pending.left_s[:, 0], 2.0)
    assert np.isinf(np.asarray(drawn.pending.left_s[:, 1])).all()


def test_what_goes_on_has_the_law_of_what_has_not_ended_yet():
    law, num = GridGrasping(), 20_000
    drawn = drawn_at(team_of(law), 3.0, num)
    nodes, weights = np.polynomial.hermite_e.hermegauss(NUM_NODES)
    weights = weights / weights.sum()
    missed = np.exp(np.asarray(law.log_failure(0.0, nodes * law.offset_std), dtype=np.float64))
    # Of what holds, half took 2 s and would be over; of what misses, all goes on.
    joint = {True: weights * (1 - missed) / 2, False: weights * missed}
    mass = sum(each.sum() for each in joint.values())
    trait, is_held = np.asarray(drawn.table.grasp_trait[:, 0]), np.asarray(drawn.pending.is_held[:, 0])
    for held, of_nodes in joint.items():
        for node, probability in zip(nodes, of_nodes / mass, strict=True):
            share = np.mean((is_held == held) & np.isclose(trait, node * law.offset_std, atol=1e-4))
            assert abs(share - probability) < 4 * np.sqrt(probability / num) + 1e-3
    np.testing.assert_array_equal(np.asarray(drawn.pending.left_s[:, 0]), np.where(is_held, 2.0, 4.0))


def test_nothing_hidden_is_looked_at():
    team = team_of()
    state, hidden = begun(team, jax.random.key(3))
    again = jax.jit(partial(sampled_hidden, team))(state, jax.random.key(4))
    # What is true cannot show in what is drawn: it is not handed over, and the draw is another one.
    assert not np.allclose(hidden.pending.duration_s, again.pending.duration_s)
    assert [leaf.shape for leaf in jax.tree.leaves(again)] == [leaf.shape for leaf in jax.tree.leaves(hidden)]


@pytest.mark.slow
def test_what_is_drawn_is_as_what_is():
    team, num = team_of(), 20_000

    def truth_and_draw(key):
        begin_key, draw_key = jax.random.split(key)
        state, hidden = begun(team, begin_key)
        drawn = sampled_hidden(team, state, draw_key)
        robot = 1 - state.decider
        goes_on = state.robots.is_busy[robot]
        of = lambda each: (each.pending.left_s[robot], each.pending.is_held[robot], each.table.is_dirty[1])  # noqa: E731
        return goes_on, state.robots.since_s[robot], of(hidden), of(drawn)

    goes_on, since_s, truth, drawn = jax.jit(jax.vmap(truth_and_draw))(jax.random.split(jax.random.key(5), num))
    kept = np.asarray(goes_on)
    assert kept.mean() > 0.9
    quartiles = np.quantile(np.asarray(since_s)[kept], [0.0, 0.25, 0.5, 0.75, 1.0])
    for low, high in pairwise(quartiles):
        rows = kept & (np.asarray(since_s) >= low) & (np.asarray(since_s) <= high)
        left, held, dirty = ([np.asarray(each)[rows] for each in pair] for pair in zip(truth, drawn, strict=True))
        assert kstwo_p_value(*left) > 1e-4
        for one, other in (held, dirty):
            error = np.sqrt(2 * 0.25 / rows.sum())
            assert abs(one.mean() - other.mean()) < 4 * error
