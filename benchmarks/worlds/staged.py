"""A world of three stages in [0, 1]^F, of which the first three covariates matter and only the first one moves.

Its optimum comes from a grid, backwards; the value of a policy is a mean over many trajectories that all policies
share, each of which goes on as a whole with the probability that it would go on at all.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq
from scipy.stats import norm
from worlds.world import Chances

from halfseen.logs import Logs

HORIZON = 3
NUM_FOR_TRUTH = 20_000
NUM_PILOT = 20_000
AXES = (np.linspace(0.0, 1.0, 41),) * 3
NODES = norm.ppf((np.arange(15) + 0.5) / 15)
MOVED_NOISE = 0.1
REWARD_NOISE = 0.3
RULE_SHARE = 0.5
"""Share of the logged stages in which the plain rule was followed; in the others any action was tried."""


@dataclass(frozen=True)
class Drawn:
    """One stage of the trajectories that reached it."""

    trajectory: np.ndarray
    x: np.ndarray
    action: np.ndarray
    chance: np.ndarray
    reward: np.ndarray
    duration: np.ndarray


class Staged:
    actions = ("A", "B", "C")
    actions_by_stage: ClassVar[dict[int, list[str]]] = {stage: ["A", "B", "C"] for stage in range(1, HORIZON + 1)}
    covariates: tuple[str, ...]
    half: tuple[str, float]
    step: np.ndarray
    """What each action adds to the first covariate."""

    def pays(self, x: np.ndarray, action: Any) -> np.ndarray:
        """Mean reward of a stage."""
        raise NotImplementedError

    def ends(self, x: np.ndarray, action: Any) -> np.ndarray:
        """Probability that a trajectory ends with a stage."""
        raise NotImplementedError

    def lasts(self, x: np.ndarray, action: Any) -> np.ndarray:
        """Mean duration of a stage [s]."""
        raise NotImplementedError

    def hazard(self, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Relative rate of cuts of a trajectory that begins in `x`."""
        raise NotImplementedError

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        raise NotImplementedError

    late_pay = 0.0
    """What a stage brings for each second beyond its mean duration [1/s]."""

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return RULE_SHARE * self.plain(frame, stage) + (1.0 - RULE_SHARE) / len(self.actions)

    def moved(self, x: np.ndarray, action: Any, noise: np.ndarray) -> np.ndarray:
        after = x.copy()
        after[:, 0] = np.clip(x[:, 0] + self.step[action] + MOVED_NOISE * noise, 0.0, 1.0)
        return after

    def value(self, chances: Chances) -> float:
        rng = np.random.default_rng(123)
        x, share, total = rng.random((NUM_FOR_TRUTH, len(self.covariates))), np.ones(NUM_FOR_TRUTH), 0.0
        for stage in range(1, HORIZON + 1):
            action, _ = self._chosen(x, stage, chances, rng)
            total += float((share * self.pays(x, action)).mean())
            share = share * (1.0 - self.ends(x, action))
            x = self.moved(x, action, rng.normal(size=len(x)))
        return total

    @cached_property
    def optimum(self) -> float:
        return self.value(self.best)

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Decide by the optimum's Q."""
        q = self._q(frame[list(self.covariates)].to_numpy(), stage)
        return np.eye(len(self.actions))[q.argmax(axis=1)]

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        played = list(self._play(num_trajectories, np.random.default_rng([seed, 0])))
        hazard = self.hazard(played[0].x, np.random.default_rng([seed, 1]))
        exposure_s = np.random.default_rng([seed, 2]).exponential(size=num_trajectories) / hazard
        return self._recorded(played, exposure_s / self._rate(share) if share else np.full(num_trajectories, np.inf))

    def _chosen(self, x: np.ndarray, stage: int, chances: Chances, rng: np.random.Generator) -> tuple[Any, np.ndarray]:
        chance = chances(pd.DataFrame(x, columns=pd.Index(self.covariates)), stage)
        action = (rng.random((len(x), 1)) > chance.cumsum(axis=1)).sum(axis=1)
        action = np.minimum(action, len(self.actions) - 1)
        return action, chance[np.arange(len(x)), action]

    def _play(self, num_trajectories: int, rng: np.random.Generator) -> Iterator[Drawn]:
        trajectory, x = np.arange(num_trajectories), rng.random((num_trajectories, len(self.covariates)))
        for stage in range(1, HORIZON + 1):
            action, chance = self._chosen(x, stage, self.logging, rng)
            mean_s = self.lasts(x, action)
            duration = mean_s * rng.gamma(4.0, 0.25, size=len(x))
            reward = self.pays(x, action) + self.late_pay * (duration - mean_s) + REWARD_NOISE * rng.normal(size=len(x))
            yield Drawn(trajectory, x, action, chance, reward, duration)
            goes_on = rng.random(len(x)) >= self.ends(x, action)
            trajectory, x = trajectory[goes_on], self.moved(x, action, rng.normal(size=len(x)))[goes_on]

    def _recorded(self, played: list[Drawn], cut_s: np.ndarray) -> Logs:
        total_s, parts = np.zeros(len(cut_s)), []
        for stage, drawn in enumerate(played, start=1):
            begun_s = total_s[drawn.trajectory]
            total_s[drawn.trajectory] = end_s = begun_s + drawn.duration
            is_seen = end_s <= cut_s[drawn.trajectory]
            rows = {
                "trajectory": drawn.trajectory,
                "stage": stage,
                "elapsed_s": np.where(is_seen, end_s, np.nan),
                "action": np.array(self.actions, dtype=object)[drawn.action],
                "reward": np.where(is_seen, drawn.reward, np.nan),
                "probability": drawn.chance,
                **dict(zip(self.covariates, drawn.x.T, strict=True)),
            }
            parts.append(pd.DataFrame(rows)[begun_s <= cut_s[drawn.trajectory]])
        is_cut = total_s > cut_s
        trajectories = pd.DataFrame(
            {
                "trajectory": np.arange(len(cut_s)),
                "end_s": np.minimum(total_s, cut_s),
                "ending": np.where(is_cut, "cut", "finished"),
                "cause": np.where(is_cut, "stopped", None),
            }
        )
        return Logs(pd.concat(parts, ignore_index=True), trajectories)

    @cache  # noqa: B019 - one world a process
    def _rate(self, share: float) -> float:
        rng = np.random.default_rng(5)
        played = list(self._play(NUM_PILOT, rng))
        total_s = np.bincount(
            np.concatenate([d.trajectory for d in played]), np.concatenate([d.duration for d in played])
        )
        exposure = self.hazard(played[0].x, rng) * total_s
        root: Any = brentq(lambda r: float(-np.expm1(-np.exp(r) * exposure).mean()) - share, -20.0, 10.0)
        return float(np.exp(root))

    @cache  # noqa: B019 - one world a process
    def _later(self, stage: int) -> Any:
        """V of a stage, between grid points linear; None after the last stage."""
        if stage > HORIZON:
            return None
        points = np.stack([axis.ravel() for axis in np.meshgrid(*AXES, indexing="ij")], axis=1)
        value = self._q(points, stage).max(axis=1)
        return RegularGridInterpolator(AXES, value.reshape([len(axis) for axis in AXES]))

    def _q(self, x: np.ndarray, stage: int) -> np.ndarray:
        return np.stack([self._q_of(x, action, self._later(stage + 1)) for action in range(len(self.actions))], axis=1)

    def _q_of(self, x: np.ndarray, action: int, later: Any) -> np.ndarray:
        now = self.pays(x, action)
        if later is None:
            return now
        after = np.mean([later(self.moved(x, action, np.full(len(x), node))[:, :3]) for node in NODES], axis=0)
        return now + (1.0 - self.ends(x, action)) * after
