"""Covariates of stages as numbers: numbers stay, and text becomes an indicator of each category but one.

The first category of a column, in sorted order, is the reference category without an indicator. So the indicators are
never collinear with the intercept, and eq. 3 without λ, or a proportional-hazards model of the cuts, can be fitted to
them. Every function class and every model uses the same columns. True and false become 1 and 0.

Usable columns are numbers, and text of few categories that occur in several trajectories.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import LogError, did_you_mean
from halfseen.lazy import Frame
from halfseen.logs.checks import LARGEST
from halfseen.logs.missing import remedy_of
from halfseen.shapes import Bool, Float

if TYPE_CHECKING:
    from halfseen.logs import Logs

Categories = Mapping[str, tuple[str, ...]]
"""Categories of each text column, in sorted order."""

MOST_CATEGORIES = 20
"""A column with more identifies single stages rather than what they share. This many still fit a smooth Q, which uses
the product of each two indicators."""

_MOST_NAMED = 12
_TEXT = ("string", "categorical", "boolean", "empty")

_Seen = Counter[str] | str
"""Number of trajectories in which each category occurs, or why a column has none."""


@dataclass(frozen=True)
class Covariates:
    """Columns of the stages, and their encoding as numbers.

    Examples
    --------
    >>> looks_at = Covariates(("x", "colour"), {"colour": ("blue", "green", "red")})
    >>> looks_at.names
    ('x', 'colour=green', 'colour=red')
    >>> import pandas as pd
    >>> looks_at.encode(pd.DataFrame({"x": [0.5, 2], "colour": ["red", "blue"]}))
    array([[0.5, 0. , 1. ],
           [2. , 0. , 0. ]])
    """

    columns: tuple[str, ...]
    """Their names."""
    categories: Categories = field(default_factory=dict)
    """Of the text columns."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each feature: that of a numeric column, or ``column=category``."""
        each = zip(self.columns, self._indicated, strict=True)
        return tuple(name if one is None else f"{name}={one}" for name, some in each for one in some)

    @property
    def sources(self) -> tuple[str, ...]:
        """Column that each feature comes from."""
        return tuple(name for name, some in zip(self.columns, self._indicated, strict=True) for _ in some)

    @property
    def num_features(self) -> int:
        """Number F of features."""
        return len(self.sources)

    def encode(self, frame: Frame) -> Float[np.ndarray, "m F"]:
        """Encode each row as numbers."""
        missing = [name for name in self.columns if name not in frame.columns]
        if missing:
            there = ", ".join(map(str, frame.columns)) + did_you_mean(missing[0], frame.columns)
            raise LogError(f"covariate {missing[0]!r} is missing; the columns are {there}")
        if not frame.columns.is_unique:
            twice = next((name for name in frame.columns[frame.columns.duplicated()] if name in self.columns), None)
            if twice is not None:
                raise LogError(f"there are two columns {twice!r}; drop or rename one")
        numeric = [name for name in self.columns if name not in self.categories]
        numbers = _numbers(frame, numeric)
        if len(numeric) == len(self.columns):
            return numbers
        features, source = np.empty((len(frame), self.num_features)), np.array(self.sources)
        features[:, np.isin(source, numeric)] = numbers
        for name in self.columns:
            if name in self.categories:
                indicated = np.arange(1, len(self.categories[name]))
                features[:, source == name] = self.codes(frame, name)[:, None] == indicated
        return features

    def knows(self, frame: Frame) -> Bool[np.ndarray, " m"]:
        """Which rows show no category but those that are known.

        Examples
        --------
        >>> import pandas as pd
        >>> Covariates(("colour",), {"colour": ("blue", "red")}).knows(pd.DataFrame({"colour": ["red", "green"]}))
        array([ True, False])
        """
        is_known = np.ones(len(frame), dtype=bool)
        for name in self.columns:
            if name in self.categories and name in frame.columns:
                is_known &= frame[name].astype(object).map(str).isin(self.categories[name]).to_numpy()
        return is_known

    def encode_known(self, rows: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "m F"]:
        """Encode values as `encode` does, without checks: each must be a number or a known category.

        Examples
        --------
        >>> Covariates(("x", "colour"), {"colour": ("blue", "red")}).encode_known([{"x": 2, "colour": "red"}])
        array([[2., 1.]])
        """
        each = list(zip(self.columns, self._indicated, strict=True))
        numbers = [
            [row[name] if one is None else row[name] == one for name, some in each for one in some] for row in rows
        ]
        return np.array(numbers, dtype=np.float64).reshape(len(rows), -1)

    def is_known(self, name: str, value: Any) -> bool:
        """Whether a value of a column is a Python number that `encode` takes, or text of a known category."""
        if name in self.categories:
            return type(value) is str and value in self.categories[name]
        return type(value) in (bool, int, float) and abs(value) <= LARGEST

    @property
    def _indicated(self) -> list[tuple[str | None, ...]]:
        """For each column, the categories that have an indicator; None for a numeric column."""
        return [self.categories[name][1:] if name in self.categories else (None,) for name in self.columns]

    def codes(self, frame: Frame, column: str) -> np.ndarray:
        """Code of the category of each row, from 0."""
        import pandas as pd

        from halfseen.logs.columns import value_at
        from halfseen.suggestions import alike, spelled_out

        values: Any = frame[column]
        is_null = values.isna().to_numpy()
        if is_null.any():
            where = _place(frame, int(np.argmax(is_null)))
            raise LogError(f"{where}: covariate {column!r} is null; fill it in, or learn with --missing")
        known = self.categories[column]
        codes = pd.Index(known, dtype=object).get_indexer(values.astype(object).map(str))
        if (codes < 0).any():
            row = int(np.argmax(codes < 0))
            value = str(value_at(frame, column, row))
            for same in (same for same in alike([*known, value]) if value in same):
                both = " and ".join(spelled_out(same))
                raise LogError(
                    f"{_place(frame, row)}: covariate {column!r}: {both} differ only in spelling, and the "
                    "training log never has both; write it as that log does"
                )
            raise LogError(
                f"{_place(frame, row)}: covariate {column!r} is {value!r}, which the training log lacks; give "
                f"one of {_listed(known)}, or learn again from logs with {value!r}"
            )
        return codes


def check_numeric(frame: Frame, columns: "Iterable[str]") -> None:
    """Refuse columns, those that a table has, of values that are no numbers (`LogError`)."""
    for name in (name for name in columns if name in frame and not is_numeric(frame, name)):
        is_given = frame[name].notna().to_numpy()
        if is_given.any():
            row = int(is_given.argmax())
            value = frame[name].iloc[[row]].tolist()[0]
            raise LogError(f"{_place(frame, row)}: covariate {name!r} is not numeric, but {value!r}; give numbers")


def _numbers(frame: Frame, columns: list[str]) -> Float[np.ndarray, "m F"]:
    check_numeric(frame, columns)
    values = frame[columns].to_numpy(dtype=np.float64, na_value=np.nan)
    wrong = np.argwhere(~(np.abs(values) <= LARGEST))
    if len(wrong):
        row, column = wrong[0]
        what = f"covariate {columns[column]!r} is {values[row, column]}"
        raise LogError(f"{_place(frame, int(row))}: {what}; give a finite number of at most {LARGEST:g}")
    return values


def is_numeric(frame: Frame, column: str) -> bool:
    """Whether a column holds real numbers."""
    from pandas.api.types import is_complex_dtype, is_numeric_dtype

    return is_numeric_dtype(frame[column].dtype) and not is_complex_dtype(frame[column].dtype)


def kind_of(frame: Frame, column: str) -> str | None:
    """Type of a column of neither numbers nor text; None for these two."""
    from pandas.api.types import infer_dtype

    kind = None if is_numeric(frame, column) else infer_dtype(frame[column], skipna=True)
    return None if kind in _TEXT else kind


def _place(frame: Frame, row: int) -> str:
    """Trajectory and stage of a row, if the frame has them."""
    from halfseen.logs.columns import place

    named = tuple(name for name in ("trajectory", "stage") if name in frame.columns)
    return place(frame, row, named) if named else f"row {row}"


def _listed(known: Sequence[str]) -> str:
    more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
    return ", ".join(map(repr, known[:_MOST_NAMED])) + more


def learned_categories(parts: "Iterable[Logs]", wanted: Sequence[str], known: Categories) -> dict[str, tuple[str, ...]]:
    """Find the categories of all usable text columns.

    Parameters
    ----------
    parts
        A log, in parts of whole trajectories.
    wanted
        Columns that must be usable if they hold text.
    known
        Given categories; they are kept.
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


def unfit_covariates(parts: "Iterable[Logs]") -> dict[str, str]:
    """Return the unusable covariates of the stages of a log, whole or in parts, each with the reason."""
    troubles = {name: _trouble(seen) for name, seen in _surveyed(parts, {}).items()}
    return {name: trouble for name, trouble in troubles.items() if trouble is not None}


def fit_covariates(logs: "Logs") -> list[str]:
    """Names of the usable covariates of the stages: numbers, and text of few categories."""
    unfit = unfit_covariates([logs])
    return [name for name in logs.stage_covariates if name not in unfit]


def _surveyed(parts: "Iterable[Logs]", known: Categories) -> dict[str, _Seen]:
    """Survey all columns that are not numeric."""
    found: dict[str, _Seen] = {}
    for part in parts:
        texts = [name for name in part.stage_covariates if name not in known and not is_numeric(part.stages, name)]
        if not texts:
            # A column that is numeric in one part is numeric in all.
            break
        for name in texts:
            before, now = found.get(name, Counter()), _look(part, name)
            if isinstance(before, str) or isinstance(now, str):
                found[name] = before if isinstance(before, str) else now
            elif len(both := before + now) > MOST_CATEGORIES:
                found[name] = f"has more than {MOST_CATEGORIES} categories; group them into fewer, or leave it out"
            else:
                found[name] = both
    return found


def _look(logs: "Logs", column: str) -> _Seen:
    values: Any = logs.stages[column]
    kind = kind_of(logs.stages, column)
    if kind is not None:
        return f"holds {kind}, neither numbers nor text; give one of these, or leave it out"
    is_null = values.isna().to_numpy()
    if is_null.any():
        where = _place(logs.stages, int(np.argmax(is_null)))
        return f"is null at {where}; {remedy_of(column)}"
    pairs: Any = logs.stages[["trajectory", column]].astype({column: object}).drop_duplicates()
    return Counter(pairs[column].map(str))


def _trouble(seen: _Seen) -> str | None:
    """Why a column is unusable."""
    if isinstance(seen, str):
        return seen
    if len(seen) == 1:
        return f"is {next(iter(seen))!r} in every stage, so it carries no information; leave it out"
    if max(seen.values()) == 1:
        return "has no category that two trajectories share, so it only identifies trajectories; leave it out"
    return None
