"""Checks for values that stand for others: -999 for a missing number, 255 for a -1 without a sign, 1 for true."""

from collections.abc import Iterator

import numpy as np

from halfseen.arrays import Rows
from halfseen.logs.columns import shown
from halfseen.logs.grouping import can_be_counted, covariate_columns, is_number
from halfseen.logs.logs import Logs

FEWEST, FEWEST_OTHERS, FEWEST_KINDS, MOST_SHARE = 3, 30, 3, 0.5
"""Least number of rows with a code, of rows without it, and of different values in the latter; and the largest share
of a suspect number."""
MARKS = {2.0**bits - less for bits in (15, 16, 31, 32, 63, 64) for less in (0.0, 1.0)} | {1e30}
"""Sizes of numbers that programs and sensors write where nothing was measured, besides those of nines and -1."""
UNSIGNED = tuple(2.0**bits - 1.0 for bits in (8, 16, 32, 64))
"""What -1 becomes in a type of whole numbers without a sign."""
FAR_MARK, FAR = 10.0, 1000.0
"""Least distance of a mark that was written once, and of any number, from all others, in ranges of these."""
TRUTHS = ("true", "t", "yes", "1", "1.0", "false", "f", "no", "0", "0.0")


def stand_ins(logs: Logs) -> Iterator[str]:
    """Find the least or largest number of a column if it lies apart from all others, and may stand for no value."""
    columns = [("reward", logs.stages["reward"]), *((name, values) for name, values, _ in covariate_columns(logs))]
    for name, values in columns:
        numbers = values.to_numpy(dtype=np.float64, na_value=np.nan) if is_number(values) else np.zeros(0)
        numbers = numbers[np.isfinite(numbers)]
        for number in np.unique(numbers)[[0, -1]] if len(numbers) else ():
            others = numbers[numbers != number]
            doubt = _doubt(float(number), len(numbers) - len(others), others, is_reward=name == "reward")
            if doubt:
                where = f"{number:.10g} in {len(numbers) - len(others)} of {len(numbers)} rows"
                yield f"{name} is {where}, and {others.min():.3g} to {others.max():.3g} in all others: {doubt}"


def _doubt(number: float, count: int, others: Rows, *, is_reward: bool) -> str:
    """Say what a number may stand for; "" if nothing speaks for that."""
    num_kinds = len(np.unique(others))
    if len(others) < FEWEST_OTHERS or num_kinds < 2 or count > MOST_SHARE * (count + len(others)):
        return ""
    distance, reach, is_mark = np.abs(others - number).min(), np.ptp(others), _is_mark(number)
    is_code = count >= FEWEST and num_kinds >= FEWEST_KINDS
    if is_code and distance > reach and number in UNSIGNED and (is_reward or not is_mark):
        return "was -1 written in a type without a sign?"
    is_far = distance > (FAR_MARK if is_mark else FAR) * reach
    if is_reward:
        # Success may pay far more than a step does.
        is_earned = count > 1 and not is_mark
        return "it decides what is learned; if it was not earned, mend it or leave it out" if is_far > is_earned else ""
    is_only_negative = number < 0.0 <= others.min()
    is_far |= is_code and is_mark and (is_only_negative or distance > reach)
    is_far |= is_code and number == -1.0 and is_only_negative and (others % 1.0 != 0.0).mean() > 0.5
    return "if that means missing, leave it empty, and choose a fill rule with --missing" if is_far else ""


def _is_mark(number: float) -> bool:
    size = abs(number)
    return size in MARKS or (size >= 99.0 and set(f"{size:.15g}") == {"9"})


def mixed_truths(logs: Logs) -> Iterator[str]:
    """Find text in which true, or false, is written in two ways, such as True and 1."""
    for name, values, _ in covariate_columns(logs):
        kinds = values.dropna().unique().tolist() if not is_number(values) and can_be_counted(values) else []
        words = {each.lower() for each in kinds if isinstance(each, str)}
        if 2 < len(words) <= len(TRUTHS) and words <= {*TRUTHS}:
            yield f"{name} is {' and '.join(map(shown, kinds))}, each of which counts as a category: write them alike"
