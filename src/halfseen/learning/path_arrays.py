"""A log as dense arrays, one row a path, padded to T stages: what all that is estimated from it runs on."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from halfseen.censoring import StageClocks
from halfseen.learning.task import Encoded
from halfseen.logs import Logs


class PathArrays(NamedTuple):
    """Paths and their stages; what a path has no stage for holds 0, False or NaN."""

    clocks: StageClocks
    """When each stage began and ended, who was cut, and what cuts may depend on."""
    encoded: Encoded
    has_action: Bool[np.ndarray, "n T"]
    """Stages whose action is known; that of the stage in which a path was cut need not be."""
    probability: Float[np.ndarray, "n T"]
    """Of the logged action under the logging policy; NaN where it was not logged."""
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""

    @property
    def num_paths(self) -> int:
        """Number n of paths."""
        return self.clocks.num_paths

    @property
    def path_ids(self) -> np.ndarray:
        """Names of the paths."""
        return self.clocks.path_ids

    @property
    def features(self) -> Float[np.ndarray, "n T A F"]:
        """φ(S_t, a)."""
        return self.encoded.features

    @property
    def is_possible(self) -> Bool[np.ndarray, "n T A"]:
        """Which actions each state allows."""
        return self.encoded.is_possible

    @property
    def action(self) -> Int[np.ndarray, "n T"]:
        """A_t."""
        return self.encoded.action

    @property
    def is_begun(self) -> Bool[np.ndarray, "n T"]:
        """Stages whose S_t was seen."""
        return self.clocks.is_begun

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return self.clocks.is_completed

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages after which a path had come to its own end."""
        return self.clocks.is_last

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "PathArrays":
        """Keep these paths, which may repeat, in this order; a slice of them copies nothing."""
        leaves: list[Any] = [None if leaf is None else leaf[rows] for leaf in self.encoded]
        encoded = Encoded(*leaves)
        return PathArrays(self.clocks.take(rows), encoded, *(leaf[rows] for leaf in self[2:]))


def path_arrays(logs: Logs, encoded: Encoded, covariates: pd.DataFrame | None) -> PathArrays:
    """Lay out a log.

    Parameters
    ----------
    logs
        The log.
    encoded
        Its features and actions, padded to T.
    covariates
        What cuts may depend on, a row for each stage of the log; None for nothing.
    """
    horizon = encoded.action.shape[1]
    at = stage_places(logs)

    def spread(values: np.ndarray, empty: float | bool) -> np.ndarray:
        filled = np.full((logs.num_paths, horizon, *values.shape[1:]), empty, dtype=values.dtype)
        filled[at] = values
        return filled

    def numbers(column: str) -> Float[np.ndarray, " rows"]:
        given = logs.stages[column] if column in logs.stages.columns else pd.Series(np.nan, index=logs.stages.index)
        return given.to_numpy(dtype=np.float64, na_value=np.nan)

    known = np.zeros((logs.num_stages, 0)) if covariates is None else covariates.to_numpy(dtype=np.float64)
    clocks = StageClocks(
        path_ids=logs.path_ids,
        elapsed_s=spread(numbers("elapsed_s"), np.nan),
        end_s=logs.end_s,
        is_finished=logs.is_finished,
        is_begun=spread(np.ones(logs.num_stages, dtype=bool), False),
        covariates=spread(known, 0.0),
        covariate_names=() if covariates is None else tuple(map(str, covariates.columns)),
    )
    return PathArrays(
        clocks=clocks,
        encoded=encoded,
        has_action=spread(logs.stages["action"].notna().to_numpy(), False),
        probability=spread(numbers("probability"), np.nan),
        reward=np.nan_to_num(spread(numbers("reward"), 0.0)),
    )


def stage_places(logs: Logs) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """Row of each stage's path in dense arrays, and its column."""
    return pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages["stage"].to_numpy() - 1
