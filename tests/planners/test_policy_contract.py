"""What every policy owes, anyone who wrote it; and policies by name: one list for all who take a name."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.arrays import known_to_jax, mapped
from halfseen.cli import inputs
from halfseen.errors import ArgumentError
from halfseen.planners import (
    HEURISTICS,
    PLANNER,
    UNIFORM,
    GreedyPolicy,
    MyopicPolicy,
    POMDPPolicy,
    ReservingPolicy,
    RolloutPolicy,
    named_policy,
)
from halfseen.study.policies import HEURISTICS as CONTENDERS
from halfseen.tables import LinearTablePolicy
from halfseen.tables.features import NUM_FEATURES
from halfseen.world import ExploringPolicy, Policy, Scene, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.actions import possible_actions
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes
from picked import picked, repeated

CONFIG = WorldConfig()
GREEDY = {
    f"greedy, history {h}, penalty {p}": GreedyPolicy(CONFIG, uses_history=h, counts_penalty=p)
    for h in (False, True)
    for p in (False, True)
}
POLICIES: dict[str, Policy] = GREEDY | {
    "pomdp-1": POMDPPolicy(CONFIG, 1),
    "pomdp-2": POMDPPolicy(CONFIG, 2),
    "linear": LinearTablePolicy(np.zeros((CONFIG.horizon, len(Verb), NUM_FEATURES + 1))),
    "uniform": UniformPolicy(),
    "exploring": ExploringPolicy(GreedyPolicy(CONFIG), 0.5),
}
every_policy = pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES.keys())


@pytest.fixture(scope="session")
def states():
    """States along the way, of tables of one, three and four cups, padded to five with NaN."""
    rng = np.random.default_rng(0)
    scenes = [Scene(rng.uniform(0, 0.5, (n, n)) * ~np.eye(n, dtype=bool)) for n in (1, 3, 4)]
    episodes = play(CONFIG, pad_scenes(scenes, 5), UniformPolicy(), random.key_of(0), 12)
    return picked(episodes.states, episodes.is_taken)


@pytest.fixture(scope="session")
def keys(states):
    return random.keys_of(random.key_of(1), len(states.steps_to_go))


@every_policy
def test_it_takes_possible_actions_only_and_says_how_likely_it_was_to(policy, states, keys):
    decision = policy.decide(states, keys)
    probability = decision.probability

    assert decision.action.dtype == np.int32
    assert np.all(np.take_along_axis(possible_actions(states), decision.action[:, None], axis=1))
    assert np.all(np.isnan(probability) | ((probability > 0) & (probability <= 1)))


@every_policy
def test_it_is_a_record_that_comes_back_whole(policy, states, keys):
    again = mapped(np.array, policy)

    assert isinstance(policy, Policy)
    assert type(again) is type(policy)
    np.testing.assert_array_equal(again.decide(states, keys).action, policy.decide(states, keys).action)


@pytest.mark.slow
@every_policy
def test_the_tables_of_a_batch_do_not_know_of_each_other(policy, states, keys):
    together = policy.decide(states, keys).action
    others_first = policy.decide(*mapped(lambda leaf: np.concatenate([leaf[20:], leaf[:20]]), (states, keys)))
    alone = [policy.decide(picked(states, k), keys[k]).action for k in range(len(keys))]

    np.testing.assert_array_equal(np.roll(together, -20), others_first.action)
    np.testing.assert_array_equal(together, alone)


def test_a_policy_that_says_how_likely_its_choice_was_is_right(states):
    one = picked(states, 0)
    same = repeated(one, len(states.steps_to_go))
    actions, result = [], {}
    for seed in range(40):
        keys = random.keys_of(random.key_of(seed), len(states.steps_to_go))
        decision = POLICIES["exploring"].decide(same, keys)
        actions.append(decision.action)
        result |= dict(zip(decision.action.tolist(), decision.probability.tolist(), strict=True))
    taken = np.concatenate(actions)

    assert sum(result.values()) == pytest.approx(1.0, abs=1e-5)
    for action, probability in result.items():
        assert np.mean(taken == action) == pytest.approx(probability, abs=0.04)


@pytest.mark.slow
def test_under_jit_planners_decide_as_in_numpy(states, keys):
    pytest.importorskip("jax")
    jax = known_to_jax()
    few = picked(states, np.s_[:12])
    compiled = jax.jit(lambda policy, states, keys: policy.decide(states, keys).action)
    for policy in (GreedyPolicy(CONFIG, uses_history=True), POMDPPolicy(CONFIG, 1), POMDPPolicy(CONFIG, 3, 16)):
        found = compiled(policy, mapped(jax.numpy.asarray, few), jax.numpy.asarray(keys[:12]))
        np.testing.assert_array_equal(found, policy.decide(few, keys[:12]).action)


PAIR = WorldConfig(speed=(1.0, 1.5))


@pytest.mark.parametrize("name", HEURISTICS)
def test_a_heuristic_does_what_its_name_says_and_robots_of_a_team_reserve_by_it(name):
    rule = GreedyPolicy(CONFIG, uses_history="history" in name, counts_penalty="penalty" in name)
    for config, expected in ((CONFIG, rule), (PAIR, ReservingPolicy(PAIR, replace(rule, config=PAIR)))):
        assert named_policy(name, config) == expected
        assert named_policy(name, config, 0.5) == ExploringPolicy(expected, 0.5)
    assert named_policy(name, PAIR, is_team=False) == replace(rule, config=PAIR)


def test_others_go_by_names_too():
    for config in (CONFIG, PAIR):
        assert isinstance(named_policy(UNIFORM, config, 0.5), UniformPolicy)
    planner = named_policy(PLANNER, CONFIG)
    assert isinstance(planner, POMDPPolicy)
    assert planner.planning_horizon == CONFIG.horizon
    assert named_policy(PLANNER, PAIR) == RolloutPolicy(PAIR, MyopicPolicy(PAIR))
    # One robot with a reach of its own is a team, too.
    assert named_policy(PLANNER, CONFIG, is_team=True) == RolloutPolicy(CONFIG, MyopicPolicy(CONFIG))


def test_a_name_that_is_none_is_refused():
    with pytest.raises(ArgumentError, match=r"policy is 'best'; give one of greedy, history, .*, planner"):
        named_policy("best", CONFIG)


def test_the_study_and_the_cell_know_the_same_names():
    assert [each.name for each in CONTENDERS] == list(HEURISTICS)
    assert [each.policy(CONFIG) for each in CONTENDERS] == [named_policy(name, CONFIG) for name in HEURISTICS]
    assert (*HEURISTICS, PLANNER) == inputs.NAMES
