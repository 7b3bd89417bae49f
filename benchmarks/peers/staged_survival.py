"""Backward over stages on times, as peers do who know no rewards: survival forests, and DWSurv.

*Forest*: what is left of life in stage t, given covariates and action, is a random survival forest's curve. Who moved
on to stage t + 1 is given a draw from the curve of the better action there. This is the idea of [Cho, Holloway, Couper,
Kosorok, 2023], with `scikit-survival` for their trees and draws for their curves. *DWSurv* [Simoneau, Moodie, Nijjar,
Platt, 2019]: the same with log times of who was not cut, and a shift by the blip.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from peers.weighted_survival import blip

from halfseen.logs import Logs

LONGEST_GAIN = 5.0
"""Of log time by another treatment; what few patients and many covariates say beyond is not believed."""


class StageTimes(NamedTuple):
    """Who began a stage."""

    who: Int[np.ndarray, " m"]
    x: Float[np.ndarray, "m p"]
    treated: Float[np.ndarray, " m"]
    watched: Float[np.ndarray, " m"]
    """In the stage."""
    ended: Bool[np.ndarray, " m"]
    """At the trajectory's own end."""
    moved: Bool[np.ndarray, " m"]


def stage_times(logs: Logs, covariates: list[str], treatment: str) -> list[StageTimes]:
    """Lay a log out by stage; `treatment` is the action that counts as 1."""
    frame = logs.stages.assign(
        begun=logs.stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0),
        is_last=~logs.stages["trajectory"].duplicated(keep="last"),
    )
    place = pd.Index(logs.trajectory_ids).get_indexer(frame["trajectory"])
    ends = frame["elapsed_s"].fillna(pd.Series(logs.end_s[place], index=frame.index))
    columns = (
        place,
        frame[covariates].to_numpy(dtype=float),
        (frame["action"] == treatment).to_numpy(dtype=float),
        (ends - frame["begun"]).to_numpy(dtype=float),
        (frame["is_last"] & logs.is_finished[place]).to_numpy(dtype=bool),
        (~frame["is_last"]).to_numpy(dtype=bool),
    )
    stage = frame["stage"].to_numpy()
    return [StageTimes(*(column[stage == t] for column in columns)) for t in range(1, int(stage.max()) + 1)]


Rule = Callable[[Float[np.ndarray, "m p"]], Bool[np.ndarray, " m"]]
"""Whether each state is treated."""


def forest_rules(stages: list[StageTimes], seed: int = 0, num_trees: int = 30) -> list[Rule]:
    """Learn the rule of each stage by survival forests."""
    from sksurv.ensemble import RandomSurvivalForest
    from sksurv.util import Surv

    rng, rules, later = np.random.default_rng(seed), [], np.empty(0)
    for number, stage in reversed(list(enumerate(stages))):
        time = stage.watched.copy()
        time[stage.moved] += later
        forest = RandomSurvivalForest(num_trees, min_samples_leaf=5, max_features="sqrt", random_state=seed)
        forest.fit(np.column_stack([stage.x, stage.treated]), Surv.from_arrays(stage.ended | stage.moved, time))
        rules.insert(0, _longer(forest))
        if number:
            before = stages[number - 1]
            rows = pd.Index(stage.who).get_indexer(before.who[before.moved])
            later = _drawn(forest, stage.x[rows], rng)
    return rules


def _curves(forest: Any, x: Float[np.ndarray, "m p"]) -> Float[np.ndarray, "2 m times"]:
    return np.stack(
        [
            forest.predict_survival_function(np.column_stack([x, np.full(len(x), a)]), return_array=True)
            for a in (0.0, 1.0)
        ]
    )


def _means(forest: Any, curves: Float[np.ndarray, "2 m times"]) -> Float[np.ndarray, "2 m"]:
    lengths = np.diff(forest.unique_times_, prepend=0.0)
    return (np.concatenate([np.ones((*curves.shape[:2], 1)), curves[..., :-1]], axis=-1) * lengths).sum(axis=-1)


def _longer(forest: Any) -> Rule:
    def rule(x):
        first, second = _means(forest, _curves(forest, x))
        return second > first

    return rule


def _drawn(forest: Any, x: Float[np.ndarray, "m p"], rng: np.random.Generator) -> Float[np.ndarray, " m"]:
    curves = _curves(forest, x)
    better = curves[_means(forest, curves).argmax(axis=0), np.arange(len(x))]
    index = (better > rng.random((len(x), 1))).sum(axis=1)
    return forest.unique_times_[np.minimum(index, better.shape[1] - 1)]


def dwsurv_rules(stages: list[StageTimes]) -> list[Rule]:
    """Learn the rule of each stage by DWSurv, all models linear."""
    rules, later = [], np.empty(0)
    for number, stage in reversed(list(enumerate(stages))):
        time, is_seen, design = (
            stage.watched.copy(),
            stage.ended.copy(),
            np.column_stack([np.ones(len(stage.who)), stage.x]),
        )
        time[stage.moved] += np.nan_to_num(later)
        is_seen[stage.moved] = np.isfinite(later)
        psi = blip(np.log(time), stage.treated, is_seen, design, design, design, design)
        gain = design @ psi
        rules.insert(0, lambda x, psi=psi: np.column_stack([np.ones(len(x)), x]) @ psi > 0)
        if number:
            before = stages[number - 1]
            rows = pd.Index(stage.who).get_indexer(before.who[before.moved])
            best = time * np.exp(np.clip(((gain > 0) - stage.treated) * gain, 0.0, LONGEST_GAIN))
            later = np.where(is_seen, best, np.nan)[rows]
    return rules
