"""The value of simulations and of a longer planning horizon to a planner that knows the true model: Figures 2 and 3.

All policies meet the same evaluation episodes. A planner with many simulations plays few of them, in turn over the
repetitions, so that every table is met; it is compared on those that it played. Rewards are by the control variate of
`pipeline`, and reproducible from the seed: a planner has a number of simulations, not a time limit. Decision times are
measured and reported separately.
"""

from dataclasses import dataclass
from functools import partial
from timeit import repeat
from typing import ClassVar

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.study.compare import Frame, means
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.pipeline import CUT_KIND, Source, episodes_in_turn
from halfseen.study.policies import HEURISTICS, LEARNED, Entrant, by_name, horizon_planner, planner
from halfseen.study.setting import Setting
from halfseen.world.policy import Policy

NUM_TIMED_STATES, NUM_FITS = 30, 5
OVER = (f"over_{LEARNED.name}", "se_over", "over_low", "over_high")


@dataclass(frozen=True)
class Planning(Experiment):
    """Planners by simulations and by horizon.

    `simulations` maps the simulations per decision of planners that look to the end of a trajectory to the number of
    episodes that each plays in a repetition. Other planners look `horizons` steps ahead. The learned policy is learned
    from `num_trajectories`, of which `cut_share` are cut; with `laws`, laws fitted to the same log assist. The mean of
    V° over initial tables is estimated from `num_starts`.
    """

    simulations: tuple[tuple[int, int], ...] = ((8, 25), (128, 25), (1024, 3))
    horizons: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    horizon_simulations: int = 128
    horizon_episodes: int = 15
    num_trajectories: int = 800
    cut_share: float = 1 / 2
    episodes_per_scene: int = 5
    num_starts: int = 100_000
    laws: bool = True
    most_repetitions: int | None = 6
    name: ClassVar[str] = "planning"

    def __post_init__(self) -> None:
        if len(self.horizons) < 2 or list(self.horizons) != sorted(set(self.horizons)):
            raise ArgumentError(f"horizons is {self.horizons}; give at least two, each longer than the one before")

    @property
    def by_simulations(self) -> dict[str, int]:
        """Simulations of each planner that looks to the end."""
        return {planner(size).name: size for size, _ in self.simulations}

    @property
    def by_horizon(self) -> dict[str, int]:
        """Horizon of each planner that looks a limited number of steps ahead."""
        return {horizon_planner(each, self.horizon_simulations).name: each for each in self.horizons}

    @property
    def contenders(self) -> dict[str, Entrant]:
        """All contenders, by name."""
        planners = [planner(size) for size, _ in self.simulations]
        planners += [horizon_planner(horizon, self.horizon_simulations) for horizon in self.horizons]
        return by_name(LEARNED, *HEURISTICS, *planners)

    def prepare(self, setting: Setting) -> Piece:
        """Calibrate the cuts, and value the initial tables."""
        source = Source.of(setting)
        return {"rate": source.cut_rate(self.cut_share, CUT_KIND), "start": source.start_value(self.num_starts)}

    def measure(self, setting: Setting) -> Piece:
        """Decision times [ms], and the median learning time of a few runs on this machine [s]."""
        source = Source.of(setting)
        times = source.decision_times_ms(self.contenders.values(), NUM_TIMED_STATES, self.laws)
        learn = partial(self._learned, source, source.cut_rate(self.cut_share, CUT_KIND))
        learn()
        return {"decision_ms": times, "learning_s": float(np.median(repeat(learn, number=1, repeat=NUM_FITS)))}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Play all policies: for each, the episodes it played and their rewards."""
        source, world = Source.of(setting, index), setting.world
        num_all, start = self.episodes_per_scene * len(setting.scenes), float(prepared["start"])
        turns = [({LEARNED.name: self._learned(source, prepared["rate"])}, num_all)]
        turns[0][0].update({each.name: each.policy(world) for each in HEURISTICS})
        counts = {planner(size).name: count for size, count in self.simulations}
        counts |= dict.fromkeys(self.by_horizon, self.horizon_episodes)
        turns += [({name: self.contenders[name].policy(world)}, count) for name, count in counts.items()]
        rows = []
        for policies, count in turns:
            episodes = episodes_in_turn(index, count, num_all)
            each = source.control_each(list(policies.values()), episodes, start)
            for name, played in zip(policies, each, strict=True):
                earned = zip(episodes, played.reward.tolist(), strict=True)
                rows += [{"policy": name, "episode": episode, "reward": reward} for episode, reward in earned]
        return {"rows": rows}

    def _learned(self, source: Source, rate: float) -> Policy:
        episodes, size = source.play(self.num_trajectories), self.num_trajectories
        return source.logged(episodes, laws=self.laws).learn_one(source.cut(episodes, rate, CUT_KIND), size)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure2 and figure3.

        ``figure2`` has policy, kind, simulations, decision_ms (measured on this machine), mean_reward, se, low, high;
        over_censored_q, se_over, over_low, over_high (the mean difference from the learned policy on the same
        episodes), repetitions and episodes (of one repetition). If a policy played only some episodes, its mean is the
        learned policy's on all of them plus that difference.
        ``figure3`` has planning_horizon, simulations, decision_ms, mean_reward, se, low, high, over_previous and
        over_first (paired differences from the next shorter and the shortest horizon, with se_…, …_low, …_high; null
        for the shortest), repetitions and episodes. ``learning`` has learning_s, measured.
        """
        rewards = pieces.rows.pivot(index=["repetition", "episode"], columns="policy", values="reward")
        rewards, ahead = rewards[list(self.contenders)], rewards[list(self.by_horizon)]
        earned, over = _means(rewards), _means(rewards.sub(rewards[LEARNED.name], axis=0))
        played = rewards.groupby("repetition").count().T
        counts = pd.DataFrame({"repetitions": played.shape[1], "episodes": played[0]})
        who = pd.DataFrame({"kind": {name: str(each.kind) for name, each in self.contenders.items()}})
        who["simulations"] = pd.Series(self.by_simulations, dtype="Int64")
        who["decision_ms"] = pd.Series(pieces.measured["decision_ms"])
        figure2 = pd.concat([who, means(earned.loc[LEARNED.name] + over), means(over, OVER), counts], axis=1)
        horizons = pd.DataFrame({"planning_horizon": self.by_horizon, "decision_ms": who["decision_ms"][ahead.columns]})
        simulations = horizons["planning_horizon"].where(horizons["planning_horizon"] == 1, self.horizon_simulations)
        horizons["simulations"] = simulations.mask(simulations == 1).astype("Int64")
        more = {"over_previous": ahead.diff(axis=1), "over_first": ahead.sub(ahead.iloc[:, 0], axis=0)}
        gains = [
            means(_means(gain).iloc[1:], (name, f"se_{name}", f"{name}_low", f"{name}_high"))
            for name, gain in more.items()
        ]
        figure3 = pd.concat([horizons, means(earned.loc[ahead.columns]), *gains, counts.loc[ahead.columns]], axis=1)
        learning = {"num_trajectories": [self.num_trajectories], "learning_s": [pieces.measured["learning_s"]]}
        return {
            "figure2": figure2.rename_axis("policy").reset_index(),
            "figure3": figure3.reset_index(drop=True),
            "learning": pd.DataFrame(learning),
        }


def _means(rewards: Frame) -> Frame:
    """Policies by repetitions: means over the episodes that were played."""
    return rewards.groupby("repetition").mean().T
