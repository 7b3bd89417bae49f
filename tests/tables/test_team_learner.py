"""A team learns: better than what logged it, only what is possible, the same again, and nothing that it never saw."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from halfseen.errors import ArgumentError, LogError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.planners import GreedyPolicy, ReservingPolicy, TeamOfRules
from halfseen.tables import BetaGrasp, IndependentPolicies
from halfseen.tables.grasp_table import GraspTable
from halfseen.tables.policy import decisions
from halfseen.tables.task import CAUTION
from halfseen.world import ActionSpace, ExploringPolicy, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.actions import possible_actions
from halfseen.world.logs import states_of
from halfseen.world.policy import check_fits
from halfseen.world.rollout import evaluate, play
from picked import assert_same
from played_teams import NUM_OBJECTS, layout_of, logged, played, team_of
from small_logs import table_log

REACH = np.array([[1, 1, 1, 0], [0, 1, 1, 1]], dtype=bool)
LAYOUT = layout_of(2, REACH)
TEAM = team_of(2)
RULE = GreedyPolicy(WorldConfig(horizon=5), uses_history=True, counts_penalty=True)


@pytest.fixture(scope="module")
def logs():
    return logged(played(TEAM, 200, seed=2, reach=REACH), 0.5)


@pytest.fixture(scope="module")
def learned(logs):
    return CensoredQLearner.for_team(2, horizon=5, reg=0.1).fit(logs)


def earned(policy, num_episodes):
    return evaluate(TEAM, LAYOUT, policy, random.key_of(11), num_episodes).reward


@pytest.mark.slow
def test_it_earns_more_than_what_logged_it_and_than_chance(learned):
    for other, num_episodes, errors in ((ExploringPolicy(TeamOfRules(RULE)), 1000, 4.0), (UniformPolicy(), 4000, 8.0)):
        gain = earned(learned.policy_, num_episodes) - earned(other, num_episodes)
        assert gain.mean() > errors * gain.std(ddof=1) / np.sqrt(len(gain))


@pytest.mark.slow
def test_the_same_log_gives_the_same_policy(logs, learned):
    again = CensoredQLearner.for_team(2, horizon=5, reg=0.1).fit(logs).policy_
    assert_same(learned.policy_, again)


@pytest.mark.slow
def test_of_what_is_possible_it_leaves_each_alone_where_q_promises_more_by_the_caution(logs, learned):
    states, policy = states_of(logs, 10), learned.policy_
    assert policy.caution == pytest.approx(CAUTION * logs.stages["reward"].std(ddof=0), rel=1e-6)
    of_base, of_team = decisions(policy.base, states), decisions(policy, states)
    q = policy.q_values(states)
    best = q.argmax(axis=-1)
    better = np.take_along_axis(q, best[..., None], -1)[..., 0] - np.take_along_axis(q, of_base[..., None], -1)[..., 0]
    np.testing.assert_array_equal(of_team, np.where(better > policy.caution, best, of_base))
    assert 0 < (of_team != of_base).mean() < 0.2
    is_stage = states.is_on_table.any(axis=-1)
    assert np.take_along_axis(possible_actions(states), of_team[..., None], axis=-1)[is_stage].all()


def test_q_of_a_policy_is_not_lowered(logs):
    with pytest.raises(ArgumentError, match=r"pessimism is 1\.0, but Q is that of a given policy"):
        CensoredQLearner.for_team(2, horizon=5, pessimism=1.0).fit(logs)
    best = CensoredQLearner.for_team(2, horizon=5, pessimism=1.0, base=None, reg=0.1).fit(logs)
    assert best.policy_.base is None
    assert best.policy_.margin is not None


@pytest.mark.slow
@pytest.mark.parametrize("given", [{"grasp": BetaGrasp()}, {"q_function": "kernel"}], ids=["grasps", "kernel"])
def test_a_team_takes_what_one_robot_takes(logs, given):
    logs = logs.select(logs.trajectory_ids[:60])
    policy = CensoredQLearner.for_team(2, horizon=5, base=None, reg=0.1, **given).fit(logs).policy_
    assert isinstance(policy.grasp, GraspTable) == ("grasp" in given)
    states = states_of(logs, 10)
    q, is_possible = policy.q_values(states), possible_actions(states)
    assert np.isfinite(q).any(axis=-1).all()
    assert (q[~is_possible] == -np.inf).all()


def test_a_base_that_is_given_is_improved_upon(logs):
    policy = CensoredQLearner.for_team(2, horizon=5, base=TeamOfRules(RULE), reg=0.1).fit(logs).policy_
    assert policy.base == TeamOfRules(RULE)


@pytest.mark.parametrize(
    ("base", "error", "message"),
    [
        ("each", ArgumentError, "base is 'each'; give None, 'auto' or a policy of a team"),
        (RULE, PolicyError, "GreedyPolicy decides for one robot"),
        (IndependentPolicies((RULE,) * 3), PolicyError, "the policy is for 3 robots, but the team has 2"),
        (ExploringPolicy(TeamOfRules(RULE)), ArgumentError, "ExploringPolicy draws its actions"),
    ],
)
def test_a_base_that_is_none_of_this_team_is_refused(logs, base, error, message):
    with pytest.raises(error, match=message):
        CensoredQLearner.for_team(2, horizon=5, base=base).fit(logs)


@pytest.mark.slow
def test_q_is_of_the_best_policy_where_the_log_does_not_tell_each_robots_reward(logs):
    some = Logs(logs.stages.drop(columns="1_reward"), logs.trajectories, logs.objects)
    learner = CensoredQLearner.for_team(2, horizon=5, reg=0.1).fit(some)
    assert learner.policy_.base is None
    assert any(
        "policies of single robots cannot be learned: stages: there is no" in result for result in learner.chosen_
    )


@pytest.mark.slow
def test_what_was_never_seen_completed_has_no_value():
    never_lifts = played(TEAM, 120, seed=8, reach=REACH)
    logs = logged(never_lifts, 0.3)
    kept = logs.stages.groupby("trajectory")["action"].transform(lambda actions: not (actions == Verb.LIFT.name).any())
    some = logs.select(logs.stages.loc[kept, "trajectory"].unique())
    learner = CensoredQLearner.for_team(2, horizon=5, reg=0.1).fit(some)
    assert [result.split(" was ")[0] for result in learner.unseen_] == ["LIFT"]
    replayed = play(TEAM, LAYOUT, learner.policy_, random.key_of(1), 100)
    verbs = ActionSpace(NUM_OBJECTS).verb(replayed.action)[replayed.is_taken]
    assert not (verbs == Verb.LIFT).any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0,), "num_robots is 0; give a whole number of at least 1"),
        ((2.5,), "num_robots is 2.5; give a whole number"),
        (("2",), "num_robots is '2'"),
        ((True,), "num_robots is True"),
        ((2, "3"), "horizon is '3'; give a whole number of at least 1"),
        ((2, 2.5), "horizon is 2.5"),
        ((2, 0), "horizon is 0"),
    ],
)
def test_a_team_has_a_whole_number_of_robots_and_of_their_decisions(given, message):
    with pytest.raises((ArgumentError, TypeCheckError), match=f"{message}|Type-check error"):
        CensoredQLearner.for_team(*given)


def test_each_for_itself_does_what_is_possible_and_keeps_its_own_policy():
    each = IndependentPolicies((RULE, UniformPolicy()))
    trajectories = play(TEAM, LAYOUT, each, random.key_of(5), 60)
    taken, possible = trajectories.is_taken, possible_actions(trajectories.states)
    assert np.take_along_axis(possible, trajectories.action[..., None], axis=2)[..., 0][taken].all()
    by = trajectories.probability[taken], trajectories.states.decider[taken]
    assert (by[0][by[1] == 0] == 1.0).all()
    assert (by[0][by[1] == 1] < 1.0).any()
    with pytest.raises(ArgumentError, match="policies is"):
        IndependentPolicies(())


@pytest.mark.parametrize(
    ("learner", "message"),
    [
        (CensoredQLearner.for_team(3, horizon=5), "the log has 2 robots, but num_robots is 3"),
        (CensoredQLearner.for_table(10), "the log has 2 robots, but a table policy decides for one; learn with"),
    ],
    ids=["of another team", "of one robot"],
)
def test_a_log_of_another_number_of_robots_is_refused(logs, learner, message):
    with pytest.raises(LogError, match=message):
        learner.fit(logs)


def test_the_log_of_one_robot_is_none_of_a_team():
    with pytest.raises(LogError, match="no column 'robot'"):
        CensoredQLearner.for_team(2, horizon=5).fit(table_log())


@pytest.mark.slow
@pytest.mark.parametrize("num_robots", [2, 3])
def test_a_policy_of_another_number_of_robots_does_not_play(learned, num_robots):
    policy = learned.policy_ if num_robots == 3 else ReservingPolicy(team_of(3), RULE)
    with pytest.raises(PolicyError, match=f"is for {5 - num_robots} robots, but the team has {num_robots}"):
        check_fits(policy, team_of(num_robots))


@pytest.mark.slow
@pytest.mark.parametrize(
    "change", [{"action": "PUSH"}, {"object": None}], ids=["a verb that nobody knows", "a verb without its object"]
)
def test_what_a_team_does_not_know_is_refused(logs, change):
    stages = logs.stages.copy()
    row = int(np.flatnonzero(stages["action"] == "LIFT")[0])
    for column, value in change.items():
        stages.loc[row, column] = value
    broken = Logs(stages, logs.trajectories, logs.objects)
    with pytest.raises(LogError, match="is unknown to a team; give WASH or LIFT with an object"):
        CensoredQLearner.for_team(2, horizon=5).fit(broken)
