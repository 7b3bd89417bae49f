"""How long a team will be busy: the bound, object by object and robot by robot, in plain Python."""

import numpy as np
import pytest

from halfseen.world.actions import FADES_PER_S, WAIT, WAITS, makespans, others_of
from picked import picked
from played_teams import played, team_of

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
