"""Logs whose policies have values that are known: what `verdicts` asks about.

cell        `examples/pick_cell`: hazards of a cut grow with clutter and while a stage drags on
trial       `examples/clinical_trial`: survival times are rewards, cuts come at a constant rate
haze        a Q that is not linear, and cuts by a cause of which the log holds a proxy only. Haze clouds the camera; the
            log has the temperature z, and haze is z and chance. Given z cuts depend on nothing that rewards depend on,
            but their hazards are neither proportional nor log-linear. Values are means over many paths.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from halfseen.logs import Logs

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
sys.path += [str(EXAMPLES / "pick_cell"), str(EXAMPLES / "clinical_trial")]

import cell_optimum  # noqa: E402
import cell_parts  # noqa: E402
import cell_paths  # noqa: E402
import trial_optimum  # noqa: E402
import trial_patients  # noqa: E402

Chances = Callable[[pd.DataFrame, int], np.ndarray]
"""(covariates, stage from 1) → chance of each action, for each row."""


@dataclass(frozen=True)
class Drawn:
    """A policy of named actions that draws them with these chances."""

    chances: Chances
    actions: tuple[str, ...]
    horizon: int
    covariates: tuple[str, ...]
    actions_by_stage: dict[int, list[Any]]

    def probabilities(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return self.chances(frame, stage)


class World(Protocol):
    """Where logs come from, and what policies are worth there."""

    actions: tuple[str, ...]
    actions_by_stage: dict[int, list[Any]]
    covariates: tuple[str, ...]
    half: str
    """A covariate, uniform at first, whose halves a policy may tell apart."""

    def log(self, num_paths: int, seed: int, share: float) -> Logs: ...

    def value(self, chances: Chances) -> float: ...

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray: ...

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray: ...

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray: ...


def policies_of(world: World) -> dict[str, Drawn]:
    """Policies to be judged: better ones, and three that are exactly as good as the logging policy.

    best        the optimum
    plain       a rule of thumb
    null, near  the logging policy, but nearer to the best one in one half of the states and farther in the other
    null, far   the best action or the worst, by lot
    null, split the best action in one half of the states, in the other the best or the worst by lot
    """
    own = world.value(world.logging)
    middle = middle_of(world)

    def near(share: float) -> Chances:
        def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
            is_low = (frame[world.half].to_numpy() < middle)[:, None]
            mixed = (1 - share) * world.logging(frame, stage) + share * _worst(world, frame, stage)
            return np.where(is_low, 0.8 * world.logging(frame, stage) + 0.2 * world.best(frame, stage), mixed)

        return chances

    def far(share: float) -> Chances:
        return lambda frame, stage: (1 - share) * world.best(frame, stage) + share * _worst(world, frame, stage)

    def split(share: float) -> Chances:
        def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
            is_low = (frame[world.half].to_numpy() < middle)[:, None]
            return np.where(is_low, world.best(frame, stage), far(share)(frame, stage))

        return chances

    def null(family: Callable[[float], Chances]) -> Chances:
        root: Any = brentq(lambda share: world.value(family(share)) - own, 0.0, 1.0, xtol=1e-3)
        return family(root)

    named = {
        "best": world.best,
        "plain": world.plain,
        "null, near": null(near),
        "null, far": null(far),
        "null, split": null(split),
    }
    rest = (world.actions, len(world.actions_by_stage), world.covariates, world.actions_by_stage)
    return {name: Drawn(chances, *rest) for name, chances in named.items()}


def middle_of(world: World) -> float:
    return 1.55 if world.half == "weight_kg" else 0.5


def _uniform(world: World) -> Chances:
    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        is_possible = np.isin(np.array(world.actions, dtype=object), world.actions_by_stage[stage])
        return np.tile(is_possible / is_possible.sum(), (len(frame), 1))

    return chances


def _worst(world: World, frame: pd.DataFrame, stage: int) -> np.ndarray:
    """The possible action after the best one, in their order: seldom a good one."""
    possible = np.flatnonzero(np.isin(np.array(world.actions, dtype=object), world.actions_by_stage[stage]))
    best = world.best(frame, stage).argmax(axis=1)
    place = np.searchsorted(possible, best)
    return np.eye(len(world.actions))[possible[(place + 1) % len(possible)]]


class Cell:
    actions = cell_parts.ACTIONS_ALL
    actions_by_stage = cell_parts.ACTIONS
    covariates = tuple(cell_parts.COVARIATES)
    half = "weight_kg"
    logging = staticmethod(cell_paths.logging_chances)
    value = staticmethod(cell_optimum.chances_value)

    def log(self, num_paths: int, seed: int, share: float) -> Logs:
        return cell_paths.simulate(num_paths, seed, share > 0, self.rate(share))

    @staticmethod
    @cache
    def rate(share: float) -> float:
        if share == 0:
            return 1.0
        root: Any = brentq(lambda r: cell_paths.simulate(5000, 0, rate=np.exp(r)).cut_share - share, -9, -2, xtol=1e-2)
        return float(np.exp(root))

    @cached_property
    def _best(self) -> list[np.ndarray]:
        return [q.argmax(axis=-1) for q in cell_optimum.optimum()[1]]

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        axes = zip(cell_optimum.AXES, self.covariates, strict=True)
        at = [np.rint((frame[n].to_numpy() - a[0]) / (a[1] - a[0])).astype(int) for a, n in axes]
        return np.eye(len(self.actions))[self._best[stage - 1][tuple(at)]]

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return np.eye(len(self.actions))[cell_paths.rule_of_thumb(frame, stage)]


class Trial:
    actions = trial_patients.TREATMENTS
    actions_by_stage = trial_patients.ACTIONS
    covariates = tuple(trial_patients.COVARIATES)
    half = "wellness"
    value = staticmethod(trial_optimum.chances_value)

    def log(self, num_paths: int, seed: int, share: float) -> Logs:
        return trial_patients.trial(num_paths, share, seed)

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return _uniform(self)(frame, stage)

    @cached_property
    def _best(self) -> list[np.ndarray]:
        return [q.argmax(axis=-1) for q in trial_optimum.optimum()[1]]

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        at = [np.rint(frame[n].to_numpy() * (len(trial_optimum.GRID) - 1)).astype(int) for n in self.covariates]
        return np.eye(len(self.actions))[self._best[stage - 1][tuple(at)]]

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Aggressive where the tumour is large and the patient well."""
        is_a = (frame["tumour"] + frame["wellness"] > 1.0).to_numpy()
        return np.eye(len(self.actions))[np.where(is_a, 0, 1)]


class Haze:
    """Three stages; x is where a part lies, z the temperature; one of three tools picks it."""

    actions = ("A", "B", "C")
    actions_by_stage = {stage: ["A", "B", "C"] for stage in (1, 2, 3)}  # noqa: RUF012 - read only
    covariates = ("x", "y", "z")
    half = "x"
    num_for_truth = 200_000

    def log(self, num_paths: int, seed: int, share: float) -> Logs:
        rng = np.random.default_rng([seed, 7])
        haze_noise = np.random.default_rng([seed, 8]).normal(size=num_paths)
        played, total = self._play(num_paths, self.logging, rng)
        z = played[0]["z"]
        haze = 2.0 * (z - 0.5) + 0.7 * haze_noise
        cut_s = np.full(num_paths, np.inf)
        if share > 0:
            hazard = np.exp(self._level(share)) * (0.3 + np.maximum(haze, 0.0) ** 2)
            cut_s = np.random.default_rng([seed, 9]).exponential(size=num_paths) / hazard
        return self._recorded(played, total, cut_s)

    def value(self, chances: Chances) -> float:
        played, _ = self._play(self.num_for_truth, chances, np.random.default_rng(123))
        return float(sum(frame["reward"].sum() for frame in played) / self.num_for_truth)

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return 0.5 * self.plain(frame, stage) + 0.5 / 3.0

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        x = frame["x"].to_numpy()
        return np.eye(3)[np.select([x < 0.35, x < 0.7], [0, 1], 2)]

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """A good one: greedy, for what a stage brings hardly changes the next one."""
        each = np.stack([self._mean(frame, action)[0] for action in range(3)], axis=1)
        return np.eye(3)[each.argmax(axis=1)]

    def _mean(self, frame: pd.DataFrame, action: Any) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the reward but for the part that grows with the duration, and mean duration [s]."""
        x, y, z = (frame[name].to_numpy() for name in self.covariates)
        pays = np.choose(
            action,
            [1.2 * np.sin(3.0 * x) * (1.0 - y), np.exp(-8.0 * (x - 0.5) ** 2) + 0.5 * (y > 0.5), 1.5 * x * y + 0.3 * z],
        )
        lasts = np.choose(action, [2.0 + 3.0 * y, 3.0 + 2.0 * x * z, 2.5 + 1.5 * z])
        return pays + 0.08 * lasts, lasts

    def _play(self, num: int, chances: Chances, rng: np.random.Generator) -> tuple[list[pd.DataFrame], np.ndarray]:
        frame = pd.DataFrame(rng.random((num, 3)), columns=pd.Index(self.covariates)).assign(path=np.arange(num))
        clock, played = np.zeros(num), []
        for stage in (1, 2, 3):
            chance = chances(frame, stage)
            level, gamma, noise, leaves, move = rng.random((num, 1)), *rng.random((4, num))
            keep = frame["path"].to_numpy()
            action = np.minimum((level[keep] > chance.cumsum(axis=1)).sum(axis=1), 2)
            pays, lasts = self._mean(frame, action)
            duration = lasts * (0.3 + 1.4 * gamma[keep] ** 1.0)
            reward = pays + 0.08 * (duration - lasts) * (1 + frame["y"].to_numpy()) + 0.3 * (2 * noise[keep] - 1)
            goes = leaves[keep] > 0.15 + 0.3 * frame["y"].to_numpy() * (action == 1)
            begun = clock[keep].copy()
            clock[keep] = begun + duration
            played.append(
                frame.assign(
                    stage=stage,
                    action=action,
                    reward=reward,
                    begun=begun,
                    elapsed_s=clock[keep],
                    probability=chance[np.arange(len(keep)), action],
                )
            )
            moved = np.clip(frame["x"] + 0.3 * (move[keep] - 0.5), 0, 1)
            frame = frame.assign(x=moved, y=np.clip(frame["y"] + 0.1, 0, 1))[goes]
        return played, clock

    @cache  # noqa: B019 - one world a process
    def _level(self, share: float) -> float:
        def excess(level: float) -> float:
            rng = np.random.default_rng(5)
            played, total = self._play(20_000, self.logging, rng)
            haze = 2.0 * (played[0]["z"].to_numpy() - 0.5) + 0.7 * rng.normal(size=20_000)
            return float(1.0 - np.exp(-np.exp(level) * (0.3 + np.maximum(haze, 0) ** 2) * total).mean()) - share

        root: Any = brentq(excess, -9.0, 2.0, xtol=1e-3)
        return float(root)

    def _recorded(self, played: list[pd.DataFrame], total: np.ndarray, cut_s: np.ndarray) -> Logs:
        stages = pd.concat(played, ignore_index=True)
        cut_of_row = np.asarray(cut_s)[stages["path"]]
        stages = stages.assign(
            elapsed_s=stages["elapsed_s"].where(stages["elapsed_s"] <= cut_of_row),
            reward=stages["reward"].where(stages["elapsed_s"] <= cut_of_row),
            action=np.array(self.actions, dtype=object)[stages["action"]],
        )
        is_cut = total > cut_s
        paths = pd.DataFrame(
            {
                "path": np.arange(len(total)),
                "end_s": np.minimum(total, cut_s),
                "ending": np.where(is_cut, "cut", "finished"),
                "cause": np.where(is_cut, "haze", None),
            }
        )
        return Logs(stages[stages["begun"] <= cut_of_row].drop(columns="begun"), paths)


WORLDS: dict[str, World] = {"cell": Cell(), "trial": Trial(), "haze": Haze()}
