"""Which covariates of a log can be looked at: numbers, and text of few categories that several paths share."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from pandas.api.types import infer_dtype

from halfseen.errors import LogError
from halfseen.learning.covariates import Categories, is_numeric
from halfseen.logs import Logs
from halfseen.logs.refusal import place

MOST_CATEGORIES = 20
"""A column with more tells one stage from another rather than what they have in common; so many still fit a smooth Q,
which looks at the product of each two indicators."""

_TEXT = ("string", "categorical", "boolean", "empty")


def learned_categories(parts: Iterable[Logs], wanted: Sequence[str], known: Categories) -> dict[str, tuple[str, ...]]:
    """Find the categories of all columns of text that can be looked at.

    Parameters
    ----------
    parts
        A log, in parts of whole paths.
    wanted
        Columns that must be among them, if they hold text.
    known
        Categories that are given; they stay as they are.

    Raises
    ------
    LogError
        A wanted column cannot be looked at: it has nulls, one value, too many, or one of its own for every path.
    """
    found = _surveyed(parts, known)
    for name in wanted:
        trouble = _trouble(found[name]) if name in found else None
        if trouble is not None:
            raise LogError(f"covariate {name!r} {trouble}")
    learned = {
        name: tuple(sorted(seen)) for name, seen in found.items() if isinstance(seen, Counter) and not _trouble(seen)
    }
    return {**known, **learned}


def unfit_covariates(parts: Iterable[Logs]) -> dict[str, str]:
    """Tell which covariates of the stages of a log, whole or in parts, cannot be looked at, and why."""
    troubles = {name: _trouble(seen) for name, seen in _surveyed(parts, {}).items()}
    return {name: trouble for name, trouble in troubles.items() if trouble is not None}


def fit_covariates(logs: Logs) -> list[str]:
    """Name the covariates of the stages that can be looked at: numbers, and text of few categories."""
    unfit = unfit_covariates([logs])
    return [name for name in logs.stage_covariates if name not in unfit]


_Seen = Counter[str] | str
"""In how many paths each category occurs, or why a column has none."""


def _surveyed(parts: Iterable[Logs], known: Categories) -> dict[str, _Seen]:
    """Look at all columns that hold no numbers."""
    found: dict[str, _Seen] = {}
    for part in parts:
        texts = [name for name in part.stage_covariates if name not in known and not is_numeric(part.stages, name)]
        if not texts:
            # What one part holds as numbers, all do.
            break
        for name in texts:
            found[name] = _joined(found.get(name, Counter()), _look(part, name))
    return found


def _look(logs: Logs, column: str) -> _Seen:
    values = logs.stages[column]
    kind = infer_dtype(values, skipna=True)
    if kind not in _TEXT:
        return f"holds {kind}, neither numbers nor text; give one of these, or leave it out"
    is_null = values.isna().to_numpy()
    if is_null.any():
        where = place(logs.stages, int(np.argmax(is_null)))
        return f"is null at {where}; fill it in, with a word such as 'unknown' where nothing is known, or leave it out"
    pairs = pd.DataFrame({"path": logs.stages["path"], "value": values.astype(object)}).drop_duplicates()
    return Counter(pairs["value"].map(str))


def _joined(before: _Seen, now: _Seen) -> _Seen:
    if isinstance(before, str) or isinstance(now, str):
        return before if isinstance(before, str) else now
    both = before + now
    if len(both) > MOST_CATEGORIES:
        return f"has more than {MOST_CATEGORIES} categories; group them into fewer, or leave it out"
    return both


def _trouble(seen: _Seen) -> str | None:
    """Why a column cannot be looked at."""
    if isinstance(seen, str):
        return seen
    if len(seen) == 1:
        return f"is {next(iter(seen))!r} in every stage, so it tells nothing apart; leave it out"
    if max(seen.values()) == 1:
        return "has no category that two paths share, so it names the path; leave it out"
    return None
