"""A look one step ahead of two robots, each with a law of its own, by plain loops over results, labels and nodes."""

from dataclasses import dataclass
from math import exp, log1p

import numpy as np

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def assumed(occluded, offset):
    """P(held) and expected seconds of `AssumedGrasping()`."""
    scale_s = exp(0.6 + 2.2 * occluded - offset)
    missed = exp(-6.0 / scale_s)
    return 1.0 - missed, scale_s * (1.0 - missed)


def logistic(log_odds, per_occlusion, held_s, missed_s):
    """The same of a `FittedGrasping` whose times have all but no spread, and are below its limit."""

    def of(occluded, offset):
        held = 1.0 / (1.0 + exp(-(log_odds + per_occlusion * occluded + offset)))
        return held, held * held_s + (1.0 - held) * missed_s

    return of


@dataclass
class NaiveMyopic:
    """One table, of which robot `me` decides."""

    laws: list
    """(occluded, offset) to (P(held), expected seconds) of each robot."""
    stds: list
    speed: list
    price: float
    """Of a second, 0 or above."""
    hides: np.ndarray
    there: list
    dirty: list
    attempts: list
    """(robot, object, occlusion, held)."""
    reach: np.ndarray
    me: int
    busy: dict
    """Other robots: (verb, object, seconds so far)."""
    to_go: list
    gone: list

    def __post_init__(self):
        self.num = len(self.hides)
        self.weights = [self.posterior(i) for i in range(self.num)]
        self.washed = {i for verb, i, _ in self.busy.values() if verb == "WASH"}

    def occluded(self, i, without=None):
        shown = [1.0 - self.hides[i][j] for j in range(self.num) if self.there[j] and j != without]
        return 1.0 - float(np.prod(shown))

    def posterior(self, i, *more):
        weights = WEIGHTS.copy()
        for robot, target, occluded, held in (*self.attempts, *more):
            if target == i:
                for g, node in enumerate(NODES):
                    chance = self.laws[robot](occluded, self.stds[robot] * node)[0]
                    weights[g] *= chance if held else 1.0 - chance
        return weights / weights.sum()

    def mean(self, robot, i, occluded, which, weights=None):
        at = [self.laws[robot](occluded, self.stds[robot] * node)[which] for node in NODES]
        return float(np.dot(self.weights[i] if weights is None else weights, at))

    def chance(self, robot, i, occluded, weights=None):
        return self.mean(robot, i, occluded, 0, weights)

    def seconds(self, robot, i):
        return (1.0 + self.mean(robot, i, self.occluded(i), 1)) / self.speed[robot]

    def after(self, i, held):
        """Weights of the nodes once the robot that decides has tried."""
        return self.posterior(i, (self.me, i, self.occluded(i), held))

    def team(self, with_me):
        return [r for r in range(2) if (with_me if r == self.me else not self.gone[r])]

    def left(self, robot):
        return self.to_go[robot] - (robot == self.me)

    def try_of(self, team, i, seen_at, chance_of):
        """(gain, probability that it is worth it) of one more try, by whom it is worth the most."""
        right = 0.5 + 0.3 * (1.0 - seen_at) ** 1.5
        found = []
        for robot in team:
            if not self.reach[robot][i] or self.left(robot) <= 0:
                continue
            gain = number = 0.0
            for says_dirty in (True, False):
                if_dirty, if_clean = (right, 1.0 - right) if says_dirty else (1.0 - right, right)
                result = self.dirty[i] * if_dirty + (1.0 - self.dirty[i]) * if_clean
                dirty = self.dirty[i] * if_dirty / result
                held = chance_of(robot)
                worth = held * (dirty * 10.0 - (1.0 - dirty) * 10.0) - (1.0 - held)
                worth -= self.price / len(team) * self.seconds(robot, i)
                gain, number = gain + result * max(worth, 0.0), number + (result if worth > 0.0 else 0.0)
            found.append((gain, number))
        return max(found, key=lambda each: each[0]) if found else (0.0, 0.0)

    def value(self, team, tries):
        gain, number = (sum(each[k] for each in tries) for k in (0, 1))
        decisions = sum(self.left(r) for r in team)
        return min(1.0, decisions / max(number, 1.0)) * gain

    def wanted(self):
        return [i for i in range(self.num) if self.there[i] and i not in self.washed]

    def now(self, team, i, weights=None):
        occluded = self.occluded(i)
        return self.try_of(team, i, occluded, lambda r: self.chance(r, i, occluded, weights))

    def finish(self):
        team = self.team(False)
        return self.value(team, [self.now(team, i) for i in self.wanted()]) if team else 0.0

    def wait(self):
        team, left_s = self.team(True), []
        for robot, (_, target, since_s) in self.busy.items():
            expected_s = self.seconds(robot, target)
            left_s.append(max(expected_s - since_s, 0.3 * expected_s))
        return self.value(team, [self.now(team, i) for i in self.wanted()]) - self.price / len(team) * min(left_s)

    def attempt(self, verb, i):
        team, wanted = self.team(True), self.wanted()
        held, own_s = self.chance(self.me, i, self.occluded(i)), self.seconds(self.me, i)
        missed = self.value(team, [self.now(team, j, self.after(j, False) if j == i else None) for j in wanted])
        if_held = []
        for j in wanted:
            if j != i:
                cleared = self.occluded(j, without=i)
                at = cleared if verb == "WASH" else self.occluded(j)
                if_held.append(self.try_of(team, j, cleared, lambda r, j=j, at=at: self.chance(r, j, at)))
            elif verb == "LIFT":
                again = self.after(i, True)
                if_held.append(
                    self.try_of(team, i, 0.0, lambda r, again=again: self.chance(r, i, self.occluded(i), again))
                )
        pays = self.dirty[i] * 10.0 - (1.0 - self.dirty[i]) * 10.0
        now = held * pays - (1.0 - held) if verb == "WASH" else -0.1 * own_s
        after = held * self.value(team, if_held) + (1.0 - held) * missed
        return now + after - self.price / len(team) * own_s


def odds_to_share(log_odds):
    """P of log-odds."""
    return exp(log_odds - log1p(exp(log_odds)))
