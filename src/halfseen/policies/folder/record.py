"""The schema of policy.json: what a policy looks at, its log and how it was learned, its importance weights.

What differs between kinds of policies is in `kinds` and `table_kinds`.
"""

import json
import re
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple

import halfseen
from halfseen.errors import PolicyError
from halfseen.reading import json_of

FORMAT, VERSION = "halfseen-policy", 2

Kind = Literal["flat", "table", "table-laws", "team", "team-laws"]
Of = TypeVar("Of")
Horizon = Annotated[int, Meta(ge=1)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Counts = dict[str, int]


class SeenStates(Struct):
    """The states of some stages: ranges of numbers, and counts of the categories of text.

    Margins are how far below and above its range a number may lie by chance.
    """

    stages: tuple[int, int]
    ranges: dict[str, tuple[float, float] | Counts]
    num_states: int = 0
    margins: dict[str, tuple[Annotated[float, Meta(ge=0.0)], Annotated[float, Meta(ge=0.0)]]] = {}

    def __post_init__(self) -> None:
        # msgspec 0.22 reads out of bounds if a tuple is in a union with a dict whose values are bounded.
        for name, seen in {"stages": self.stages, **self.ranges}.items():
            if min(seen.values(), default=0) < 1 if isinstance(seen, dict) else seen[0] > seen[1]:
                shown = seen if isinstance(seen, dict) else list(seen)
                raise ValueError(f"{name} is {shown}; a count is below 1, or it ends before it begins")


class Verdict(Struct):
    """Whether the learned policy beats the logging policy."""

    verdict: str
    reason: str
    sentence: str


class Distribution(Struct):
    """A distribution function at increasing values, or the shares of names."""

    values: list[float] | None = None
    below: list[Share] = []
    names: list[str] | None = None
    shares: list[Share] = []

    def __post_init__(self) -> None:
        places, shares = (self.names, self.shares) if self.values is None else (self.values, self.below)
        if not places or len(places) != len(shares) or (np.diff(self.values or []) <= 0.0).any():
            raise ValueError("it needs a share for each of its names, or of its values, which must rise")


class PromisedStage(Struct):
    """The states of one stage of a log."""

    stage: Horizon
    num_states: Horizon
    covariates: dict[str, Distribution]


class PromisedValue(Struct):
    """The value of a trajectory."""

    value: float
    low: float
    high: float
    standard_error: float

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)).all():
            raise ValueError(f"it holds {astuple(self)}; numbers must be finite")


class PromisedPart(Struct):
    """Reward or log duration of an action: linear coefficients, the intercept first, their covariance, residuals."""

    action: str
    what: Literal["reward", "duration"]
    num_states: Horizon
    coefficients: list[float]
    deviation: Annotated[float, Meta(ge=0.0)]
    covariance: list[list[float]]
    residuals: Distribution

    def __post_init__(self) -> None:
        if np.shape(self.covariance) != (len(self.coefficients),) * 2:
            raise ValueError("its covariance does not have the size of its coefficients")


class Unmoved(Struct):
    """Covariates that never changed from a stage to the next, and the number of such steps."""

    names: list[str]
    num: Annotated[int, Meta(ge=0)]


class Promise(Struct):
    """The states that a policy was learned for, its promised value there, and how its cell behaved.

    Older folders lack the fields that have a default here.
    """

    stages: list[PromisedStage]
    value: PromisedValue | None = None
    brings: tuple[float, float] | None = None
    parts: list[PromisedPart] = []
    first_states: list[list[float]] = []
    unmoved: Unmoved | None = None

    def __post_init__(self) -> None:
        if len({len(each) for each in self.first_states}) > 1:
            raise ValueError("its first_states have different numbers of covariates")
        if self.brings is not None and not self.brings[0] <= self.brings[1]:
            raise ValueError(f"brings is {list(self.brings)}; the least must come first")


class SourceLog(Struct):
    """A log that a policy was learned from, with its first and last trajectory."""

    name: str | None
    num_trajectories: Horizon
    first: int | float | str
    last: int | float | str


class LearnedFrom(Struct):
    """What a policy was learned from; older folders lack the fields that have a default here."""

    sentence: str
    sha256: str | None = None
    sources: list[SourceLog] = []


class Record(Struct):
    """Content of every policy.json; older folders lack the fields that have a default here."""

    kind: Kind
    schema: dict[str, Any]
    learner: dict[str, Any]
    log: LearnedFrom
    diagnostics: dict[str, Any]
    reg: dict[str, Any]
    versions: dict[str, Any]
    column_major: list[str]
    seen: list[SeenStates]
    warnings: list[str] = []
    verdict: Verdict | None = None
    promise: Promise | None = None
    reward_spread: Annotated[float, Meta(ge=0.0)] = 0.0
    stages_left: list[Annotated[float, Meta(ge=1.0)]] = []
    actions_taken: list[Counts] = []


def plain(value: Any) -> Any:
    """Convert a value for JSON: null for a number without a JSON form, the printed form of an object."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return None if isinstance(value, float) and not np.isfinite(value) else value
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (Sequence, np.ndarray)):
        return [plain(entry) for entry in value]
    return repr(value)


def as_json(record: Mapping[str, Any]) -> bytes:
    """Serialise a record; the same record gives the same bytes."""
    return (json.dumps(plain(record), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def from_json(data: bytes) -> dict[str, Any]:
    """Parse a record, and check that it is of this version.

    Raises
    ------
    PolicyError
        The data are no JSON, or describe no policy, or one of another version.
    """
    try:
        record = json_of(data)
    except ValueError as error:
        raise PolicyError(f"it is not JSON ({error}); learn the policy again") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise PolicyError("it does not describe a policy; give a folder that `halfseen learn` wrote")
    if record.get("version") != VERSION:
        raise PolicyError(
            f"version {record.get('version')!r} is not the {VERSION} that halfseen {halfseen.__version__} reads; use "
            "the halfseen that wrote it, or learn the policy again"
        )
    converted(record, Record, {"kind": get_args(Kind)})
    return record


def converted(values: Any, kind: type[Of], names: Mapping[str, Collection[str]] = MappingProxyType({})) -> Of:
    """Convert JSON values to those of a schema.

    Parameters
    ----------
    values
        The JSON values.
    kind
        The schema.
    names
        By field, the names allowed in it; a refusal lists them.

    Raises
    ------
    PolicyError
        The values do not fit; the field, its value and the expected form are named.
    """
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise PolicyError(f"{_refusal(values, str(error), names)}; learn the policy again") from error


def _refusal(values: Any, error: str, names: Mapping[str, Collection[str]]) -> str:
    """Prefix msgspec's message with the field and its value; messages of our own checks name the value already."""
    what, _, place = error.partition(" - at ")
    keys = [key or int(number) for key, number in re.findall(r"\.([^.\[\]`]+)|\[(\d+)\]", place.partition("[...]")[0])]
    keys += re.findall("missing required field `(.+)`", what)
    for key in keys:
        values = values.get(key) if isinstance(values, dict) else values[key]
    name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")
    known = next((names[str(key)] for key in reversed(keys) if str(key) in names), None)
    if known is not None and what.startswith(("Invalid enum", "Invalid value")):
        return f"{name} is {repr(values)[:80]}; it must be one of {', '.join(known)}"
    if name and what.startswith(("Expected ", "Invalid ", "Object ", "Number ")):
        name = f"{name} is {repr(values)[:80]}"
    return f"{name}: {what}" if name else what
