"""How likely policies of tables would have done what a log shows; and what that says of the value of a team's rule."""

import numpy as np
import pytest

from halfseen.arrays import record
from halfseen.errors import ArgumentError, PolicyError
from halfseen.evaluation import evaluate, held_out_verdict
from halfseen.learning import CensoredQLearner
from halfseen.planners import GreedyPolicy
from halfseen.tables import IndependentPolicies, TeamTask
from halfseen.tables.policy import decisions, table_probabilities
from halfseen.world import ExploringPolicy, UniformPolicy, WorldConfig, random
from halfseen.world.actions import possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.policy import uniformly
from halfseen.world.rollout import evaluate as play_to_the_end
from halfseen.world.rollout import play
from played_teams import SCENE, WashWhatIsDirty, layout_of, logged, played, team_of


@record
class Whimsical:
    """Draws its actions, and does not say how."""

    def decide(self, state, key):
        decision = uniformly(possible_actions(state), key)
        return decision._replace(probability=np.full(decision.action.shape, np.nan, dtype=np.float32))


RULE = WashWhatIsDirty()


@pytest.fixture(scope="module", params=[1, 2, 3])
def trajectories(request):
    return played(team_of(request.param), 20, seed=2)


def test_a_policy_that_draws_nothing_takes_what_it_decides(trajectories):
    taken = table_probabilities(RULE, trajectories.states)
    assert taken.shape == possible_actions(trajectories.states).shape
    np.testing.assert_array_equal(taken.argmax(axis=-1), RULE.decide(trajectories.states, None).action)
    np.testing.assert_array_equal(taken.argmax(axis=-1), decisions(RULE, trajectories.states))
    np.testing.assert_array_equal(taken.sum(axis=-1), 1.0)


def test_what_a_log_tells_of_its_own_policy_is_the_probability_that_was_logged(trajectories):
    logger = ExploringPolicy(UniformPolicy(), 0.5)
    layout, key = layout_of(trajectories.states.num_robots), random.key_of(3)
    drawn = play(team_of(trajectories.states.num_robots), layout, ExploringPolicy(RULE, 0.3), key, 40)
    likely = table_probabilities(ExploringPolicy(RULE, 0.3), drawn.states)
    own = np.take_along_axis(likely, drawn.action[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(own[drawn.is_taken], drawn.probability[drawn.is_taken], rtol=1e-5)
    uniform = table_probabilities(logger, drawn.states)
    np.testing.assert_allclose(uniform.sum(axis=-1), 1.0, rtol=1e-6)
    assert not uniform[~possible_actions(drawn.states)].any()


def test_what_does_not_say_how_it_draws_is_not_known(trajectories):
    assert np.isnan(table_probabilities(Whimsical(), trajectories.states)).all()
    with pytest.raises(ArgumentError, match="Whimsical draws its actions, so a state does not determine them"):
        decisions(Whimsical(), trajectories.states)


def test_what_is_for_others_is_refused(trajectories):
    with pytest.raises(ArgumentError, match="str does not decide about tables"):
        table_probabilities("greedy", trajectories.states)
    with pytest.raises(PolicyError, match="GreedyPolicy decides for one robot"):
        table_probabilities(GreedyPolicy(WorldConfig()), trajectories.states)
    with pytest.raises(PolicyError, match="the policy is for 4 robots, but the team has"):
        table_probabilities(IndependentPolicies((RULE,) * 4), trajectories.states)


TEAM = team_of(2, horizon=4, reward_per_s=-0.05)
REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]


def log_of(policy, num_trajectories, cut_share, seed):
    drawn = play(TEAM, layout_of(2, REACH), policy, random.key_of(seed), num_trajectories)
    cuts = cut(drawn, cut_rate(drawn, cut_share, "independent"), "independent", np.random.default_rng(0))
    return to_logs(cuts, "independent", [SCENE], 0.6)


@pytest.fixture(scope="module")
def truth():
    return float(play_to_the_end(TEAM, layout_of(2, REACH), RULE, random.key_of(9), 6_000).reward.mean())


@pytest.mark.slow
def test_a_log_tells_what_another_rule_of_the_team_would_earn(truth):
    logs = log_of(ExploringPolicy(RULE, 0.4), 1_000, 0.2, seed=1)
    result = evaluate(RULE, logs, against=["logging", UniformPolicy()], censoring="kaplan-meier")
    for estimate in (result.importance_sampling, result.doubly_robust):
        error = (estimate.high - estimate.low) / (2.0 * 1.96)
        assert error < 1.0
        assert abs(estimate.value - truth) < 3.5 * error
    assert result.verdict == "better"


@pytest.mark.slow
def test_intervals_of_a_teams_rule_cover(truth):
    """Of 10 logs, 95 % intervals miss the truth in more than 2 with probability .012."""
    found = [
        evaluate(RULE, log_of(ExploringPolicy(RULE, 0.4), 300, 0.2, seed), against="logging") for seed in range(10)
    ]
    assert sum(not one.doubly_robust.low <= truth <= one.doubly_robust.high for one in found) <= 2


@pytest.mark.slow
def test_a_policy_of_a_team_gets_a_verdict_from_its_log():
    logs = logged(played(TEAM, 60, seed=4, reach=REACH), 0.2)
    learner = CensoredQLearner.for_team(2, horizon=4, base=None, reg=0.1, censoring="kaplan-meier").fit(logs)
    verdict = held_out_verdict(learner, logs, num_folds=2)
    assert verdict.evaluation is not None
    assert np.isfinite(verdict.evaluation.doubly_robust.value)


def test_evaluation_measures_a_team_from_nothing_and_lets_it_do_all_that_is_possible():
    logs = logged(played(TEAM, 60, seed=4, reach=REACH), 0.0)
    learning, judging = (TeamTask(grasp=None, base=None, is_evaluating=flag).encode(logs, 8) for flag in (False, True))
    assert (judging.is_possible | ~learning.is_possible).all()
    assert judging.is_possible.sum() > learning.is_possible.sum()
    plain = [TeamTask(grasp=None, base=None, reduces_variance=False, is_evaluating=flag) for flag in (False, True)]
    model = CensoredQLearner(8, plain[1], reg=0.1).compose(logs)
    laid = model.lay_out(logs)
    stages = model.rewarded(laid, np.ones(laid.reward.shape))
    shaped, as_paid = (task.reduce_variance(stages)[0] for task in plain)
    np.testing.assert_array_equal(as_paid, stages.reward)
    assert np.abs(shaped - stages.reward).max() > 1.0
