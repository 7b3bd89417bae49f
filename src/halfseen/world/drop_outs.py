"""The log of a team as if every drop-out of one robot had ended the table: for the value as if nobody dropped out."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs import Logs
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import CUT, is_own_reward


def cut_at_drop_outs(logs: Logs) -> Logs:
    """Cut each path where its first robot dropped out, with the cause of that.

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
    first = np.argmin(np.where(np.isnan(out_s), np.inf, out_s), axis=1)
    rows = np.arange(len(out_s))
    first_s, is_out = out_s[rows, first], ~np.isnan(out_s).all(axis=1)
    causes = np.stack([_causes(logs.paths, r) for r in robots], axis=1)[rows, first]
    paths = logs.paths.drop(columns=[f"{r}_{what}" for r in robots for what in ("out_s", "out_cause")], errors="ignore")
    paths = paths.assign(
        end_s=np.where(is_out, first_s, paths["end_s"]),
        ending=np.where(is_out, CUT, paths["ending"]),
        cause=np.where(is_out, causes, paths["cause"].astype(object)),
    )
    return Logs(*_stages_before(logs, paths, first_s), reward_unit=logs.reward_unit)


def _causes(paths: pd.DataFrame, robot: int) -> np.ndarray:
    name = f"{robot}_out_cause"
    return paths[name].to_numpy(dtype=object) if name in paths.columns else np.full(len(paths), None, dtype=object)


def _stages_before(logs: Logs, paths: pd.DataFrame, first_s: np.ndarray) -> Any:
    """Stages, paths and objects, up to the stage in which the first drop-out of each path fell."""
    stages = logs.stages
    path_row = pd.Index(logs.path_ids).get_indexer(stages["path"])
    at_s = first_s[path_row]
    begin_s = stages["elapsed_s"].groupby(path_row).shift(fill_value=0.0).to_numpy()
    is_after = begin_s >= at_s
    is_in = ~is_after & ~(stages["elapsed_s"].to_numpy() < at_s) & ~np.isnan(at_s)
    outcomes = ["elapsed_s", "reward", *filter(is_own_reward, stages.columns)]
    stages = stages.assign(**{name: stages[name].mask(pd.Series(is_in)) for name in outcomes})[~is_after]
    if logs.objects is None:
        return stages, paths
    kept = pd.DataFrame(stages[["path", "stage"]])
    return stages, paths, logs.objects.merge(kept, on=["path", "stage"])
