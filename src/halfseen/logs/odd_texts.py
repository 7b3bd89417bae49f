"""Checks for texts of a log that mean something else: numbers, missing values, other spellings, dates made of names."""

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from halfseen.logs.columns import shown
from halfseen.logs.grouping import covariate_columns, is_number
from halfseen.logs.logs import Logs
from halfseen.suggestions import alike, spelled_out

NUM_NAMED, MOST_SPELLINGS, FEWEST_MEASURED, FEWEST_WHOLE = 3, 1000, 8, 21
AS_NUMBER = r"[+-]?(?:\d{1,3}(?:[.,'\u2019 ]\d{3})+(?:[.,]\d+)?|\d*[.,]\d+)"
"""A fraction, or a number with thousands separators."""
AS_MEASURED = re.compile(
    rf"(?:{AS_NUMBER}|[+-]?\d+) ?(?P<unit>%|°?[^\W\d_]{{1,4}})"
    r"|\d{1,4}:[0-5]\d(:[0-5]\d([.,]\d+)?)?|\d{4}-\d\d-\d\d([ T].*)?"
)
"""A number with a unit; a duration or time of day; or a date."""
_MONTH = "jan|feb|m[aä]r|mrz|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz]"
AS_DATE = re.compile(rf"\d{{4}}-\d\d-\d\d|\d{{1,2}}[-.] ?({_MONTH})|({_MONTH})[- ]\d\d", re.IGNORECASE)
"""A date as spreadsheet programs write it."""
READ_AS_MISSING = {"nan", "<na>", "null", "n/a", "#n/a", "#nv", "nat"}
"""Texts, in lower case, that programs write for what is missing; none and NA are names, too."""


def numbers_as_text(logs: Logs) -> Iterator[str]:
    """Find columns of text most of which are numbers, also of one unit, or times; a few of these may be names."""
    for name, values, _ in covariate_columns(logs):
        kinds = _kinds_of_text(values)
        numbers = [each for each in kinds if re.fullmatch(AS_NUMBER, each)]
        measured = {each: match["unit"] for each in kinds if (match := AS_MEASURED.fullmatch(each))}
        are_alike = len(measured) >= FEWEST_MEASURED and len({*measured.values()}) == 1
        numbers = [*measured] if are_alike else numbers
        whole = [each for each in kinds if re.fullmatch(r"[+-]?\d+", each)]
        most = 0.5 * sum(kinds.values())
        if sum(kinds[each] for each in numbers) > most:
            example = numbers[0]
            remedy = "write them as numbers, with a decimal point, and without separators and units"
        elif len(whole) >= FEWEST_WHOLE and sum(kinds[each] for each in whole) > most:
            example, remedy = whole[0], "if they are sizes, and no names, write them as numbers"
        else:
            continue
        trouble = f"looks like numbers, such as {shown(example)}, and each counts as a category"
        yield f"{name} is text that {trouble}: {remedy}"


def missing_as_text(logs: Logs) -> Iterator[str]:
    """Find texts that programs write for what is missing."""
    for name, values, _ in covariate_columns(logs):
        kinds = _kinds_of_text(values)
        missing = [each for each in kinds if each.strip().lower() in READ_AS_MISSING]
        if missing:
            yield (
                f"{name} is {shown(missing[0])} in {sum(kinds[each] for each in missing)} of {len(values)} rows, and "
                "counts as a category: if it means missing, leave it empty, and choose a fill rule with --missing"
            )


def _names(logs: Logs) -> Iterator[tuple[str, list[Any]]]:
    """The different causes, actions and texts of each covariate; none where they are too many for names."""
    names = [("causes", logs.trajectories["cause"]), ("actions", logs.stages["action"])]
    names += [(f"values of {name}", _texts(values)) for name, values, _ in covariate_columns(logs)]
    for what, values in names:
        found = values.dropna().unique().tolist()
        yield what, found if len(found) <= MOST_SPELLINGS else []


def spelling(logs: Logs) -> Iterator[str]:
    """Find names that differ only in their spelling."""
    for what, found in _names(logs):
        for same in (*alike(found), *_equal(found)):
            as_first = ", ".join(f"{json.dumps(other)} = {json.dumps(same[0])}" for other in same[1:])
            yield (
                f"{what} {listed(spelled_out(same))} differ only in their spelling: count them as one (in a mapping: "
                f"values = {{{as_first}}})"
            )


def _equal(names: Iterable[Any]) -> Iterator[list[str]]:
    """Group the names that are one number, such as 0.5 and 0.50."""
    numbers: dict[float, list[str]] = {}
    for name in sorted(name for name in names if isinstance(name, str) and re.fullmatch(r"-?\d+(\.\d+)?", name)):
        numbers.setdefault(float(name), []).append(name)
    yield from (same for same in numbers.values() if len(same) > 1)


def dates_among_names(logs: Logs) -> Iterator[str]:
    """Find dates among other names, as spreadsheet programs make of names such as MAR-1."""
    for what, found in _names(logs):
        dates = [name for name in found if isinstance(name, str) and AS_DATE.fullmatch(name)]
        if dates and 2 * len(dates) <= len(found):
            yield (
                f"{what} {listed(dates)} are dates, and others are not: a spreadsheet program makes dates of names "
                "such as MAR-1; restore what they were"
            )


def listed(names: Iterable[str]) -> str:
    """The first names, and how many more there are."""
    names = list(names)
    more = f" and {len(names) - NUM_NAMED} more" if len(names) > NUM_NAMED else ""
    return ", ".join(names[:NUM_NAMED]) + more


def _texts(values: Any) -> Any:
    """The text values of a column."""
    return values[:0] if is_number(values) else values[values.map(lambda each: isinstance(each, str)).astype(bool)]


def _kinds_of_text(values: Any) -> dict[str, int]:
    """How often each text occurs in a column, in order of appearance."""
    return _texts(values).value_counts(sort=False).to_dict()
