"""The best of all policies of a small team by brute force: every hidden truth, and every history on its own."""

from itertools import product
from math import exp
from typing import NamedTuple

import numpy as np

WASH, LIFT, WAIT, FINISH = "WASH", "LIFT", "WAIT", "FINISH"


class Truth(NamedTuple):
    """Something that may be true, and how likely it is together with all that was seen."""

    mass: float
    dirty: tuple
    offsets: tuple
    ends: tuple
    """When what each robot is at will end, and whether it holds; None where it is at nothing that ends."""


class Seen(NamedTuple):
    clock_s: float
    there: frozenset
    tasks: tuple
    """Verb, object and begin of what each robot is at."""
    parked: frozenset
    to_go: tuple


class BruteForceTeam:
    """Value of the best policy by recursion over histories, `config.world.grasping` being a `GridGrasping`."""

    def __init__(self, config, hides, reach, near, num_nodes):
        self.config, self.world, self.hides = config, config.world, np.asarray(hides, dtype=float)
        self.reach, self.near, self.num_nodes = reach, near, num_nodes

    def value(self):
        nodes, weights = np.polynomial.hermite_e.hermegauss(self.num_nodes)
        grips = list(zip(nodes * float(self.world.grasping.offset_std), weights / sum(weights), strict=True))
        size, num_robots, share = len(self.hides), self.config.num_robots, self.world.dirty_share
        truths = [
            Truth(
                float(np.prod([share if one else 1 - share for one in dirty]) * np.prod([p for _, p in grip])),
                dirty,
                tuple(u for u, _ in grip),
                (None,) * num_robots,
            )
            for dirty in product([True, False], repeat=size)
            for grip in product(grips, repeat=size)
        ]
        horizon = (self.world.horizon,) * num_robots
        seen = Seen(0.0, frozenset(range(size)), (None,) * num_robots, frozenset(), horizon)
        return self.after_look(seen, truths, None)

    def occlusion(self, there, i, held=None):
        return 0.0 if i == held else 1 - np.prod([1 - self.hides[i, j] for j in there - {held}])

    def after_look(self, seen, truths, held):
        law, total, cups = self.world.seeing, 0.0, sorted(seen.there)
        right = {i: law.floor + law.gain * (1 - self.occlusion(seen.there, i, held)) ** law.power for i in cups}
        for labels in product([True, False], repeat=len(cups)):
            told = []
            for truth in truths:
                of_each = [
                    right[i] if truth.dirty[i] == says else 1 - right[i] for i, says in zip(cups, labels, strict=True)
                ]
                told.append(truth._replace(mass=truth.mass * np.prod(of_each)))
            total += self.best(seen, told)
        return total

    def free(self, seen):
        robots = range(self.config.num_robots)
        return [r for r in robots if seen.tasks[r] is None and r not in seen.parked and seen.to_go[r] > 0]

    def best(self, seen, truths):
        free = self.free(seen)
        if not seen.there or (not free and not any(seen.tasks)):
            return self.world.reward_dirty_left * sum(t.mass * sum(t.dirty[i] for i in seen.there) for t in truths)
        if not free:
            return self.event(seen, truths)
        return max(self.begun(seen, truths, free[0], *action) for action in self.possible(seen, free[0]))

    def possible(self, seen, robot):
        at_work = [task for task in seen.tasks if task is not None and task[0] != WAIT]
        taken = {task[1] for task in at_work if task[0] in (WASH, LIFT)}
        objects = [
            i for i in seen.there if i in self.reach[robot] and not any(i == j or {i, j} in self.near for j in taken)
        ]
        return [(FINISH, None), *product((WASH, LIFT), objects)] + [(WAIT, None)] * bool(at_work)

    def begun(self, seen, truths, robot, verb, target):
        seen = seen._replace(
            tasks=put(seen.tasks, robot, (verb, target, seen.clock_s)),
            to_go=put(seen.to_go, robot, seen.to_go[robot] - 1),
        )
        after = []
        for truth in truths:
            for chance, took_s, is_held in self.results(seen, truth, verb, target):
                end_s = round(seen.clock_s + (self.world.transport_s + took_s) / self.config.speed[robot], 9)
                end = None if verb == WAIT else (end_s, is_held)
                after.append(truth._replace(mass=truth.mass * chance, ends=put(truth.ends, robot, end)))
        return self.best(seen, after)

    def results(self, seen, truth, verb, target):
        if verb in (WAIT, FINISH):
            return [(1.0, 0.0, False)]
        law, occluded = self.world.grasping, self.occlusion(seen.there, target)
        holds = 1 / (1 + exp(-(law.log_odds + law.log_odds_per_occlusion * occluded + truth.offsets[target])))
        held = [(holds / len(law.held_s), each, True) for each in law.held_s]
        return held + [((1 - holds) / len(law.missed_s), each, False) for each in law.missed_s]

    def event(self, seen, truths):
        """All that may be seen to end first."""
        told = {}
        for truth in truths:
            robot = min((r for r, end in enumerate(truth.ends) if end), key=lambda r: (truth.ends[r][0], r))
            told.setdefault((robot, *truth.ends[robot]), []).append(truth)
        return sum(self.ended(seen, those, *what) for what, those in told.items())

    def ended(self, seen, truths, robot, end_s, is_held):
        verb, target, begun_s = seen.tasks[robot]
        mass = sum(t.mass for t in truths)
        reward = mass * self.config.reward_per_s * (end_s - seen.clock_s)
        there = seen.there
        if verb == WASH and is_held:
            dirty = sum(t.mass for t in truths if t.dirty[target])
            reward += dirty * self.world.reward_wash_dirty + (mass - dirty) * self.world.reward_wash_clean
            there = there - {target}
        elif verb == WASH:
            reward += mass * self.world.reward_wash_failed
        elif verb == LIFT:
            reward += mass * self.world.reward_lift_per_s * (end_s - begun_s)
        tasks = [None if task is None or task[0] == WAIT else task for task in put(seen.tasks, robot, None)]
        parked = seen.parked | ({robot} if verb == FINISH else set())
        seen = seen._replace(clock_s=end_s, there=there, tasks=tuple(tasks), parked=parked)
        truths = [t._replace(ends=put(t.ends, robot, None)) for t in truths]
        return reward + self.after_look(seen, truths, target if verb == LIFT and is_held else None)


def put(each, place, value):
    return (*each[:place], value, *each[place + 1 :])
