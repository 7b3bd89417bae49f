"""Worlds once more, in plain Python, without arrays: of one robot (design §3), and of a team."""

import math
from dataclasses import dataclass, field


def hidden_share(hides, is_present, i):
    """occ_i = 1 − Π_j (1 − hides[i, j]·present_j)."""
    visible = 1.0
    for j, present in enumerate(is_present):
        if present:
            visible *= 1.0 - hides[i][j]
    return 1.0 - visible


def mean_grasp_s(occlusion, offset):
    return math.exp(0.6 + 2.2 * occlusion - offset)


def accuracy(occlusion):
    return 0.5 + 0.3 * (1.0 - occlusion) ** 1.5


def naive_step(table, verb, target, exponential, label_uniforms):
    """One action; `table` is a dict of lists (hides, on_table, log_odds, dirty, offset) and steps_to_go.

    `exponential` is the draw of E, `label_uniforms` that of each label. Returns reward, duration [s], whether the
    trajectory is over, and the table after it.
    """
    after = {key: list(value) if isinstance(value, list) else value for key, value in table.items()}
    after["steps_to_go"] -= 1
    reward, attempt_s, held = 0.0, 0.0, None
    if verb != "FINISH":
        occlusion = hidden_share(table["hides"], table["on_table"], target)
        grasp_s = mean_grasp_s(occlusion, table["offset"][target]) * exponential
        succeeded = grasp_s <= 6.0
        attempt_s = grasp_s if succeeded else 6.0
        after["attempts"] = [*table["attempts"], (target, occlusion, succeeded)]
        if verb == "WASH" and succeeded:
            reward = 5.0 if table["dirty"][target] else -10.0
            after["on_table"][target] = False
        elif verb == "WASH":
            reward = -1.0
        else:
            reward = -0.1 * (attempt_s + 1.0)
            if succeeded:
                held = target
                after["lifts"][target] += 1
    duration_s = attempt_s + 1.0

    hiding = [on and j != held for j, on in enumerate(after["on_table"])]
    for i, on in enumerate(after["on_table"]):
        if not on:
            continue
        right = accuracy(0.0 if i == held else hidden_share(table["hides"], hiding, i))
        says_dirty = table["dirty"][i] == (label_uniforms[i] < right)
        after["log_odds"][i] += math.log(right / (1.0 - right)) * (1 if says_dirty else -1)

    is_over = verb == "FINISH" or after["steps_to_go"] == 0 or not any(after["on_table"])
    if is_over:
        reward -= 5.0 * sum(on and dirty for on, dirty in zip(after["on_table"], table["dirty"], strict=True))
    return reward, duration_s, is_over, after


WASH, LIFT, WAIT, FINISH = "WASH", "LIFT", "WAIT", "FINISH"


@dataclass
class NaiveTeam:
    """Robots, what each is at and until when, and the clock."""

    num_robots: int
    num_objects: int
    horizon: int
    near: set[tuple[int, int]]
    reach: list[set[int]]
    clock_s: float = 0.0
    there: set[int] = field(default_factory=set)
    busy: dict[int, tuple[str, int, float, float]] = field(default_factory=dict)
    """Robot: verb, object, begin and end of what it is at; a robot that waits has no end."""
    parked: set[int] = field(default_factory=set)
    spent: dict[int, int] = field(default_factory=dict)
    out_at_s: dict[int, float] = field(default_factory=dict)
    """Clock at which each robot drops out, if it is at something then."""
    out: dict[int, float] = field(default_factory=dict)
    """Those that did, and when."""
    price_per_s: float = 0.0
    alone: dict[int, float] = field(default_factory=dict)
    """What the last step would have paid each robot had it been alone."""

    def __post_init__(self):
        self.there = set(range(self.num_objects))
        self.spent = dict.fromkeys(range(self.num_robots), 0)

    @property
    def free(self):
        can = [r for r in range(self.num_robots) if r not in self.busy and r not in self.parked and r not in self.out]
        return [r for r in can if self.spent[r] < self.horizon]

    @property
    def is_over(self):
        return not self.there or (not self.busy and not self.free)

    def possible(self):
        """(verb, object) of the robot that decides."""
        robot = self.free[0]
        at_work = [task for r, task in self.busy.items() if r != robot and task[0] != WAIT]
        taken = {i for task in at_work if task[0] in (WASH, LIFT) for i in self.there if self._are_near(i, task[1])}
        objects = sorted((self.there & self.reach[robot]) - taken)
        found = [(FINISH, 0), *((verb, i) for verb in (WASH, LIFT) for i in objects)]
        return found + ([(WAIT, 0)] if at_work else [])

    def _are_near(self, i, j):
        return i == j or (i, j) in self.near or (j, i) in self.near

    def _is_done(self, robot):
        is_spent = robot in self.parked or robot in self.out or self.spent[robot] == self.horizon
        return robot not in self.busy and is_spent

    def step(self, verb, target):
        """Reward of the stage and its time."""
        robot, begun_s, reward = self.free[0], self.clock_s, 0.0
        self.alone = dict.fromkeys(range(self.num_robots), 0.0)
        self.spent[robot] += 1
        end_s = {WAIT: float("inf"), FINISH: self.clock_s + 1.0}.get(verb, self.clock_s + 2.0 + 2.0 * target)
        self.busy[robot] = (verb, target, self.clock_s, end_s)
        while not self.free and not self.is_over:
            reward += self._event()
        passed_s = self.clock_s - begun_s
        left = -5.0 * len(self.there) if self.is_over else 0.0
        return reward + left + self.price_per_s * passed_s, passed_s

    def _event(self):
        """Reward of the next end, or the next drop-out."""
        since_s, going = self.clock_s, [r for r in range(self.num_robots) if not self._is_done(r)]
        done = min(self.busy, key=lambda r: (self.busy[r][3], r))
        leaver = min(self.busy, key=lambda r: (self.out_at_s.get(r, float("inf")), r))
        reward = 0.0
        if self.out_at_s.get(leaver, float("inf")) < self.busy[done][3]:
            self.clock_s = self.out[leaver] = self.out_at_s[leaver]
            del self.busy[leaver]
        else:
            reward = self._end(done)
            self.alone[done] += reward
        self.busy = {r: task for r, task in self.busy.items() if task[0] != WAIT}
        for r in going:
            self.alone[r] += self.price_per_s * (self.clock_s - since_s)
            if self._is_done(r) and r not in self.out:
                self.alone[r] -= 5.0 * len(self.there & self.reach[r])
        return reward

    def _end(self, robot):
        verb, target, since_s, self.clock_s = self.busy.pop(robot)
        if verb == WASH:
            self.there.discard(target)
            return 5.0
        if verb == LIFT:
            return -0.1 * (self.clock_s - since_s)
        self.parked.add(robot)
        return 0.0
