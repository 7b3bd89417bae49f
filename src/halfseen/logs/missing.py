"""Imputation of missing covariates of the stages: a rule for each column, fitted to the log.

``"refuse"`` is the default. ``"median+flag"`` fills in the median of the log, and adds a column ``NAME_missing`` that
is 1 in such rows; for text, it fills in the separate category ``"missing"``. ``"last"`` fills in the last value of the
same trajectory; before the first value, it acts like ``"median+flag"`` without a flag. ``"keep"`` leaves all nulls, to
rewrite a log; nothing can be learned from such a log. The right rule depends on why values are missing
[LittleRubin2019]_. A flag is part of the state if the decision lacked the value, too.

Nulls are filled in when a log is read. A policy keeps its `Filling`, and fills in its states in the same way.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import repeat
from typing import Any, Literal, TypeAlias

import numpy as np

from halfseen.errors import ArgumentError, LogError, did_you_mean, warn
from halfseen.lazy import Frame

REFUSE, MEDIAN, LAST, KEEP = "refuse", "median+flag", "last", "keep"
RULES = (MEDIAN, LAST, REFUSE)
OTHERS = "*"
"""Key of the rule for all columns that are not named."""
CATEGORY, FLAG = "missing", "_missing"
_LARGEST = 1e300


@dataclass(frozen=True)
class Fill:
    """Fill value of one covariate."""

    rule: Literal["median+flag", "last"]
    value: float | str | None
    """The median, or the category for missing text; None for text that was never missing in the log."""
    num_missing: int = 0
    """Number of stages of the log in which it was missing."""
    has_flag: bool = False
    """Whether a column marks where it was missing."""

    def __post_init__(self) -> None:
        if isinstance(self.value, float) and not np.isfinite(self.value):
            raise ValueError(f"value is {self.value}, but numbers must be finite")
        if self.num_missing < 0 or (self.has_flag and not self.is_number):
            raise ValueError(f"num_missing is {self.num_missing}, has_flag {self.has_flag}; only numbers have a flag")

    @property
    def is_number(self) -> bool:
        """Whether the covariate holds numbers."""
        return isinstance(self.value, float)

    @property
    def source(self) -> str:
        """Description of its value."""
        return "the median of the logs" if self.is_number else "a category of its own"

    @property
    def stands(self) -> str:
        """Describe how it is filled in."""
        value = f"the median {self.value:.6g}" if self.is_number else f"the category {self.value!r}"
        return f"the last value of its trajectory, or {value}" if self.rule == LAST else value


@dataclass(frozen=True)
class Filling:
    """Fill values of all covariates with missing values.

    Examples
    --------
    >>> filling = Filling({"x": Fill("median+flag", 0.5, num_missing=3, has_flag=True)}, num_stages=100)
    >>> filling.of_state({"x": None, "y": 2.0}, ["x", "x_missing", "y"])[0]
    {'x': 0.5, 'y': 2.0, 'x_missing': 1}
    """

    fills: Mapping[str, Fill]
    num_stages: int
    """Number of stages of the log that it was fitted to."""

    def __post_init__(self) -> None:
        if self.num_stages < 1:
            raise ValueError(f"num_stages is {self.num_stages}; a log has at least one")

    @property
    def flags(self) -> dict[str, str]:
        """Columns that mark where a covariate was missing, each with that covariate."""
        return {name + FLAG: name for name, fill in self.fills.items() if fill.has_flag}

    def of_log(self, stages: Frame) -> Frame:
        """Fill in the stages of whole trajectories, sorted by trajectory and stage; warn of each absent column.

        Raises
        ------
        LogError
            A covariate holds text where the fill value is a number, or vice versa.
        """
        columns: dict[str, Any] = {}
        absent = self.absent_from(stages.columns)
        for name in absent:
            warn("stages", f"there is no column {name!r}; it is replaced by {self.fills[name].stands} in every stage")
        full = stages.assign(**dict.fromkeys(absent)) if absent else stages
        for name in (name for name in self.fills if name in full.columns):
            columns |= _filled(full, name, self.fills[name], full["trajectory"])
        return full.assign(**columns) if columns else full

    def absent_from(self, columns: Collection[str]) -> list[str]:
        """Covariates that are not columns of a log but have a fill value."""
        return [name for name, fill in self.fills.items() if name not in columns and fill.value is not None]

    def of_states(self, frame: Frame, names: Collection[str]) -> Frame:
        """Fill in states without a history like `of_log`; any of `names` without a column is missing in all states."""
        columns: dict[str, Any] = {}
        for name, fill in self.fills.items():
            if name in names or name + FLAG in names:
                there = frame if name in frame.columns else frame.assign(**{name: None})
                columns |= {name: there[name]} | _filled(there, name, fill, None)
        return frame.assign(**columns) if columns else frame

    def of_state(
        self, state: Mapping[str, Any], names: Collection[str], last: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, str]]:
        """Fill in one state.

        Parameters
        ----------
        state
            Covariates by name; a missing one is None, NaN or absent.
        names
            Covariates that the decision uses.
        last
            Covariates of the stage before in the same trajectory, filled in; None if there is none.

        Returns
        -------
        dict, dict
            The state, with flags of what was missing; and for each missing covariate, a sentence about its fill value.
        """
        full, said = dict(state), {}
        for name, fill in self.fills.items():
            if name not in state and name not in names and name + FLAG not in names:
                continue
            is_null = _is_null(state.get(name))
            if is_null:
                carried = None if fill.rule != LAST or last is None else last.get(name)
                value, source = (fill.value, fill.source) if _is_null(carried) else (carried, "its last value")
                if value is None:
                    continue
                full[name] = value
                shown = f"{value:.6g}" if isinstance(value, int | float) else repr(value)
                said[name] = f"{name} is missing and is replaced by {shown}, {source}"
            elif fill.is_number and isinstance(state[name], bool):
                # If the fill value is a median, convert truth values to numbers.
                full[name] = float(state[name])
            if fill.has_flag:
                full[name + FLAG] = int(is_null or bool(full.get(name + FLAG)))
        return full, said

    def lines(self) -> list[str]:
        """Report for each covariate with missing values how often it was missing, and how it is filled in."""
        return [
            f"{name} is missing in {share_of(fill.num_missing, self.num_stages)}; it is replaced by {fill.stands}"
            for name, fill in self.fills.items()
            if fill.num_missing
        ]


Missing: TypeAlias = str | Mapping[str, str | Fill] | Filling | None
"""A rule for all covariates, rules or fills by covariate (``"*"`` for all others), or a fitted filling."""


def is_flag(name: str, names: Collection[str]) -> bool:
    """Whether a column is the missing flag of one of these."""
    return name.endswith(FLAG) and name.removesuffix(FLAG) in names


def share_of(num_missing: int, num_stages: int) -> str:
    """Format the number of stages without a covariate: 12 of 400 stages (3 %)."""
    return f"{num_missing:,} of {num_stages:,} stages ({float(f'{100.0 * num_missing / num_stages:.2g}'):g} %)"


def remedy_of(name: str) -> str:
    """The remedy for nulls in a covariate."""
    return (
        f"fill it in by --missing {name}={MEDIAN} (Python: missing={{{name!r}: {MEDIAN!r}}}), or with the rule {LAST}, "
        f"or leave column {name!r} of stages out"
    )


def missing_in(stages: Frame, covariates: Collection[str]) -> dict[str, int]:
    """Count the stages without each covariate; only covariates with nulls are returned."""
    counts: Any = stages[list(covariates)].isna().sum()
    return {str(name): int(count) for name, count in counts.items() if count}


def rules_of(missing: Missing) -> dict[str, str | Fill]:
    """Normalise to rules by column, ``"*"`` for all others; columns without a rule are left out.

    Raises
    ------
    ArgumentError
        A rule is unknown.
    """
    if missing is None:
        return {}
    if isinstance(missing, Filling):
        return dict(missing.fills)
    if not isinstance(missing, str | Mapping):
        raise ArgumentError(f"missing is {missing!r}; give one of {', '.join(RULES)}, or a dict of these by column")
    rules: dict[str, str | Fill] = {OTHERS: missing} if isinstance(missing, str) else dict(missing)
    for name, rule in rules.items():
        if not isinstance(rule, Fill) and rule not in RULES:
            where = "missing" if name == OTHERS else f"missing of {name!r}"
            close = did_you_mean(rule, RULES) if isinstance(rule, str) else ""
            raise ArgumentError(f"{where} is {rule!r}; choose among {', '.join(RULES)}{close}")
    return rules


Column: TypeAlias = Callable[[str], Iterable[Any]]
"""Returns the values of a column of the stages, in parts."""


def learned_filling(missing: Missing, covariates: Collection[str], column: Column, num_stages: int) -> Filling | None:
    """Fit the fill values of the covariates to a log; None if all nulls are refused.

    Parameters
    ----------
    missing
        Rules; a `Filling` is returned unchanged.
    covariates
        Names of the covariates of the stages.
    column
        Returns their values.
    num_stages
        Number of stages of the log.

    Raises
    ------
    ArgumentError
        A rule is unknown, or names no covariate.
    LogError
        A covariate is null in every stage, or has a rule but holds neither numbers nor text.
    """
    if isinstance(missing, Filling):
        return missing
    rules = rules_of(missing)
    unknown = [name for name, rule in rules.items() if name not in covariates and name != OTHERS and rule in RULES]
    if unknown:
        there = (", ".join(covariates) or "none") + did_you_mean(unknown[0], covariates)
        raise ArgumentError(f"missing names {unknown[0]!r}; the stages have {there}")
    fills = {name: rule for name, rule in rules.items() if isinstance(rule, Fill)}
    flags = {name + FLAG for name in covariates}
    for name in covariates:
        rule = rules.get(name, REFUSE if name in flags else rules.get(OTHERS, REFUSE))
        if rule in (MEDIAN, LAST):
            is_flagged = rule == MEDIAN and name + FLAG in covariates and all(map(_is_flag, column(name + FLAG)))
            fill = _learned(name, rule, column(name), column(name + FLAG) if is_flagged else None)
            if fill is not None:
                fills[name] = fill
            elif name in rules:
                raise LogError(
                    f"covariate {name} holds neither numbers nor text, which no rule can fill in; leave it out"
                )
    ordered = {name: fills[name] for name in (*covariates, *fills) if name in fills}
    return Filling(ordered, num_stages) if fills else None


def _learned(name: str, rule: Any, parts: Iterable[Any], flags: Iterable[Any] | None) -> Fill | None:
    """Fit the fill value of a column; None if it holds neither numbers nor text."""
    numbers, num_rows, num_missing, is_text = [], 0, 0, False
    flagged = repeat(None) if flags is None else iter(flags)
    for values in parts:
        kind, is_null = _kind(values), values.isna().to_numpy(dtype=bool)
        if kind is None:
            return None
        was_missing = is_null | _said(next(flagged))
        num_rows, num_missing = num_rows + len(values), num_missing + int(was_missing.sum())
        is_text |= kind == "text"
        if kind == "number":
            numbers.append(_numbers(values)[~was_missing])
    if num_missing == num_rows:
        raise LogError(
            f"covariate {name} is null in every one of the {num_rows:,} stages, so no value can replace it; leave "
            f"column {name!r} of stages out; of a converted table, leave it out of the mapping"
        )
    if is_text:
        return Fill(rule, CATEGORY if num_missing else None, num_missing)
    # Larger or infinite values are refused later.
    median = float(np.median(np.clip(np.concatenate(numbers), -_LARGEST, _LARGEST)))
    return Fill(rule, median, num_missing, has_flag=rule == MEDIAN and (num_missing > 0 or flags is not None))


def _said(flags: Any) -> Any:
    """Where a flag column marks another as missing; False if there is none."""
    return False if flags is None else flags.to_numpy(dtype=bool)


def _is_flag(values: Any) -> bool:
    """Whether a column holds only 0 and 1, as in a log that was filled in before."""
    return all(value in (0, 1) for value in values.unique().tolist())


def _filled(frame: Frame, name: str, fill: Fill, trajectory: Any) -> dict[str, Any]:
    """The filled-in column and its flag; empty if nothing changes."""
    import pandas as pd

    values: Any = frame[name]
    kind, is_null = _kind(values), values.isna().to_numpy(dtype=bool)
    if kind not in ("null", "number" if fill.is_number else "text"):
        said = "number" if fill.is_number else "text"
        raise LogError(f"covariate {name} holds {kind or 'lists'}, but missing values are filled with a {said}")
    columns: dict[str, Any] = {}
    if is_null.any() or (fill.num_missing and fill.is_number):
        plain = pd.Series(_numbers(values), index=frame.index) if fill.is_number else values.astype(object)
        if fill.rule == LAST and trajectory is not None:
            plain = plain.groupby(trajectory.to_numpy()).ffill()
        columns[name] = plain if fill.value is None else plain.where(plain.notna(), fill.value)
    if fill.has_flag and (is_null.any() or name + FLAG not in frame.columns):
        before = frame[name + FLAG] if name + FLAG in frame.columns else None
        if before is not None and not _is_flag(before):
            raise LogError(
                f"covariate {name + FLAG} has values other than 0 and 1, with which the rule {MEDIAN} marks where "
                f"{name} is missing; rename it, or choose another rule for {name}"
            )
        columns[name + FLAG] = pd.Series((is_null | _said(before)).astype(np.int64), index=frame.index)
    return columns


def _kind(values: Any) -> str | None:
    """Content of a column: number, text, or null if all are null; None for anything else."""
    from pandas.api.types import infer_dtype, is_numeric_dtype

    if is_numeric_dtype(values.dtype):
        return "number"
    return {"boolean": "number", "string": "text", "categorical": "text", "empty": "null"}.get(
        infer_dtype(values, skipna=True)
    )


def _numbers(values: Any) -> np.ndarray:
    """Numbers and truth values as float64, null as NaN."""
    from pandas.api.types import is_numeric_dtype

    plain = values if is_numeric_dtype(values.dtype) else values.astype("boolean")
    return plain.to_numpy(dtype=np.float64, na_value=np.nan)


def _is_null(value: Any) -> bool:
    return value is None or (isinstance(value, float) and bool(value != value))
