"""A cell that picks one part a trajectory out of a bin: four actions, five stages, a rule far from good.

The rule grasps, whatever it sees, until the gripper has jammed twice. The state is small: clutter above the part, views
of it, jams. So values are exact, by backward induction. Exploration is uniform in a quarter of the decisions; an action
that is not the rule's has a chance of 1/16, and a trajectory of the optimum deviates two or three times: ratios reach
16³. All numbers are made up. What was recorded of it lies in ``logs`` and ``later_logs``; policies of it are worth:

python examples/bin_cell/bin_cell.py
"""

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from halfseen.logs import Logs

HORIZON = 5
LOOK, GRASP, SHAKE, CLEAR = range(4)
LEVELS = (3, 2, 3)
"""Of clutter, views and jams."""
STATES = np.stack([axis.ravel() for axis in np.meshgrid(*map(np.arange, LEVELS), indexing="ij")], axis=1)
BEGIN = np.array([0.5, 0.3, 0.2])
"""Chance of each clutter at first; nothing has been seen, nothing jams."""
EXPLORATION = 0.25
PRICE = np.array([0.07, 0.05, 0.08, 0.05])
"""Of each action."""
STUCK = -0.3
"""What a trajectory brings whose gripper has to be freed by hand."""
FALLS = 0.8
"""Chance that a shake takes a layer of clutter away; it hides the part again."""
SEES = 0.9
FREES = 0.9
FREED_BY_HAND = 0.5
"""Chance that a failed grasp of a jammed gripper ends the trajectory."""
SECONDS = np.array([2.0, 6.0, 4.0, 5.0])
CAUSES = ("operator", "camera", "shift")
CUT_SHARE = 1 / 3
NUM_PILOT = 20_000
Chances = Callable[[pd.DataFrame, int], np.ndarray]
"""(covariates, stage from 1) → chance of each action, for each row."""
Outcome = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Chance, reward, whether the trajectory ends, and the next state."""


def reach(state: np.ndarray) -> np.ndarray:
    """Chance that a grasp fetches the part."""
    clutter, views, jams = state.T
    return np.clip(0.3 + 0.3 * views - 0.12 * clutter - 0.2 * jams, 0.02, 0.95)


def outcomes(state: np.ndarray, action: int) -> list[Outcome]:
    """Tell all that an action may bring."""
    clutter, views, jams = state.T
    goes_on, none = np.zeros(len(state), dtype=bool), np.full(len(state), -PRICE[action])

    def moved(chance: Any, *after: Any) -> Outcome:
        return np.broadcast_to(chance, len(state)), none, goes_on, np.stack(after, axis=1)

    if action == GRASP:
        fetched, worse = reach(state), np.minimum(jams + 1, LEVELS[2] - 1)
        stuck = (1.0 - fetched) * np.where(jams == LEVELS[2] - 1, FREED_BY_HAND, 0.0)
        jammed = moved(1.0 - fetched - stuck, clutter, views, worse)
        return [(fetched, none + 1.0, ~goes_on, state), (stuck, none + STUCK, ~goes_on, state), jammed]
    if action == SHAKE:
        fewer = np.maximum(clutter - 1, 0)
        return [moved(FALLS, fewer, 0 * views, jams), moved(1.0 - FALLS, clutter, 0 * views, jams)]
    if action == LOOK:
        return [moved(SEES, clutter, np.minimum(views + 1, LEVELS[1] - 1), jams), moved(1.0 - SEES, *state.T)]
    return [moved(FREES, clutter, views, 0 * jams), moved(1.0 - FREES, *state.T)]


def _frame(state: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame(state.astype(np.float64), columns=pd.Index(Bin.covariates))


class Bin:
    """Draws logs of the cell, and values policies of it."""

    actions = ("look", "grasp", "shake", "clear")
    actions_by_stage: ClassVar[dict[int, list[str]]] = {
        stage: ["look", "grasp", "shake", "clear"] for stage in range(1, HORIZON + 1)
    }
    covariates = ("clutter", "views", "jams")
    half = ("clutter", 0.5)

    @cached_property
    def optimum(self) -> float:
        """Value of the best policy."""
        return self.value(self.best)

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Grasp; clear the gripper once it has jammed twice."""
        return np.eye(4)[np.where(frame["jams"] > 1, CLEAR, GRASP)]

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Do as the rule, or in a quarter of the decisions as chance has it."""
        return (1.0 - EXPLORATION) * self.plain(frame, stage) + EXPLORATION / 4.0

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Do what is worth most."""
        state = frame[list(self.covariates)].to_numpy().astype(int)
        return np.eye(4)[self._best[stage - 1][_index(state)].argmax(axis=1)]

    def value(self, chances: Chances) -> float:
        """Work out the expected reward of a trajectory, backwards."""
        later = np.zeros(len(STATES))
        for stage in range(HORIZON, 0, -1):
            later = np.sum(chances(_frame(STATES), stage) * _q(later), axis=1)
        return float(BEGIN @ later[_index(np.stack([np.arange(3), np.zeros(3), np.zeros(3)], axis=1).astype(int))])

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        """Draw a log of which about a share is cut."""
        stages, exposure = self._played(num_trajectories, np.random.default_rng([seed, 0]))
        rng = np.random.default_rng([seed, 1])
        limit = (
            rng.exponential(size=num_trajectories) / self._rate(share) if share else np.full(num_trajectories, np.inf)
        )
        return _recorded(stages, exposure, limit, rng)

    @cached_property
    def _best(self) -> list[np.ndarray]:
        """Q of the optimum by stage."""
        each, later = [], np.zeros(len(STATES))
        for _ in range(HORIZON):
            each.append(_q(later))
            later = each[-1].max(axis=1)
        return each[::-1]

    def _played(self, num_trajectories: int, rng: np.random.Generator) -> tuple[pd.DataFrame, np.ndarray]:
        """Draw all stages as if nothing were cut, and each trajectory's relative exposure to cuts by its end."""
        trajectory = np.arange(num_trajectories)
        state = np.stack([rng.choice(3, size=num_trajectories, p=BEGIN), 0 * trajectory, 0 * trajectory], axis=1)
        exposure, total_s, parts = np.zeros(num_trajectories), np.zeros(num_trajectories), []
        for stage in range(1, HORIZON + 1):
            chance = self.logging(_frame(state), stage)
            action = np.minimum((rng.random((len(trajectory), 1)) > chance.cumsum(axis=1)).sum(axis=1), 3)
            reward, is_last, after = _step(state, action, rng)
            took_s = SECONDS[action] * (1.0 + 0.5 * state[:, 2]) * rng.gamma(6.0, 1.0 / 6.0, size=len(trajectory))
            hazards = _hazards(state)
            begun_s, before = total_s[trajectory], exposure[trajectory]
            total_s[trajectory], exposure[trajectory] = begun_s + took_s, before + hazards.sum(axis=1) * took_s
            columns = {
                "trajectory": trajectory,
                "stage": stage,
                "begun_s": begun_s,
                "elapsed_s": total_s[trajectory],
                "before": before,
                "after": exposure[trajectory],
                "action": np.array(self.actions, dtype=object)[action],
                "reward": reward,
                "probability": chance[np.arange(len(trajectory)), action],
                **dict(zip(self.covariates, state.T.astype(np.float64), strict=True)),
                **dict(zip(CAUSES, hazards.T, strict=True)),
            }
            parts.append(pd.DataFrame(columns))
            trajectory, state = trajectory[~is_last], after[~is_last]
        return pd.concat(parts, ignore_index=True), exposure

    @cache  # noqa: B019 - one world a process
    def _rate(self, share: float) -> float:
        _, exposure = self._played(NUM_PILOT, np.random.default_rng(5))
        root: Any = brentq(lambda r: float(-np.expm1(-np.exp(r) * exposure).mean()) - share, -20.0, 10.0)
        return float(np.exp(root))


def _index(state: np.ndarray) -> np.ndarray:
    return np.ravel_multi_index(tuple(state.T), LEVELS)


def _q(later: np.ndarray) -> np.ndarray:
    """Q of each state and action, given what states are worth one stage later."""

    def of(action: int) -> np.ndarray:
        found = outcomes(STATES, action)
        return sum(chance * (reward + np.where(ends, 0.0, later[_index(to)])) for chance, reward, ends, to in found)

    return np.stack([of(action) for action in range(4)], axis=1)


def _step(state: np.ndarray, action: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw reward, whether the trajectory ends, and the next state."""
    reward, is_last, after = np.zeros(len(state)), np.zeros(len(state), dtype=bool), state.copy()
    luck = rng.random(len(state))
    for each in range(4):
        rows = np.flatnonzero(action == each)
        found = outcomes(state[rows], each)
        drawn = (luck[rows][:, None] > np.cumsum([chance for chance, *_ in found], axis=0).T).sum(axis=1)
        drawn, k = np.minimum(drawn, len(found) - 1), np.arange(len(rows))
        for leaf, place in ((reward, 1), (is_last, 2), (after, 3)):
            leaf[rows] = np.stack([one[place] for one in found])[drawn, k]
    return reward, is_last, after


def _hazards(state: np.ndarray) -> np.ndarray:
    """Relative rates of the causes of cuts: who watches stops a jammed gripper, cameras lose what is not seen."""
    clutter, views, jams = state.T
    return np.stack([0.2 + 0.9 * jams, 0.1 * clutter + 0.3 * (1 - views), np.full(len(state), 0.5)], axis=1)


def _recorded(stages: pd.DataFrame, exposure: np.ndarray, limit: np.ndarray, rng: np.random.Generator) -> Logs:
    """Cut each trajectory once its exposure reaches its limit."""
    trajectory = stages["trajectory"].to_numpy()
    kept = stages[stages["before"].to_numpy() <= limit[trajectory]].reset_index(drop=True)
    own = limit[kept["trajectory"].to_numpy()]
    is_seen = kept["after"].to_numpy() <= own
    way = (own - kept["before"]) / (kept["after"] - kept["before"])
    cut_s = kept["begun_s"] + np.where(is_seen, 1.0, way) * (kept["elapsed_s"] - kept["begun_s"])
    last = kept.groupby("trajectory").tail(1).sort_values("trajectory")
    end_s = cut_s[last.index].to_numpy()
    is_cut = exposure > limit
    rates = last[list(CAUSES)].to_numpy()
    drawn = (rng.random((len(last), 1)) > np.cumsum(rates, axis=1) / rates.sum(axis=1, keepdims=True)).sum(axis=1)
    cause = np.where(is_cut, np.array(CAUSES, dtype=object)[np.minimum(drawn, 2)], None)
    trajectories = pd.DataFrame(
        {"trajectory": last["trajectory"].to_numpy(), "end_s": end_s, "ending": "finished", "cause": cause}
    )
    trajectories.loc[is_cut, "ending"] = "cut"
    kept.loc[~is_seen, ["elapsed_s", "reward"]] = np.nan
    columns = ["trajectory", "stage", "elapsed_s", "action", "reward", "probability", *Bin.covariates]
    return Logs(kept[columns], trajectories, reward_unit="net parts")


def main() -> None:
    """Tell what policies are worth."""
    cell = Bin()
    policies = {"the cell as it runs": cell.logging, "its rule": cell.plain, "the optimum": cell.best}
    for name, chances in policies.items():
        print(f"{name:<22}{cell.value(chances):6.3f} net parts a trajectory")


if __name__ == "__main__":
    main()
