"""Exploration: which other actions than the best are drawn, and with which probability.

Exploration draws another action than the best, so that the log shows the value of other actions. With ε and k possible
actions, the best is taken with probability 1 − ε + ε/k and each other one with ε/k: every possible action has a
probability above 0, which the log records. With an exploration table, only the actions that it names are drawn, each
with its own probability, in the states that it names.

An exploration table is a rule in a file (`rule_files`) with a column ``probability``, the share of the decisions in
which an action is tried. Every matching row counts, so several actions may be tried in one state::

    stage,clutter,action,probability
    <= 1.5,<= 0.5,look,0.39
    <= 1.5,,shake,0.19
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.policies.decision import Decision
from halfseen.policies.rule_files import check_values, csv_entries, named_in, number_or_text, reading, rows_of
from halfseen.policies.rule_table import ACTION, STAGE, RuleRow

PROBABILITY = "probability"
MOST_EXPLORED = 0.9
"""Largest share of the decisions of a state that may be drawn; the rest is left to the policy."""


@dataclass(frozen=True)
class ExplorationTable:
    """Draws actions for exploration where its rows match.

    Parameters
    ----------
    rows
        Conditions and actions.
    probability
        Probability with which each row's action is drawn.
    """

    rows: tuple[RuleRow, ...]
    probability: tuple[float, ...]

    def shares(self, covariates: Mapping[str, Any], stage: int) -> dict[str, float]:
        """Probability with which each action is drawn in a state; otherwise the policy decides."""
        drawn = dict[str, float]()
        for row, share in zip(self.rows, self.probability, strict=True):
            if str(row.action) not in drawn and row.matches_state(covariates, stage):
                drawn[str(row.action)] = share
        total = sum(drawn.values())
        return {name: share * min(1.0, MOST_EXPLORED / total) for name, share in drawn.items()}


def read_exploration(
    path: str | Path, actions: Sequence[Any], columns: Sequence[str], texts: Collection[str] = ()
) -> ExplorationTable:
    """Read a table of exploration from a CSV file.

    Parameters
    ----------
    path
        The file.
    actions, columns
        Actions that the policy may take, and columns that it looks at.
    texts
        Columns that hold text.

    Raises
    ------
    ArgumentError
        The file cannot be read or is no such table, names an action or a column unknown to the policy, or has an
        invalid probability; the message names file and row.
    """
    with reading(Path(path), "a table of actions to try ({})"):
        entries = csv_entries(Path(path), PROBABILITY)
        written = [asked.pop(PROBABILITY, "") for asked, _ in entries]
        rows = rows_of(entries, {})
        _check(rows, actions, columns, texts)
        return ExplorationTable(rows, tuple(_share(k, text) for k, text in enumerate(written, start=1)))


def _check(rows: Sequence[RuleRow], actions: Sequence[Any], columns: Sequence[str], texts: Collection[str]) -> None:
    known = [*columns, STAGE]
    for number, row in enumerate(rows, start=1):
        if str(row.action) not in map(str, actions):
            raise ArgumentError(f"row {number}: {named_in('action', row.action, actions)}")
        for one in row.conditions:
            if one.column not in known:
                raise ArgumentError(f"row {number}: {named_in('column', one.column, known)}")
        check_values(number, row, known, texts)


def _share(number: int, text: str) -> float:
    share = number_or_text(text)
    if isinstance(share, str) or not 0.0 < share < 1.0:
        raise ArgumentError(f"row {number}: {PROBABILITY} is {text!r}; give a number between 0 and 1")
    return share


def as_csv(conditions: Sequence[Mapping[str, str]], actions: Sequence[str], shares: Sequence[float]) -> str:
    """Write rows in the format of `read_exploration`."""
    rows, written = pd.DataFrame(list(conditions), index=range(len(actions))), [f"{share:.2g}" for share in shares]
    return rows.assign(**{ACTION: actions, PROBABILITY: written}).to_csv(index=False, lineterminator="\n")


def chance_of(decision: Decision, shares: Mapping[str, float], action: str) -> float:
    """Probability with which `taken` takes an action."""
    possible = {name: share for name, share in shares.items() if decision.q_values.get(name) is not None}
    rest = 1.0 - sum(possible.values()) if action == str(decision.action) else 0.0
    return rest + possible.get(action, 0.0)


class Taken(NamedTuple):
    """The action taken, and its probability."""

    decision: Decision
    """Decision with the action taken; its reason says if the action was drawn."""
    probability: float
    """Probability of the action; above 0."""
    is_explored: bool
    """Whether an action other than the best was drawn."""


def uniform_shares(decision: Decision, epsilon: float) -> dict[str, float]:
    """ε/k for each possible action."""
    possible = [name for name, q in decision.q_values.items() if q is not None]
    return {name: epsilon / len(possible) for name in possible} if epsilon > 0.0 else {}


def taken(decision: Decision, shares: Mapping[str, float], rng: np.random.Generator) -> Taken:
    """Take the action of a decision, or draw one to explore.

    Parameters
    ----------
    decision
        Decision of the policy, with the Q of each possible action.
    shares
        Probability with which each action is drawn; the share of an impossible action goes to the decision.
    rng
        Random generator; not used if nothing can be drawn.

    Examples
    --------
    >>> best = Decision("A", {"A": 1.0, "B": 0.5, "C": None}, "A: worth 0.50 more than B.")
    >>> taken(best, {}, np.random.default_rng(0)).probability
    1.0
    >>> shares = uniform_shares(best, 0.5)
    >>> drawn = [taken(best, shares, np.random.default_rng(seed)) for seed in range(99)]
    >>> sorted({(one.decision.action, one.probability) for one in drawn})
    [('A', 0.75), ('B', 0.25)]
    """
    possible = {name: share for name, share in shares.items() if decision.q_values.get(name) is not None}
    if not possible:
        return Taken(decision, 1.0, False)
    best, luck = str(decision.action), rng.random()
    reached = np.cumsum(list(possible.values()))
    drawn = [*possible, best][int(np.searchsorted(reached, luck, side="right"))]
    if drawn == best:
        return Taken(decision, 1.0 - float(reached[-1]) + possible.get(best, 0.0), False)
    reason = f"{drawn}: drawn to explore; otherwise the policy takes {decision.reason}"
    return Taken(replace(decision, action=type(decision.action)(drawn), reason=reason), possible[drawn], True)
