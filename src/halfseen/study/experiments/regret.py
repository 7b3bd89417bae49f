"""Regret of policies on tables so small that the optimum is known: Figure 7.

On a few tables of three cups the optimum is solved once. Policies are learned as elsewhere, from a log over these
tables with every proportion of cuts; each is then valued exactly on every table. There is no simulation noise: learned
policies differ by their logs only. The slow planners are run in a sample of the states, which adds a little noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.planners.exact import TableOptimum, solve_table
from halfseen.study.compare import means, records, row_of, where, wide
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.pipeline import CUT_KIND, EVALUATION, Source, random_key
from halfseen.study.policies import HEURISTICS, LEARNED, OPTIMUM, Entrant, StudyKind, by_name, horizon_planner
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

NUM_CUPS = 3
HIDING_PROBABILITY, MOST_HIDDEN = 0.75, 0.8
"""Probability that a nearer cup hides one behind it, and the upper end of its uniform hidden share."""
NUM_GRIP_NODES = 31
"""Nodes of the grid of grip offsets in the exact world: with this many it matches the simulated world of the logs to
1e-4 of reward; they add no states."""
CELL = ["policy", "num_trajectories", "cut_share"]
REGRET = ["regret", "se", "low", "high"]


@dataclass(frozen=True)
class Regret(Experiment):
    """Regret on `num_tables` small tables, with trajectories of `horizon` steps.

    Policies are learned from logs of each size and proportion of cuts; with `laws`, laws fitted to the same log assist.
    The text reports `reported_cut_share`. Planners look `planner_horizons` steps ahead and decide in `planner_states`
    states of each step in a repetition.
    """

    num_tables: int = 6
    horizon: int = 6
    num_trajectories: tuple[int, ...] = (50, 200, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    reported_cut_share: float = 1 / 2
    planner_horizons: tuple[int, ...] = (1, 2, 3, 6)
    planner_simulations: int = 128
    planner_states: int = 4
    laws: bool = True
    most_repetitions: int | None = 8
    name: ClassVar[str] = "regret"

    @property
    def planners(self) -> list[Entrant]:
        """The planners."""
        return [horizon_planner(h, self.planner_simulations) for h in self.planner_horizons]

    @property
    def contenders(self) -> dict[str, Entrant]:
        """All contenders, by name."""
        return by_name(LEARNED, *self.planners, *HEURISTICS, OPTIMUM)

    def small(self, setting: Setting) -> "SmallTables":
        """Draw the small tables, which follow from the seed; they are solved once in a process."""
        return small_tables(self.num_tables, replace(setting.world, horizon=self.horizon), setting.seed)

    def prepare(self, setting: Setting) -> Piece:
        """Solve the tables: the exact values of the optimum, FINISH at once and each heuristic; calibrate the cuts."""
        small = self.small(setting)
        source, left = small.source(), float(small.world.reward_dirty_left) * float(small.world.dirty_share) * NUM_CUPS
        regrets = small.regrets([each.policy(small.world) for each in HEURISTICS])
        return {
            "optimum": [optimum.value for optimum in small.optima],
            "finish": [left] * len(small.scenes),
            "regrets": dict(zip((each.name for each in HEURISTICS), regrets, strict=True)),
            "rates": [source.cut_rate(cut_share, CUT_KIND) for cut_share in self.cut_shares],
        }

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn from a fresh log and value the learned policies."""
        small = self.small(setting)
        source = small.source(index)
        key = random_key(setting.seed, EVALUATION, index)
        planned = [small.regrets([each.policy(small.world)], key, self.planner_states)[0] for each in self.planners]
        rows = [{"policy": who.name, "regrets": of} for who, of in zip(self.planners, planned, strict=True)]
        episodes = source.play(max(self.num_trajectories))
        trajectories = source.logged(episodes, laws=self.laws)
        logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in prepared["rates"]]
        policies = [one.policy for one in trajectories.learn(logs, self.num_trajectories)]
        places = product(self.num_trajectories, self.cut_shares)
        for place, regrets in zip(places, small.regrets(policies), strict=True):
            rows.append(dict(zip(CELL, (LEARNED.name, *place), strict=True)) | {"regrets": regrets})
        return {"rows": rows}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make regret: policy, num_trajectories, cut_share, regret, se, low, high, regret_share, optimum, repetitions.

        The standard error is over repetitions: for learned policies, over logs; for planners, over the sampled states
        and their own draws. Heuristics and the optimum are exact: their se is 0 and their repetitions null. No se
        includes the variation between tables. `regret_share` is the mean regret as a proportion of the optimum's
        earnings above FINISH at once, and `optimum` the value of the optimum.
        """
        known = pieces.prepared
        optimum, rows = float(np.mean(known["optimum"])), pieces.rows.reindex(columns=["repetition", *CELL, "regrets"])
        cells = wide(rows.assign(regret=rows["regrets"].map(np.mean)), CELL, "regret")
        estimated = means(cells, REGRET).assign(repetitions=len(pieces.repetitions)).reset_index()
        exact = pd.Series(known["regrets"] | {OPTIMUM.name: 0.0}).map(np.mean).rename("regret").rename_axis("policy")
        exact = exact.reset_index().assign(se=0.0, low=exact.to_numpy(), high=exact.to_numpy())
        table = pd.concat([estimated, exact.astype({"regret": float})], ignore_index=True)
        scale = optimum - float(np.mean(known["finish"]))
        table = table.assign(regret_share=table["regret"] / scale, optimum=optimum)
        # Learned policies come first, as in the other tables; the order among the others is kept.
        table = table.sort_values("num_trajectories", key=pd.isna, kind="stable", ignore_index=True)
        table = table.loc[:, [*CELL, *REGRET, "regret_share", "optimum", "repetitions"]]
        return {"regret": table.astype({"num_trajectories": "Int64", "cut_share": "Float64", "repetitions": "Int64"})}

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """The policy learned from the largest log, the best of a kind, and how far the first is below the second."""
        table = tables["regret"]
        kinds = {kind: [each.name for each in self.contenders.values() if each.kind == kind] for kind in StudyKind}
        # The first of those tied.
        rule, planner = (
            min(records(where(table, policy=kinds[kind])), key=lambda row: row["regret"])
            for kind in (StudyKind.HEURISTIC, StudyKind.PLANNER)
        )
        end = row_of(table, num_trajectories=max(self.num_trajectories), cut_share=self.reported_cut_share)
        ends = ("gain", "gain_low", "gain_high"), ("regret", "high", "low")
        gained = {name: rule["regret"] - end[column] for name, column in zip(*ends, strict=True)}
        return {"end": end, "rule": rule, "planner": planner, "gained": gained}


@dataclass(frozen=True)
class SmallTables:
    """Small tables and their optima, solved on first use."""

    world: WorldConfig
    scenes: tuple[Scene, ...]
    seed: int

    @cached_property
    def optima(self) -> list[TableOptimum]:
        """The optimum of each table."""
        return [solve_table(scene, self.world, num_grip_nodes=NUM_GRIP_NODES) for scene in self.scenes]

    def regrets(self, policies: Sequence[Any], *draws: Any) -> list[list[float]]:
        """Regrets of several policies, each on each table."""
        regrets = [optimum.value - optimum.policy_values(policies, *draws) for optimum in self.optima]
        return np.transpose(regrets).tolist()

    def source(self, index: int = 0) -> Source:
        """Source of trajectories on them."""
        return Source(self.world, pad_scenes(self.scenes), self.seed, index)


@lru_cache(maxsize=1)
def small_tables(num_tables: int, world: WorldConfig, seed: int) -> SmallTables:
    """Draw small tables; cached, so that the same arguments give the same object with its optima."""
    rng, shape = np.random.default_rng([seed, NUM_CUPS]), (NUM_CUPS, NUM_CUPS)
    scenes = []
    for k in range(num_tables):
        is_hiding, hidden = rng.random(shape) < HIDING_PROBABILITY, MOST_HIDDEN * rng.random(shape)
        scenes.append(Scene(np.tril(np.where(is_hiding, hidden, 0.0), -1), name=f"small-{k}"))
    return SmallTables(world, tuple(scenes), seed)
