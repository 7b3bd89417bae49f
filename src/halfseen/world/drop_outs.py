"""Robots of a team that drop out alone: what a log tells of them, and the log as if each had ended its table."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs import Logs
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import CUT, is_own_reward
from halfseen.world.cuts import CutEpisodes

DROP_OUT_CAUSE = "battery"


def drop_out_columns(cuts: CutEpisodes, cause: str) -> dict[str, Any]:
    """When each robot dropped out, and why; null where it did not before the path's end, nothing where nobody can."""
    if cuts.episodes.out_s is None:
        return {}
    duration_s = np.where(cuts.is_completed, np.asarray(cuts.episodes.duration_s, dtype=np.float64), 0.0)
    at_s = (np.cumsum(duration_s, axis=1) - duration_s)[..., None] + np.asarray(cuts.episodes.out_s, dtype=np.float64)
    out_s = np.where(cuts.is_begun[..., None], at_s, np.inf).min(axis=1)
    is_seen = np.isfinite(out_s) & (out_s <= cuts.end_s[:, None])
    found: dict[str, Any] = {}
    for r in range(is_seen.shape[1]):
        found[f"{r}_out_s"] = np.where(is_seen[:, r], out_s[:, r], np.nan)
        found[f"{r}_out_cause"] = np.where(is_seen[:, r], cause, np.array(None))
    return found


def cut_at_drop_outs(logs: Logs) -> Logs:
    """Cut each path where its first robot dropped out, with the cause of that: for the value as if nobody dropped out.

    The stage in which it fell is not completed, also where it ended there since robots that waited were free: without
    the drop-out it would have gone on.

    Parameters
    ----------
    logs
        The log of a team.
    """
    robots = robots_that_may_drop_out(logs.paths)
    if not robots:
        return logs
    out_s = logs.paths[[f"{r}_out_s" for r in robots]].to_numpy(dtype=np.float64)
    named = logs.paths.reindex(columns=[f"{r}_out_cause" for r in robots]).to_numpy(dtype=object)
    rows, first = np.arange(len(out_s)), np.argmin(np.where(np.isnan(out_s), np.inf, out_s), axis=1)
    first_s, cause = out_s[rows, first], named[rows, first]
    is_out = ~np.isnan(first_s)
    paths = logs.paths.drop(columns=[f"{r}_{what}" for r in robots for what in ("out_s", "out_cause")], errors="ignore")
    paths = paths.assign(
        end_s=np.where(is_out, first_s, paths["end_s"]),
        ending=np.where(is_out, CUT, paths["ending"]),
        cause=np.where(is_out, cause, paths["cause"].astype(object)),
    )
    path_row, stages = pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages
    begin_s, at_s = stages["elapsed_s"].groupby(path_row).shift(fill_value=0.0).to_numpy(), first_s[path_row]
    is_after = begin_s >= at_s
    is_in = ~is_after & ~(stages["elapsed_s"].to_numpy() < at_s) & ~np.isnan(at_s)
    outcomes = ["elapsed_s", "reward", *filter(is_own_reward, stages.columns)]
    kept: Any = stages.assign(**{name: stages[name].mask(pd.Series(is_in)) for name in outcomes})[~is_after]
    objects = None if logs.objects is None else logs.objects.merge(kept[["path", "stage"]], on=["path", "stage"])
    return Logs(kept, paths, objects, reward_unit=logs.reward_unit)
