"""How far policies stay below the best of all policies, on tables so small that it is known: one repetition.

On a few tables of three cups the optimum is solved once. From a log over them, cut at every share, policies are
learned as in the study; each is then valued exactly on every table. There is no noise of simulated episodes: learned
policies differ by their logs alone. The planners, which take their time, are asked in some of the states only, which
leaves a little noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.planners.optimum import TableOptimum, solve_table
from halfseen.study.design import StudyDesign
from halfseen.study.findings import LEARNED
from halfseen.study.learning import learn
from halfseen.study.policies import heuristics, logging_policy, planners
from halfseen.study.repetition import EVALUATION, LOGS, PILOT, cut_log, first_paths, folds, random_key
from halfseen.study.treatments import treat
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.cuts import CutKind, cut_rate
from halfseen.world.episodes import play
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes
from halfseen.world.table_world import NUM_PILOT_PATHS

NUM_CUPS = 3
HIDING_SHARE, MOST_HIDDEN = 0.75, 0.8
"""A nearer cup hides one behind it with this probability, and then a share of it that is uniform up to this."""
NUM_GRIP_NODES = 31
"""Of the grid of grip offsets in the exact world: with so many it is the simulated world, in which logs are made, to
1e-4 of reward; they cost no states."""
PLANNER_STATES = 8
"""States of each step in which a planner is asked, in each repetition."""
CUT_KIND: CutKind = "independent"


@dataclass(frozen=True)
class SmallTables:
    """Small tables and what is known of them, worked out when it is first asked for.

    Parameters
    ----------
    design
        The study's, its world with the horizon of these tables.
    scenes
        The tables.
    """

    design: StudyDesign
    scenes: tuple[Scene, ...]

    @cached_property
    def optima(self) -> list[TableOptimum]:
        """The optimum of each table."""
        return [solve_table(scene, self.design.world, num_grip_nodes=NUM_GRIP_NODES) for scene in self.scenes]

    @cached_property
    def cut_rates(self) -> dict[float, float]:
        """Rate of cuts at each share of cut paths that the study has, from one pilot."""
        key = random_key(self.design, PILOT)
        pilot = play(self.design.world, pad_scenes(self.scenes), logging_policy(self.design), key, NUM_PILOT_PATHS)
        return {share: cut_rate(pilot, share, CUT_KIND) for share in self.design.cut_shares}


def small_tables(design: StudyDesign, num_tables: int, horizon: int) -> SmallTables:
    """Draw tables of three cups that stand one behind another; they follow from the study's seed.

    Parameters
    ----------
    design
        The study's.
    num_tables
        How many.
    horizon
        Steps that a path on them may have.
    """
    rng = np.random.default_rng([design.seed, NUM_CUPS])
    scenes = []
    for k in range(num_tables):
        is_hiding = rng.random((NUM_CUPS, NUM_CUPS)) < HIDING_SHARE
        hidden = MOST_HIDDEN * rng.random((NUM_CUPS, NUM_CUPS))
        scenes.append(Scene(np.tril(np.where(is_hiding, hidden, 0.0), -1), name=f"small-{k}"))
    return SmallTables(replace(design, world=replace(design.world, horizon=horizon)), tuple(scenes))


def run_regret_baselines(tables: SmallTables) -> dict[str, Any]:
    """Return what the optimum, FINISH at once and each heuristic earn on each table, exactly; plain numbers."""
    config = tables.design.world
    left = float(config.reward_dirty_left) * float(config.dirty_share) * NUM_CUPS
    rules = heuristics(tables.design)
    return {
        "optimum": [optimum.value for optimum in tables.optima],
        "finish": [left] * len(tables.scenes),
        "regrets": {name: [optimum.regret(rule) for optimum in tables.optima] for name, rule in rules.items()},
    }


def run_regret_repetition(tables: SmallTables, num_paths: Sequence[int], repetition: int) -> dict[str, Any]:
    """Learn from a fresh log and value what was learned; return plain numbers.

    Parameters
    ----------
    tables
        The small tables.
    num_paths
        Sizes of the logs; a smaller log is the beginning of a larger one.
    repetition
        Which; from it follow the log, its cuts, and the draws of the planners.
    """
    key = random_key(tables.design, EVALUATION, repetition)
    rows: list[dict[str, Any]] = [
        {"policy": name, "regrets": [one.regret(planner, key, PLANNER_STATES) for one in tables.optima]}
        for name, planner in planners(tables.design).items()
    ]
    for size, cut_share, policy in _learned(tables, num_paths, repetition):
        regrets = [optimum.regret(policy) for optimum in tables.optima]
        rows.append({"policy": LEARNED, "num_paths": size, "cut_share": cut_share, "regrets": regrets})
    return {"repetition": repetition, "rows": rows}


def _learned(
    tables: SmallTables, num_paths: Sequence[int], repetition: int
) -> list[tuple[int, float, LinearTablePolicy]]:
    """Size of the log, share of cut paths, and the policy learned from it."""
    design, longest = tables.design, max(num_paths)
    key = random_key(design, LOGS, repetition)
    episodes = play(design.world, pad_scenes(tables.scenes), logging_policy(design), key, longest)
    features, is_possible = encode_states(episodes.states)
    encoded = Encoded(np.asarray(features), np.asarray(is_possible), np.asarray(episodes.action))
    fold = folds(design, repetition, longest)
    rates = tables.cut_rates
    logs = [cut_log(design, episodes, rates[share], CUT_KIND, repetition) for share in design.cut_shares]
    learned = []
    for size in num_paths:
        treated = [treat(first_paths(log, size), "weighted", design.world) for log in logs]
        policies = learn(Encoded(*(leaf[:size] for leaf in encoded)), treated, fold[:size])
        coefficients: Float[np.ndarray, "B T K F"] = np.asarray(policies.coefficients)
        for share, of_policy in zip(design.cut_shares, coefficients, strict=True):
            learned.append((size, share, LinearTablePolicy(jax.numpy.asarray(of_policy))))
    return learned
