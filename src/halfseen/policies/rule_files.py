"""Rules of thumb in files: each row asks for conditions and names an action, and the first that matches wins.

As CSV, an empty cell asks nothing::

    stage,weight_kg,shine,action
    > 2,,,hand over
    ,> 1.5,,parallel
    ,,> 0.5,suction
    ,,,soft

As TOML the same is::

    [[rule]]
    when = { stage = "> 2" }
    action = "hand over"

    [[rule]]
    action = "soft"

A condition is a value, or ``<``, ``<=``, ``>``, ``>=``, ``=`` or ``!=`` and a value; several are joined by ``and``. The
last row asks nothing, so every state matches one.

A table of what to explore has a column ``probability``, the share of the decisions in which an action is tried. There
each row that matches has its say, so several actions may be tried in one state::

    stage,clutter,action,probability
    <= 1.5,<= 0.5,look,0.39
    <= 1.5,,shake,0.19

A rule decides in a policy's place, else what the policy's log did most often in that stage (`FallBack`).
"""

import csv
import io
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, did_you_mean
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.rule_table import ACTION, COMPARISONS, STAGE, Condition, RuleRow, RuleTable
from halfseen.reading import opened_text, read_text, reason_of, toml_of

if TYPE_CHECKING:
    from halfseen.policies.rule_table import RuleTable


def read_rule_table(path: str | Path, horizon: int, names: Sequence[Hashable] = ()) -> RuleTable:
    """Read a rule from a CSV or TOML file.

    Parameters
    ----------
    path
        The file; its ending says which of the two it is.
    horizon
        Number T of stages.
    names
        Actions as the log has them: an action that is written like one of these is that one, number or not.

    Raises
    ------
    ArgumentError
        The file cannot be read, or is no rule; file and row are named.
    """
    path, known = Path(path), {str(name): name for name in names}
    if path.suffix.lower() not in _READERS:
        raise ArgumentError(f"{path}: a rule is a file that ends in {' or '.join(_READERS)}")
    try:
        return RuleTable(_rows(_READERS[path.suffix.lower()](path), known), horizon)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as a rule ({reason_of(error)}); mend it there") from error


def named_in(kind: str, name: Any, known: Sequence[Any]) -> str:
    """Say that something is not among those that are known."""
    there = list(map(str, known))
    return f"there is no {kind} {name}; there are {', '.join(there)}{did_you_mean(str(name), there)}"


Entries = list[tuple[dict[str, Any], Any]]
"""What each row asks of which column, and its action."""


def _csv_entries(path: Path, also: str | None = None) -> Entries:
    with opened_text(path) as file:
        reader = csv.reader(file, skipinitialspace=True)
        head, *rows = [[cell.strip() for cell in row] for row in reader if any(cell.strip() for cell in row)] or [[]]
    lacking = next((name for name in (ACTION, also) if name is not None and name not in head), None)
    if lacking is not None or len(set(head)) < len(head) or "" in head:
        wanted = lacking or ACTION
        raise ArgumentError(f"its first line is {','.join(head)!r}; name each column once, one of them {wanted!r}")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(head):
            raise ArgumentError(f"row {number} has {len(row)} cells, and the first line {len(head)}")
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
            what = f"an unknown key {others[0]!r}" if others else "a 'when' that is no table"
            raise ArgumentError(f"row {number} has {what}; give when = {{ column = condition }} and action")
    return [(rule.get("when", {}), rule.get(ACTION, "")) for rule in rules]


_READERS: dict[str, Callable[[Path], Entries]] = {".csv": _csv_entries, ".toml": _toml_entries}


def _rows(entries: Entries, known: Mapping[str, Hashable]) -> tuple[RuleRow, ...]:
    rows = []
    for number, (asked, action) in enumerate(entries, start=1):
        if not isinstance(action, str | int) or action == "":
            raise ArgumentError(f"row {number}: action is {action!r}; name one")
        parts = [(str(column), part) for column, text in asked.items() for part in str(text).split(" and ")]
        conditions = tuple(_condition(number, *part) for part in parts)
        rows.append(RuleRow(conditions, known.get(str(action), action)))
    return tuple(rows)


def _condition(number: int, column: str, text: str) -> Condition:
    stripped = text.strip()
    sign = next((sign for sign in COMPARISONS if stripped.startswith(sign)), "")
    written = stripped.removeprefix(sign).strip()
    value = _number_or_text(written)
    is_text = isinstance(value, str)
    if not written or (is_text and (sign not in ("", "=", "!=") or column == STAGE or written[0] in "<>=!")):
        raise ArgumentError(
            f"row {number}: {column} is {text.strip()!r}, which is no condition; give a value, or one of "
            f"{' '.join(COMPARISONS)} and a number"
        )
    return Condition(column, sign or "=", value)


def _number_or_text(written: str) -> float | str:
    try:
        value = float(written)
    except ValueError:
        return written
    return value if np.isfinite(value) else written


PROBABILITY = "probability"
MOST_EXPLORED = 0.9
"""Share of the decisions of a state that may be drawn; the rest is left to the policy."""


@dataclass(frozen=True)
class ExplorationTable:
    """Tries actions by chance where its rows match.

    Parameters
    ----------
    rows
        Conditions and actions.
    probability
        With which each row's action is drawn.
    """

    rows: tuple[RuleRow, ...]
    probability: tuple[float, ...]

    def shares(self, covariates: Mapping[str, Any], stage: int) -> dict[str, float]:
        """Probability with which each action is drawn in a state; the policy decides in the rest."""
        drawn = dict[str, float]()
        for row, share in zip(self.rows, self.probability, strict=True):
            if str(row.action) not in drawn and row.matches_state(covariates, stage):
                drawn[str(row.action)] = share
        total = sum(drawn.values())
        return {name: share * min(1.0, MOST_EXPLORED / total) for name, share in drawn.items()}


def read_exploration(
    path: str | Path, actions: Sequence[Any], columns: Sequence[str], texts: Collection[str] = ()
) -> ExplorationTable:
    """Read a table from a CSV file.

    Parameters
    ----------
    path
        The file.
    actions, columns
        That the policy may take, and that it looks at.
    texts
        Those of the columns that hold text.

    Raises
    ------
    ArgumentError
        The file cannot be read or is no such table, names an action or a column that the policy does not know, or a
        probability is none; file and row are named.
    """
    path = Path(path)
    try:
        entries = _csv_entries(path, PROBABILITY)
        written = [asked.pop(PROBABILITY, "") for asked, _ in entries]
        rows = _rows(entries, {})
        _check(rows, actions, columns, texts)
        return ExplorationTable(rows, tuple(_share(k, text) for k, text in enumerate(written, start=1)))
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as a table of what to try ({reason_of(error)})") from error


def _check(rows: Sequence[RuleRow], actions: Sequence[Any], columns: Sequence[str], texts: Collection[str]) -> None:
    known = [*columns, STAGE]
    for number, row in enumerate(rows, start=1):
        if str(row.action) not in map(str, actions):
            raise ArgumentError(f"row {number}: {named_in('action', row.action, actions)}")
        unknown = next((one.column for one in row.conditions if one.column not in known), None)
        if unknown is not None:
            raise ArgumentError(f"row {number}: {named_in('column', unknown, known)}")
        for one in row.conditions:
            if isinstance(one.value, str) != (one.column in texts):
                holds = "text" if one.column in texts else "numbers"
                raise ArgumentError(f"row {number}: {one.column} is {one.value!r}, and the policy knows {holds} of it")


def _share(number: int, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = np.nan
    if not 0.0 < share < 1.0:
        raise ArgumentError(f"row {number}: {PROBABILITY} is {text!r}; give a number between 0 and 1")
    return share


def as_csv(conditions: Sequence[Mapping[str, str]], actions: Sequence[str], shares: Sequence[float]) -> str:
    """Write rows down as `read_exploration` reads them."""
    columns = list(dict.fromkeys(name for one in conditions for name in one))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*columns, ACTION, PROBABILITY])
    for one, action, share in zip(conditions, actions, shares, strict=True):
        writer.writerow([*(one.get(name, "") for name in columns), action, f"{share:.2g}"])
    return text.getvalue()


FINISH = "FINISH"
"""What ends a trajectory of tables, and is always possible."""


@dataclass(frozen=True, eq=False)
class FallBack:
    """Names an action in any state, whatever is known of it.

    Parameters
    ----------
    usual
        The usual action of each stage; beyond them that of the last goes on.
    says
        Where `usual` comes from, in words.
    rule
        What is asked first; None for nothing.
    rule_name
        What it is called.
    """

    usual: tuple[Hashable, ...]
    says: str
    rule: "RuleTable | None" = None
    rule_name: str = ""

    def action(self, covariates: Mapping[str, Any], stage: int) -> tuple[Any, str]:
        """Name the action in a state, and what named it; a rule that fails in it is passed over."""
        usual = self.usual[min(stage, len(self.usual)) - 1]
        if self.rule is None:
            return usual, self.says
        try:
            return self.rule.action(covariates, stage), self.rule_name
        except (HalfseenError, TypeError, ValueError) as error:
            return usual, f"{self.says}, for {self.rule_name} fails: {error}"


def rule_of(stored: StoredPolicy, file: Path) -> "RuleTable":
    """Read a rule of thumb whose actions a policy knows.

    Raises
    ------
    ArgumentError
        The policy is of tables, the file is no rule, or it names an action that the policy does not know.
    """
    if stored.is_table:
        raise ArgumentError(f"{file}: the policy is of tables of objects, and rules are of named actions; leave it out")
    rule = read_rule_table(file, stored.horizon, stored.policy.actions)
    unknown = next((name for name in rule.actions if name not in stored.policy.actions), None)
    if unknown is not None:
        raise ArgumentError(f"{file}: {named_in('action', unknown, stored.policy.actions)}")
    return rule


def fall_back_of(stored: StoredPolicy, file: Path | None = None) -> FallBack | None:
    """Find what decides in a policy's place; None where a folder of before does not say what its log did.

    Parameters
    ----------
    stored
        The policy.
    file
        A rule as .csv or .toml, which is asked first; None for the log's usual actions alone.

    Raises
    ------
    ArgumentError
        As `rule_of`.
    """
    if stored.is_table:
        if file is not None:
            rule_of(stored, file)
        return FallBack((FINISH,), "it ends the trajectory")
    rule = None if file is None else rule_of(stored, file)
    usual = usual_actions(stored)
    if rule is None:
        return FallBack(usual, "the usual action of its log in this stage") if usual else None
    fixed = rule.rows[-1].action
    known = (usual, "the usual action of its log in this stage") if usual else ((fixed,), "the last row of its rule")
    return FallBack(*known, rule, f"the rule {file.name}" if file else "")


def usual_actions(stored: StoredPolicy) -> tuple[Hashable, ...]:
    """By stage, the possible action that the log of a policy of named actions took most often; empty if unknown."""
    usual: list[Hashable] = []
    counts = [*stored.record.get("actions_taken", ())][: stored.horizon]
    for possible, taken in zip(stored.policy.actions_by_stage.values(), counts, strict=False):
        seen = [name for name in possible if str(name) in taken]
        usual += [max(seen, key=lambda name: taken[str(name)])] if seen else usual[-1:]
    return tuple(usual)
