"""A team of one is the world of one robot, to the last bit; of several, each decides when it is free."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from naive_team import NaiveTeam

from halfseen.errors import ArgumentError
from halfseen.team import actions, dynamics
from halfseen.team.config import TeamConfig
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world import dynamics as one_robot
from halfseen.world.action_space import ActionSpace, Verb, possible_actions
from halfseen.world.grasping import Attempt
from halfseen.world.state import pad_scenes
from picked import picked

START, STEP, POSSIBLE = jax.jit(dynamics.start), jax.jit(dynamics.step), jax.jit(actions.possible_actions)
HIDES = np.array([[0.0, 0.4, 0.1], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def workspace(num_robots, num_objects, near=()):
    is_near = np.eye(num_objects, dtype=bool)
    for i, j in near:
        is_near[i, j] = is_near[j, i] = True
    return Workspace(jnp.ones((num_robots, num_objects), dtype=bool), jnp.asarray(is_near))


def layout_of(hides=HIDES):
    return picked(pad_scenes([Scene(hides)]), 0)


@pytest.mark.parametrize("seed", range(8))
def test_a_team_of_one_is_the_world_of_one_robot_to_the_last_bit(seed):
    config, layout = WorldConfig(horizon=5), layout_of()
    team, rng = TeamConfig(config), np.random.default_rng(seed)
    key = jax.random.key(seed)
    state, hidden = jax.jit(one_robot.start)(config, layout, key)
    of_team, secrets = START(team, TeamLayout(layout, workspace(1, 3)), key)
    step, team_step = jax.jit(one_robot.step), jax.jit(dynamics.step)
    for t in range(config.horizon):
        possible = np.flatnonzero(possible_actions(state))
        of_one = np.asarray(POSSIBLE(of_team))
        np.testing.assert_array_equal(np.flatnonzero(of_one), possible)
        action, at = jnp.asarray(rng.choice(possible)), jax.random.fold_in(key, t)
        state, hidden, outcome = step(config, state, hidden, action, at)
        of_team, secrets, same = team_step(team, of_team, secrets, action, at)
        for one, other in zip(
            jax.tree.leaves((state, hidden, outcome)),
            jax.tree.leaves((of_team.table, secrets.table, same._replace(of_robots=None))),
            strict=True,
        ):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(same.of_robots.reward, [outcome.reward], rtol=1e-6)
        if outcome.is_over:
            break


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SureGrasping:
    """Every attempt works, and takes two seconds for each number of its object, plus one."""

    limit_s: float = 10.0

    def draw_trait(self, num_objects, key):
        return None

    def attempt(self, arrangement, trait, verb, target, key):
        return Attempt(jnp.asarray(True), 1.0 + 2.0 * target, arrangement.hides, None)


def played(team, actions_taken, hides=HIDES, space=None, key=0):
    """Deciders, durations and rewards of a team that takes these (verb, object), and the states."""
    num_objects = len(hides)
    space = workspace(team.num_robots, num_objects) if space is None else space
    state, hidden = START(team, TeamLayout(layout_of(hides), space), jax.random.key(key))
    table, step, rows, states = ActionSpace(num_objects), jax.jit(dynamics.step), [], [state]
    for t, (verb, target) in enumerate(actions_taken):
        action = actions.wait_of(num_objects) if verb == actions.WAIT else table.encode(int(verb), target)
        assert bool(POSSIBLE(state)[action]), (t, verb, target)
        decider = int(state.decider)
        state, hidden, outcome = step(
            team, state, hidden, jnp.asarray(action), jax.random.fold_in(jax.random.key(9), t)
        )
        rows.append((decider, float(outcome.duration_s), float(outcome.reward), bool(outcome.is_over)))
        states.append(state)
    return rows, states


def team_of(num_robots=2, **others):
    world = WorldConfig(grasping=SureGrasping(), dirty_share=1.0 - 1e-6, horizon=5)
    return TeamConfig(world, speed=(1.0,) * num_robots, **others)


def test_robots_work_side_by_side_and_each_decides_when_it_is_free():
    rows, states = played(team_of(), [(Verb.WASH, 0), (Verb.WASH, 1), (Verb.WASH, 2)])
    # Robot 0 takes 2 s for object 0, robot 1 takes 4 s for object 1; then robot 0 takes 6 s for object 2.
    assert [row[:3] for row in rows] == [(0, 0.0, 0.0), (1, 2.0, 5.0), (0, 2.0, 5.0)]
    assert int(states[-1].decider) == 1
    np.testing.assert_allclose(states[-1].robots.since_s[0], 2.0)
    assert np.flatnonzero(states[-1].table.is_on_table).tolist() == [2]


def test_a_clear_table_ends_the_path_whoever_is_free():
    rows, _ = played(team_of(), [(Verb.WASH, 0), (Verb.WASH, 1), (Verb.WASH, 2), (actions.WAIT, 0)])
    assert rows[-1] == (1, 4.0, 5.0, True)
    assert sum(row[1] for row in rows) == pytest.approx(8.0)


def test_nobody_touches_what_another_is_at_or_what_is_near_it():
    _, states = played(team_of(), [(Verb.WASH, 1)], space=workspace(2, 3, near=[(1, 2)]))
    assert np.flatnonzero(actions.possible_actions(states[-1])).tolist() == [0, 1, 4, 7]  # FINISH, 0 twice, WAIT


def test_nobody_waits_where_nothing_is_to_come():
    _, states = played(team_of(), [])
    assert not bool(actions.possible_actions(states[0])[actions.wait_of(3)])
    _, states = played(team_of(3), [(Verb.WASH, 0), (actions.WAIT, 0)])
    assert bool(actions.possible_actions(states[-1])[actions.wait_of(3)])


def test_who_parks_does_nothing_more_and_the_path_ends_when_all_have():
    rows, states = played(team_of(), [(Verb.FINISH, 0), (Verb.WASH, 1), (Verb.FINISH, 0)])
    # Going home takes 1 s, the wash 4 s: nobody is asked in between.
    assert [(row[0], row[1], row[3]) for row in rows] == [(0, 0.0, False), (1, 4.0, False), (1, 1.0, True)]
    assert rows[-1][2] == pytest.approx(-10.0)
    assert states[-1].robots.is_parked.tolist() == [True, True]


def test_each_second_of_the_table_has_its_price():
    dear, _ = played(team_of(reward_per_s=-0.5), [(Verb.WASH, 0), (Verb.WASH, 1), (Verb.WASH, 2)])
    assert [row[2] for row in dear] == [0.0, 4.0, 4.0]


def test_a_fast_robot_takes_less():
    rows, _ = played(replace(team_of(), speed=(1.0, 4.0)), [(Verb.WASH, 0), (Verb.WASH, 1)])
    assert rows[-1][:2] == (1, 1.0)


def test_decisions_are_counted_for_each_robot():
    team = team_of()
    team = replace(team, world=replace(team.world, horizon=1))
    rows, states = played(team, [(Verb.LIFT, 0), (Verb.LIFT, 1)])
    assert rows[-1][3]
    assert states[-1].robots.decisions_to_go.tolist() == [0, 0]
    assert rows[-1][1] == pytest.approx(4.0)


def test_what_another_holds_up_hides_nothing():
    hides = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.9], [0.0, 0.0, 0.0]])
    _, states = played(team_of(), [(Verb.LIFT, 2), (Verb.LIFT, 1)], hides)
    # Robot 1 is done at 4 s; object 2 is in the air from 5 s on, and back on the table at 6 s.
    assert int(states[-1].decider) == 1
    assert states[-1].table.lifts.tolist() == [0, 1, 0]


@pytest.mark.parametrize("drop_out_rate", [None, 0.0, 0.08])
@pytest.mark.parametrize("num_robots", [1, 2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_what_happens_is_what_happens_event_by_event(num_robots, seed, drop_out_rate):
    rng, num_objects = np.random.default_rng(seed), 4
    world = WorldConfig(grasping=SureGrasping(), dirty_share=1.0 - 1e-6, horizon=4)
    rates = None if drop_out_rate is None else (drop_out_rate,) * num_robots
    team = TeamConfig(world, (1.0,) * num_robots, reward_per_s=-0.25, drop_out_rate=rates)
    table = ActionSpace(num_objects)
    reach = rng.random((num_robots, num_objects)) < 0.8
    space = replace(workspace(num_robots, num_objects, near=[(0, 3)]), is_in_reach=jnp.asarray(reach))
    state, hidden = START(team, TeamLayout(layout_of(np.zeros((4, 4))), space), jax.random.key(seed))
    out_at_s = {} if rates is None else dict(enumerate(np.asarray(hidden.until_out_s).tolist()))
    naive = NaiveTeam(
        num_robots, num_objects, 4, {(0, 3)}, [set(np.flatnonzero(row)) for row in reach],
        out_at_s=out_at_s, price_per_s=-0.25,
    )  # fmt: skip
    number = {"FINISH": 0, "WASH": int(Verb.WASH), "LIFT": int(Verb.LIFT)}

    def encoded(verb, target):
        return actions.wait_of(num_objects) if verb == "WAIT" else table.encode(number[verb], target)

    for t in range(4 * num_robots):
        possible = naive.possible()
        assert np.flatnonzero(POSSIBLE(state)).tolist() == sorted(encoded(*each) for each in possible)
        assert int(state.decider) == naive.free[0]
        chosen, begun_s, were_out = possible[rng.integers(len(possible))], naive.clock_s, set(naive.out)
        reward, passed_s = naive.step(*chosen)
        at = jax.random.fold_in(jax.random.key(seed), t)
        state, hidden, outcome = STEP(team, state, hidden, jnp.asarray(encoded(*chosen)), at)
        np.testing.assert_allclose([outcome.reward, outcome.duration_s], [reward, passed_s], atol=1e-4)
        np.testing.assert_allclose(outcome.of_robots.reward, [naive.alone[r] for r in range(num_robots)], atol=1e-4)
        if rates is not None:
            out_s = [naive.out[r] - begun_s if r in naive.out.keys() - were_out else np.inf for r in range(num_robots)]
            np.testing.assert_allclose(outcome.of_robots.out_s, out_s, atol=1e-4)
            assert np.flatnonzero(state.robots.is_out).tolist() == sorted(naive.out)
        assert bool(outcome.is_over) == naive.is_over
        if naive.is_over:
            break
    assert naive.is_over


def dropped(until_out_s, actions_taken, num_robots=2):
    """What a team does whose robots drop out then."""
    team = team_of(num_robots, drop_out_rate=(0.1,) * num_robots)
    layout = TeamLayout(layout_of(), workspace(num_robots, 3))
    state, hidden = START(team, layout, jax.random.key(0))
    hidden = replace(hidden, until_out_s=jnp.asarray(until_out_s, dtype=jnp.float32))
    answers = []
    for verb, target in actions_taken:
        action = actions.wait_of(3) if verb == actions.WAIT else ActionSpace(3).encode(int(verb), target)
        assert bool(POSSIBLE(state)[action]), (verb, target)
        before = state
        state, hidden, outcome = STEP(team, state, hidden, jnp.asarray(action), jax.random.key(0))
        answers.append((before, state, outcome))
    return answers


def test_what_a_robot_that_drops_out_was_at_is_put_back_and_the_others_go_on():
    # Robot 0 washes object 0 until 2 s; robot 1 would wash object 1 until 4 s, but drops out at 3 s.
    answers = dropped([np.inf, 3.0], [(Verb.WASH, 0), (Verb.WASH, 1), (actions.WAIT, 0), (Verb.WASH, 1)])
    before, after, outcome = answers[2]
    assert (float(outcome.duration_s), float(outcome.reward), bool(outcome.is_over)) == (1.0, 0.0, False)
    assert outcome.of_robots.out_s.tolist() == [np.inf, 1.0]
    for one, other in zip(jax.tree.leaves(before.table), jax.tree.leaves(after.table), strict=True):
        np.testing.assert_array_equal(one, other)
    assert after.robots.is_out.tolist() == [False, True]
    assert after.robots.is_busy.tolist() == [False, False]
    assert int(after.decider) == 0
    assert np.flatnonzero(POSSIBLE(after)).tolist() == [0, 2, 3, 5, 6]  # FINISH, 1 and 2 twice; nobody to wait for
    assert float(answers[3][2].reward) == 5.0


def test_the_path_is_over_when_all_have_dropped_out_or_parked():
    answers = dropped([5.0, 0.5], [(Verb.FINISH, 0), (Verb.WASH, 1)])
    _, after, outcome = answers[-1]
    assert (after.robots.is_parked.tolist(), after.robots.is_out.tolist()) == ([True, False], [False, True])
    assert (float(outcome.duration_s), float(outcome.reward), bool(outcome.is_over)) == (1.0, -15.0, True)
    assert outcome.of_robots.reward.tolist() == [-15.0, 0.0]


def test_what_ends_at_the_moment_of_a_drop_out_ends_before_it():
    _, after, outcome = dropped([2.0], [(Verb.WASH, 0)], num_robots=1)[-1]
    assert (float(outcome.reward), bool(outcome.is_over)) == (5.0, False)
    assert after.robots.is_out.tolist() == [False]


def test_that_a_robot_may_drop_out_changes_no_other_draw():
    layout = TeamLayout(layout_of(), workspace(2, 3))
    may, cannot = team_of(drop_out_rate=(0.1, 0.0)), team_of()
    drawn, plain = (START(team, layout, jax.random.key(3)) for team in (may, cannot))
    assert np.isinf(drawn[1].until_out_s).tolist() == [False, True]
    seen, secret = (jax.tree.leaves((state.table, hidden.table)) for state, hidden in (drawn, plain))
    for one, other in zip(seen, secret, strict=True):
        np.testing.assert_array_equal(one, other)
    # Where nobody can, neither state nor secrets hold anything more than before.
    assert plain[0].robots.is_out is None
    assert plain[1].until_out_s is None


def test_a_robot_drops_out_at_its_hazard():
    layout, team = TeamLayout(layout_of(), workspace(2, 3)), team_of(drop_out_rate=(0.1, 0.02))
    keys = jax.random.split(jax.random.key(0), 4000)
    until_s = jax.jit(jax.vmap(lambda key: dynamics.start(team, layout, key)[1].until_out_s))(keys)
    rate = 1.0 / np.mean(until_s, axis=0)
    np.testing.assert_allclose(rate, [0.1, 0.02], rtol=4.0 / np.sqrt(4000))
    assert abs(np.corrcoef(until_s.T)[0, 1]) < 4.0 / np.sqrt(4000)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"speed": ()}, "speed is \\(\\)"),
        ({"speed": (1.0, np.nan)}, "speed of robot 1 is nan; give a finite number above 0"),
        ({"speed": (0.0,)}, "speed of robot 0 is 0.0"),
        ({"reward_per_s": 1.0}, "reward_per_s is 1.0; give a finite price, 0 or below"),
        ({"reward_per_s": -np.inf}, "reward_per_s is -inf"),
        ({"drop_out_rate": (0.1, 0.1)}, "drop_out_rate has 2 entries for 1 robots"),
        ({"drop_out_rate": (-0.1,)}, "drop_out_rate of robot 0 is -0.1; give a finite hazard"),
        ({"drop_out_rate": (np.inf,)}, "drop_out_rate of robot 0 is inf"),
    ],
)
def test_numbers_that_no_team_has_are_refused(change, told):
    with pytest.raises(ArgumentError, match=told):
        TeamConfig(**change)
