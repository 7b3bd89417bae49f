"""From a file with the covariates of one stage to what a policy of named actions decides from."""

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import pandas as pd

from halfseen.errors import ArgumentError, LogError, PolicyError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.named_decider import NamedObservation
from halfseen.reading import json_of, read_bytes, read_text, reason_of

STATE_FILES = (".json", ".csv")


def read_covariates(stored: StoredPolicy, file: Path, stage: int | None = None) -> NamedObservation:
    """Read the covariates of one stage.

    Parameters
    ----------
    stored
        A policy of named actions.
    file, stage
        As `read_observation` takes them.

    Raises
    ------
    HalfseenError
        The file cannot be read, or does not fit the policy.
    """
    row = _state_row(file, stored.policy)
    return NamedObservation(row, _stage_of(file, row, stage, stored.horizon))


def _state_row(file: Path, policy: FlatPolicy) -> pd.DataFrame:
    """Read the covariates of one stage."""
    covariates = policy.covariates
    looks_at = ", ".join(covariates) or "no covariates"
    if file.suffix not in STATE_FILES:
        raise PolicyError(
            f"{file}: the policy is of named actions and looks at {looks_at}, not at clouds; give them as .json or .csv"
        )
    row = _read_states(file, policy.categories)
    if len(row) != 1:
        raise PolicyError(f"{file}: it holds {len(row)} states; give one: a JSON object, or a header and one row")
    missing = [name for name in covariates if name not in row.columns]
    if missing:
        raise PolicyError(
            f"{file}: the policy looks at {looks_at}, and there is no {missing[0]!r} among "
            f"{', '.join(map(str, row.columns)) or 'nothing'}; give what the policy was learned from"
        )
    try:
        policy.looks_at.encode(row)
    except LogError as error:
        raise PolicyError(f"{file}: {error}") from error
    return row


def _read_states(file: Path, texts: Iterable[str]) -> pd.DataFrame:
    try:
        if file.suffix == ".json":
            state = json_of(read_text(file))
            return pd.DataFrame([state]) if isinstance(state, dict) else pd.DataFrame()
        exact: Any = {"float_precision": "round_trip", "converters": dict.fromkeys(texts, str)}
        return pd.read_csv(BytesIO(read_bytes(file)), **exact)
    except (OSError, ValueError) as error:
        raise PolicyError(f"{file}: it cannot be read ({reason_of(error)}); give one state as .json or .csv") from error


def _stage_of(file: Path, row: pd.DataFrame, given: int | None, horizon: int) -> int:
    stage = row["stage"].iloc[0] if "stage" in row.columns else given or 1
    if isinstance(stage, bool) or not (hasattr(stage, "__index__") and 1 <= int(stage) <= horizon):
        raise PolicyError(f"{file}: stage is {stage}; it is a whole number from 1 to the policy's horizon, {horizon}")
    if given not in (None, int(stage)):
        raise ArgumentError(f"--stage is {given}, but {file} says {stage}; leave one of them out")
    return int(stage)
