"""Sixteen hidden diseases, sixteen treatments, eight symptoms, at most eight visits; of the project's own numbers.

A treatment cures with a probability of its disease, which ends a trajectory and earns 64; it costs something, and moves
the symptoms. Symptoms that go too far cost 8. Care knows roughly what cures which disease, guesses the disease by
today's symptoms, and repeats neither of the last two treatments.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.logs import Logs

NUM_DISEASES = NUM_TREATMENTS = 16
NUM_SYMPTOMS = HORIZON = 8
TREATMENTS = tuple(f"t{number}" for number in range(NUM_TREATMENTS))
SYMPTOMS = tuple(f"x{number}" for number in range(NUM_SYMPTOMS))
CUT_RATE = 0.05
"""Of a trajectory, a visit."""

Chances = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Probability of each treatment, by symptoms and the last two treatments (−1 for none)."""


class Visit(NamedTuple):
    is_there: np.ndarray
    symptoms: np.ndarray
    treatment: np.ndarray
    chance: np.ndarray
    reward: np.ndarray
    is_cured: np.ndarray


class Clinic:
    """The world of a seed, and who logs: care, or one who takes what care holds for worst, but for a share of tries.

    A try takes any treatment. What care knows of a probability of cure has a standard error.
    """

    def __init__(self, seed: int = 0, tried_share: float = 0.5, is_worst: bool = False, error: float = 0.08) -> None:
        rng, self.tried_share, self.is_worst = np.random.default_rng(seed), tried_share, is_worst
        self.typical = rng.normal(0.0, 1.0, (NUM_DISEASES, NUM_SYMPTOMS))
        self.cures = np.full((NUM_DISEASES, NUM_TREATMENTS), 0.01)
        for disease in self.cures:
            disease[rng.permutation(NUM_TREATMENTS)[:4]] = [0.5, 0.3, 0.15, 0.1]
        self.moves = rng.normal(0.0, 0.12, (NUM_TREATMENTS, NUM_SYMPTOMS))
        self.cost = rng.uniform(1.0, 5.0, NUM_TREATMENTS)
        self.known = np.clip(self.cures + rng.normal(0.0, error, self.cures.shape), 0.0, 1.0)

    def _worth(self, symptoms: np.ndarray) -> np.ndarray:
        log_odds = -0.25 * ((symptoms[:, None] - self.typical) ** 2).sum(axis=-1)
        odds = np.exp(log_odds - log_odds.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True) @ self.known - self.cost / 64.0

    def care(self, symptoms: np.ndarray, last: np.ndarray) -> np.ndarray:
        worth = self._worth(symptoms)
        for each in last.T:
            worth[np.flatnonzero(each >= 0), each[each >= 0]] = -np.inf
        return np.eye(NUM_TREATMENTS)[worth.argmax(axis=1)]

    def logging(self, symptoms: np.ndarray, last: np.ndarray) -> np.ndarray:
        worst = np.eye(NUM_TREATMENTS)[self._worth(symptoms).argmin(axis=1)]
        preferred = worst if self.is_worst else self.care(symptoms, last)
        return (1.0 - self.tried_share) * preferred + self.tried_share / NUM_TREATMENTS

    def visits(self, chances: Chances, num_trajectories: int, seed: int) -> list[Visit]:
        rng, rows = np.random.default_rng([seed, 0]), np.arange(num_trajectories)
        disease = rng.integers(0, NUM_DISEASES, num_trajectories)
        symptoms = self.typical[disease] + rng.normal(0.0, 1.0, (num_trajectories, NUM_SYMPTOMS))
        is_there, last, visits = np.ones(num_trajectories, dtype=bool), np.full((num_trajectories, 2), -1), []
        for _ in range(HORIZON):
            each = chances(symptoms, last)
            reached = np.cumsum(each, axis=1)
            treatment = np.minimum((rng.random((num_trajectories, 1)) > reached).sum(axis=1), NUM_TREATMENTS - 1)
            is_cured = rng.random(num_trajectories) < self.cures[disease, treatment]
            after = 0.5 * (symptoms + self.typical[disease]) + self.moves[treatment]
            after += rng.normal(0.0, 0.7, after.shape)
            is_bad = np.abs(after).max(axis=1) > 3.2
            reward = np.where(is_cured, 64.0, -8.0 * is_bad) - self.cost[treatment]
            visits.append(Visit(is_there, symptoms, treatment, each[rows, treatment], reward, is_cured))
            is_there, symptoms, last = is_there & ~is_cured, after, np.column_stack([treatment, last[:, 0]])
        return visits

    def value(self, chances: Chances, num_trajectories: int = 10_000, seed: int = 10**6) -> float:
        visits = self.visits(chances, num_trajectories, seed)
        return float(sum((visit.is_there * visit.reward).sum() for visit in visits) / num_trajectories)

    def log(self, num_trajectories: int, seed: int) -> Logs:
        visits = self.visits(self.logging, num_trajectories, seed)
        cut_at = np.random.default_rng([seed, 1]).exponential(1.0 / CUT_RATE, num_trajectories)
        stages, trajectories = [], []
        for row in range(num_trajectories):
            for stage, visit in enumerate(visits, start=1):
                is_cut = bool(cut_at[row] < stage)
                known = (None, None) if is_cut else (float(stage), float(visit.reward[row]))
                action = TREATMENTS[visit.treatment[row]]
                stages.append([row, stage, *known, action, visit.chance[row], *visit.symptoms[row]])
                if is_cut or visit.is_cured[row] or stage == HORIZON:
                    end = (float(cut_at[row]), "cut") if is_cut else (float(stage), "finished")
                    trajectories.append([row, *end])
                    break
        columns = ["trajectory", "stage", "elapsed_s", "reward", "action", "probability", *SYMPTOMS]
        return Logs(
            stages=pd.DataFrame(stages, columns=columns),
            trajectories=pd.DataFrame(trajectories, columns=["trajectory", "end_s", "ending"]),
        )
