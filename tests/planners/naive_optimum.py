"""The best of all policies by brute force: a joint belief over everything hidden, every history on its own."""

from itertools import product

import numpy as np


def hermite(config, num_nodes):
    nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
    return [
        (config.grasping.offset_std * node, weight / sum(weights)) for node, weight in zip(nodes, weights, strict=True)
    ]


def hidden_states(config, num_cups, grips):
    """All (attributes, grip offsets), and the prior of each."""
    every, prior = [], []
    for dirty in product([False, True], repeat=num_cups):
        for offsets in product(grips, repeat=num_cups):
            of_dirty = [config.dirty_share if one else 1 - config.dirty_share for one in dirty]
            every.append((dirty, tuple(offset for offset, _ in offsets)))
            prior.append(np.prod(of_dirty) * np.prod([weight for _, weight in offsets]))
    return every, np.array(prior)


class BruteForce:
    """Value of the best policy, or of the one that `choose` is, by recursion over histories."""

    def __init__(self, config, hides, num_nodes, choose=None):
        self.config, self.hides, self.choose = config, hides, choose
        self.every, self.prior = hidden_states(config, len(hides), hermite(config, num_nodes))

    def value(self, horizon):
        there = frozenset(range(len(self.hides)))
        return self._after_look(self.prior, there, None, (), horizon)

    def occlusion(self, there, i):
        return 1 - np.prod([1 - self.hides[i][j] for j in there])

    def dirty_mass(self, mass, i):
        return sum(m for m, (dirty, _) in zip(mass, self.every, strict=True) if dirty[i])

    def left(self, mass, there):
        return self.config.reward_dirty_left * sum(self.dirty_mass(mass, i) for i in there)

    def _after_look(self, mass, there, held, attempts, steps):
        """Sum over all labels; `mass` need not sum to 1, so that no chance is divided by."""
        cups = sorted(there)
        total = 0.0
        for labels in product([False, True], repeat=len(cups)):
            likelihood = np.ones(len(mass))
            for i, label in zip(cups, labels, strict=True):
                occluded = 0.0 if i == held else self.occlusion(there - {held}, i)
                right = self.config.seeing.floor + self.config.seeing.gain * (1 - occluded) ** self.config.seeing.power
                likelihood *= [right if dirty[i] == label else 1 - right for dirty, _ in self.every]
            total += self._best(mass * likelihood, there, attempts, steps)
        return total

    def _best(self, mass, there, attempts, steps):
        if steps == 0 or not there:
            return self.left(mass, there)
        if self.choose is not None:
            is_dirty = [self.dirty_mass(mass, i) / mass.sum() for i in range(len(self.hides))]
            return self._q(self.choose(is_dirty, there, attempts, steps), mass, there, attempts, steps)
        num_cups = len(self.hides)
        actions = [0] + [1 + verb * num_cups + i for verb in (0, 1) for i in there]
        return max(self._q(action, mass, there, attempts, steps) for action in actions)

    def _q(self, action, mass, there, attempts, steps):
        if action == 0:
            return self.left(mass, there)
        is_lift, i = divmod(action - 1, len(self.hides))
        config, occluded = self.config, self.occlusion(there, i)
        log_time = config.grasping.log_time + config.grasping.log_time_per_occlusion * occluded
        scale = np.array([np.exp(log_time - grip[i]) for _, grip in self.every])
        missed = mass * np.exp(-config.grasping.limit_s / scale)
        grasped = mass - missed
        after_miss, after_grasp = (*attempts, (i, occluded, False)), (*attempts, (i, occluded, True))
        value = self._after_look(missed, there, None, after_miss, steps - 1)
        if is_lift:
            seconds = config.transport_s + scale * (1 - np.exp(-config.grasping.limit_s / scale))
            value += config.reward_lift_per_s * float(mass @ seconds)
            return value + self._after_look(grasped, there, i, after_grasp, steps - 1)
        dirty = self.dirty_mass(grasped, i)
        value += config.reward_wash_failed * missed.sum()
        value += config.reward_wash_dirty * dirty + config.reward_wash_clean * (grasped.sum() - dirty)
        return value + self._after_look(grasped, there - {i}, None, after_grasp, steps - 1)
