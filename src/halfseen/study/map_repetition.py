"""One repetition of the map: at every place a fresh log, a learned policy, and the heuristics on the same episodes."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import jax
import numpy as np

from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.study.design import StudyDesign
from halfseen.study.findings import LEARNED
from halfseen.study.learning import learn
from halfseen.study.map_cells import MapCell, MapDesign, map_cells, random_tables
from halfseen.study.policies import heuristics, logging_policy
from halfseen.study.repetition import cut_log, folds, means, random_key
from halfseen.study.treatments import treat
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.cuts import CutKind, cut_rate
from halfseen.world.episodes import Episodes, evaluate, play
from halfseen.world.policy import Policy
from halfseen.world.state import Layout, pad_scenes

MAP_PILOT, MAP_LOGS, MAP_EVALUATION = range(16, 19)
"""What random keys are for, beside those of `halfseen.study.repetition`."""
_TABLES = 2
CUT_KIND: CutKind = "independent"

MapRates = Mapping[MapCell, float]
"""Rate of cuts at each place."""


def map_cut_rates(design: StudyDesign, map_design: MapDesign) -> dict[MapCell, float]:
    """Rate at which the wanted share of the paths is cut, at each place from a pilot of its own."""
    return {
        cell: cut_rate(_logged(design, map_design, cell, MAP_PILOT, 0), map_design.cut_share, CUT_KIND)
        for cell in map_cells(map_design, design.world)
    }


def run_map_repetition(design: StudyDesign, map_design: MapDesign, rates: MapRates, repetition: int) -> dict[str, Any]:
    """Learn and play at every place; return plain numbers, one row for each."""
    rows = [run_map_cell(design, map_design, cell, rate, repetition) for cell, rate in rates.items()]
    return {"repetition": repetition, "map": rows}


def run_map_cell(
    design: StudyDesign, map_design: MapDesign, cell: MapCell, rate: float, repetition: int
) -> dict[str, Any]:
    """Learn and play at one place; return the place and the mean reward of each policy.

    It depends on no other place but through the largest N, to which all tables are padded so that one compiled call
    serves all places.
    """
    here = _at(design, cell)
    layouts = _layouts(design, map_design, cell, repetition)
    key = random_key(design, MAP_EVALUATION, repetition)
    num_episodes = map_design.num_tables * map_design.episodes_per_table
    learned = _learned(here, _logged(design, map_design, cell, MAP_LOGS, repetition), rate, repetition)
    policies: dict[str, Policy] = {LEARNED: learned, **heuristics(here)}
    rewards = {
        name: means(evaluate(here.world, layouts, policy, key, num_episodes))["reward"]
        for name, policy in policies.items()
    }
    return asdict(cell) | {"rewards": rewards}


def _at(design: StudyDesign, cell: MapCell) -> StudyDesign:
    return replace(design, world=cell.world(design.world))


def _layouts(design: StudyDesign, map_design: MapDesign, cell: MapCell, repetition: int) -> Layout:
    """The tables of a repetition: at one N the same ones everywhere, denser or looser."""
    rng = np.random.default_rng([design.seed, repetition, _TABLES, cell.num_objects])
    scenes = random_tables(cell.num_objects, cell.occlusion, map_design.num_tables, rng)
    return pad_scenes(scenes, max(map_design.num_objects))


def _logged(design: StudyDesign, map_design: MapDesign, cell: MapCell, purpose: int, repetition: int) -> Episodes:
    here = _at(design, cell)
    layouts = _layouts(design, map_design, cell, repetition)
    key = random_key(design, purpose, repetition)
    return play(here.world, layouts, logging_policy(here), key, map_design.num_paths)


def _learned(here: StudyDesign, episodes: Episodes, rate: float, repetition: int) -> LinearTablePolicy:
    log = cut_log(here, episodes, rate, CUT_KIND, repetition)
    features, is_possible = encode_states(episodes.states)
    encoded = Encoded(np.asarray(features), np.asarray(is_possible), np.asarray(episodes.action))
    fold = folds(here, repetition, len(encoded.action))
    policies = learn(encoded, [treat(log, "weighted", here.world)], fold)
    return jax.tree.map(lambda leaf: leaf[0], policies)
