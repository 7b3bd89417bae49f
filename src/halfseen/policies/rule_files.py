"""Rules of thumb in files: each row has conditions and an action, and the first row that matches wins.

In a CSV file, an empty cell is no condition::

    stage,weight_kg,shine,action
    > 2,,,hand over
    ,> 1.5,,parallel
    ,,> 0.5,suction
    ,,,soft

The same rule in TOML::

    [[rule]]
    when = { stage = "> 2" }
    action = "hand over"

    [[rule]]
    action = "soft"

A condition is a value, or ``<``, ``<=``, ``>``, ``>=``, ``=`` or ``!=`` and a value; several are joined by ``and``. The
last row has no conditions, so every state matches a row.

A rule is the fallback of a policy; failing that, the log's most frequent action in that stage is (`FallBack`).
"""

import csv
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, did_you_mean, within
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.rule_table import ACTION, COMPARISONS, STAGE, Condition, RuleRow, RuleTable
from halfseen.reading import opened_text, read_text, reason_of, toml_of


def read_rule_table(path: str | Path, horizon: int, names: Sequence[Hashable] = ()) -> RuleTable:
    """Read a rule from a CSV or TOML file.

    Parameters
    ----------
    path
        The file; its extension determines the format.
    horizon
        Number T of stages.
    names
        Actions in the log: an action that is written like one of these is that action, number or not.

    Raises
    ------
    ArgumentError
        The file cannot be read, or is no rule; the message names file and row.
    """
    path, known = Path(path), {str(name): name for name in names}
    if path.suffix.lower() not in _READERS:
        raise ArgumentError(f"{path}: give a rule as a file that ends in {' or '.join(_READERS)}")
    with reading(path, "a rule ({}); fix it there"):
        return RuleTable(rows_of(_READERS[path.suffix.lower()](path), known), horizon)


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Name a file in refusals; `what` says what it cannot be read as, with a place for the reason."""
    try:
        with within(path):
            yield
    except HalfseenError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as {what.format(reason_of(error))}") from error


def named_in(kind: str, name: Any, known: Sequence[Any]) -> str:
    """Say that a name is not among the known ones."""
    there = list(map(str, known))
    return f"unknown {kind} {name}; give one of {', '.join(there)}{did_you_mean(str(name), there)}"


Entries = list[tuple[dict[str, Any], Any]]
"""The conditions of each row by column, and its action."""


def csv_entries(path: Path, also: str | None = None) -> Entries:
    """Read the rows of a CSV file with a column of actions, and perhaps one more."""
    with opened_text(path) as file:
        reader = csv.reader(file, skipinitialspace=True)
        head, *rows = [[cell.strip() for cell in row] for row in reader if any(cell.strip() for cell in row)] or [[]]
    lacking = next((name for name in (ACTION, also) if name is not None and name not in head), None)
    if lacking is not None or len(set(head)) < len(head) or "" in head:
        wanted = lacking or ACTION
        raise ArgumentError(f"its first line is {','.join(head)!r}; name each column once, one of them {wanted!r}")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(head):
            raise ArgumentError(f"row {number} has {len(row)} cells, but the first line {len(head)}")
    cells = [dict(zip(head, row, strict=True)) for row in rows]
    return [({name: text for name, text in row.items() if text and name != ACTION}, row[ACTION]) for row in cells]


def _toml_entries(path: Path) -> Entries:
    read = toml_of(read_text(path))
    rules: Any = read.get("rule")
    if set(read) != {"rule"} or not isinstance(rules, list) or not all(isinstance(rule, dict) for rule in rules):
        raise ArgumentError(f"it holds {', '.join(read) or 'nothing'}; give [[rule]] entries and nothing else")
    for number, rule in enumerate(rules, start=1):
        others = sorted(set(rule) - {"when", ACTION})
        if others or not isinstance(rule.get("when", {}), dict):
            what = f"an unknown key {others[0]!r}" if others else "a 'when' that is not a table"
            raise ArgumentError(f"row {number} has {what}; give when = {{ column = condition }} and action")
    return [(rule.get("when", {}), rule.get(ACTION, "")) for rule in rules]


_READERS: dict[str, Callable[[Path], Entries]] = {".csv": csv_entries, ".toml": _toml_entries}


def rows_of(entries: Entries, known: Mapping[str, Hashable]) -> tuple[RuleRow, ...]:
    """Interpret rows; an action that is written like a known one is that one."""
    rows = []
    for number, (asked, action) in enumerate(entries, start=1):
        if not isinstance(action, str | int) or isinstance(action, bool) or action == "":
            raise ArgumentError(f"row {number}: action is {action!r}; give one")
        conditions = [_condition(number, str(name), part) for name, text in asked.items() for part in _parts(text)]
        _refuse_impossible(number, conditions)
        rows.append(RuleRow(tuple(conditions), known.get(str(action), action)))
    return tuple(rows)


def _parts(given: Any) -> list[str]:
    """Split several conditions, of which only the first may lack a sign; text may hold the word "and" itself."""
    parts = (text := str(int(given) if isinstance(given, bool) else given)).split(" and ")
    return parts if all(part.strip().startswith(tuple(COMPARISONS)) for part in parts[1:]) else [text]


def _condition(number: int, column: str, text: str) -> Condition:
    stripped = text.strip()
    sign = next((sign for sign in COMPARISONS if stripped.startswith(sign)), "")
    written = stripped.removeprefix(sign).strip()
    value = number_or_text(written)
    is_text = isinstance(value, str)
    if not written or (is_text and (sign not in ("", "=", "!=") or column == STAGE or written[0] in "<>=!")):
        raise ArgumentError(
            f"row {number}: {column} is {text.strip()!r}, which is not a condition; give a value, or one of "
            f"{' '.join(COMPARISONS)} and a number"
        )
    return Condition(column, sign or "=", value, written)


def _refuse_impossible(number: int, conditions: Sequence[Condition]) -> None:
    """Refuse conditions on a column that no number fulfils, or for the stage no whole number from 1."""
    for column in dict.fromkeys(one.column for one in conditions if not isinstance(one.value, str)):
        asked = [one for one in conditions if one.column == column and not isinstance(one.value, str)]
        at = sorted(float(one.value) for one in asked)
        near = [-np.inf, *at, *(low / 2.0 + high / 2.0 for low, high in pairwise(at)), np.inf]
        if column == STAGE:
            near = [stage for each in at for stage in (1.0, np.floor(each), np.floor(each) + 1.0) if stage >= 1.0]
        if not any(all(COMPARISONS[one.sign](value, one.value) for one in asked) for value in near):
            written = " and ".join(f"{one.sign} {one.written}".removeprefix("= ") for one in asked)
            remedy = "stages are whole numbers from 1" if column == STAGE else "the row would never match"
            raise ArgumentError(f"row {number}: no {column} is {written}; {remedy}")


def number_or_text(written: str) -> float | str:
    """A finite number, or the text as it is."""
    try:
        value = float(written)
    except ValueError:
        return written
    return value if np.isfinite(value) else written


def check_values(number: int, row: RuleRow, known: Collection[str], texts: Collection[str]) -> None:
    """Refuse text for a known column of numbers, and sizes for one of text."""
    for one in (one for one in row.conditions if one.column in known):
        if one.text is None if one.column in texts else isinstance(one.value, str):
            holds = "text" if one.column in texts else "numbers"
            raise ArgumentError(f"row {number}: {one.column} is {one.value!r}; give {holds}, as in the policy")


def unseen(rows: Sequence[RuleRow], categories: Mapping[str, Collection[str]]) -> Iterator[str]:
    """Say which conditions ask for a text that no log showed; they hold never, or always."""
    for one in (one for row in rows for one in row.conditions):
        if one.column in categories and one.text not in categories[one.column]:
            meant = did_you_mean(str(one.text), categories[one.column])
            yield f"a row asks for {one.column} {one.sign} {one.text}, which no log showed{meant}"


FINISH = "FINISH"
"""The action that ends a trajectory of tables; always possible."""


@dataclass(frozen=True, eq=False)
class FallBack:
    """Returns an action in any state, even if covariates are missing.

    Parameters
    ----------
    usual
        The usual action of each stage; later stages use the last one.
    says
        Source of `usual`, in words.
    rule
        The rule to try first; None for none.
    rule_name
        Name of the rule.
    """

    usual: tuple[Hashable, ...]
    says: str
    rule: RuleTable | None = None
    rule_name: str = ""

    def action(self, covariates: Mapping[str, Any], stage: int) -> tuple[Any, str]:
        """Return the action in a state, and its source; a rule that fails in the state is skipped."""
        usual = self.usual[min(stage, len(self.usual)) - 1]
        if self.rule is None:
            return usual, self.says
        try:
            return self.rule.action(covariates, stage), self.rule_name
        except (HalfseenError, TypeError, ValueError) as error:
            return usual, f"{self.says}, as {self.rule_name} fails: {error}"


def rule_of(stored: StoredPolicy, file: Path) -> RuleTable:
    """Read a rule of thumb whose actions a policy knows.

    Raises
    ------
    ArgumentError
        The policy is of tables, the file is no rule, or an action or the kind of a column is unknown to the policy.
    """
    if stored.is_table:
        raise ArgumentError(f"{file}: rules are for named actions, not for tables of objects; leave it out")
    policy = stored.policy
    rule = read_rule_table(file, stored.horizon, policy.actions)
    with within(file):
        for number, row in enumerate(rule.rows, start=1):
            if row.action not in policy.actions:
                raise ArgumentError(named_in("action", row.action, policy.actions))
            check_values(number, row, policy.covariates, policy.categories)
    return rule


def fall_back_of(stored: StoredPolicy, file: Path | None = None) -> FallBack | None:
    """Find the fallback of a policy; None for an older folder without the log's actions.

    Parameters
    ----------
    stored
        The policy.
    file
        A rule as .csv or .toml, which is tried first; None for the log's usual actions alone.

    Raises
    ------
    ArgumentError
        As for `rule_of`.
    """
    if stored.is_table:
        if file is not None:
            rule_of(stored, file)
        return FallBack((FINISH,), "it ends the trajectory")
    usual, says = usual_actions(stored), "the usual action of its log in this stage"
    if file is None:
        return FallBack(usual, says) if usual else None
    rule = rule_of(stored, file)
    known = (usual, says) if usual else ((rule.rows[-1].action,), "the last row of its rule")
    return FallBack(*known, rule, f"the rule {file.name}")


def usual_actions(stored: StoredPolicy) -> tuple[Hashable, ...]:
    """For each stage, the possible action most frequent in the log of a policy of named actions; empty if unknown."""
    usual: list[Hashable] = []
    counts = [*stored.record.get("actions_taken", ())][: stored.horizon]
    for possible, taken in zip(stored.policy.actions_by_stage.values(), counts, strict=False):
        seen = [name for name in possible if str(name) in taken]
        usual += [max(seen, key=lambda name: taken[str(name)])] if seen else usual[-1:]
    return tuple(usual)
