"""Probabilities π(a | S_t), in each stage of a log, of a policy to evaluate or of a baseline.

Baselines are the logging policy, with and without its exploration, sequences, rules and other policies.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from halfseen.errors import ArgumentError, did_you_mean, warn
from halfseen.estimator import is_count
from halfseen.evaluation.logging_rule import NAME as LOGGING_RULE_NAME
from halfseen.learning.discrete_policy import NamedActionPolicy, checked_probabilities, more_cautious
from halfseen.learning.named_task import NamedActions
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.logs.columns import shown
from halfseen.policies.folder import read_policy
from halfseen.policies.rule_files import read_rule_table, unseen
from halfseen.policies.rule_table import Rule, RuleTable
from halfseen.shapes import Float, Int
from halfseen.suggestions import composed


@dataclass(frozen=True)
class FixedSequence:
    """A policy that takes the same action in every state of a stage; a baseline.

    Parameters
    ----------
    sequence
        The action of each stage.

    Raises
    ------
    ArgumentError
        There is no stage, or the names are one text.

    Examples
    --------
    >>> FixedSequence(("B", "A")).probabilities(pd.DataFrame(index=range(2)), stage=1)
    array([[1., 0.],
           [1., 0.]])
    """

    sequence: Sequence[Hashable] | np.ndarray

    def __post_init__(self) -> None:
        if isinstance(self.sequence, str) or not hasattr(self.sequence, "__len__") or len(self.sequence) == 0:
            raise ArgumentError(f"sequence is {self.sequence!r}; give a tuple of names, one for each stage")

    @property
    def actions(self) -> tuple[Hashable, ...]:
        """Names, in the order of their first use."""
        return tuple(dict.fromkeys(self.sequence))

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        return len(self.sequence)

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action of that stage (from 1)."""
        if not (is_count(stage) and stage <= self.horizon):
            raise ArgumentError(f"stage is {stage!r}; it lies in 1 to the horizon, {self.horizon}")
        is_taken = [name == self.sequence[stage - 1] for name in self.actions]
        return np.tile(np.array(is_taken, dtype=np.float64), (len(frame), 1))

    @property
    def actions_by_stage(self) -> dict[int, list[Hashable]]:
        """The one action of each stage, from 1."""
        return {stage: [name] for stage, name in enumerate(self.sequence, start=1)}


@dataclass(frozen=True, eq=False)
class CrossFitted:
    """One policy per fold of a log, which decides for its trajectories and was learned from the others."""

    policies: tuple[Any, ...]
    """Of each fold, in the form that the task accepts."""
    fold: Int[np.ndarray, " n"]
    """Of each trajectory."""
    horizon: int
    """Number T of stages."""

    def more_cautious(self, times: float) -> "CrossFitted":
        """The same policies with their margins multiplied."""
        return replace(self, policies=tuple(more_cautious(policy, times) for policy in self.policies))

    def target_probabilities(self, logs: Logs, horizon: int, task: Task) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of every stage that began, by the policy of each trajectory's fold; 0 elsewhere."""
        each = np.stack([task.target_probabilities(policy, logs, horizon) for policy in self.policies])
        return each[self.fold, np.arange(logs.num_trajectories)]


def refuse_other_names(policy: NamedActionPolicy, logs: Logs, who: str) -> None:
    """Refuse a policy whose actions are whole numbers if the log's are text, or vice versa."""
    logged: list[Any] = logs.stages["action"].dropna().unique().tolist()
    composed_as = {composed(name): name for name in logged if isinstance(name, str)}
    for name in policy.actions:
        if isinstance(name, str) and name not in logged and composed(name) in composed_as:
            raise ArgumentError(
                f"the action {name!a} of {who} is {composed_as[composed(name)]!a} in the log, the same word in "
                "another Unicode form; write it in the log as the policy has it"
            )
    is_text = [{isinstance(name, str) for name in names} for names in (policy.actions, logged)]
    if len(is_text[0]) != 1 or len(is_text[1]) != 1 or is_text[0] == is_text[1]:
        return
    alike = next((name for name in logged if str(name) == str(policy.actions[0])), logged[0])
    words = ["text" if True in each else "whole numbers" for each in is_text]
    raise ArgumentError(
        f"the actions of {who} are {words[0]}, such as {shown(policy.actions[0])}, but the log's are {words[1]}, such "
        f"as {shown(alike)}; write the log's column action as {words[0]}"
    )


def horizon_of(policy: Any, default: int) -> int:
    """Number of stages of a policy."""
    coefficients = getattr(policy, "coefficients", None)
    by_coefficients = None if coefficients is None else coefficients.shape[-3]
    return int(getattr(policy, "horizon", None) or by_coefficients or default)


def target_probabilities(
    policy: Any, logs: Logs, trajectories: TrajectoryArrays, task: Task
) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of every stage that began, for a policy or one per fold; 0 elsewhere."""
    horizon = trajectories.action.shape[1]
    if isinstance(policy, CrossFitted):
        probabilities = policy.target_probabilities(logs, horizon, task)
    else:
        probabilities = task.target_probabilities(policy, logs, horizon)
    probabilities = np.where(trajectories.is_begun[..., None], probabilities, 0.0)
    if np.isnan(probabilities).any():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions but does not give their probabilities, which evaluation by a "
            "log needs; evaluate it by simulation"
        )
    wrong = trajectories.is_begun[..., None] & (probabilities > 0) & ~trajectories.is_possible
    if wrong.any():
        trajectory, stage, action = np.argwhere(wrong)[0]
        raise ArgumentError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: the policy takes action number "
            f"{action + 1}, which is not possible there; give a policy for the actions of this stage"
        )
    return probabilities


LOGGING, LOGGING_RULE = "logging", "logging-rule"
"""The logging policy, and the same without its exploration."""
DEFAULT = (LOGGING, LOGGING_RULE)
SEQUENCE = "sequence:"


@dataclass(frozen=True)
class Baseline:
    """A policy to compare with.

    Parameters
    ----------
    policy
        ``"logging"``, ``"logging-rule"``, or any policy that `evaluate` accepts.
    name
        In plain words, as in "better than …".
    """

    policy: Any
    name: str


def baselines_of(against: Any, logs: Logs) -> tuple[Baseline, ...]:
    """Parse the baselines given to `evaluate`.

    Parameters
    ----------
    against
        One, or a list of: ``"logging"``, ``"logging-rule"``; a `Baseline` with its own name; a policy; a function of
        covariates and stage that returns an action for each row; a string ``"sequence:A,B,A"``; or a path of a CSV or
        TOML rule, or of a policy folder.
    logs
        The log of the comparison.
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
        return Baseline(given, f"the sequence {', '.join(map(str, given.sequence))}")
    if callable(given) and not hasattr(given, "probabilities") and not hasattr(given, "decide"):
        taken = [np.asarray(given(frame, stage), dtype=object).ravel() for stage, frame in _stages(logs)]
        rule = Rule(given, tuple(dict.fromkeys(name for names in taken for name in names)), logs.horizon)
        return Baseline(rule, f"the rule {getattr(given, '__name__', type(given).__name__)}")
    return Baseline(given, f"the {type(given).__name__}")


def _written_baseline(text: str, logs: Logs) -> Baseline:
    if text == LOGGING:
        return Baseline(LOGGING, "the logging policy")
    if text == LOGGING_RULE:
        return Baseline(LOGGING_RULE, LOGGING_RULE_NAME)
    if text.startswith(SEQUENCE):
        known = {str(name): name for name in _logged_actions(logs)}
        names = [name.strip() for name in text.removeprefix(SEQUENCE).split(",")]
        if not all(names):
            raise ArgumentError(f"against is {text!r}; name an action for each stage, as {SEQUENCE}A,B,A")
        return _baseline(FixedSequence(tuple(known.get(name, name) for name in names)), logs)
    path = Path(text)
    if path.suffix.lower() in (".csv", ".toml"):
        return Baseline(_written_rule(path, logs), f"the rule {path.name}")
    if path.is_dir():
        return Baseline(read_policy(path).policy, f"the policy {path.name}")
    raise ArgumentError(
        f"against is {text!r}; give {LOGGING}, {LOGGING_RULE}, {SEQUENCE}A,B,A, a file with a rule (.csv or .toml), "
        f"or a policy folder{did_you_mean(text, (LOGGING, LOGGING_RULE))}"
    )


def _written_rule(path: Path, logs: Logs) -> RuleTable:
    """Read a rule, and warn of categories and actions that the log does not have: they may be misspelled."""
    actions = _logged_actions(logs)
    rule = read_rule_table(path, logs.horizon, actions)
    texts = [name for name in rule.columns if name in logs.stages and not is_numeric_dtype(logs.stages[name].dtype)]
    for trouble in unseen(rule.rows, {name: [*map(str, logs.stages[name].unique())] for name in texts}):
        warn(path, trouble)
    for action in (action for action in rule.actions if action not in actions):
        warn(path, f"it takes {action!r}, which no log showed{did_you_mean(action, actions)}")
    return rule


def _logged_actions(logs: Logs) -> list[Hashable]:
    return logs.stages["action"].dropna().unique().tolist()


def _stages(logs: Logs) -> Sequence[tuple[int, Any]]:
    return [(int(stage), frame) for stage, frame in logs.stages.groupby("stage")]  # type: ignore[arg-type]


@dataclass(frozen=True)
class _KnownActions:
    """A policy without the actions that the task does not have and that it never takes in the log."""

    policy: Any
    actions: tuple[Hashable, ...]
    horizon: int

    def probabilities(self, frame: Any, stage: int) -> Float[np.ndarray, "m A"]:
        column = [self.policy.actions.index(name) for name in self.actions]
        return checked_probabilities(self.policy, frame, stage)[:, column]


def baseline_probabilities(
    policy: Any, name: str, logs: Logs, trajectories: TrajectoryArrays, task: Task
) -> Float[np.ndarray, "n T A"] | str:
    """π(a | S_t) of a baseline in every stage that began; or, in words, its action that the log does not have."""
    horizon = trajectories.action.shape[1]
    own = horizon_of(policy, horizon)
    if own < (logs.horizon if isinstance(task, NamedActions) else horizon):
        raise ArgumentError(
            f"against: {name} is for {own} stage(s), but a trajectory has up to {logs.horizon}; add stages"
        )
    if isinstance(task, NamedActions):
        if not isinstance(policy, NamedActionPolicy):
            raise ArgumentError(f"against: {name} does not decide about the named actions of the log")
        if {composed(str(each)) for each in policy.actions} & {composed(str(each)) for each in task.names}:
            refuse_other_names(policy, logs, name)
        unknown = _unknown_action(policy, logs, task)
        if unknown is not None:
            return unknown
        kept = tuple(name for name in policy.actions if name in task.names)
        policy = _KnownActions(policy, kept, own)
    elif isinstance(policy, NamedActionPolicy):
        raise ArgumentError(f"against: {name} does not decide about the tables of objects of the log")
    return target_probabilities(policy, logs, trajectories, task)


def _unknown_action(policy: NamedActionPolicy, logs: Logs, task: NamedActions) -> str | None:
    """The first action that the policy takes in a stage and that the task does not have."""
    for stage, frame in _stages(logs):
        possible = [name for name, is_it in zip(task.names, task.possible(stage), strict=True) if is_it]
        taken = checked_probabilities(policy, frame, stage).max(axis=0) > 0
        for name, is_taken in zip(policy.actions, taken, strict=True):
            if is_taken and name not in possible:
                return f"{name} in stage {stage}"
    return None
