"""From cut episodes of a team to `Logs`: those of a table, and which robot decided, and what the others were at.

Beside the columns of one robot's log, a stage holds `robot` (from 0) and, for each robot r, what it was at when that
stage began: r_does ("WASH 3", "WAIT", "FREE", "PARKED"), r_since_s (for how long, 0 where it is free) and
r_decisions_to_go.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.logs import Logs
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.number import Number
from halfseen.world.recording import VERB_NAMES, objects_of, paths_of, stages_of
from halfseen.world.scene import Scene

TEAM_VERBS = (*VERB_NAMES, "WAIT")
FREE, PARKED = "FREE", "PARKED"


def to_logs(cuts: CutEpisodes, kind: CutKind | str, scenes: Sequence[Scene], dirty_share: Number | None = None) -> Logs:
    """Write down what a recorder would have kept of these episodes of a team.

    Parameters
    ----------
    cuts
        The episodes, whose states are those of a team; path k began from scene k modulo their number.
    kind
        How they were cut.
    scenes
        Where they began.
    dirty_share
        P(DIRTY) of an object before any label; None if it is not to be told.
    """
    states, begun = cuts.episodes.states, np.argwhere(cuts.is_begun)
    of_table = replace(cuts, episodes=replace(cuts.episodes, states=states.table))
    stages = stages_of(of_table, begun, TEAM_VERBS).assign(**_robots(states, begun))
    return Logs(stages, paths_of(cuts, kind, scenes, dirty_share), objects_of(of_table, begun))


def _robots(states: TeamState, begun: Int[np.ndarray, "rows 2"]) -> dict[str, pd.Series]:
    path, stage = begun.T
    robots = states.robots
    found = {"robot": pd.Series(np.asarray(states.decider)[path, stage].astype(np.int64))}
    for r in range(robots.num_robots):
        at = path, stage, r
        is_busy, verb = np.asarray(robots.is_busy)[at], np.asarray(robots.verb)[at]
        objects = np.char.add(" ", np.asarray(robots.target)[at].astype(str))
        words = np.char.add(np.array(TEAM_VERBS)[verb], np.where(np.isin(verb, TARGETED), objects, ""))
        idle = np.where(np.asarray(robots.is_parked)[at], PARKED, FREE)
        found[f"{r}_does"] = pd.Series(np.where(is_busy, words, idle))
        found[f"{r}_since_s"] = pd.Series(np.where(is_busy, np.asarray(robots.since_s, dtype=np.float64)[at], 0.0))
        found[f"{r}_decisions_to_go"] = pd.Series(np.asarray(robots.decisions_to_go)[at].astype(np.int64))
    return found
