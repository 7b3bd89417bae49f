"""The state of a recording, replaced as a whole: names and kinds of columns so far, and the trajectory in progress.

Columns keep their names and kinds from the first row on, as `Logs` requires; a refusal after hours of recording would
come too late. A kind is number, truth value, text, or a list of one of these. Numbers with fractions are a kind of
their own, and so are numbers with whole numbers too large for a float to hold exactly.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from math import isfinite
from typing import Any

import numpy as np

from halfseen.errors import LogError
from halfseen.logs.checks import EARLIEST_DATE_S
from halfseen.logs.columns import LARGEST_FRACTION, OWN_NAMES, STEPPED_BACK, is_of_one_robot, shown
from halfseen.logs.missing import is_flag
from halfseen.logs.recorded import RESOLUTION_S

_LARGEST_WHOLE = 2**63
_NUMBER, _FRACTION, _HUGE, _TEXT, _TRUTH = "number", "fraction", "whole number beyond 2^53", "text", "truth value"
_EMPTY_LIST = "list"
_CLOCK_REMEDY = "give the time since the trajectory began [s]"

Row = dict[str, Any]
Kinds = dict[str, str]


@dataclass
class Schema:
    """Names and kinds of the columns recorded so far."""

    labels: Kinds = field(default_factory=dict)
    """Kinds of the names of trajectories, actions, objects and robots, if there are any."""
    trajectories: Kinds = field(default_factory=dict)
    covariates: Kinds | None = None
    """Kinds of the covariates of the stages; None before the first stage."""
    objects: Kinds | None = None
    """Kinds of the columns of the objects; None before the first stage, empty if stages have no objects."""
    has_probability: bool | None = None
    """Whether actions come with their probability; None before the first action."""
    has_robot: bool | None = None
    """Whether stages name the robot that decides; None before the first stage."""

    def with_trajectory(self, name: Any, columns: Mapping[str, Any]) -> tuple["Schema", Any, Row]:
        """Check a trajectory's name and columns. Columns may differ between trajectories; None leaves one out."""
        schema, where = replace(self, labels=dict(self.labels)), f"trajectory {shown(name)}"
        name = schema._label("trajectory", name, where)
        row, kinds = _row(columns, self.trajectories, where, "column")
        schema.trajectories = {**self.trajectories, **kinds}
        return schema, name, row

    def with_stage(
        self, covariates: Any, objects: Any, chosen: Mapping[str, Any], where: str
    ) -> tuple["Schema", dict[str, Any]]:
        """Check the inputs of a stage that begins, and make its event.

        `chosen` holds robot, action, object, probability and stepped_back, each None or left out if there is none;
        `where` names the trajectory and the stage.
        """
        schema = replace(self, labels=dict(self.labels))
        seen, schema.covariates = _row(covariates, self.covariates, where, "covariate")
        rows, robot = schema._rows(objects, where), chosen.get("robot")
        schema._check_always("robot", robot is not None, where)
        event = {"covariates": seen} | ({} if robot is None else {"robot": schema._label("robot", robot, where)})
        event |= schema._choice(chosen, where)
        if rows and "object" in event and event["object"] not in [row["object"] for row in rows]:
            others = ", ".join(shown(row["object"]) for row in rows)
            what = f"object {shown(event['object'])} of the action is not among the objects of the stage"
            raise LogError(f"{where}: {what} ({others})")
        return schema, event | ({"objects": rows} if rows else {})

    def _rows(self, objects: Any, where: str) -> list[Row]:
        if objects is not None and not isinstance(objects, Iterable):
            raise LogError(f"{where}: objects is {_short(objects)}; give a list with a dict for each")
        given = [] if objects is None else list(objects)
        if not given:
            if self.objects:
                raise LogError(f"{where}: it has no objects, though stages before it have; give those present")
            if objects is not None:
                raise LogError(f"{where}: objects is empty; give those present, or None in every stage")
            self.objects = {}
            return []
        if self.objects == {}:
            raise LogError(f"{where}: it has objects, though stages before it have none; give them always or never")
        rows = [self._object_row(each, where) for each in given]
        names = [row["object"] for row in rows]
        repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if repeated is not None:
            raise LogError(f"{where}, object {shown(repeated)}: it is listed twice; give each object one row")
        return rows

    def _object_row(self, given: Any, where: str) -> Row:
        if not isinstance(given, Mapping) or "object" not in given:
            raise LogError(f"{where}: object {_short(given)} has no name; give a dict with 'object' and its covariates")
        name = self._label("object", given["object"], where)
        values = {column: value for column, value in given.items() if column != "object"}
        row, kinds = _row(values, self.objects, f"{where}, object {shown(name)}", "covariate", {"object": "name"})
        self.objects = kinds
        return {"object": name, **row}

    def _choice(self, chosen: Mapping[str, Any], where: str) -> Row:
        action, acted_on, probability = (chosen.get(name) for name in ("action", "object", "probability"))
        if action is None:
            if acted_on is not None or probability is not None:
                raise LogError(f"{where}: object or probability is given without action; give the action as well")
            return {}
        choice: Row = {"action": self._label("action", action, where)}
        if acted_on is not None:
            choice["object"] = self._label("object", acted_on, where)
        self._check_always("probability", probability is not None, where)
        if probability is not None:
            remedy = "give the probability in (0, 1] with which the action was chosen, or leave it out everywhere"
            choice["probability"] = checked_number(probability, "probability", where, remedy)
            if not 0 < choice["probability"] <= 1:
                raise LogError(f"{where}: probability is {choice['probability']}; {remedy}")
        why = chosen.get(STEPPED_BACK)
        if why is not None and not isinstance(why, str):
            raise LogError(f"{where}: {STEPPED_BACK} is {_short(why)}; say why the rule decided, or leave it out")
        return choice | ({} if why is None else {STEPPED_BACK: checked_text(why, where, STEPPED_BACK)})

    def _check_always(self, what: str, is_given: bool, where: str) -> None:
        """Refuse a value that is given in some stages only."""
        if getattr(self, f"has_{what}") not in (None, is_given):
            word = "given" if is_given else "missing"
            raise LogError(f"{where}: {what} is {word}, unlike in stages before; give it always or never")
        setattr(self, f"has_{what}", is_given)

    def _label(self, what: str, value: Any, where: str) -> int | str:
        label, kind = _plain(value, where, what)
        if not isinstance(label, int | str) or isinstance(label, bool):
            raise LogError(f"{where}: {what} {_short(label)} is not a name; give a whole number or text")
        kind = _in_words(kind)
        known = self.labels.setdefault(what, kind)
        if known != kind:
            raise LogError(
                f"{where}: {what} {_short(label)} is a {kind}, but earlier ones are {known}; give names of one kind"
            )
        return label


@dataclass(frozen=True)
class TrajectoryState:
    """State of a trajectory that is being recorded, and its clock, which never goes back."""

    name: int | str
    number: int = 0
    """Its number among the trajectories that this recorder began."""
    stage: int = 0
    """Number of the stage that began last; 0 before the first."""
    is_in_stage: bool = False
    has_action: bool = False
    """Whether the stage began with an action."""
    is_ended: bool = False
    at_s: float = 0.0
    """Time of the last event [s]."""
    is_given: bool | None = None
    """Whether times are given, not read from the machine's clock; None before the first."""
    began_s: float = 0.0
    """When the trajectory began, on the machine's clock [s]."""
    completed_s: float = 0.0
    """When its last stage was completed [s]."""
    noted_s: float = 0.0
    """Latest time up to which the disk shows it running [s]."""
    events: tuple[dict[str, Any], ...] = ()
    """Its events so far, if they are kept; else empty."""

    def started(self) -> "TrajectoryState":
        """The state with its clock started now."""
        return replace(self, began_s=time.monotonic())

    def read_s(self) -> float:
        """Read the machine's clock [s], rounded to nanoseconds; strictly increasing, however coarse that clock is."""
        return max(round(time.monotonic() - self.began_s, 9), round(self.at_s + RESOLUTION_S, 9))

    def timed(self, elapsed_s: Any, where: str, *, is_later: bool = False) -> "TrajectoryState":
        """The state at an event whose time is given or, if None, read; no time precedes (or equals) the last one."""
        if self.is_given not in (None, elapsed_s is not None):
            word = "missing" if elapsed_s is None else "given"
            raise LogError(f"{where}: elapsed_s is {word}, unlike before in this trajectory; give it always or never")
        if elapsed_s is None:
            return replace(self, at_s=self.read_s(), is_given=False)
        at_s = checked_number(elapsed_s, "elapsed_s", where, _CLOCK_REMEDY)
        trouble = None
        if at_s < self.at_s or (is_later and at_s == self.at_s):
            trouble = f"{'is before' if at_s < self.at_s else 'is still'} the {self.at_s} of the event before"
        elif 0.0 < at_s < RESOLUTION_S:
            trouble = f"is less than the {RESOLUTION_S} s that clocks resolve"
        elif at_s >= EARLIEST_DATE_S:
            trouble = "is a date, or not in seconds"
        if trouble is not None:
            raise LogError(f"{where}: elapsed_s {at_s} {trouble}; {_CLOCK_REMEDY}")
        return replace(self, at_s=at_s, is_given=True)

    def after(self, event: dict[str, Any]) -> "TrajectoryState":
        """The state after an event."""
        state = replace(self, at_s=event.get("at_s", self.at_s))
        match event["event"]:
            case "stage":
                has_action, noted_s = "action" in event, state.at_s
                return replace(state, stage=event["stage"], is_in_stage=True, has_action=has_action, noted_s=noted_s)
            case "done":
                return replace(state, is_in_stage=False, completed_s=state.at_s)
            case "running":
                return replace(state, noted_s=state.at_s)
            case "finished" | "cut":
                return replace(state, is_in_stage=False, is_ended=True)
        return state

    def end_s(self, elapsed_s: Any, where: str) -> float:
        """Time of the trajectory's end [s]; if the clock is given and this time is not, that of the last event."""
        return self.at_s if self.is_given and elapsed_s is None else self.timed(elapsed_s, where).at_s


@dataclass(frozen=True)
class RecordingState:
    """State of the recording in a folder."""

    schema: Schema = field(default_factory=Schema)
    num_shares: int | None = None
    """Number of robots with own rewards in each stage; None before the first completed stage."""
    trajectory: TrajectoryState | None = None
    """The last trajectory that began; None before the first of this recorder."""


def checked_number(value: Any, what: str, where: str, remedy: str) -> float:
    """Turn a number of any kind into a float; NaN and infinity are refused."""
    plain = value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value
    try:
        number = float("nan") if isinstance(plain, str | bytes) else float(plain)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not isfinite(number):
        raise LogError(f"{where}: {what} is {_short(plain)}; {remedy}")
    return number


def checked_text(value: str, where: str, what: str) -> str:
    """Refuse text that files or tables cannot store or distinguish."""
    if "\0" in value:
        raise LogError(f"{where}: {what} {_short(value)} holds the character NUL; end the text before it")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise LogError(f"{where}: {what} {_short(value)} is not Unicode text; decode it") from error
    return value


def _row(
    values: Any, known: Kinds | None, where: str, word: str, also: Kinds | None = None
) -> tuple[dict[str, Any], Kinds]:
    """Values as JSON holds them, and their kinds; `also` holds the kinds of further columns of the row.

    Columns of a trajectory may be None or missing. Covariates are the same in every row, except for flags of missing
    values, which depend on the policy.
    """
    if not isinstance(values, Mapping):
        raise LogError(f"{where}: covariates are a {type(values).__name__}; give a dict of names and values")
    row: Row = {}
    kinds: Kinds = dict(also or {})
    for name, value in values.items():
        if not isinstance(name, str):
            raise LogError(f"{where}: {word} {name!r} has a name that is not text; rename it")
        before, what = (known or {}).get(name), f"{word} {name if name.isprintable() else repr(name)}"
        if before is None and (name.strip().lower() in OWN_NAMES or is_of_one_robot(name)):
            raise LogError(f"{where}: {name!r} is a reserved column of the log; choose another name")
        if value is None and word == "column":
            continue
        if before is None:
            checked_text(name, where, f"name of {word}")
        row[name], kind = _plain(value, where, what)
        kinds[name] = _common_kind(before, kind, where, what)
    if known is not None and word != "column":
        for name, kind in {**known, **kinds}.items():
            others = kinds if name in known else known
            # A flag of missing values that is left out is 0 or false.
            if name in others or (is_flag(name, others) and kind in (_NUMBER, _FRACTION, _TRUTH)):
                continue
            missing = "is missing, though it was given before; give it in every row"
            what = missing if name in known else "was not given before; give the same in every row"
            raise LogError(f"{where}: {word} {name if name.isprintable() else repr(name)} {what}")
        kinds = {**known, **kinds}
    return row, kinds


def _common_kind(before: str | None, now: str, where: str, what: str) -> str:
    """The kind of a column whose values were of one kind and now come with another."""
    if before is None or before == now:
        return now
    for kind, other in ((before, now), (now, before)):
        if _holds(kind, other):
            return kind
    if _in_words(before) == _in_words(now):
        raise LogError(
            f"{where}: {what} has a whole number beyond 2^53 and a fraction, now or before, but no column can hold "
            "both exactly; give such whole numbers as text"
        )
    raise LogError(f"{where}: {what} is a {_in_words(now)}, before it was a {_in_words(before)}; give it one type")


def _holds(kind: str, other: str) -> bool:
    """Whether a column of one kind can also hold values of the other."""
    if kind.startswith(_EMPTY_LIST) and other.startswith(_EMPTY_LIST):
        item, other_item = (each.removeprefix("list of ").removesuffix("s") for each in (kind, other))
        return other == _EMPTY_LIST or (kind != _EMPTY_LIST and _holds(item, other_item))
    return other in (kind, _NUMBER) if kind in (_FRACTION, _HUGE) else other == kind


def _in_words(kind: str) -> str:
    """The kind in words, with all kinds of numbers as "number"."""
    return kind.replace(_FRACTION, _NUMBER).replace(_HUGE, _NUMBER)


def _plain(value: Any, where: str, what: str) -> tuple[Any, str]:
    """A value as JSON holds it, and its kind."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return value, _TRUTH
    if isinstance(value, int | float):
        is_whole = isinstance(value, int)
        if not (-_LARGEST_WHOLE <= value < _LARGEST_WHOLE if is_whole else isfinite(value)):
            raise LogError(f"{where}: {what} is {_short(value)}; give the finite number that the policy saw")
        is_huge = is_whole and abs(value) > LARGEST_FRACTION
        return value, _HUGE if is_huge else _NUMBER if is_whole else _FRACTION
    if isinstance(value, str):
        return checked_text(value, where, what), _TEXT
    if isinstance(value, list | tuple):
        return _plain_list(value, where, what)
    raise LogError(f"{where}: {what} is {_short(value)}; give a number, text, or a flat list of these")


def _plain_list(values: list | tuple, where: str, what: str) -> tuple[list[Any], str]:
    pairs = [_plain(value, where, what) for value in values]
    kinds = {kind for _, kind in pairs}
    if any(kind.startswith(_EMPTY_LIST) for kind in kinds) or len(set(map(_in_words, kinds))) > 1:
        raise LogError(f"{where}: {what} is not a flat list of one type; give only numbers or only text")
    common: Any = reduce(lambda one, other: _common_kind(one, other, where, what), kinds, None)
    return [plain for plain, _ in pairs], _EMPTY_LIST if common is None else f"list of {common}s"


def _short(value: Any) -> str:
    """Write a value in one line, shortened if long."""
    if isinstance(value, int) and value.bit_length() > 200:
        return f"a whole number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}…"
