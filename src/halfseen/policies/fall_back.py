"""What decides in a policy's place: a rule of thumb, else what the policy's log did most often in that stage."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from halfseen.errors import ArgumentError, HalfseenError
from halfseen.policies.folder.stored import StoredPolicy

if TYPE_CHECKING:
    from halfseen.policies.rule_table import RuleTable

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
    from halfseen.policies.rule_files import named_in, read_rule_table

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
