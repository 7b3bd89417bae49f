"""Peers on a table of states by actions: each learns π(a | s) from the same completed stages.

In a state that was never seen complete all of them do as the rule of today. A stage before a cut counts in full, for
the state in which the cut fell is known; that is the best that these methods can be given.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from worlds.mdp import FiniteWorld, Steps

NUM_SWEEPS = 300
ENOUGH = 1e-7


class Counts(NamedTuple):
    """What a log has seen."""

    n: np.ndarray
    """Completed stages by state and action."""
    moves: scipy.sparse.csr_matrix
    """Share of successors of each cell, (S·A, S)."""
    reward: np.ndarray
    """Of each state that is entered."""
    is_end: np.ndarray

    def backed_up(self, value: np.ndarray) -> np.ndarray:
        """Mean of R + V(S′) by state and action; 0 where never seen."""
        return (self.moves @ (self.reward + np.where(self.is_end, 0.0, value))).reshape(self.n.shape)

    @property
    def is_seen(self) -> np.ndarray:
        return self.n > 0

    @property
    def clone(self) -> np.ndarray:
        """Share of each action in each state."""
        return self.n / np.maximum(self.n.sum(axis=1, keepdims=True), 1)


def counts_of(world: FiniteWorld, steps: Steps) -> Counts:
    done, size = steps.successor >= 0, world.num_states * world.num_actions
    cell = steps.state[done] * world.num_actions + steps.action[done]
    n = np.bincount(cell, minlength=size)
    moves = scipy.sparse.csr_matrix((1.0 / n[cell], (cell, steps.successor[done])), (size, world.num_states))
    return Counts(n.reshape(world.num_states, -1), moves, world.reward, world.is_end)


def iterated(counts: Counts, allowed: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    """Q by value iteration over some actions, less a penalty; −inf for the others."""
    value = np.zeros(len(allowed))
    for _ in range(NUM_SWEEPS):
        q = np.where(allowed, counts.backed_up(value) - penalty, -np.inf)
        new = np.where(allowed.any(axis=1), q.max(axis=1), 0.0)
        change, value = float(np.abs(new - value).max()), new
        if change < ENOUGH:
            break
    return q


def greedy(q: np.ndarray) -> np.ndarray:
    return np.eye(q.shape[1])[q.argmax(axis=1)]


def behaviour_cloning(counts: Counts) -> np.ndarray:
    return counts.clone


def certainty_equivalence(counts: Counts, least: int = 1) -> np.ndarray:
    """Best in the estimated world, among what was seen so often; where nothing was, what was seen most."""
    often = counts.n >= least
    most = counts.is_seen & (counts.n == counts.n.max(axis=1, keepdims=True))
    return greedy(iterated(counts, np.where(often.any(axis=1, keepdims=True), often, most), np.zeros(often.shape)))


def pessimistic(counts: Counts, caution: float) -> np.ndarray:
    """Value iteration with a lower bound, Q − caution/√n [Rashidinejad et al. 2021]."""
    return greedy(iterated(counts, counts.is_seen, caution / np.sqrt(np.maximum(counts.n, 1))))


def discrete_bcq(counts: Counts, threshold: float = 0.3) -> np.ndarray:
    """Best among actions that are at least so likely as the likeliest [Fujimoto et al. 2019]."""
    share = counts.clone
    return greedy(
        iterated(counts, counts.is_seen & (share >= threshold * share.max(axis=1, keepdims=True)), 0.0 * share)
    )


def discrete_cql(counts: Counts, alpha: float, discount: float = 0.99, num_sweeps: int = 400) -> np.ndarray:
    """Q that a log-sum-exp holds down and the log holds up [Kumar et al. 2020], on a table.

    Of ½ Σ n (Q − target)² + α Σ n_s (log Σ exp Q − Σ share·Q) the gradient by cell, over n, is
    Q − target + α (softmax Q / share − 1); steps are damped where the share is small. Without a discount what holds Q
    up would add up for ever.
    """
    seen, share = counts.is_seen, np.maximum(counts.clone, 1e-12)
    q = np.zeros(seen.shape)
    for _ in range(num_sweeps):
        among = np.where(seen, q, -np.inf)
        value = np.where(seen.any(axis=1), among.max(axis=1), 0.0)
        odds = np.where(seen, np.exp(q - value[:, None]), 0.0)
        soft = odds / np.maximum(odds.sum(axis=1, keepdims=True), 1e-300)
        slope = q - counts.backed_up(discount * value) + alpha * (soft / share - 1.0)
        q = np.where(seen, q - 0.5 * slope / (1.0 + alpha / share), 0.0)
    return greedy(np.where(seen, q, -np.inf))
