"""Actions are numbered one to one; and how long a team will be busy after each, in plain Python."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.world import ActionSpace, Verb
from halfseen.world.actions import FADES_PER_S, FINISH, TARGETED, WAIT, WAITS, makespans, others_of
from picked import picked
from played_teams import played, team_of


@given(st.integers(1, 40))
def test_actions_are_numbered_one_to_one_and_those_of_a_verb_stand_side_by_side(num_objects):
    space = ActionSpace(num_objects)
    pairs = [(Verb.FINISH, 0), *((verb, target) for verb in TARGETED for target in range(num_objects))]
    codes = [space.encode(verb, target) for verb, target in pairs]
    assert codes == list(range(space.num_actions))
    assert [(space.verb(code), space.target(code)) for code in codes] == pairs
    assert ActionSpace.of_size(space.num_actions) == space
    verbs, targets = space.verb(np.array(codes)), space.target(np.array(codes))
    assert np.array_equal(space.encode(verbs, targets), codes)
    assert np.array_equal(verbs, space.verbs)
    for verb in Verb:
        assert np.flatnonzero(space.verbs == verb).tolist() == list(range(*space.of(verb).indices(len(codes))))


def test_finish_has_no_target_and_names_say_verb_and_target():
    assert ActionSpace(3).encode(Verb.FINISH, 2) == FINISH
    assert ActionSpace(2).names == ("FINISH", "WASH 0", "WASH 1", "LIFT 0", "LIFT 1")


def test_values_are_laid_out_as_the_actions_are():
    space = ActionSpace(2)
    of_verb = {verb: np.array([10.0 * verb, 10.0 * verb + 1.0]) for verb in TARGETED}
    joined = space.join(np.asarray(-3.0), of_verb)
    assert joined.tolist() == [-3.0, *(10.0 * verb + target for verb in TARGETED for target in range(2))]
    batch = space.join(np.zeros(5), {verb: np.full((5, 2), float(verb)) for verb in TARGETED})
    assert np.array_equal(batch, np.broadcast_to(space.verbs, (5, space.num_actions)))
    # A verb that is not known is never worth taking.
    unknown = space.join(np.asarray(0.0), {Verb.WASH: np.ones(2)})
    assert unknown.tolist() == [0.0, 1.0, 1.0, -np.inf, -np.inf]


REACH = {1: [[1, 1, 1, 0]], 2: [[1, 1, 0, 0], [0, 1, 1, 1]], 3: [[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]]}


def plain_bound(reach, goes_on, begun, work):
    going = [r for r in range(len(goes_on)) if goes_on[r]]
    alone = {
        r: sum(w for i, w in enumerate(work) if reach[r][i] and sum(reach[q][i] for q in going) == 1) for r in going
    }
    total = sum(w for i, w in enumerate(work) if any(reach[r][i] for r in going)) + sum(begun[r] for r in going)
    return max([begun[r] + alone[r] for r in going] + [total / max(len(going), 1), 0.0])


def plain(state):
    robots, me = state.robots, int(state.decider)
    num_robots, num_objects = state.workspace.is_in_reach.shape
    reach = np.asarray(state.workspace.is_in_reach)
    at = [r for r in range(num_robots) if r != me and robots.is_busy[r] and robots.verb[r] not in (0, WAIT)]
    begun = [float(np.exp(-FADES_PER_S * robots.since_s[r])) if r in at else 0.0 for r in range(num_robots)]
    taken = {int(robots.target[r]) for r in at}
    is_dirty = 1.0 / (1.0 + np.exp(-np.asarray(state.log_odds)))
    work = [
        min(max(4.0 * (is_dirty[i] - 0.5), 0.0), 1.0) if state.is_on_table[i] and i not in taken else 0.0
        for i in range(num_objects)
    ]
    goes_home = [bool(robots.is_busy[r]) and int(robots.verb[r]) == 0 for r in range(num_robots)]
    others = [r != me and not bool(robots.is_done[r]) and not goes_home[r] for r in range(num_robots)]
    everyone = [on or r == me for r, on in enumerate(others)]

    def after(goes_on, mine, left):
        return plain_bound(reach, goes_on, [b + mine * (r == me) for r, b in enumerate(begun)], left)

    finish, lift, wait = after(others, 0.0, work), after(everyone, 1.0, work), after(everyone, WAITS, work)
    wash = [
        after(everyone, 1.0, [0.0 if i == target else w for i, w in enumerate(work)]) for target in range(num_objects)
    ]
    return [finish, *wash, *[lift] * num_objects, wait]


@pytest.mark.parametrize("num_robots", [1, 2, 3])
def test_it_is_the_bound_of_scheduling_theory(num_robots):
    trajectories = played(team_of(num_robots), 6, seed=3, reach=REACH[num_robots])
    bounds = makespans(trajectories.states, others_of(trajectories.states))
    for at in zip(*np.nonzero(trajectories.is_taken), strict=True):
        np.testing.assert_allclose(bounds[at], plain(picked(trajectories.states, at)), rtol=1e-5, atol=1e-6)
