"""Fitting a request to the columns of the log that it continues, so that no decision is lost to a client's change."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from halfseen.errors import PolicyError
from halfseen.logs.columns import shown
from halfseen.logs.missing import is_flag

TEXT, TRUTH = "text", "truth value"


def fitted(covariates: Mapping[str, Any], kinds: Mapping[str, str] | None) -> tuple[dict[str, Any], list[str]]:
    """Covariates, or columns of an object, as the log holds them, and a warning for each that is not recorded.

    Truth values become 0 and 1 where the log has numbers, and the other way round.

    Parameters
    ----------
    covariates
        Those of the request.
    kinds
        As in `LogRecorder.kinds`; None for a log that begins.
    """
    if kinds is None:
        return dict(covariates), []
    new = [name for name in covariates if name not in kinds and not is_flag(name, kinds)]
    kept = {name: _as(kinds.get(name), value) for name, value in covariates.items() if name not in new}
    return kept, [f"{shown(name)} is not in the log so far, and is not recorded" for name in new]


def _as(kind: str | None, value: Any) -> Any:
    if kind == TRUTH and not isinstance(value, bool) and value in (0, 1):
        return bool(value)
    return int(value) if isinstance(value, bool) and kind not in (None, TRUTH) else value


def refuse_other_columns(policy: Any, kinds: Mapping[str, str] | None, folder: Path) -> None:
    """Refuse to continue a log in which the states of a policy of named actions cannot be recorded.

    Parameters
    ----------
    policy
        The policy.
    kinds
        As in `LogRecorder.kinds`; None for a log that begins.
    folder
        Folder of the log.

    Raises
    ------
    PolicyError
        The log lacks a covariate of the policy, or has text where the policy takes numbers, or the other way round.
    """
    if kinds is None:
        return
    filling = getattr(policy, "filling", None)
    flags = set() if filling is None else set(filling.flags)
    for name in getattr(policy, "covariates", ()):
        kind = kinds.get(name)
        wants_text = name in policy.categories
        if (kind is None and name not in flags) or (kind is not None and (kind == TEXT) != wants_text):
            has = "lacks it" if kind is None else f"has a {kind} there"
            wants = "text" if wants_text else "a number"
            raise PolicyError(
                f"the policy takes {wants} as {shown(name)}, but {folder} {has}; record into another folder"
            )
