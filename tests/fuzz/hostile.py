"""Values that readers meet and rarely expect."""

from typing import Any

import numpy as np

LONG = "n" * 300
NUMBERS = (
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 1e39, 1e-320, -0.0, 0, 1, -1, 0.5, 2, 1e6, 1e9),
    *(2**31, 2**53 + 1, 2**63 - 1, 2**63, -(2**63), 2**64, 10**30),
)
WORDS = (
    *("", " ", "\x00", "\x1b[31mred\x1b[0m", "\ud800", "\u202eabc", "a\nb", "nan", "NaN", "None", "é" * 40, LONG),
    *("../../etc/passwd", "/dev/zero", "%s%n{0}", "=1+1", "A", "LIFT", "WASH", "FINISH", "cut", "finished", "TABLE"),
)
IN_TEXT = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "-1", "0", "1", "2", "1e9", "0x10", "1_0", "01", "\u0661"),
    *("9" * 400, "4294967296", "9223372036854775808", "-9223372036854775809", "1.5", "", "true", "null", "[]", "{}"),
    *('"a"', "\x1b[31m", "\x00", LONG, "[" * 200, "é", "w" * 140_000),
)
IN_TEXT_BYTES = (*(word.encode() for word in IN_TEXT), b"\xff\xfe", b"\xed\xa0\x80")
FOR_OPTIONS = (
    *("nan", "inf", "-inf", "1e308", "1e-308", "-1", "0", "1", "2", "0.5", "1.5", "1000000000000", "1e400", "0x10"),
    *("9223372036854775808", "-9223372036854775809", "9" * 400, "", " ", "nope", "\x1b[31mred", LONG, "1,2", "a,b"),
    *("../x", "/dev/zero", "/dev/null", "/dev/null/x", "in", "in/none", "x1", "x1,x1", "\u0661", "--", "-", ".", "é"),
)


def nested(depth: int) -> list[Any]:
    """Lists in lists."""
    inner: list[Any] = []
    for _ in range(depth):
        inner = [inner]
    return inner


def any_value(rng: np.random.Generator) -> Any:
    """A value of any kind that JSON has."""
    kind = rng.integers(8)
    if kind < 3:
        return pick(rng, NUMBERS)
    if kind < 5:
        return pick(rng, WORDS)
    others = (None, True, False, [], {}, [None], {"a": 1}, [0.0] * 5, [0] * 100_000, nested(30), nested(100), [[[]]])
    return pick(rng, others)


def pick(rng: np.random.Generator, choices: Any) -> Any:
    """One of some; of a tuple or list of anything, which NumPy would make an array."""
    return choices[int(rng.integers(len(choices)))]
