"""Several robots at a table: one of them is the world of one robot, to the last bit; each decides when it is free."""

from dataclasses import replace

import numpy as np
import pytest
from naive_world import NaiveTeam

from halfseen.world import ActionSpace, Scene, Verb, WorldConfig, random
from halfseen.world.actions import WAIT, possible_actions, wait_of
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from picked import assert_same, picked, repeated
from played_teams import SureGrasping
from world.world_cases import layouts_of

HIDES = np.array([[0.0, 0.4, 0.1], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def workspace(num_robots, num_objects, near=()):
    return picked(layouts_of(np.zeros((num_objects,) * 2), np.ones((num_robots, num_objects)), near).workspace, 0)


def layout_of(hides=HIDES, space=None):
    return replace(picked(pad_scenes([Scene(hides)]), 0), workspace=space)


@pytest.mark.parametrize("seed", range(8))
def test_a_team_of_one_is_the_world_of_one_robot_to_the_last_bit(seed):
    config, key, rng = WorldConfig(horizon=5), random.key_of(seed), np.random.default_rng(seed)
    state, hidden = start(config, layout_of(), key)
    of_team, secrets = start(config, layout_of(space=workspace(1, 3)), key)
    for t in range(config.horizon):
        possible = np.flatnonzero(possible_actions(state))
        np.testing.assert_array_equal(np.flatnonzero(possible_actions(of_team)), possible)
        action, at = rng.choice(possible), random.fold_in(key, t)
        state, hidden, outcome = step(config, state, hidden, action, at)
        of_team, secrets, same = step(config, of_team, secrets, action, at)
        alone = {"robots": None, "workspace": None, "decider": None, "attempt_robot": None}
        alone = replace(of_team, **alone), replace(secrets, pending=None)
        same_alone = same._replace(paid_alone=None)
        assert_same((state, hidden, outcome), (*alone, same_alone))
        np.testing.assert_allclose(same.paid_alone, [outcome.reward], rtol=1e-6)
        if outcome.is_over:
            break


def encoded(verb, target, num_objects):
    return wait_of(num_objects) if verb == WAIT else ActionSpace(num_objects).encode(int(verb), target)


def followed(config, state, hidden, actions_taken):
    """States, and outcomes, of a team that takes these (verb, object)."""
    states, outcomes = [state], []
    for t, each in enumerate(actions_taken):
        action = np.asarray(encoded(*each, state.num_objects))
        assert possible_actions(state)[action], (t, *each)
        state, hidden, outcome = step(config, state, hidden, action, random.fold_in(random.key_of(9), t))
        states.append(state)
        outcomes.append(outcome)
    return states, outcomes


def played(config, actions_taken, hides=HIDES, space=None):
    """Deciders, durations and rewards of a team that takes these (verb, object), and the states."""
    space = workspace(config.num_robots, len(hides)) if space is None else space
    state, hidden = start(config, layout_of(hides, space), random.key_of(0))
    states, outcomes = followed(config, state, hidden, actions_taken)
    rows = [
        (int(before.decider), float(each.duration_s), float(each.reward), bool(each.is_over))
        for before, each in zip(states, outcomes, strict=False)
    ]
    return rows, states


def team_of(num_robots=2, **others):
    others = {"horizon": 5, "speed": (1.0,) * num_robots} | others
    return WorldConfig(grasping=SureGrasping(), dirty_share=1.0 - 1e-6, **others)


WASHES = [(Verb.WASH, 0), (Verb.WASH, 1), (Verb.WASH, 2)]
"""Robot 0 takes 2 s for object 0, robot 1 takes 4 s for object 1; then robot 0 takes 6 s for object 2."""


BESIDE = [(0, 0.0, 0.0), (1, 2.0, 5.0), (0, 2.0, 5.0)]


@pytest.mark.parametrize(
    ("changes", "actions_taken", "rows", "is_over"),
    [
        ({}, WASHES, BESIDE, False),
        ({}, [*WASHES, (WAIT, 0)], [*BESIDE, (1, 4.0, 5.0)], True),
        ({"reward_per_s": -0.5}, WASHES, [(0, 0.0, 0.0), (1, 2.0, 4.0), (0, 2.0, 4.0)], False),
        ({"speed": (1.0, 4.0)}, WASHES[:2], [(0, 0.0, 0.0), (1, 1.0, 5.0)], False),
        # Going home takes 1 s, the wash 4 s: nobody is asked in between.
        ({}, [(Verb.FINISH, 0), WASHES[1], (Verb.FINISH, 0)], [(0, 0.0, 0.0), (1, 4.0, 5.0), (1, 1.0, -10.0)], True),
        ({"horizon": 1}, [(Verb.LIFT, 0), (Verb.LIFT, 1)], [(0, 0.0, 0.0), (1, 4.0, -15.6)], True),
    ],
    ids=[
        "side by side",
        "a clear table ends the trajectory",
        "seconds cost",
        "a fast robot",
        "all park",
        "decisions are spent",
    ],
)
def test_each_decides_when_it_is_free(changes, actions_taken, rows, is_over):
    found, states = played(team_of(**changes), actions_taken)
    np.testing.assert_allclose([row[:3] for row in found], rows, atol=1e-5)
    assert [row[3] for row in found] == [False] * (len(rows) - 1) + [is_over]
    robots, spent = states[-1].robots, np.bincount([row[0] for row in rows], minlength=2)
    assert robots.decisions_to_go.tolist() == (changes.get("horizon", 5) - spent).tolist()
    assert robots.is_parked.tolist() == [actions_taken[-1][0] == Verb.FINISH] * 2
    if rows == BESIDE:
        assert int(states[-1].decider) == 1
        np.testing.assert_allclose(robots.since_s[0], 2.0)
        assert np.flatnonzero(states[-1].is_on_table).tolist() == [2]


def test_nobody_touches_what_another_is_at_or_what_is_near_it_and_waits_for_nobody():
    _, states = played(team_of(), [(Verb.WASH, 1)], space=workspace(2, 3, near=[(1, 2)]))
    assert not bool(possible_actions(states[0])[wait_of(3)])
    assert np.flatnonzero(possible_actions(states[-1])).tolist() == [0, 1, 4, 7]  # FINISH, 0 twice, WAIT
    _, states = played(team_of(3), [(Verb.WASH, 0), (WAIT, 0)])
    assert bool(possible_actions(states[-1])[wait_of(3)])


def test_what_another_holds_up_hides_nothing():
    hides = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.9], [0.0, 0.0, 0.0]])
    _, states = played(team_of(), [(Verb.LIFT, 2), (Verb.LIFT, 1)], hides)
    # Robot 1 is done at 4 s; object 2 is in the air from 5 s on, and back on the table at 6 s.
    assert int(states[-1].decider) == 1
    assert states[-1].lifts.tolist() == [0, 1, 0]


@pytest.mark.slow
@pytest.mark.parametrize("drop_out_rate", [None, 0.0, 0.08])
@pytest.mark.parametrize("num_robots", [1, 2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_what_happens_is_what_happens_event_by_event(num_robots, seed, drop_out_rate):
    rng, num_objects = np.random.default_rng(seed), 4
    rates = None if drop_out_rate is None else (drop_out_rate,) * num_robots
    config = team_of(num_robots, horizon=4, reward_per_s=-0.25, drop_out_rate=rates)
    reach = rng.random((num_robots, num_objects)) < 0.8
    space = replace(workspace(num_robots, num_objects, near=[(0, 3)]), is_in_reach=reach)
    state, hidden = start(config, layout_of(np.zeros((4, 4)), space), random.key_of(seed))
    out_at_s = {} if rates is None else dict(enumerate(hidden.until_out_s.tolist()))
    naive = NaiveTeam(
        num_robots, num_objects, 4, {(0, 3)}, [set(np.flatnonzero(row)) for row in reach],
        out_at_s=out_at_s, price_per_s=-0.25,
    )  # fmt: skip
    number = {"FINISH": Verb.FINISH, "WASH": Verb.WASH, "LIFT": Verb.LIFT, "WAIT": WAIT}

    def code(verb, target):
        return encoded(number[verb], target, num_objects)

    for t in range(4 * num_robots):
        possible = naive.possible()
        assert np.flatnonzero(possible_actions(state)).tolist() == sorted(code(*each) for each in possible)
        assert int(state.decider) == naive.free[0]
        chosen, begun_s, were_out = possible[rng.integers(len(possible))], naive.clock_s, set(naive.out)
        reward, passed_s = naive.step(*chosen)
        at = random.fold_in(random.key_of(seed), t)
        state, hidden, outcome = step(config, state, hidden, np.asarray(code(*chosen)), at)
        np.testing.assert_allclose([outcome.reward, outcome.duration_s], [reward, passed_s], atol=1e-4)
        np.testing.assert_allclose(outcome.paid_alone, [naive.alone[r] for r in range(num_robots)], atol=1e-4)
        if rates is not None:
            out_s = [naive.out[r] - begun_s if r in naive.out.keys() - were_out else np.inf for r in range(num_robots)]
            np.testing.assert_allclose(outcome.out_s, out_s, atol=1e-4)
            assert np.flatnonzero(state.robots.is_out).tolist() == sorted(naive.out)
        assert bool(outcome.is_over) == naive.is_over
        if naive.is_over:
            break
    assert naive.is_over


def dropped(until_out_s, actions_taken, num_robots=2):
    """What a team does whose robots drop out then: before, after and outcome of each stage."""
    config = team_of(num_robots, drop_out_rate=(0.1,) * num_robots)
    state, hidden = start(config, layout_of(space=workspace(num_robots, 3)), random.key_of(0))
    hidden = replace(hidden, until_out_s=np.asarray(until_out_s, dtype=np.float32))
    states, outcomes = followed(config, state, hidden, actions_taken)
    return list(zip(states, states[1:], outcomes, strict=False))


def test_what_a_robot_that_drops_out_was_at_is_put_back_and_the_others_go_on():
    # Robot 0 washes object 0 until 2 s; robot 1 would wash object 1 until 4 s, but drops out at 3 s.
    answers = dropped([np.inf, 3.0], [(Verb.WASH, 0), (Verb.WASH, 1), (WAIT, 0), (Verb.WASH, 1)])
    before, after, outcome = answers[2]
    assert (float(outcome.duration_s), float(outcome.reward), bool(outcome.is_over)) == (1.0, 0.0, False)
    assert outcome.out_s.tolist() == [np.inf, 1.0]
    assert_same(*(replace(each, robots=None, decider=None) for each in (before, after)))
    assert after.robots.is_out.tolist() == [False, True]
    assert after.robots.is_busy.tolist() == [False, False]
    assert int(after.decider) == 0
    # FINISH, 1 and 2 twice; nobody to wait for.
    assert np.flatnonzero(possible_actions(after)).tolist() == [0, 2, 3, 5, 6]
    assert float(answers[3][2].reward) == 5.0


def test_the_trajectory_is_over_when_all_have_dropped_out_or_parked():
    answers = dropped([5.0, 0.5], [(Verb.FINISH, 0), (Verb.WASH, 1)])
    _, after, outcome = answers[-1]
    assert (after.robots.is_parked.tolist(), after.robots.is_out.tolist()) == ([True, False], [False, True])
    assert (float(outcome.duration_s), float(outcome.reward), bool(outcome.is_over)) == (1.0, -15.0, True)
    assert outcome.paid_alone.tolist() == [-15.0, 0.0]


def test_what_ends_at_the_moment_of_a_drop_out_ends_before_it():
    _, after, outcome = dropped([2.0], [(Verb.WASH, 0)], num_robots=1)[-1]
    assert (float(outcome.reward), bool(outcome.is_over)) == (5.0, False)
    assert after.robots.is_out.tolist() == [False]


def test_that_a_robot_may_drop_out_changes_no_other_draw():
    layout, may, cannot = layout_of(space=workspace(2, 3)), team_of(drop_out_rate=(0.1, 0.0)), team_of()
    drawn, plain = (start(config, layout, random.key_of(3)) for config in (may, cannot))
    assert np.isinf(drawn[1].until_out_s).tolist() == [False, True]
    assert_same(*((replace(state, robots=None), replace(hidden, until_out_s=None)) for state, hidden in (drawn, plain)))
    # Where nobody can, neither state nor secrets hold anything more than before.
    assert plain[0].robots.is_out is None
    assert plain[1].until_out_s is None


def test_a_robot_drops_out_at_its_hazard():
    keys = random.keys_of(random.key_of(0), 4000)
    layouts = repeated(layout_of(space=workspace(2, 3)), 4000)
    until_s = start(team_of(drop_out_rate=(0.1, 0.02)), layouts, keys)[1].until_out_s
    rate = 1.0 / np.mean(until_s, axis=0)
    np.testing.assert_allclose(rate, [0.1, 0.02], rtol=4.0 / np.sqrt(4000))
    assert abs(np.corrcoef(until_s.T)[0, 1]) < 4.0 / np.sqrt(4000)
