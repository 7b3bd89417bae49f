"""From a file with the covariates of one stage to what a policy of named actions decides from."""

from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError, LogError, PolicyError
from halfseen.lazy import Frame
from halfseen.learning.flat_policy import FlatPolicy
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
    policy = stored.policy
    if file.suffix not in STATE_FILES:
        raise PolicyError(
            f"{file}: the policy is of named actions and looks at {_looks_at(policy)}, not at clouds; give them as "
            ".json or .csv"
        )
    states = _read_states(file, policy.categories)
    if len(states) != 1:
        raise PolicyError(f"{file}: it holds {len(states)} states; give one: a JSON object, or a header and one row")
    values, said = known_covariates(policy, states[0], str(file)), states[0].get("stage")
    if said is not None and stage not in (None, said):
        raise ArgumentError(f"--stage is {stage}, but {file} says {said}; leave one of them out")
    return NamedObservation(values, checked_stage(said if said is not None else stage or 1, stored.horizon, str(file)))


def known_covariates(policy: FlatPolicy, state: Mapping[str, Any], where: str) -> dict[str, float | str]:
    """Take what a policy looks at from a state in memory, as `NamedDecider.decide_known` does.

    Parameters
    ----------
    policy
        A policy of named actions.
    state
        Covariates by name, and whatever else there is.
    where
        Where it comes from, for messages.

    Raises
    ------
    PolicyError
        A covariate is missing, no finite number, null or of an unknown category.
    """
    looks_at, texts = policy.looks_at, policy.categories
    if not all(name in state and looks_at.is_known(name, state[name]) for name in policy.covariates):
        # What is not plain is looked at as if it stood in a file.
        row = _row(state, where)
        _check_row(row, policy, where)
        state = {name: row[name].iloc[0] for name in policy.covariates}
    return {name: (str if name in texts else float)(state[name]) for name in policy.covariates}


def checked_stage(stage: Any, horizon: int, where: str) -> int:
    """Take a stage as a number.

    Raises
    ------
    PolicyError
        The policy knows no such stage.
    """
    if isinstance(stage, bool) or not (hasattr(stage, "__index__") and 1 <= int(stage) <= horizon):
        raise PolicyError(f"{where}: stage is {stage}; it is a whole number from 1 to the policy's horizon, {horizon}")
    return int(stage)


def _looks_at(policy: FlatPolicy) -> str:
    return ", ".join(policy.covariates) or "no covariates"


def _check_row(row: Frame, policy: FlatPolicy, where: str) -> None:
    """Refuse a row without what the policy looks at."""
    missing = [name for name in policy.covariates if name not in row.columns]
    if missing:
        raise PolicyError(
            f"{where}: the policy looks at {_looks_at(policy)}, and there is no {missing[0]!r} among "
            f"{', '.join(map(str, row.columns)) or 'nothing'}; give what the policy was learned from"
        )
    try:
        policy.looks_at.encode(row)
    except LogError as error:
        raise PolicyError(f"{where}: {error}") from error


def _read_states(file: Path, texts: Iterable[str]) -> list[dict[str, Any]]:
    try:
        if file.suffix == ".json":
            state = json_of(read_text(file))
            return [state] if isinstance(state, dict) else []
        import pandas as pd

        exact: Any = {"float_precision": "round_trip", "converters": dict.fromkeys(texts, str)}
        return pd.read_csv(BytesIO(read_bytes(file)), **exact).to_dict("records")
    except (OSError, ValueError) as error:
        raise PolicyError(f"{file}: it cannot be read ({reason_of(error)}); give one state as .json or .csv") from error


def _row(state: Mapping[str, Any], where: str) -> Frame:
    import pandas as pd

    try:
        return pd.DataFrame([dict(state)])
    except OverflowError as error:
        raise PolicyError(f"{where}: a number of it is too large for any covariate; look at its unit") from error
