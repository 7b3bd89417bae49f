"""The best of all policies under fitted laws by brute force: a joint belief over everything hidden, ξ included.

An object that is dirty is said to be so once ξ ~ U(0, 1), which nobody sees, lies below the curve at all that has been
in view; a clean one by the other curve. So ξ matters only by the interval between values of the curves that it lies in.
"""

from itertools import pairwise, product

import numpy as np
from scipy import stats
from scipy.special import expit


class FittedBruteForce:
    """Value of the best policy, or of the one that `choose` is, by recursion over histories."""

    def __init__(self, config, hides, grip, num_nodes, choose=None):
        self.config, self.hides, self.choose, self.num_cups = config, hides, choose, len(hides)
        law = config.grasping
        nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
        of_grip = list(zip(law.offset_std * nodes, weights / weights.sum(), strict=True))
        each = [self._hidden(i, [(grip[i] + u, weight) for u, weight in of_grip]) for i in range(self.num_cups)]
        every = list(product(*each))
        self.prior = np.array([np.prod([weight for *_, weight in cups]) for cups in every])
        self.dirty, self.offset, self.xi = (np.array([[cup[k] for cup in cups] for cups in every]) for k in range(3))
        self.held_s, self.missed_s = (self._mean_s(log_s) for log_s in (law.log_held_s, law.log_missed_s))

    def value(self, horizon):
        there = frozenset(range(self.num_cups))
        return self._after_look(self.prior, there, None, (), (0.0,) * self.num_cups, horizon)

    def occlusion(self, there, i):
        return 1 - np.prod([1 - self.hides[i][j] for j in there])

    def _hidden(self, i, grips):
        """All (dirty, offset, ξ) of one cup, and the chance of each; ξ in the middle of its interval."""
        others = [j for j in range(self.num_cups) if j != i]
        subsets = [
            [j for j, there in zip(others, bits, strict=True) if there] for bits in product([0, 1], repeat=len(others))
        ]
        views = [1.0, *(self.config.seeing.facing * (1 - self.occlusion(there, i)) for there in subsets)]
        for is_dirty in (True, False):
            ends = sorted({0.0, 1.0, *(float(self.found_by(is_dirty, view)) for view in views)})
            of_dirty = self.config.dirty_share if is_dirty else 1 - self.config.dirty_share
            for (low, high), (offset, weight) in product(pairwise(ends), grips):
                yield is_dirty, offset, (low + high) / 2, of_dirty * weight * (high - low)

    def found_by(self, is_dirty, view):
        law = self.config.seeing
        return np.interp(view, [0.0, *law.views], [0.0, *(law.sensitivity if is_dirty else law.false_alarms)])

    def _mean_s(self, log_s):
        """∫ P(T > t) dt up to the limit."""
        law, (node, weight) = self.config.grasping, np.polynomial.legendre.leggauss(500)
        half_s = law.limit_s / 2
        return half_s * weight @ stats.lognorm(s=law.log_std, scale=np.exp(log_s)).sf(half_s * (1 + node))

    def _left(self, mass, there):
        return self.config.reward_dirty_left * sum(mass @ self.dirty[:, i] for i in there)

    def _after_look(self, mass, there, held, attempts, seen, steps):
        """Sum over all that may have been found by now; `mass` need not sum to 1, so that no chance is divided by."""
        facing, cups = self.config.seeing.facing, sorted(there)
        now = [1.0 if i == held else facing * (1 - self.occlusion(there - {held}, i)) for i in range(self.num_cups)]
        seen = tuple(max(was, view) if i in there else was for i, (was, view) in enumerate(zip(seen, now, strict=True)))
        curves = {i: np.where(self.dirty[:, i], *(self.found_by(d, seen[i]) for d in (True, False))) for i in cups}
        found = np.reshape([self.xi[:, i] < curves[i] for i in cups], (len(cups), len(mass)))
        total = 0.0
        for told in product([False, True], repeat=len(cups)):
            left = mass * (found == np.reshape(told, (-1, 1))).all(axis=0)
            if left.any():
                total += self._best(left, there, attempts, seen, dict(zip(cups, told, strict=True)), steps)
        return total

    def _best(self, mass, there, attempts, seen, told, steps):
        if steps == 0 or not there:
            return self._left(mass, there)
        if self.choose is not None:
            is_dirty = mass @ self.dirty / mass.sum()
            counted = [1.0 if told.get(i, False) else seen[i] for i in range(self.num_cups)]
            action = self.choose(is_dirty, counted, there, attempts, steps)
            return self._q(action, mass, there, attempts, seen, steps)
        actions = [0] + [1 + verb * self.num_cups + i for verb in (0, 1) for i in there]
        return max(self._q(action, mass, there, attempts, seen, steps) for action in actions)

    def _q(self, action, mass, there, attempts, seen, steps):
        if action == 0:
            return self._left(mass, there)
        is_lift, i = divmod(action - 1, self.num_cups)
        config, law, occluded = self.config, self.config.grasping, self.occlusion(there, i)
        grasped = mass * expit(law.log_odds + law.log_odds_per_occlusion * occluded + self.offset[:, i])
        missed = mass - grasped
        tried = [(*attempts, (i, occluded, is_grasped)) for is_grasped in (False, True)]
        value = self._after_look(missed, there, None, tried[0], seen, steps - 1)
        if is_lift:
            seconds = mass.sum() * config.transport_s + grasped.sum() * self.held_s + missed.sum() * self.missed_s
            value += config.reward_lift_per_s * seconds
            return value + self._after_look(grasped, there, i, tried[1], seen, steps - 1)
        dirty = grasped @ self.dirty[:, i]
        value += config.reward_wash_failed * missed.sum()
        value += config.reward_wash_dirty * dirty + config.reward_wash_clean * (grasped.sum() - dirty)
        return value + self._after_look(grasped, there - {i}, None, tried[1], seen, steps - 1)
