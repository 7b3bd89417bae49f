"""What a policy is compared with: the logging policy, with and without its exploration, sequences, rules, others."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, did_you_mean
from halfseen.evaluation.logging_rule import NAME as LOGGING_RULE_NAME
from halfseen.evaluation.targets import FixedSequence, horizon_of, refuse_other_names, target_probabilities
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.learning.named_task import NamedActions
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.logs.spelling import composed
from halfseen.policies.folder import read_policy
from halfseen.policies.rule_files import read_rule_table
from halfseen.policies.rule_table import Rule
from halfseen.shapes import Float

LOGGING, LOGGING_RULE = "logging", "logging-rule"
"""The logging policy as it was, and what it does where it does not explore."""
DEFAULT = (LOGGING, LOGGING_RULE)
SEQUENCE = "sequence:"


@dataclass(frozen=True)
class Baseline:
    """What a policy is compared with.

    Parameters
    ----------
    policy
        ``"logging"``, ``"logging-rule"``, or anything that `evaluate` takes for a policy.
    name
        In plain words, as in "better than …".
    """

    policy: Any
    name: str


def baselines_of(against: Any, logs: Logs) -> tuple[Baseline, ...]:
    """Understand what `evaluate` is given to compare a policy with.

    Parameters
    ----------
    against
        One, or a list of: ``"logging"``, ``"logging-rule"``; an `Baseline` with a name of its own; a policy; a function
        of covariates and stage that names an action for each row; a text ``"sequence:A,B,A"``; or a trajectory of a CSV
        or TOML rule, or of a policy folder.
    logs
        The log that the comparison rests on.

    Raises
    ------
    ArgumentError
        One is none of these, there are none, or two have the same name.
    """
    given = list(against) if isinstance(against, list | tuple) else [against]
    if not given:
        raise ArgumentError("against is empty; give at least one baseline, or None for the logging policy")
    baselines = tuple(_baseline(each, logs) for each in given)
    names = [baseline.name for baseline in baselines]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise ArgumentError(
            f"against names {twice} twice; name it once, or tell them apart with Baseline(policy, name)"
        )
    return baselines


def _baseline(given: Any, logs: Logs) -> Baseline:
    if isinstance(given, Baseline):
        return given
    if isinstance(given, str | Path):
        return _written_baseline(str(given), logs)
    if isinstance(given, FixedSequence):
        return Baseline(given, _sequence_name(given))
    if callable(given) and not hasattr(given, "probabilities") and not hasattr(given, "decide"):
        return Baseline(_rule_of(given, logs), f"the rule {getattr(given, '__name__', type(given).__name__)}")
    return Baseline(given, f"the {type(given).__name__}")


def _written_baseline(text: str, logs: Logs) -> Baseline:
    if text == LOGGING:
        return Baseline(LOGGING, "the logging policy")
    if text == LOGGING_RULE:
        return Baseline(LOGGING_RULE, LOGGING_RULE_NAME)
    if text.startswith(SEQUENCE):
        return _written_sequence(text, logs)
    path = Path(text)
    if path.suffix.lower() in (".csv", ".toml"):
        return Baseline(read_rule_table(path, logs.horizon, _logged_actions(logs)), f"the rule {path.name}")
    if path.is_dir():
        return Baseline(read_policy(path).policy, f"the policy {path.name}")
    raise ArgumentError(
        f"against is {text!r}; it is {LOGGING}, {LOGGING_RULE}, {SEQUENCE}A,B,A, a file with a rule (.csv or .toml), "
        f"or a policy folder{did_you_mean(text, (LOGGING, LOGGING_RULE))}"
    )


def _written_sequence(text: str, logs: Logs) -> Baseline:
    known = {str(name): name for name in _logged_actions(logs)}
    names = [name.strip() for name in text.removeprefix(SEQUENCE).split(",")]
    if not all(names):
        raise ArgumentError(f"against is {text!r}; name an action for each stage, as {SEQUENCE}A,B,A")
    sequence = FixedSequence(tuple(known.get(name, name) for name in names))
    return Baseline(sequence, _sequence_name(sequence))


def _sequence_name(sequence: FixedSequence) -> str:
    return f"the sequence {', '.join(map(str, sequence.sequence))}"


def _logged_actions(logs: Logs) -> list[Hashable]:
    return logs.stages["action"].dropna().unique().tolist()


def _rule_of(decide: Any, logs: Logs) -> Rule:
    taken = [np.asarray(decide(frame, stage), dtype=object).ravel() for stage, frame in _stages(logs)]
    return Rule(decide, tuple(dict.fromkeys(name for names in taken for name in names)), logs.horizon)


def _stages(logs: Logs) -> Sequence[tuple[int, Any]]:
    return [(int(stage), frame) for stage, frame in logs.stages.groupby("stage")]  # type: ignore[arg-type]


@dataclass(frozen=True)
class _KnownActions:
    """A policy less the actions that the task does not have, and that it takes nowhere in the log."""

    policy: Any
    actions: tuple[Hashable, ...]
    horizon: int

    def probabilities(self, frame: Any, stage: int) -> Float[np.ndarray, "m A"]:
        column = [self.policy.actions.index(name) for name in self.actions]
        return np.asarray(self.policy.probabilities(frame, stage))[:, column]


def baseline_probabilities(
    policy: Any, name: str, logs: Logs, trajectories: TrajectoryArrays, task: Task
) -> Float[np.ndarray, "n T A"] | str:
    """π(a | S_t) of a baseline in every begun stage; or in words, the action that it takes and the log has not.

    Raises
    ------
    ArgumentError
        It is no policy of such a log, names the same actions by other types, or has fewer stages than the log.
    """
    horizon = trajectories.action.shape[1]
    own = horizon_of(policy, horizon)
    if own < (logs.horizon if isinstance(task, NamedActions) else horizon):
        raise ArgumentError(
            f"against: {name} is for {own} stage(s), and a trajectory has up to {logs.horizon}; add some"
        )
    if isinstance(task, NamedActions):
        if not isinstance(policy, NamedActionPolicy):
            raise ArgumentError(f"against: {name} decides nothing about named actions, which the log is of")
        if {composed(str(each)) for each in policy.actions} & {composed(str(each)) for each in task.names}:
            refuse_other_names(policy, logs, name)
        unknown = _unknown_action(policy, logs, task)
        if unknown is not None:
            return unknown
        kept = tuple(name for name in policy.actions if name in task.names)
        policy = _KnownActions(policy, kept, own)
    elif isinstance(policy, NamedActionPolicy):
        raise ArgumentError(f"against: {name} decides nothing about tables of objects, which the log is of")
    return target_probabilities(policy, logs, trajectories, task)


def _unknown_action(policy: NamedActionPolicy, logs: Logs, task: NamedActions) -> str | None:
    """The first action that it takes in a stage where the task has none of that name."""
    for stage, frame in _stages(logs):
        possible = [name for name, is_it in zip(task.names, task.possible(stage), strict=True) if is_it]
        taken = np.asarray(policy.probabilities(frame, stage)).max(axis=0) > 0
        for name, is_taken in zip(policy.actions, taken, strict=True):
            if is_taken and name not in possible:
                return f"{name} in stage {stage}"
    return None
