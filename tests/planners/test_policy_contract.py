"""What every policy owes, whoever wrote it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners import GreedyPolicy, POMDPPolicy
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.action_space import Verb, possible_actions
from halfseen.world.episodes import play
from halfseen.world.policy import ExploringPolicy, Policy
from halfseen.world.state import pad_scenes
from picked import picked

CONFIG = WorldConfig()
GREEDY = {
    f"greedy, history {h}, penalty {p}": GreedyPolicy(CONFIG, uses_history=h, counts_penalty=p)
    for h in (False, True)
    for p in (False, True)
}
POLICIES: dict[str, Policy] = GREEDY | {
    "pomdp-1": POMDPPolicy(CONFIG, 1),
    "pomdp-2": POMDPPolicy(CONFIG, 2),
    "linear": LinearTablePolicy(jnp.zeros((CONFIG.horizon, len(Verb), NUM_FEATURES + 1))),
    "uniform": UniformPolicy(),
    "exploring": ExploringPolicy(GreedyPolicy(CONFIG), 0.5),
}
every_policy = pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES.keys())


@jax.jit
def decide_each(policy, states, keys):
    return jax.vmap(policy.decide)(states, keys)


@pytest.fixture(scope="session")
def states():
    """States along the way, of tables of one, three and four cups, padded to five with NaN."""
    rng = np.random.default_rng(0)
    scenes = [Scene(rng.uniform(0, 0.5, (n, n)) * ~np.eye(n, dtype=bool)) for n in (1, 3, 4)]
    episodes = play(CONFIG, pad_scenes(scenes, 5), UniformPolicy(), jax.random.key(0), 12)
    return picked(episodes.states, np.asarray(episodes.is_taken))


@pytest.fixture(scope="session")
def keys(states):
    return jax.random.split(jax.random.key(1), len(states.steps_to_go))


@every_policy
def test_it_takes_possible_actions_only_and_says_how_likely_it_was_to(policy, states, keys):
    decision = decide_each(policy, states, keys)
    is_possible = jax.jit(jax.vmap(possible_actions))(states)
    probability = np.asarray(decision.probability)

    assert decision.action.dtype == jnp.int32
    assert np.all(np.take_along_axis(np.asarray(is_possible), np.asarray(decision.action)[:, None], axis=1))
    assert np.all(np.isnan(probability) | ((probability > 0) & (probability <= 1)))


@every_policy
def test_it_is_a_pytree_that_comes_back_whole(policy, states, keys):
    leaves, structure = jax.tree.flatten(policy)
    again = jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves])

    assert isinstance(policy, Policy)
    assert type(again) is type(policy)
    np.testing.assert_array_equal(decide_each(again, states, keys).action, decide_each(policy, states, keys).action)


@every_policy
def test_the_tables_of_a_batch_do_not_know_of_each_other(policy, states, keys):
    together = decide_each(policy, states, keys).action
    others_first = decide_each(
        policy, *jax.tree.map(lambda leaf: jnp.concatenate([leaf[20:], leaf[:20]]), (states, keys))
    )

    np.testing.assert_array_equal(np.roll(together, -20), others_first.action)


def test_a_policy_that_says_how_likely_its_choice_was_is_right(states):
    one = picked(states, 0)
    same = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(states.steps_to_go), *leaf.shape)), one)
    actions, told = [], {}
    for seed in range(40):
        keys = jax.random.split(jax.random.key(seed), len(states.steps_to_go))
        decision = decide_each(POLICIES["exploring"], same, keys)
        actions.append(np.asarray(decision.action))
        told |= dict(zip(decision.action.tolist(), decision.probability.tolist(), strict=True))
    taken = np.concatenate(actions)

    assert sum(told.values()) == pytest.approx(1.0, abs=1e-5)
    for action, probability in told.items():
        assert np.mean(taken == action) == pytest.approx(probability, abs=0.04)
