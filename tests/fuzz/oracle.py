"""What came of a case: refused in one clear line, right, or a fault."""

import json
import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NoReturn

from fuzz.cases import Case

OUTPUTS = ("--out", "--record", "--clouds", "--export", "--picture", "--onnx")
REFUSED, RIGHT = "refused", "right"
LONGEST_LINE = 1250
"""Characters of a line that a person reads."""
MOST_GROWN_MB = 2000
UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
NETS = ("check that it exists and can be read", "nested too deeply to be read", "give less at once")
"""How lines end that nobody foresaw."""
FROM_INSIDE = re.compile(
    r"object has no attribute|not subscriptable|unhashable|index out of (range|bounds)|Traceback|takes \d+ positional"
    r"|validation error for|not supported between|unsupported operand|could not be broadcast|must be real number|assert"
    r"|expected .* got .*Type|<class|<function| object at 0x|NoneType"
)
"""What reads as if a library spoke to a programmer."""


@dataclass(frozen=True)
class Outcome:
    """What a command line did."""

    status: int | None
    out: str = ""
    err: str = ""
    seconds: float = 0.0
    grown_mb: float = 0.0
    changed: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    death: str = ""
    traceback: str = field(default="", repr=False)
    netted: str = field(default="", repr=False)


def judged(case: Case, outcome: Outcome, answer: str | None) -> tuple[str, str]:
    """Say what came of a case, and what speaks for that."""
    lines = outcome.err.splitlines()
    faults = {
        outcome.death: bool(outcome.death),
        "traceback": bool(outcome.traceback) or "Traceback (most recent" in outcome.err,
        "status": outcome.status not in (0, 2),
        "memory": outcome.grown_mb > MOST_GROWN_MB,
        "input changed": bool(outcome.changed) and not _writes_into_input(case),
        "left behind": any(outcome.status == 2 or not _is_named(name, case) for name in outcome.left),
        "another's line": any(not line.startswith("halfseen: ") for line in lines),
        "escape code": bool(UNPRINTABLE.search(outcome.out + outcome.err)),
        "long line": any(len(line) > LONGEST_LINE for line in lines),
        "net": any(net in outcome.err for net in NETS),
        "from inside": bool(FROM_INSIDE.search(outcome.err)),
        "no one line": outcome.status == 2 and not _is_one_line(case, outcome),
        "no JSON": outcome.status == 0 and _asks_for_json(case) and not is_json(outcome.out),
        "another answer": answer is not None and (outcome.status, outcome.out) != (0, answer),
    }
    for fault, is_so in faults.items():
        if is_so:
            return f"fault: {fault}", _evidence(fault, outcome)
    return (RIGHT, "") if outcome.status == 0 else (REFUSED, outcome.err.strip())


def is_json(text: str) -> bool:
    """Whether a text is JSON, or lines of it, whose numbers are finite."""
    try:
        json.loads(text, parse_constant=_refuse)
    except ValueError:
        return False
    return True


def _is_named(name: str, case: Case) -> bool:
    """Whether a command line says that this is written."""
    return any(word.removeprefix("csv:").split("/")[0] == name for word in case.words)


def _writes_into_input(case: Case) -> bool:
    """Whether the words ask for an output in the folder of the input."""
    return any(before in OUTPUTS and word.startswith("in") for before, word in pairwise(case.words))


def _asks_for_json(case: Case) -> bool:
    options = {before for before, word in pairwise(case.words) if word == "--json"}
    is_value = any(before.startswith("-") and before not in ("--no-verdict", "-q", "--json") for before in options)
    others = {"--help", "-h", "--mapping-template", "--version"} & set(case.words)
    return "--json" in case.words and not is_value and not others


def _is_one_line(case: Case, outcome: Outcome) -> bool:
    """Of several clouds each has a line, and what was seen of the others is said; warnings may stand above the line."""
    is_of_many = case.words[:1] == ("look",)
    return (is_of_many or outcome.out == "") and outcome.err.endswith("\n") and outcome.err != "\n"


def _evidence(fault: str, outcome: Outcome) -> str:
    explained: dict[str, Any] = {
        "memory": f"{outcome.grown_mb:.0f} MB; {outcome.err[-300:]}",
        "hang": f"{outcome.seconds:.0f} s",
        "input changed": ", ".join(outcome.changed),
        "left behind": f"{', '.join(outcome.left)}; {outcome.err[-300:]}",
        "traceback": outcome.traceback[-2000:] or outcome.err[-2000:],
        "no JSON": outcome.out[-300:],
        "another answer": f"{outcome.err[-500:]} {outcome.out[:300]}",
    }
    return explained.get(fault) or f"{outcome.err[-1500:]}{outcome.netted}"


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
