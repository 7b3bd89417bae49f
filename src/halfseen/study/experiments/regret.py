"""Regret of policies on tables so small that the optimum is known: Figure 7.

On a few tables of three cups the optimum is solved once. Policies are learned as elsewhere, from a log over these
tables with every proportion of cuts; each is then valued exactly on every table. There is no simulation noise: learned
policies differ by their logs only. The slow planners are run in a sample of the states, which adds a little noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.evaluation.estimate import Estimate
from halfseen.figures import WIDTH_INCHES, draw_bars, write_title
from halfseen.planners.exact import TableOptimum, solve_table
from halfseen.study import figures
from halfseen.study.compare import estimated_in, learned_from, mean_columns, records, row_of, stacked
from halfseen.study.experiment import Drawing, Listing, PieceOf, Pieces, Section, Tables, words
from halfseen.study.pipeline import CUT_KIND, EVALUATION, Source, random_key
from halfseen.study.policies import HEURISTICS, LEARNED, OPTIMUM, Entrant, StudyKind, by_name, horizon_planner
from halfseen.study.setting import Setting
from halfseen.wording import MISSING, Claim, amount, share
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

NUM_CUPS = 3
HIDING_PROBABILITY, MOST_HIDDEN = 0.75, 0.8
"""Probability that a nearer cup hides one behind it, and the upper end of its uniform hidden share."""
NUM_GRIP_NODES = 31
"""Nodes of the grid of grip offsets in the exact world: with this many it matches the simulated world of the logs to
1e-4 of reward; they add no states."""
REGRET_AXIS = "regret: reward of a trajectory below the optimum, mean over the small tables"
BAR_DODGE = 1.05
REGRET = ["regret", "se", "low", "high"]
INTERVAL = ["regret", "low", "high"]


@dataclass(frozen=True)
class Regret:
    """Regret on `num_tables` small tables, with trajectories of `horizon` steps.

    Policies are learned from logs of each size and proportion of cuts; with `laws`, laws fitted to the same log assist.
    The text reports `told_cut_share`. Planners look `planner_horizons` steps ahead and decide in `planner_states`
    states of each step in a repetition.
    """

    num_tables: int = 6
    horizon: int = 6
    num_trajectories: tuple[int, ...] = (50, 200, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    told_cut_share: float = 1 / 2
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

    def prepare(self, setting: Setting) -> PieceOf:
        """Solve the tables: the exact values of the optimum, FINISH at once and each heuristic; calibrate the cuts."""
        small = self.small(setting)
        left = float(small.world.reward_dirty_left) * float(small.world.dirty_share) * NUM_CUPS
        source = small.source()
        return {
            "optimum": [optimum.value for optimum in small.optima],
            "finish": [left] * len(small.scenes),
            "regrets": {each.name: small.regrets(each.policy(small.world)) for each in HEURISTICS},
            "rates": [source.cut_rate(cut_share, CUT_KIND) for cut_share in self.cut_shares],
        }

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log and value the learned policies."""
        small = self.small(setting)
        source = small.source(index)
        key = random_key(setting.seed, EVALUATION, index)
        rows: list[dict[str, Any]] = [
            {"policy": each.name, "regrets": small.regrets(each.policy(small.world), key, self.planner_states)}
            for each in self.planners
        ]
        episodes = source.play(max(self.num_trajectories))
        trajectories = source.logged(episodes, laws=self.laws)
        logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in prepared["rates"]]
        policies = [one.policy for one in trajectories.learn(logs, self.num_trajectories)]
        places = product(self.num_trajectories, self.cut_shares)
        for (size, cut_share), regrets in zip(places, small.regrets_of(policies), strict=True):
            rows.append({"policy": LEARNED.name, "num_trajectories": size, "cut_share": cut_share, "regrets": regrets})
        return {"index": index, "rows": rows}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make regret: policy, num_trajectories, cut_share, regret, se, low, high, regret_share, optimum, repetitions.

        The standard error is over repetitions: for learned policies, over logs; for planners, over the sampled states
        and their own draws. Heuristics and the optimum are exact: their se is 0 and their repetitions null. No se
        includes the variation between tables. `regret_share` is the mean regret as a proportion of the optimum's
        earnings above FINISH at once, and `optimum` the value of the optimum.
        """
        return {"regret": _table(pieces)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say how far below the optimum the learned policy stays."""
        table = tables["regret"]
        claim = claim_of(self, table)
        lost = amount(100 * _end(self, table)["regret_share"], 1)
        share_lost = f"that is {lost} % of what the optimum gains over FINISH at once"
        sentence = (
            f"On {self.num_tables} small tables, of three cups and {self.horizon} steps each: {_lower(claim.sentence)}"
        )
        title, draw = f"On small tables, {_lower(claim.title)}", partial(_draw, self, table)
        drawing = Drawing("regret", "Figure 7", title, words(self.name, "caption"), draw)
        sentences = (f"{sentence[:-1]}; {share_lost}.",)
        return Section("How far from the optimum?", sentences, (drawing,), (_numbers(self, table),))


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

    def regrets(self, policy: Any, *draws: Any) -> list[float]:
        """Regret of a policy on each table."""
        return self.regrets_of([policy], *draws)[0]

    def regrets_of(self, policies: Sequence[Any], *draws: Any) -> list[list[float]]:
        """Regrets of several policies, each on each table."""
        regrets = [optimum.value - optimum.policy_values(policies, *draws) for optimum in self.optima]
        return np.transpose(regrets).tolist()

    def source(self, index: int = 0) -> Source:
        """Source of trajectories on them."""
        return Source(self.world, pad_scenes(self.scenes), self.seed, index)


@lru_cache(maxsize=1)
def small_tables(num_tables: int, world: WorldConfig, seed: int) -> SmallTables:
    """Draw small tables; cached, so that the same arguments give the same object with its optima."""
    rng = np.random.default_rng([seed, NUM_CUPS])
    scenes = []
    for k in range(num_tables):
        is_hiding = rng.random((NUM_CUPS, NUM_CUPS)) < HIDING_PROBABILITY
        hidden = MOST_HIDDEN * rng.random((NUM_CUPS, NUM_CUPS))
        scenes.append(Scene(np.tril(np.where(is_hiding, hidden, 0.0), -1), name=f"small-{k}"))
    return SmallTables(world, tuple(scenes), seed)


def _table(pieces: Pieces) -> pd.DataFrame:
    known = pieces.prepared
    optimum = float(np.mean(known["optimum"]))
    scale = optimum - float(np.mean(known["finish"]))
    place = ["policy", "num_trajectories", "cut_share"]
    rows = []
    for row in stacked(pieces.repetitions, "rows", "regrets"):
        values = row["regrets"].mean(axis=1)
        at = {name: row.get(name) for name in place}
        rows.append(at | mean_columns(values, REGRET) | {"repetitions": len(values)})
    exact = {name: float(np.mean(regrets)) for name, regrets in known["regrets"].items()} | {OPTIMUM.name: 0.0}
    rows += [{"policy": name, "se": 0.0} | dict.fromkeys(INTERVAL, value) for name, value in exact.items()]
    table = pd.DataFrame(rows).assign(optimum=optimum)
    table = table.assign(regret_share=table["regret"] / scale)
    # Learned policies come first, as in the other tables; the order among the others is kept.
    table = table.sort_values("num_trajectories", key=pd.isna, kind="stable", ignore_index=True)
    table = table.loc[:, [*place, *REGRET, "regret_share", "optimum", "repetitions"]]
    return table.astype({"num_trajectories": "Int64", "cut_share": "Float64", "repetitions": "Int64"})


def claim_of(design: Regret, table: pd.DataFrame) -> Claim:
    """Claim that the policy learned from the largest log has less regret than the best heuristic, which is exact."""
    end = _end(design, table)
    best = _best(design, table, StudyKind.HEURISTIC)
    rule, planner = (float(each["regret"]) for each in (best, _best(design, table, StudyKind.PLANNER)))
    gain = Estimate(rule - end["regret"], rule - end["high"], rule - end["low"], end["se"], float(end["repetitions"]))
    return Claim(
        f"The policy {learned_from(int(end['num_trajectories']), design.told_cut_share)}",
        "has less regret than",
        "has more regret than",
        f"the best heuristic ({design.contenders[best['policy']].label})",
        gain,
        note=f"regret {amount(float(end['regret']))} against {amount(rule)}, the best planner’s {amount(planner)}",
    )


def _end(design: Regret, table: pd.DataFrame) -> dict[str, Any]:
    return row_of(table, num_trajectories=max(design.num_trajectories), cut_share=design.told_cut_share)


def _best(design: Regret, table: pd.DataFrame, kind: StudyKind) -> dict[str, Any]:
    """Policy of a kind with the least regret; the first of those tied."""
    rows = [row for row in records(table) if design.contenders[row["policy"]].kind == kind]
    return min(rows, key=lambda row: row["regret"])


def _lower(words: str) -> str:
    return words[:1].lower() + words[1:]


def _draw(design: Regret, table: pd.DataFrame, title: str) -> Figure:
    """Regret against the size of the log, with the names of all lines at the right."""
    figure = Figure(figsize=(WIDTH_INCHES, 5.6))
    top = write_title(figure, title) - 0.08
    axes = figure.add_axes((0.07, 0.10, 0.58, top - 0.10))
    best = [_best(design, table, kind)["policy"] for kind in (StudyKind.HEURISTIC, StudyKind.PLANNER)]
    labels = [
        figures.draw_level(axes, design.contenders[row["policy"]], float(row["regret"]), row["policy"] in best)
        for row in records(table)
        if row["policy"] != LEARNED.name
    ]
    draw = partial(draw_bars, linewidth=1.8)
    labels += figures.draw_by_cut_share(axes, table, design.cut_shares, INTERVAL, draw, BAR_DODGE)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(figures.TRAJECTORIES_AXIS)
    figures.finish_by_size(axes, REGRET_AXIS, design.num_trajectories, (1.2, 1.2), labels)
    return figure


def _numbers(design: Regret, table: pd.DataFrame) -> Listing:
    cells = {
        "policy": lambda row: design.contenders[row["policy"]].label,
        "logged trajectories": lambda row: str(row["num_trajectories"]) if row["policy"] == LEARNED.name else MISSING,
        "cut": lambda row: share(float(row["cut_share"])) if row["policy"] == LEARNED.name else MISSING,
        "regret": lambda row: amount(row["regret"]) if pd.isna(row["repetitions"]) else estimated_in(row, INTERVAL),
        "% of the optimum above FINISH": lambda row: amount(100 * row["regret_share"], 1),
    }
    return Listing.of("The numbers of Figure 7", "", records(table), cells)
