"""Joint change of the covariates of the first stage, noticed by a classifier.

On joint states, a classifier bets on which of two is the newer one. A coin decides whether a new state is put aside or
paired with the oldest state that is aside; the first of these come from the policy's log. While nothing has changed
the two are exchangeable, so 2 σ(θ · (φ(new) − φ(old))) has mean 1 for any predictable θ. θ is learned from earlier
pairs by logistic regression [PodkopaevRamdas2023]_. φ are the covariates and their products.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.learning.behaviour import mean_and_scale
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring.betting import LOSSES, STAKE
from halfseen.monitoring.diagnosis import ChangePoint, change_point
from halfseen.shapes import Bool, Float, Int

RIDGE, NEWTON_STEPS = 5.0, 6
FEWEST_PAIRS, MORE = 20, 1.3
LARGEST = 5.0
"""Absolute value at which standardised covariates are clipped."""


@dataclass(frozen=True, eq=False)
class FirstStates:
    """First states of the training log and of the service, and the pairs that the classifier bets on.

    Parameters
    ----------
    features
        φ of the states of the training log, then of those of the service whose categories are known.
    is_known
        Whether a trajectory of the service has such a state.
    pairs
        Rows of `features` of the new state and of the older one.
    """

    features: Float[np.ndarray, "m P"]
    is_known: Bool[np.ndarray, " n"]
    pairs: Int[np.ndarray, "k 2"]

    @property
    def num_reference(self) -> int:
        """Number of states of the training log."""
        return len(self.features) - int(self.is_known.sum())

    @property
    def apart(self) -> Float[np.ndarray, "k P"]:
        """φ(new) − φ(old) of each pair."""
        return self.features[self.pairs[:, 0]] - self.features[self.pairs[:, 1]]

    @property
    def payoffs(self) -> Float[np.ndarray, "n 1 S"]:
        """Payoffs of each trajectory; 1 if its state is put aside or unknown."""
        bets = np.zeros(len(self.is_known))
        bets[np.flatnonzero(self.is_known)[self.pairs[:, 0] - self.num_reference]] = _bets(self.apart)
        return 1.0 + STAKE * bets[:, None, None] * LOSSES

    def changed_at(self, alarm: int) -> ChangePoint:
        """Trajectory, up to that of the alarm, from which states look newer to the classifier of all pairs."""
        newness, num = self.features @ _learned(self.apart), self.num_reference
        values = np.full(len(self.is_known), np.nan)
        values[self.is_known] = newness[num:]
        return change_point(values, float(newness[:num].mean()) if num else 0.0, num, alarm)


def first_states(looks_at: Covariates, logs: Logs, reference: Float[np.ndarray, "k d"], seed: int) -> FirstStates:
    """Pair the first states of a log, each with an older one.

    Parameters
    ----------
    looks_at
        Covariates of the policy.
    logs
        The log of its service.
    reference
        Encoded first states of the training log.
    seed
        Seed of the coins.
    """
    rows: Any = logs.stages[logs.stages["stage"] == 1]
    is_known = np.asarray(looks_at.knows(rows))
    coins = np.random.default_rng([seed, 1]).random(len(rows))
    states = looks_at.encode(rows[is_known])
    features = _features(np.concatenate([reference, states]), reference if len(reference) > 1 else states)
    return FirstStates(features, is_known, _pairs(len(reference), coins[is_known]))


def _pairs(num_reference: int, coins: Float[np.ndarray, " n"]) -> Int[np.ndarray, "k 2"]:
    aside, used, pairs = list(range(num_reference)), 0, []
    for new, coin in enumerate(coins, start=num_reference):
        if coin < 0.5 or used == len(aside):
            aside.append(new)
        else:
            pairs.append((new, aside[used]))
            used += 1
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _features(states: np.ndarray, scale_of: np.ndarray) -> Float[np.ndarray, "m P"]:
    mean, spread = mean_and_scale(scale_of)
    scaled = np.clip((states - mean) / spread, -LARGEST, LARGEST)
    one, other = np.triu_indices(states.shape[1])
    return np.concatenate([scaled, scaled[:, one] * scaled[:, other]], axis=1)


def _bets(apart: Float[np.ndarray, "m P"]) -> Float[np.ndarray, " m"]:
    """2 σ − 1 of each pair, with θ learned from earlier pairs."""
    bets, begun, end = np.zeros(len(apart)), 0, FEWEST_PAIRS
    while begun < len(apart):
        if begun >= FEWEST_PAIRS:
            bets[begun:end] = np.tanh(0.5 * apart[begun:end] @ _learned(apart[:begun]))
        begun, end = end, max(int(MORE * end), end + 1)
    return bets


def _learned(apart: Float[np.ndarray, "m P"]) -> Float[np.ndarray, " P"]:
    theta = np.zeros(apart.shape[1])
    for _ in range(NEWTON_STEPS):
        chance = 0.5 * (1.0 - np.tanh(0.5 * apart @ theta))
        slope = apart.T @ chance - RIDGE * theta
        curve = (apart * (chance * (1.0 - chance))[:, None]).T @ apart + RIDGE * np.eye(len(theta))
        theta = theta + np.linalg.solve(curve, slope)
    return theta
