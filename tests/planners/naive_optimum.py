"""The best of all policies by brute force: a joint belief over everything hidden, every history on its own.

Where errors of labels persist, an object that is dirty is said to be so once ξ ~ U(0, 1), which nobody sees, lies below
the curve at all that has been in view; a clean one by the other curve. So ξ matters only by the interval between values
of the curves that it lies in.
"""

from functools import cache
from itertools import pairwise, product

import numpy as np
from scipy import stats
from scipy.special import expit

from halfseen.world import FittedGrasping, PersistentSeeing


def hermite(config, num_nodes):
    nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
    return [
        (config.grasping.offset_std * node, weight / sum(weights)) for node, weight in zip(nodes, weights, strict=True)
    ]


class BruteForce:
    """Value of the best policy, or of the one that `choose` is, by recursion over histories."""

    def __init__(self, config, scene, num_nodes, choose=None):
        self.config, self.hides, self.choose, self.num_cups = config, scene.hides, choose, len(scene.hides)
        self.persists = isinstance(config.seeing, PersistentSeeing)
        offsets = hermite(config, num_nodes)
        each = [self._hidden(i, [(scene.grip[i] + u, weight) for u, weight in offsets]) for i in range(self.num_cups)]
        every = list(product(*each))
        self.prior = np.array([np.prod([weight for *_, weight in cups]) for cups in every])
        self.dirty, self.offset, self.xi = (np.array([[cup[k] for cup in cups] for cups in every]) for k in range(3))

    def value(self, horizon):
        there = frozenset(range(self.num_cups))
        return self._after_look(self.prior, there, None, (), (0.0,) * self.num_cups, horizon)

    def occlusion(self, there, i):
        return 1 - np.prod([1 - self.hides[i][j] for j in there])

    def _hidden(self, i, grips):
        """All (dirty, offset, ξ) of one cup, and the chance of each; ξ in the middle of its interval."""
        for is_dirty in (True, False):
            of_dirty = self.config.dirty_share if is_dirty else 1 - self.config.dirty_share
            for (low, high), (offset, weight) in product(pairwise(self._ends(i, is_dirty)), grips):
                yield is_dirty, offset, (low + high) / 2, of_dirty * weight * (high - low)

    def _ends(self, i, is_dirty):
        if not self.persists:
            return [0.0, 1.0]
        others = [j for j in range(self.num_cups) if j != i]
        subsets = [
            [j for j, there in zip(others, bits, strict=True) if there] for bits in product([0, 1], repeat=len(others))
        ]
        views = [1.0, *(self.config.seeing.facing * (1 - self.occlusion(there, i)) for there in subsets)]
        return sorted({0.0, 1.0, *(float(self._found_by(is_dirty, view)) for view in views)})

    def _found_by(self, is_dirty, view):
        law = self.config.seeing
        return np.interp(view, [0.0, *law.views], [0.0, *(law.sensitivity if is_dirty else law.false_alarms)])

    def _left(self, mass, there):
        return self.config.reward_dirty_left * sum(mass @ self.dirty[:, i] for i in there)

    def _look(self, there, held, seen):
        """P(DIRTY is said of each cup | all that is hidden), and how much of each has been seen by then."""
        law = self.config.seeing
        visible = [1.0 if i == held else 1 - self.occlusion(there - {held}, i) for i in range(self.num_cups)]
        if not self.persists:
            right = [law.floor + law.gain * view**law.power for view in visible]
            return [np.where(self.dirty[:, i], right[i], 1 - right[i]) for i in range(self.num_cups)], seen
        now = [view if i == held else law.facing * view for i, view in enumerate(visible)]
        seen = tuple(max(was, view) if i in there else was for i, (was, view) in enumerate(zip(seen, now, strict=True)))
        curves = [
            np.where(self.dirty[:, i], *(self._found_by(dirty, seen[i]) for dirty in (True, False)))
            for i in range(self.num_cups)
        ]
        return [np.float64(self.xi[:, i] < curve) for i, curve in enumerate(curves)], seen

    def _after_look(self, mass, there, held, attempts, seen, steps):
        """Sum over all labels; `mass` need not sum to 1, so that no chance is divided by."""
        says, seen = self._look(there, held, seen)
        total = 0.0
        for labels in product([False, True], repeat=len(there)):
            of_labels = dict(zip(sorted(there), labels, strict=True))
            left = mass * np.prod([says[i] if label else 1 - says[i] for i, label in of_labels.items()], axis=0)
            if left.any():
                total += self._best(left, there, attempts, seen, of_labels, steps)
        return total

    def _best(self, mass, there, attempts, seen, result, steps):
        if steps == 0 or not there:
            return self._left(mass, there)
        if self.choose is not None:
            is_found = [self.persists and result.get(i, False) for i in range(self.num_cups)]
            counted = np.where(is_found, 1.0, seen)
            action = self.choose(mass @ self.dirty / mass.sum(), counted, there, attempts, steps)
            return self._q(action, mass, there, attempts, seen, steps)
        actions = [0] + [1 + verb * self.num_cups + i for verb in (0, 1) for i in there]
        return max(self._q(action, mass, there, attempts, seen, steps) for action in actions)

    def _attempt(self, i, occluded):
        """P(held) and mean time, given all that is hidden."""
        law, offset = self.config.grasping, self.offset[:, i]
        if not isinstance(law, FittedGrasping):
            scale = np.exp(law.log_time + law.log_time_per_occlusion * occluded - offset)
            held = 1 - np.exp(-law.limit_s / scale)
            return held, scale * held
        held = expit(law.log_odds + law.log_odds_per_occlusion * occluded + offset)
        return held, held * self._mean_s(law.log_held_s) + (1 - held) * self._mean_s(law.log_missed_s)

    @cache  # noqa: B019
    def _mean_s(self, log_s):
        """∫ P(T > t) dt up to the limit."""
        law, (node, weight) = self.config.grasping, np.polynomial.legendre.leggauss(500)
        half_s = law.limit_s / 2
        return half_s * weight @ stats.lognorm(s=law.log_std, scale=np.exp(log_s)).sf(half_s * (1 + node))

    def _q(self, action, mass, there, attempts, seen, steps):
        if action == 0:
            return self._left(mass, there)
        is_lift, i = divmod(action - 1, self.num_cups)
        config, occluded = self.config, self.occlusion(there, i)
        held, seconds = self._attempt(i, occluded)
        grasped, missed = mass * held, mass * (1 - held)
        tried = [(*attempts, (i, occluded, is_grasped)) for is_grasped in (False, True)]
        value = self._after_look(missed, there, None, tried[0], seen, steps - 1)
        if is_lift:
            value += config.reward_lift_per_s * (mass.sum() * config.transport_s + mass @ seconds)
            return value + self._after_look(grasped, there, i, tried[1], seen, steps - 1)
        dirty = grasped @ self.dirty[:, i]
        value += config.reward_wash_failed * missed.sum()
        value += config.reward_wash_dirty * dirty + config.reward_wash_clean * (grasped.sum() - dirty)
        return value + self._after_look(grasped, there - {i}, None, tried[1], seen, steps - 1)
