"""The optimum of a team is what brute force finds, of one robot what `solve_table` finds; values are exact."""

from collections import defaultdict
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from naive_optimum import hermite

from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy, MyopicPolicy, POMDPPolicy, ReservingPolicy, solve_table, solve_team
from halfseen.planners.exact_table import GridGrasping
from halfseen.world import AssumedGrasping, GraspingByRobot, UniformPolicy, WorldConfig, random
from halfseen.world.rollout import evaluate
from picked import picked
from world.world_cases import layouts_of

TWO = np.array([[0.0, 0.4], [0.1, 0.0]])
THREE = np.array([[0.0, 0.4, 0.0], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def team_of(horizon, num_robots=2, grasping=None, **others):
    grasping = GridGrasping() if grasping is None else grasping
    return WorldConfig(**{"horizon": horizon, "grasping": grasping, "speed": (1.0,) * num_robots} | others)


def workspace(num_robots, num_objects, out_of_reach=(), near=()):
    reach = np.ones((num_robots, num_objects), dtype=bool)
    for robot, cup in out_of_reach:
        reach[robot, cup] = False
    return picked(layouts_of(np.zeros((num_objects, num_objects)), reach, near).workspace, 0)


# An attempt of 1 s and one of 3 s end at once with others, and are in the air when others look.
FEW = GridGrasping(held_s=(1.0, 3.0), held_share=(0.25, 0.75), limit_s=3.0)
ONE_TIME = GridGrasping(held_s=(1.0,), held_share=(1.0,), limit_s=3.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "hides", "space"),
    [
        (team_of(1, grasping=FEW), TWO, workspace(2, 2)),
        (team_of(1, grasping=FEW, reward_per_s=-0.3), TWO, workspace(2, 2)),
        (team_of(1, grasping=FEW, speed=(1.0, 2.0), reward_per_s=-0.2), TWO, workspace(2, 2)),
        (team_of(1, grasping=replace(FEW, base=AssumedGrasping(limit_s=1e6))), TWO, workspace(2, 2)),
        (team_of(1, grasping=FEW, reward_per_s=-0.1), THREE, workspace(2, 3, out_of_reach=[(0, 2)], near=[(0, 1)])),
        pytest.param(
            team_of(2, grasping=ONE_TIME, reward_per_s=-0.3),
            TWO,
            workspace(2, 2, out_of_reach=[(1, 0)]),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["at no price", "at a price", "of two speeds", "surely", "three objects", "two decisions of each"],
)
def test_two_robots_are_worth_what_brute_force_finds(config, hides, space):
    brute = BruteForceTeam(config, hides, space.is_in_reach, space.is_near, hermite(config, 2))

    assert solve_team(hides, config, space, num_grip_nodes=2).value == pytest.approx(brute.value(), abs=1e-9)


@pytest.mark.parametrize("law", [GridGrasping(), AssumedGrasping()], ids=["times on a grid", "any time"])
def test_one_robot_is_the_optimum_of_one_robot(law):
    config = team_of(3, num_robots=1, grasping=law)
    of_team, of_one = solve_team(TWO, config, workspace(1, 2)), solve_table(TWO, config)
    assert of_team.num_states == of_one.num_states
    np.testing.assert_allclose(of_team.value, of_one.value, atol=1e-9, rtol=0)
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    pairs = [(ReservingPolicy(config, rule), rule), (MyopicPolicy(config), POMDPPolicy(config, 1))]
    for team, alone in pairs:
        np.testing.assert_allclose(of_team.policy_value(team), of_one.policy_value(alone), atol=1e-9, rtol=0)


def test_one_robot_pays_for_its_time_and_reaches_what_it_reaches():
    """With one decision and one object in reach: what it earns, less the mean time that it takes; or it leaves."""
    config = team_of(1, num_robots=1, reward_per_s=-0.5, speed=(2.0,))
    space = workspace(1, 2, out_of_reach=[(0, 1)])
    free, paid = (solve_team(TWO, replace(config, reward_per_s=price), space).value for price in (0.0, -0.5))
    both = solve_team(TWO, replace(config, reward_per_s=0.0), workspace(1, 2)).value
    # An attempt takes from 1.5 to 3.5 s, and going home .5 s.
    assert free - 0.5 * 3.5 <= paid <= free - 0.5 * 0.5
    assert free < both


def test_some_states_stand_for_all_and_several_policies_are_worth_what_each_is_by_itself():
    config, space = team_of(1, grasping=FEW), workspace(2, 2)
    optimum, rule = solve_team(TWO, config, space, num_grip_nodes=3), GreedyPolicy(config, counts_penalty=True)
    policies = (ReservingPolicy(config, rule), MyopicPolicy(config), UniformPolicy())
    alone = [optimum.policy_value(policy) for policy in policies]
    np.testing.assert_allclose(optimum.policy_values(policies), alone, rtol=1e-12)
    assert max(alone) <= optimum.value + 1e-9
    lots = [optimum.policy_value(policies[0], random.key_of(seed), 4) for seed in range(60)]
    assert np.mean(lots) == pytest.approx(alone[0], abs=float(4 * np.std(lots) / np.sqrt(60)) + 1e-9)


@pytest.mark.slow
def test_no_policy_beats_the_optimum_and_a_second_robot_is_worth_something():
    config, space = team_of(2), workspace(2, 3)
    optimum = solve_team(THREE, config, space)
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    for policy in (ReservingPolicy(config, rule), MyopicPolicy(config), UniformPolicy()):
        assert optimum.regret(policy) > 0.01
    one = solve_team(THREE, team_of(2, num_robots=1), workspace(1, 3))
    assert optimum.value > one.value + 0.1


@pytest.mark.slow
def test_the_value_of_a_policy_is_what_it_earns():
    config = team_of(3, reward_per_s=-0.2)
    space = workspace(2, 3, out_of_reach=[(0, 2), (1, 0)], near=[(0, 1)])
    optimum = solve_team(THREE, config, space)
    layouts = layouts_of(THREE, space.is_in_reach, near=[(0, 1)])
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    for policy in (ReservingPolicy(config, rule), MyopicPolicy(config)):
        earned = np.asarray(evaluate(config, layouts, policy, random.key_of(11), 40_000).reward, dtype=np.float64)
        error = earned.std() / np.sqrt(len(earned))
        assert abs(earned.mean() - optimum.policy_value(policy)) < 4 * error


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (team_of(1, grasping=AssumedGrasping()), "AssumedGrasping, whose attempts may take any time"),
        (team_of(2), "have more than 100 states .*shorten the horizon"),
        (team_of(1, drop_out_rate=(0.1, 0.1)), "drop_out_rate is given"),
        (team_of(1, grasping=GraspingByRobot((GridGrasping(), GridGrasping()))), "has its own law of grasping"),
    ],
)
def test_what_cannot_be_solved_is_refused(config, message):
    with pytest.raises(ArgumentError, match=message):
        solve_team(TWO, config, workspace(2, 2), max_states=100)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"held_share": (0.5, 0.6)}, "held_share is"),
        ({"held_s": (2.0, 7.0)}, "held_s is"),
        ({"held_s": (2.0,)}, "one share"),
    ],
)
def test_a_grid_that_is_none_is_refused(numbers, message):
    with pytest.raises(ArgumentError, match=message):
        GridGrasping(**numbers)


FINISH, WASH, LIFT, WAIT = "FINISH", "WASH", "LIFT", "WAIT"


class BruteForceTeam:
    """Value of the best policy of a team, by recursion over histories.

    A belief is a dictionary: (attributes, grips, how each robot's attempt ends) → mass; masses need not sum to 1.
    """

    def __init__(self, config, hides, reach, near, grips):
        self.config, self.hides = config, hides
        self.reach, self.near, self.grips = reach, near, grips
        self.num, self.num_robots = len(hides), len(config.speed)

    def value(self):
        share = self.config.dirty_share
        mass = {}
        for dirty in product([False, True], repeat=self.num):
            for offsets in product(self.grips, repeat=self.num):
                prior = np.prod([share if one else 1 - share for one in dirty])
                key = (dirty, tuple(offset for offset, _ in offsets), (None,) * self.num_robots)
                mass[key] = prior * np.prod([weight for _, weight in offsets])
        there = frozenset(range(self.num))
        robots = tuple((self.config.horizon, "FREE", 0, 0.0) for _ in range(self.num_robots))
        return sum(self._best(result, there, robots) for result in self._looked(mass, there, frozenset()))

    def occlusion(self, there, i):
        return 1 - np.prod([1 - self.hides[i][j] for j in there])

    def _looked(self, mass, there, held):
        """Beliefs after every set of labels."""
        cups, law = sorted(there), self.config.seeing
        for labels in product([False, True], repeat=len(cups)):
            after = dict(mass)
            for i, label in zip(cups, labels, strict=True):
                hidden = 0.0 if i in held else self.occlusion(there - held, i)
                right = law.floor + law.gain * (1 - hidden) ** law.power
                after = {key: m * (right if key[0][i] == label else 1 - right) for key, m in after.items()}
            yield after

    def _left(self, mass, there):
        return self.config.reward_dirty_left * sum(m * sum(key[0][i] for i in there) for key, m in mass.items())

    def _best(self, mass, there, robots):
        """Value where somebody decides."""
        free = [r for r, (to_go, verb, _, _) in enumerate(robots) if verb == "FREE" and to_go > 0]
        return max(
            self._begin(mass, there, robots, free[0], *action) for action in self._possible(there, robots, free[0])
        )

    def _possible(self, there, robots, r):
        others = [robot for k, robot in enumerate(robots) if k != r]
        taken = {i for _, verb, at, _ in others if verb in (WASH, LIFT) for i in there if i == at or self.near[i][at]}
        yield FINISH, 0
        for i in sorted(there - taken):
            if self.reach[r][i]:
                yield WASH, i
                yield LIFT, i
        if any(verb in (WASH, LIFT, FINISH) for _, verb, _, _ in others):
            yield WAIT, 0

    def _begin(self, mass, there, robots, r, verb, target):
        to_go, speed, law = robots[r][0] - 1, self.config.speed[r], self.config.grasping
        begun = (*robots[:r], (to_go, verb, target, 0.0), *robots[r + 1 :])
        after = defaultdict(float)
        for (dirty, grips, ends), m in mass.items():
            for end, chance in self._ends(verb, there, target, grips, speed, law):
                after[dirty, grips, (*ends[:r], end, *ends[r + 1 :])] += m * chance
        return self._go_on(dict(after), there, begun)

    def _ends(self, verb, there, target, grips, speed, law):
        rest = self.config.transport_s
        if verb == WAIT:
            return [((False, np.inf), 1.0)]
        if verb == FINISH:
            return [((False, rest / speed), 1.0)]
        base = law.base
        scale = np.exp(base.log_time + base.log_time_per_occlusion * self.occlusion(there, target) - grips[target])
        missed = np.exp(-base.limit_s / scale)
        held = [
            ((True, (rest + time) / speed), (1 - missed) * share)
            for time, share in zip(law.held_s, law.held_share, strict=True)
        ]
        return [*held, ((False, (rest + law.limit_s) / speed), missed)]

    def _go_on(self, mass, there, robots):
        """Value of what follows, whether or not somebody decides."""
        done = [verb == "PARKED" or (verb == "FREE" and to_go == 0) for to_go, verb, _, _ in robots]
        if all(done) or not there:
            return self._left(mass, there)
        if any(verb == "FREE" and to_go > 0 for to_go, verb, _, _ in robots):
            return self._best(mass, there, robots)
        result = defaultdict(dict)
        for key, m in mass.items():
            result[self._observed(key, robots)][key] = m
        return sum(self._event(part, there, robots, *seen) for seen, part in result.items())

    def _observed(self, key, robots):
        """Who ends first, when and how; and what the others hold in the air then."""
        left = [
            (round(end[1] - since, 9), r)
            for r, ((_, verb, _, since), end) in enumerate(zip(robots, key[2], strict=True))
            if verb in (WASH, LIFT, FINISH)
        ]
        passed, first = min(left)
        up = []
        for rest, r in left:
            is_up = key[2][r][0] and rest - passed <= self.config.transport_s / self.config.speed[r] + 1e-9
            up += [robots[r][2]] if r != first and is_up else []
        return first, passed, key[2][first], frozenset(up)

    def _event(self, mass, there, robots, first, passed, end, up):
        _, verb, target, _ = robots[first]
        total = sum(mass.values())
        dirty = sum(m for key, m in mass.items() if key[0][target])
        reward = self.config.reward_per_s * passed * total
        held = set(up)
        if verb == WASH:
            config = self.config
            paid = config.reward_wash_dirty * dirty + config.reward_wash_clean * (total - dirty)
            reward += paid if end[0] else config.reward_wash_failed * total
            there = there - {target} if end[0] else there
        if verb == LIFT:
            reward += self.config.reward_lift_per_s * end[1] * total
            held |= {target} if end[0] else set()
        after = [
            (left, "PARKED" if r == first and verb == FINISH else "FREE", 0, 0.0)
            if r == first or what == WAIT
            else (left, what, at, since + passed)
            for r, (left, what, at, since) in enumerate(robots)
        ]
        # Who decides no more has nothing to look for: what follows is one sum over all labels.
        is_over = all(left == 0 for left, *_ in robots)
        looked = [mass] if is_over else self._looked(mass, there, frozenset(held))
        return reward + sum(self._go_on(part, there, tuple(after)) for part in looked)
