"""What a journal takes: plain values, in columns that keep their names and kinds from the first row on.

`Logs` refuses a covariate that is missing from some stages or is now a number and now text. That must be told when the
value is given: after hours of recording it would be too late.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np

from halfseen.errors import LogError
from halfseen.logs.columns import OBJECT_COLUMNS, STAGE_COLUMNS, TRAJECTORY_COLUMNS, is_of_one_robot, shown
from halfseen.logs.frames import LARGEST_FRACTION

Kinds = Mapping[str, str]

_OWN_NAMES = {*STAGE_COLUMNS, *TRAJECTORY_COLUMNS, *OBJECT_COLUMNS}
_LARGEST_WHOLE = 2**63

_NUMBER, _FRACTION, _HUGE, _TEXT, _TRUTH = "number", "fraction", "whole number beyond 2^53", "text", "truth value"
_EMPTY_LIST = "list"


@dataclass(frozen=True)
class Schema:
    """Names and kinds of what was recorded so far.

    A kind is number, truth value, text, or a list of one of these. Numbers that include fractions, and those that
    include whole numbers so large that a fraction cannot tell them apart, are kinds of their own.

    Parameters
    ----------
    labels
        Kind of the names of trajectories, actions, objects and robots, where there are any.
    trajectories
        Kind of each column of the trajectories.
    covariates
        Kind of each covariate of the stages; None before the first stage.
    objects
        Kind of each column of the objects; None before the first stage, empty where stages have none.
    has_probability
        Whether actions come with their probability; None before the first action.
    has_robot
        Whether stages say which robot decides; None before the first stage.
    """

    labels: Kinds = field(default_factory=dict)
    trajectories: Kinds = field(default_factory=dict)
    covariates: Kinds | None = None
    objects: Kinds | None = None
    has_probability: bool | None = None
    has_robot: bool | None = None

    def with_trajectory(self, name: Any, columns: Mapping[str, Any]) -> tuple["Schema", Any, dict[str, Any]]:
        """Check a trajectory's name and columns; columns may differ between trajectories, and None leaves one out."""
        where = f"trajectory {shown(name)}"
        labels, name = self._with_label("trajectory", name, where)
        _refuse_names(columns, self.trajectories, where)
        given = {column: value for column, value in columns.items() if value is not None}
        row, kinds = _row(given, self.trajectories, where, "column")
        return replace(self, labels=labels, trajectories={**self.trajectories, **kinds}), name, row

    def with_stage(
        self,
        covariates: Any,
        objects: Any,
        chosen: Mapping[str, Any],
        where: str,
    ) -> tuple["Schema", dict[str, Any]]:
        """Check what is known when a stage begins, and make its event.

        Parameters
        ----------
        covariates, objects
            What was seen.
        chosen
            robot, action, object and probability, None where there is none.
        where
            The trajectory and the stage, for messages.
        """
        _refuse_names(covariates, self.covariates, where)
        seen, kinds = _row(covariates, self.covariates, where, "covariate")
        schema = replace(self, covariates=_checked_names(kinds, self.covariates, where, "covariate"))
        schema, rows = schema._with_objects(objects, where)
        schema, who = schema._with_robot(chosen.get("robot"), where)
        schema, choice = schema._with_choice(chosen, where)
        _refuse_absent(choice.get("object"), rows, where)
        event = {"covariates": seen, **who, **choice}
        return schema, event if rows is None else {**event, "objects": rows}

    def _with_objects(self, objects: Any, where: str) -> tuple["Schema", list[dict[str, Any]] | None]:
        if objects is not None and not isinstance(objects, Iterable):
            raise LogError(f"{where}: objects is {_short(objects)}; give a list with a dict for each")
        objects = None if objects is None else list(objects)
        if not objects:
            if self.objects:
                raise LogError(f"{where}: it has no objects, though stages before it have; give those that stood there")
            if objects is not None:
                raise LogError(f"{where}: objects is empty; give those that stood there, or None in every stage")
            return replace(self, objects={}), None
        if self.objects is not None and not self.objects:
            raise LogError(f"{where}: it has objects, though stages before it have none; give them always or never")
        schema, rows = self, []
        for given in objects:
            schema, row = schema._with_object(given, where)
            rows.append(row)
        names = [row["object"] for row in rows]
        repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if repeated is not None:
            raise LogError(f"{where}, object {shown(repeated)}: it is there twice; give each object one row")
        return schema, rows

    def _with_object(self, given: Any, where: str) -> tuple["Schema", dict[str, Any]]:
        if not isinstance(given, Mapping) or "object" not in given:
            raise LogError(f"{where}: object {_short(given)} has no name; give a dict with 'object' and its covariates")
        labels, name = self._with_label("object", given["object"], where)
        where = f"{where}, object {shown(name)}"
        values = {column: value for column, value in given.items() if column != "object"}
        _refuse_names(values, self.objects, where)
        row, kinds = _row(values, self.objects, where, "covariate")
        names = _checked_names({"object": "name", **kinds}, self.objects, where, "covariate")
        is_known = labels == self.labels and names == self.objects
        return self if is_known else replace(self, labels=labels, objects=names), {"object": name, **row}

    def _with_robot(self, robot: Any, where: str) -> tuple["Schema", dict[str, Any]]:
        if self.has_robot not in (None, robot is not None):
            word = "missing" if self.has_robot else "given"
            raise LogError(f"{where}: robot is {word}, unlike in stages before; give it always or never")
        schema = replace(self, has_robot=robot is not None)
        if robot is None:
            return schema, {}
        labels, robot = schema._with_label("robot", robot, where)
        return replace(schema, labels=labels), {"robot": robot}

    def _with_choice(self, chosen: Mapping[str, Any], where: str) -> tuple["Schema", dict[str, Any]]:
        action, acted_on, probability = (chosen.get(name) for name in ("action", "object", "probability"))
        if action is None:
            if acted_on is not None or probability is not None:
                raise LogError(f"{where}: object or probability is given without action; give the action as well")
            return self, {}
        labels, action = self._with_label("action", action, where)
        schema, choice = replace(self, labels=labels), {"action": action}
        if acted_on is not None:
            labels, choice["object"] = schema._with_label("object", acted_on, where)
            schema = replace(schema, labels=labels)
        if self.has_probability not in (None, probability is not None):
            word = "missing" if self.has_probability else "given"
            raise LogError(f"{where}: probability is {word}, unlike in stages before; give it always or never")
        if probability is not None:
            choice["probability"] = _probability(probability, where)
        return replace(schema, has_probability=probability is not None), choice

    def _with_label(self, what: str, value: Any, where: str) -> tuple[Kinds, Any]:
        label, kind = _plain(value, where, what)
        if not isinstance(label, int | str) or isinstance(label, bool):
            raise LogError(f"{where}: {what} {_short(label)} is no name; give a whole number or text")
        kind = _told(kind)
        known = self.labels.get(what, kind)
        if known != kind:
            raise LogError(
                f"{where}: {what} {_short(label)} is a {kind}, those before are {known}; give names of one kind"
            )
        return {**self.labels, what: kind}, label


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


def checked_robot(value: Any, where: str) -> int:
    """Turn the number of a robot, from 0, into an int."""
    plain = value.item() if isinstance(value, np.generic) else value
    if not isinstance(plain, int) or isinstance(plain, bool) or plain < 0:
        raise LogError(f"{where}: robot {shown(plain)} is no number of one; give 0, 1, …")
    return plain


def _probability(value: Any, where: str) -> float:
    remedy = "give the probability in (0, 1] with which the action was chosen, or leave it out everywhere"
    probability = checked_number(value, "probability", where, remedy)
    if not 0 < probability <= 1:
        raise LogError(f"{where}: probability is {probability}; {remedy}")
    return probability


def _row(
    values: Mapping[str, Any], known: Kinds | None, where: str, word: str
) -> tuple[dict[str, Any], dict[str, str]]:
    row: dict[str, Any] = {}
    kinds: dict[str, str] = {}
    for name, value in values.items():
        if not isinstance(name, str):
            raise LogError(f"{where}: {word} {name!r} has a name that is not text; rename it")
        if known is None or name not in known:
            checked_text(name, where, f"name of {word}")
        what = f"{word} {_written(name)}"
        row[name], kind = _plain(value, where, what)
        kinds[name] = _common_kind(None if known is None else known.get(name), kind, where, what)
    return row, kinds


def _common_kind(before: str | None, now: str, where: str, what: str) -> str:
    """The kind of a column that was of one kind, and is now given another."""
    if before is None or before == now:
        return now
    for kind, other in ((before, now), (now, before)):
        if _holds(kind, other):
            return kind
    if _told(before) == _told(now):
        raise LogError(
            f"{where}: {what} has a whole number beyond 2^53 and a fraction, now or before, and no column holds both "
            "exactly; give such whole numbers as text"
        )
    raise LogError(f"{where}: {what} is a {_told(now)}, before it was a {_told(before)}; give it one type")


def _holds(kind: str, other: str) -> bool:
    """Whether a column of one kind also holds what is of the other."""
    if kind.startswith(_EMPTY_LIST) and other.startswith(_EMPTY_LIST):
        return other == _EMPTY_LIST or (kind != _EMPTY_LIST and _holds(_item(kind), _item(other)))
    return other in (kind, _NUMBER) if kind in (_FRACTION, _HUGE) else other == kind


def _item(kind: str) -> str:
    return kind.removeprefix("list of ").removesuffix("s")


def _told(kind: str) -> str:
    """A kind in words: numbers of all kinds are numbers."""
    return kind.replace(_FRACTION, _NUMBER).replace(_HUGE, _NUMBER)


def _plain(value: Any, where: str, what: str) -> tuple[Any, str]:
    """Turn a value into what JSON holds, and tell its kind."""
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
    if any(kind.startswith(_EMPTY_LIST) for kind in kinds) or len({_told(kind) for kind in kinds}) > 1:
        raise LogError(f"{where}: {what} is no flat list of one type; give numbers or text, side by side")
    common = None
    for kind in kinds:
        common = _common_kind(common, kind, where, what)
    return [plain for plain, _ in pairs], _EMPTY_LIST if common is None else f"list of {common}s"


def checked_text(value: str, where: str, what: str) -> str:
    """Refuse text that files or tables do not hold, or do not tell apart."""
    if "\0" in value:
        raise LogError(f"{where}: {what} {_short(value)} holds the character NUL; end the text before it")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise LogError(f"{where}: {what} {_short(value)} is no Unicode text; decode it") from error
    return value


def _written(name: str) -> str:
    return name if name.isprintable() else repr(name)


def _short(value: Any) -> str:
    """Write a value in a line, however long it is."""
    if isinstance(value, int) and value.bit_length() > 200:
        return f"a whole number of {value.bit_length()} bits"
    told = repr(value)
    return told if len(told) <= 80 else f"{told[:77]}…"


def _checked_names(kinds: dict[str, str], known: Kinds | None, where: str, word: str) -> Kinds:
    if known is None:
        return kinds
    for name in (name for name in known if name not in kinds):
        raise LogError(f"{where}: {word} {_written(name)} is missing, though it was there before; give it in every row")
    for name in (name for name in kinds if name not in known):
        raise LogError(f"{where}: {word} {_written(name)} was not there before; give the same in every row")
    return kinds


def _refuse_names(values: Any, known: Kinds | None, where: str) -> None:
    if not isinstance(values, Mapping):
        raise LogError(f"{where}: covariates are a {type(values).__name__}; give a dict of names and values")
    for name in values:
        if (
            isinstance(name, str)
            and (known is None or name not in known)
            and (name.strip().lower() in _OWN_NAMES or is_of_one_robot(name))
        ):
            raise LogError(f"{where}: {name!r} is a name of the log's own; choose another for what you add")


def _refuse_absent(name: Any, objects: list[dict[str, Any]] | None, where: str) -> None:
    names = [row["object"] for row in objects or ()]
    if name is not None and objects is not None and name not in names:
        others = ", ".join(shown(other) for other in names)
        raise LogError(f"{where}: object {shown(name)} of the action is not among the objects of the stage ({others})")
