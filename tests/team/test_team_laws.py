"""Each robot of a team may have a law of grasping of its own: the world, beliefs, rules and logs go by it."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from naive_myopic import NODES, WEIGHTS, NaiveMyopic, assumed, logistic, odds_to_share

from halfseen.errors import ArgumentError
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.futures import KnownRewards, foreseen, future_rewards
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team import MyopicTeam, Robot, Team, TeamConfig, TeamOfRules, TeamWorld, UniformTeam, dynamics, episodes
from halfseen.team.actions import WAIT, possible_actions, wait_of
from halfseen.team.grid_grasping import GridGrasping
from halfseen.team.gymnasium_env import TeamCupsEnv
from halfseen.team.named import named_team
from halfseen.team.optimum import solve_team
from halfseen.team.recording import attempted_by, states_of, to_logs
from halfseen.team.robots import check_robot
from halfseen.team.rollout import RolloutTeam, imagined_team
from halfseen.team.rules import ReservingTeam, RoundRobin
from halfseen.world import AssumedGrasping, FittedGrasping, GraspingByRobot, Scene, WorldConfig
from halfseen.world.action_space import Verb
from halfseen.world.grasping import Arrangement, Attempt
from halfseen.world.grasping_by_robot import check_law
from halfseen.world.state import NO_ATTEMPT, occlusion
from picked import picked

NUM_OBJECTS = 4
HIDES = np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.25), 1)
SCENE = Scene(HIDES, places_m=np.array([[-0.3, 0.0], [-0.1, 0.0], [0.1, 0.0], [0.3, 0.0]]))
WORLD = WorldConfig(horizon=5)
LOGISTIC = FittedGrasping(
    log_odds=0.4,
    log_odds_per_occlusion=-2.0,
    offset_std=1.5,
    log_held_s=float(np.log(2.0)),
    log_missed_s=float(np.log(4.0)),
    log_std=1e-3,
    limit_s=9.0,
)
NAIVE_LAWS = [assumed, logistic(0.4, -2.0, 2.0, 4.0)]
KEY = jax.random.key(5)
START, STEP = jax.jit(dynamics.start), jax.jit(dynamics.step)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Always:
    """Every attempt works, at once."""

    limit_s: float = 2.0

    def draw_trait(self, num_objects, key):
        return None

    def attempt(self, table, trait, verb, target, key):
        return Attempt(jnp.asarray(True), jnp.asarray(0.5), table.hides, None)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Never:
    """None works, and its trait counts the attempts."""

    limit_s: float = 7.0

    def draw_trait(self, num_objects, key):
        return {"tried": jnp.asarray(0)}

    def attempt(self, table, trait, verb, target, key):
        return Attempt(jnp.asarray(False), jnp.asarray(self.limit_s), table.hides, {"tried": trait["tried"] + 1})


def robots(*laws, reach_m=0.75):
    """One to the left, the others to the right; each lacks the far end."""
    bases = [(-0.5, 0.0), (0.5, 0.0), (0.5, 0.1)]
    return [
        Robot(base, reach_m, name=f"r{k}", grasping=law) for k, (base, law) in enumerate(zip(bases, laws, strict=False))
    ]


def world_of(*laws, price=0.0, world=WORLD):
    return TeamWorld(world, robots(*laws), reward_per_s=price)


def played(world, policy, num_paths=60, seed=0):
    return episodes.play(world.team_config, world.team.layouts([SCENE]), policy, jax.random.key(seed), num_paths)


def met(paths):
    """All states that were decided in; axis B."""
    return picked(paths.states, paths.is_taken)


def test_attempts_go_by_the_law_of_who_makes_them():
    world = world_of(Always(), Never())
    paths = played(world, UniformTeam())
    states = met(paths)
    tried = np.asarray(states.table.attempt_object) != NO_ATTEMPT
    by, held = np.asarray(states.table.attempt_robot)[tried], np.asarray(states.table.attempt_succeeded)[tried]
    assert set(by.tolist()) == {0, 1}
    np.testing.assert_array_equal(held, by == 0)
    # Transport takes a second; robot 1 is at it for 8 s, and robot 0 never for more than 1.5 s.
    longest_s = np.where(states.robots.is_busy & (states.robots.verb != WAIT), states.robots.since_s, 0.0).max(axis=0)
    assert longest_s[0] <= 1.5
    assert 4.0 < longest_s[1] <= 8.0


def test_a_trait_is_changed_by_the_attempts_of_its_own_robot():
    law = GraspingByRobot((Always(), Never()))
    table = START(world_of(Always(), Never()).team_config, first_layout(), KEY)[0].table
    arrangement = (table.hides, table.is_on_table, occlusion(table), table.grip)
    trait = law.draw_trait(NUM_OBJECTS, KEY)
    for robot, tried in ((0, 0), (1, 1)):
        # In a compiled call the robot is traced; outside it may be a plain number.
        for of in (replace(law, robot=robot), replace(law, robot=jnp.asarray(robot))):
            went = of.attempt(Arrangement(*arrangement), trait, jnp.asarray(1), jnp.asarray(0), KEY)
            assert (bool(went.is_held), int(went.trait[1]["tried"])) == (robot == 0, tried)
            assert float(of.limit_s) == (2.0, 7.0)[robot]


def first_layout(world=None):
    layouts = (world_of(None, None) if world is None else world).team.layouts([SCENE])
    return picked(layouts, 0)


def test_an_object_that_is_hard_to_grip_is_so_for_all():
    law = GraspingByRobot((AssumedGrasping(), LOGISTIC))
    one, other = law.draw_trait(50, KEY)
    np.testing.assert_allclose(other, 1.5 * one, rtol=1e-6)


@pytest.mark.parametrize("policy_of", [
    lambda config: ReservingTeam(config, GreedyPolicy(config.world, uses_history=True, counts_penalty=True)),
    lambda config: RoundRobin(GreedyPolicy(config.world, uses_history=True, counts_penalty=True)),
    pytest.param(MyopicTeam, marks=pytest.mark.slow),
    pytest.param(
        lambda config: RolloutTeam(config, named_team("history-penalty", config), num_futures=4), marks=pytest.mark.slow
    ),
])  # fmt: skip
def test_where_each_has_the_law_of_the_world_all_is_as_without(policy_of):
    own, shared = (world_of(law, law, price=-0.1) for law in (AssumedGrasping(), None))
    assert own.team_config.has_own_laws
    assert shared.team_config.world.grasping == AssumedGrasping()
    one, other = (played(world, policy_of(world.team_config), 40) for world in (own, shared))
    assert other.states.table.attempt_robot is None
    same = replace(one.states, table=replace(one.states.table, attempt_robot=None))
    mine, theirs = (replace(one, states=same, hidden=None), replace(other, hidden=None))
    for found, known in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(one.hidden.table.grasp_trait[1], other.hidden.table.grasp_trait, rtol=1e-5)


def naive_of(state, config, price=0.0):
    """The same table and team for `NaiveMyopic`."""
    table, crew, me = state.table, state.robots, int(state.decider)
    verbs = {int(Verb.WASH): "WASH", int(Verb.LIFT): "LIFT"}
    others = [r for r in range(2) if r != me]
    is_leaving = [bool(crew.is_busy[r]) and int(crew.verb[r]) == Verb.FINISH for r in range(2)]
    return NaiveMyopic(
        laws=NAIVE_LAWS,
        stds=[1.0, 1.5],
        speed=list(config.speed),
        price=price,
        hides=np.asarray(table.hides, dtype=np.float64),
        there=np.asarray(table.is_on_table).tolist(),
        dirty=[odds_to_share(float(each)) for each in table.log_odds],
        attempts=[
            (int(table.attempt_robot[k]), int(table.attempt_object[k]), float(table.attempt_occlusion[k]),
             bool(table.attempt_succeeded[k]))
            for k in tried_slots(table)
        ],
        reach=np.asarray(state.workspace.is_in_reach),
        me=me,
        busy={r: (verbs[int(crew.verb[r])], int(crew.target[r]), float(crew.since_s[r]))
              for r in others if bool(crew.is_busy[r]) and int(crew.verb[r]) in verbs},
        to_go=np.asarray(crew.decisions_to_go).tolist(),
        gone=[bool(crew.is_done[r]) or is_leaving[r] for r in range(2)],
    )  # fmt: skip


def tried_slots(table):
    return np.flatnonzero(np.asarray(table.attempt_object) != NO_ATTEMPT).tolist()


@pytest.fixture(scope="module")
def mixed():
    """States of a team of two laws that acts by chance, one by one, and its world."""
    world = world_of(None, LOGISTIC, price=-0.1)
    states = met(played(world, UniformTeam(), 40))
    return world, [picked(states, k) for k in range(0, len(states.decider), 2)]


def test_each_attempt_tells_of_a_grip_what_the_law_of_its_robot_says(mixed):
    world, states = mixed
    posterior = jax.jit(lambda table: jax.nn.softmax(grip_posterior(world.team_config.world, table).log_weights))
    by = set()
    for state in states:
        naive = naive_of(state, world.team_config)
        by |= {each[0] for each in naive.attempts}
        np.testing.assert_allclose(posterior(state.table), naive.weights, rtol=2e-4, atol=1e-6)
    assert by == {0, 1}


def test_a_rule_is_worth_what_the_robot_that_decides_can_do(mixed):
    world, states = mixed
    config = world.team_config
    rule = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)

    @jax.jit
    def told(state):
        own = config.world.as_robot(state.decider)
        seconds = expected_attempt_s(own, occlusion(state.table), grip_posterior(own, state.table))
        return (
            replace(rule, config=own).worth(state.table),
            seconds,
            ReservingTeam(config, rule).decide(state, KEY).action,
        )

    for state in states:
        naive = naive_of(state, config, price=0.1)
        me, num_going = naive.me, 1 + sum(not each for r, each in enumerate(naive.gone) if r != naive.me)
        worth, seconds, action = (np.asarray(each) for each in told(state))
        best, best_at, is_hope = 0.0, None, False
        possible = np.asarray(possible_actions(state))
        for i in np.flatnonzero(naive.there):
            held = naive.chance(me, i, naive.occluded(i))
            known = held * (naive.dirty[i] * 20.0 - 10.0) - (1.0 - held)
            assert worth[i] == pytest.approx(known, abs=1e-3)
            assert seconds[i] == pytest.approx(naive.seconds(me, i), rel=1e-3)
            gain = known - 0.1 * naive.seconds(me, i) / num_going
            if not naive.reach[me][i] or gain <= 0.0:
                continue
            is_hope = True
            is_shared = any(naive.reach[r][i] and not naive.gone[r] for r in range(2) if r != me)
            gain -= 0.1 * naive.seconds(me, i) if is_shared else 0.0
            if possible[1 + i] and (best_at is None or gain > best):
                best, best_at = gain, i
        wait = wait_of(NUM_OBJECTS)
        assert int(action) == (1 + best_at if best_at is not None else wait if is_hope and possible[wait] else 0)


def test_a_look_one_step_ahead_is_that_of_plain_loops(mixed):
    world, states = mixed
    q_values = jax.jit(MyopicTeam(world.team_config).q_values)
    seen = set()
    for state in states:
        naive, found = naive_of(state, world.team_config, price=0.1), np.asarray(q_values(state))
        possible = np.asarray(possible_actions(state))
        for action in np.flatnonzero(possible):
            verb, i = divmod(int(action) - 1, NUM_OBJECTS)
            if action == 0:
                known, name = naive.finish(), "FINISH"
            elif action == wait_of(NUM_OBJECTS):
                if not naive.busy:  # it waits for one that goes home
                    continue
                known, name = naive.wait(), "WAIT"
            else:
                name = ("WASH", "LIFT")[verb]
                known = naive.attempt(name, i)
            seen.add((name, naive.me))
            assert found[action] == pytest.approx(known, abs=2e-3), (name, i)
    assert len(seen) == 8


def test_rules_leave_to_the_other_what_they_never_hold():
    clumsy = replace(LOGISTIC, log_odds=-30.0)
    world = world_of(None, clumsy, price=-0.05)
    for name in ("greedy", "history-penalty"):
        paths = played(world, named_team(name, world.team_config))
        states, action = met(paths), np.asarray(paths.action)[np.asarray(paths.is_taken)]
        of_clumsy = np.asarray(states.decider) == 1
        assert not np.isin(action[of_clumsy], np.arange(1, 1 + 2 * NUM_OBJECTS)).any()
        assert np.isin(action[~of_clumsy], np.arange(1, 1 + NUM_OBJECTS)).any()
    # A rule that believes in one law for all does not know.
    unknowing = TeamOfRules(GreedyPolicy(WORLD, uses_history=True, counts_penalty=True))
    paths = played(world, unknowing)
    is_wash = np.isin(np.asarray(paths.action), np.arange(1, 1 + NUM_OBJECTS)) & np.asarray(paths.is_taken)
    assert (np.asarray(paths.states.decider)[is_wash] == 1).any()


def test_what_another_is_at_ends_as_its_own_law_says():
    world = world_of(None, replace(LOGISTIC, log_std=0.3))
    config = world.team_config
    state, hidden = START(config, first_layout(world), KEY)
    for action in (1, 1 + 2):  # robot 0 washes 0, robot 1 washes 2
        state, hidden, _ = STEP(config, state, hidden, jnp.asarray(action), KEY)
    robots = replace(
        state.robots,
        is_busy=jnp.array([False, True]),
        verb=jnp.array([1, 1], dtype=jnp.int32),
        target=jnp.array([0, 2], dtype=jnp.int32),
        since_s=jnp.array([0.0, 3.0]),
    )
    state = replace(state, robots=robots, decider=jnp.asarray(0, dtype=jnp.int32))
    state = replace(state, table=replace(state.table, is_on_table=jnp.ones(NUM_OBJECTS, dtype=bool)))
    draws = jax.jit(jax.vmap(lambda key: imagined_team(config, state, key)))(jax.random.split(KEY, 20_000))
    # 2 s without transport have passed: an attempt that holds lasts longer with 1/2, one that misses all but surely.
    weights = WEIGHTS.copy()
    naive = naive_of(state, config)
    held = np.array([NAIVE_LAWS[1](naive.occluded(2), 1.5 * node)[0] for node in NODES])
    lasts_missed = 1.0 - _normal_cdf((np.log(2.0) - np.log(4.0)) / 0.3)
    weights = naive.weights[2] * (held * 0.5 + (1.0 - held) * lasts_missed)
    weights /= weights.sum()
    still_held = held * 0.5 / (held * 0.5 + (1.0 - held) * lasts_missed)
    assert np.mean(draws.pending.is_held[:, 1]) == pytest.approx(weights @ still_held, abs=0.015)
    one, other = draws.table.grasp_trait
    assert np.mean(one[:, 2]) == pytest.approx(weights @ NODES, abs=0.03)
    np.testing.assert_allclose(other, 1.5 * one, rtol=1e-5, atol=1e-6)


def _normal_cdf(at):
    return float(jax.scipy.stats.norm.cdf(at))


@pytest.mark.slow
def test_futures_are_worth_what_comes_of_them():
    world, stage = world_of(None, LOGISTIC, price=-0.1), 2
    config, table_of = world.team_config, lambda each: each.table
    rule = named_team("history-penalty", config)
    paths = played(world, rule, 200)
    is_there = np.asarray(paths.is_taken[:, stage])
    later = np.asarray(jnp.sum(jnp.where(paths.is_taken, paths.reward, 0.0)[:, stage:], axis=1))[is_there]
    states = picked(paths.states, (is_there, stage))

    def worth(state, action, key):
        only = jnp.arange(possible_actions(state).shape[0]) == action
        foreseeing, rewards = replace(config, world=foreseen(config.world)), KnownRewards(config.world, table_of)
        return future_rewards(
            dynamics.TEAM, foreseeing, state, only, lambda key: imagined_team(config, state, key), rule, key, 8, rewards
        )[:, action].mean()

    given = states, paths.action[is_there, stage], jax.random.split(jax.random.key(11), int(is_there.sum()))
    found = np.asarray(jax.jit(lambda given: jax.lax.map(lambda each: worth(*each), given))(given))
    difference = found - later
    assert abs(difference.mean()) < 4.0 * difference.std() / np.sqrt(len(difference))
    assert np.corrcoef(found, later)[0, 1] > 0.1


def test_a_log_tells_who_tried_and_from_it_come_the_same_states():
    world = world_of(None, LOGISTIC)
    cuts = world.record([SCENE], UniformTeam(), 60, seed=0)
    paths, logs = cuts.episodes, to_logs(cuts, "independent", [SCENE])
    told = states_of(logs, paths.action.shape[1])
    at = logs.stages["path"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    posterior = jax.jit(
        jax.vmap(lambda table: jax.nn.softmax(grip_posterior(world.team_config.world, table).log_weights))
    )
    found, known = (posterior(picked(each.table, at)) for each in (told, paths.states))
    np.testing.assert_allclose(found, known, rtol=1e-3, atol=1e-6)
    # Who made each attempt shows in what each robot was at, too.
    by, tried = attempted_by(paths.states, np.asarray(paths.action)), np.asarray(paths.states.table.attempt_object)
    is_there = (tried != NO_ATTEMPT) & np.asarray(paths.is_taken)[..., None]
    known = np.broadcast_to(by[:, None], tried.shape)
    np.testing.assert_array_equal(np.asarray(paths.states.table.attempt_robot)[is_there], known[is_there])


def test_the_face_of_gymnasium_tells_who_tried_and_how_long_that_may_take():
    team = Team(tuple(robots(None, LOGISTIC)))
    env, shared = TeamCupsEnv(SCENE, team), TeamCupsEnv(SCENE)
    space, plain = env.observation_space, shared.observation_space
    assert isinstance(space, spaces.Dict)
    assert isinstance(plain, spaces.Dict)
    assert space["since_s"].contains(np.full(2, 10.0, dtype=np.float32))  # 9 s of the slower law, and transport
    assert not space["since_s"].contains(np.full(2, 10.1, dtype=np.float32))
    assert "attempt_robot" not in plain.spaces
    seen, info = env.reset(seed=0)
    for action in (1, 2):
        seen, _, _, _, info = env.step(action)
    for _ in range(3):
        seen, _, is_over, _, info = env.step(int(np.flatnonzero(info["action_mask"])[-1]))
        if is_over:
            break
    assert space.contains(seen)
    assert set(seen["attempt_robot"].tolist()) <= {0, 1}


BARE = {"base_m": (0.0, 0.0), "reach_m": 1.0, "name": "robot"}


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: check_law(3, "left: grasping"), r"left: grasping is 3, no law of grasping of one robot; give one"),
        (
            lambda: check_robot({**BARE, "grasping": AssumedGrasping}),
            "robot: grasping is <class .*, no law of grasping",
        ),
        (lambda: Robot((0.0, 0.0), 1.0, grasping=GraspingByRobot((LOGISTIC,))), "robot: grasping is GraspingByRobot"),
        (lambda: GraspingByRobot(()), r"laws is \(\): give the law"),
        (
            lambda: GraspingByRobot((LOGISTIC, GraspingByRobot((LOGISTIC,)))),
            r"laws\[1\] is GraspingByRobot.*, no law of grasping of one robot",
        ),
        (
            lambda: TeamConfig(replace(WORLD, grasping=GraspingByRobot((LOGISTIC,))), (1.0, 1.0)),
            "grasping of the world has laws for 1 robots, and the team has 2; give each its own, or all one",
        ),
        (
            lambda: MyopicTeam(world_of(None, Never()).team_config).q_values(
                START(world_of(None, Never()).team_config, first_layout(), KEY)[0]
            ),
            "grasping of the config is Never, a law that can be drawn from but",
        ),
        (
            lambda: solve_team(SCENE, world_of(GridGrasping(), GridGrasping()).team_config, first_layout().workspace),
            "robots have laws of grasping of their own; a team is solved whose robots have one law",
        ),
    ],
)
def test_what_is_no_law_is_told_in_one_line(wrong, told):
    with pytest.raises(ArgumentError, match=told) as caught:
        wrong()
    assert "\n" not in str(caught.value)
