"""Checks for values that stand for others: -999 for a missing number, 255 for a -1 without a sign, 1 for true."""

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.logs.columns import shown
from halfseen.logs.grouping import can_be_counted, covariate_columns, is_number
from halfseen.logs.logs import Logs

FEWEST_CODES, FEWEST_OTHERS, FEWEST_KINDS = 3, 30, 3
"""Least numbers of rows with a code, of rows without it, and of different values in the latter."""
CODES = (-99.0, -999.0, -9999.0, -99999.0, -32768.0, 999.0, 9999.0, 99999.0, 32767.0, 65535.0, 1e30)
"""Numbers that programs and sensors write where nothing was measured, beside -1."""
UNSIGNED = tuple(2.0**bits - 1.0 for bits in (8, 16, 32, 64))
"""What -1 becomes in a type of whole numbers without a sign."""
TRUTHS = ("true", "t", "yes", "1", "1.0", "false", "f", "no", "0", "0.0")


def missing_codes(logs: Logs) -> Iterator[str]:
    """Find covariates with a number that often stands for nothing, and lies apart from all others."""
    for name, values, _ in covariate_columns(logs):
        for words, code in _apart(name, values, {-1.0, *CODES}):
            remedy = "leave it empty, and choose a fill rule with --missing"
            yield f"{words}: if {code:g} means missing, {remedy}"


def lost_signs(logs: Logs) -> Iterator[str]:
    """Find rewards and covariates with a number that -1 becomes without a sign, apart from all others."""
    columns = [("reward", logs.stages["reward"]), *((name, values) for name, values, _ in covariate_columns(logs))]
    for name, values in columns:
        for words, _ in _apart(name, values.dropna(), {*UNSIGNED} - {*CODES} if name != "reward" else {*UNSIGNED}):
            yield f"{words}: was -1 written in a type without a sign?"


def _apart(name: str, values: Any, codes: Collection[float]) -> Iterator[tuple[str, float]]:
    """Describe each code that lies apart from all other numbers of a column."""
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan) if is_number(values) else np.zeros(0)
    numbers = numbers[np.isfinite(numbers)]
    for code in sorted({numbers.min(initial=0.0), numbers.max(initial=0.0)} & {*codes}):
        others = numbers[numbers != code]
        if len(numbers) - len(others) >= FEWEST_CODES and _is_apart(float(code), others):
            range_ = f"{others.min():.3g} to {others.max():.3g} in all others"
            yield (
                f"{name} is {code:.10g} in {len(numbers) - len(others)} of {len(values)} rows, and {range_}",
                float(code),
            )


def _is_apart(code: float, others: Rows) -> bool:
    """Whether a code is the only negative number, and -1 among fractions; or farther from others than these range."""
    if len(others) < FEWEST_OTHERS or len(np.unique(others)) < FEWEST_KINDS:
        return False
    is_only_negative = code < 0.0 <= others.min() and (code != -1.0 or (others % 1.0 != 0.0).mean() > 0.5)
    return bool(is_only_negative or (code != -1.0 and np.abs(others - code).min() > np.ptp(others)))


def mixed_truths(logs: Logs) -> Iterator[str]:
    """Find text in which true, or false, is written in two ways, such as True and 1."""
    for name, values, _ in covariate_columns(logs):
        kinds = values.dropna().unique().tolist() if not is_number(values) and can_be_counted(values) else []
        words = {each.lower() for each in kinds if isinstance(each, str)}
        if 2 < len(words) <= len(TRUTHS) and words <= {*TRUTHS}:
            yield f"{name} is {' and '.join(map(shown, kinds))}, each of which counts as a category: write them alike"
