"""The best that a team can do by brute force: a joint belief over all that is hidden, every history on its own.

What is hidden is the attribute and the grip of each object, and how what each robot is at will end. Nothing is counted,
nothing is kept, and no two histories are taken for one.
"""

from collections import defaultdict
from itertools import product

import numpy as np

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
        return sum(self._best(told, there, robots) for told in self._looked(mass, there, frozenset()))

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
        told = defaultdict(dict)
        for key, m in mass.items():
            told[self._observed(key, robots)][key] = m
        return sum(self._event(part, there, robots, *seen) for seen, part in told.items())

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
