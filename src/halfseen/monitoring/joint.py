"""Whether states taken together have changed, by a classifier that bets on which of two is the newer one.

Each new state is put aside, or, by a coin, paired with the oldest that is aside: a state of the policy's log at first.
While nothing has changed the two are exchangeable, so 2 σ(θ · (φ(new) − φ(old))) has the mean 1 for any θ known before;
θ is learned from the pairs before by logistic regression [PodkopaevRamdas2023]_. φ are covariates and their products.
"""

import numpy as np

from halfseen.monitoring.betting import LOSSES, STAKE
from halfseen.shapes import Float

RIDGE, NEWTON_STEPS = 5.0, 6
FEWEST_PAIRS, MORE = 20, 1.3
LARGEST = 5.0
"""Of standardised covariates."""


def pair_payoffs(
    states: Float[np.ndarray, "n d"], reference: Float[np.ndarray, "k d"], coins: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 1 S"]:
    """Payoffs after each new state; 1 for one that is put aside.

    Parameters
    ----------
    states
        New states in their order.
    reference
        States of the log.
    coins
        Uniform on [0, 1).
    """
    features = _features(np.concatenate([reference, states]), reference if len(reference) > 1 else states)
    pairs = _pairs(len(states), len(reference), coins)
    news = np.array([len(reference) + i for i, _ in pairs], dtype=int)
    apart = features[news] - features[np.array([old for _, old in pairs], dtype=int)]
    bets = np.zeros(len(states))
    bets[[i for i, _ in pairs]] = _bets(apart)
    return 1.0 + STAKE * bets[:, None, None] * LOSSES


def _pairs(num: int, num_reference: int, coins: Float[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Which new state is paired with which older one, as rows of reference and new states together."""
    aside, used, pairs = list(range(num_reference)), 0, []
    for i in range(num):
        if coins[i] < 0.5 or used == len(aside):
            aside.append(num_reference + i)
        else:
            pairs.append((i, aside[used]))
            used += 1
    return pairs


def _features(states: np.ndarray, scale_of: np.ndarray) -> Float[np.ndarray, "m P"]:
    spread = scale_of.std(axis=0)
    scaled = np.clip((states - scale_of.mean(axis=0)) / np.where(spread > 0, spread, 1.0), -LARGEST, LARGEST)
    one, other = np.triu_indices(states.shape[1])
    return np.concatenate([scaled, scaled[:, one] * scaled[:, other]], axis=1)


def _bets(apart: Float[np.ndarray, "m P"]) -> Float[np.ndarray, " m"]:
    """2 σ − 1 of each pair, by what was learned from those before."""
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
