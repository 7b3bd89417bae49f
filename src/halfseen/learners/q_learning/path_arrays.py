"""A log as dense arrays, one row a path, padded to T stages: what all that is estimated from it runs on."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from halfseen.learners.q_learning.encoding import Encoded
from halfseen.logs import Logs

SMALLEST_AGE_S = 1e-9
"""A stage that was cut as it began was watched this long [s]; clocks are told apart to this much, too."""


class PathArrays(NamedTuple):
    """Paths and their stages; what a path has no stage for holds 0, False or NaN."""

    path_ids: np.ndarray
    features: Float[np.ndarray, "n T A F"]
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    has_action: Bool[np.ndarray, "n T"]
    """Stages whose action is known; that of the stage in which a path was cut need not be."""
    probability: Float[np.ndarray, "n T"]
    """Of the logged action under the logging policy; NaN where it was not logged."""
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""
    elapsed_s: Float[np.ndarray, "n T"]
    """U_t [s], NaN where not completed."""
    end_s: Float[np.ndarray, " n"]
    is_finished: Bool[np.ndarray, " n"]
    is_begun: Bool[np.ndarray, "n T"]
    covariates: Float[np.ndarray, "n T P"]
    """What cuts may depend on; 0 where there is no such stage."""
    covariate_names: tuple[str, ...]

    @property
    def num_paths(self) -> int:
        """Number n of paths."""
        return len(self.end_s)

    @property
    def encoded(self) -> Encoded:
        """What the Q-functions look at, and what was done."""
        return Encoded(self.features, self.is_possible, self.action)

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return ~np.isnan(self.elapsed_s)

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages after which a path had come to its own end."""
        last = self.is_begun.sum(axis=1) - 1
        return (np.arange(self.action.shape[1]) == last[:, None]) & self.is_finished[:, None]

    @property
    def begun_at_s(self) -> Float[np.ndarray, "n T"]:
        """U_{t−1} of each begun stage [s]; 0 elsewhere."""
        before = np.concatenate([np.zeros((self.num_paths, 1)), self.elapsed_s[:, :-1]], axis=1)
        return np.where(self.is_begun, before, 0.0)

    @property
    def watched_s(self) -> Float[np.ndarray, "n T"]:
        """How long each begun stage was watched, to its completion or its cut [s]; 0 elsewhere."""
        until = np.where(self.is_completed, self.elapsed_s, self.end_s[:, None])
        age = np.maximum(np.round((until - self.begun_at_s) / SMALLEST_AGE_S) * SMALLEST_AGE_S, SMALLEST_AGE_S)
        return np.where(self.is_begun, age, 0.0)

    def take(self, rows: Int[np.ndarray, " k"]) -> "PathArrays":
        """Keep these paths, which may repeat, in this order."""
        kept: Any = {name: leaf[rows] for name, leaf in self._asdict().items() if name != "covariate_names"}
        return self._replace(**kept)


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
    at = pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages["stage"].to_numpy() - 1

    def spread(values: np.ndarray, empty: float | bool) -> np.ndarray:
        filled = np.full((logs.num_paths, horizon, *values.shape[1:]), empty, dtype=values.dtype)
        filled[at] = values
        return filled

    def numbers(column: str) -> Float[np.ndarray, " rows"]:
        given = logs.stages[column] if column in logs.stages.columns else pd.Series(np.nan, index=logs.stages.index)
        return given.to_numpy(dtype=np.float64, na_value=np.nan)

    known = np.zeros((logs.num_stages, 0)) if covariates is None else covariates.to_numpy(dtype=np.float64)
    return PathArrays(
        path_ids=logs.path_ids,
        features=encoded.features,
        is_possible=encoded.is_possible,
        action=encoded.action,
        has_action=spread(logs.stages["action"].notna().to_numpy(), False),
        probability=spread(numbers("probability"), np.nan),
        reward=np.nan_to_num(spread(numbers("reward"), 0.0)),
        elapsed_s=spread(numbers("elapsed_s"), np.nan),
        end_s=logs.end_s,
        is_finished=logs.is_finished,
        is_begun=spread(np.ones(logs.num_stages, dtype=bool), False),
        covariates=spread(known, 0.0),
        covariate_names=() if covariates is None else tuple(map(str, covariates.columns)),
    )
