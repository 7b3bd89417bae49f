"""What the policy that is evaluated would have done in each stage of a log: π(a | S_t)."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.learning.covariates import fit_covariates
from halfseen.learning.discrete_policy import NamedActionPolicy, more_cautious
from halfseen.learning.named_task import NamedActions
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Task, named_task
from halfseen.logs import Logs
from halfseen.logs.columns import shown
from halfseen.shapes import Float, Int
from halfseen.suggestions import composed


@dataclass(frozen=True)
class FixedSequence:
    """Takes the same action for everyone, one for each stage: what a policy has to beat.

    Parameters
    ----------
    sequence
        The action of each stage.

    Examples
    --------
    >>> FixedSequence(("B", "A")).probabilities(pd.DataFrame(index=range(2)), stage=1)
    array([[1., 0.],
           [1., 0.]])
    """

    sequence: tuple[Hashable, ...]

    @property
    def actions(self) -> tuple[Hashable, ...]:
        """Names, in the order in which they first appear."""
        return tuple(dict.fromkeys(self.sequence))

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        return len(self.sequence)

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action of that stage (from 1)."""
        is_taken = [name == self.sequence[stage - 1] for name in self.actions]
        return np.tile(np.array(is_taken, dtype=np.float64), (len(frame), 1))

    @property
    def actions_by_stage(self) -> dict[int, list[Hashable]]:
        """The one action of each stage, from 1."""
        return {stage: [name] for stage, name in enumerate(self.sequence, start=1)}


@dataclass(frozen=True, eq=False)
class CrossFitted:
    """One policy for each fold of a log, which decides for its trajectories and was learned from the others.

    Parameters
    ----------
    policies
        Of each fold, what the task takes for a policy.
    fold
        Of each trajectory.
    horizon
        Number T of stages.
    """

    policies: tuple[Any, ...]
    fold: Int[np.ndarray, " n"]
    horizon: int

    def more_cautious(self, times: float) -> "CrossFitted":
        """The same policies with so many times their margins."""
        return replace(self, policies=tuple(more_cautious(policy, times) for policy in self.policies))

    def target_probabilities(self, logs: Logs, horizon: int, task: Task) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of each trajectory, by the policy of its fold."""
        each = np.stack([task.target_probabilities(policy, logs, horizon) for policy in self.policies])
        return each[self.fold, np.arange(logs.num_trajectories)]


def task_of(policy: Any, logs: Logs) -> Task:
    """Find out what a policy decides about.

    Of named actions, the task has those that the policy may take in a stage, and those that were taken there and it
    never would; covariates are the policy's, with the categories that it knows, or all of the log that hold numbers or
    text of few categories.

    Raises
    ------
    ArgumentError
        The policy is none of named actions, and the log none of tables; or one names actions by whole numbers, and the
        other by text.
    """
    if isinstance(policy, CrossFitted):
        # Those of all folds look at the same, and what one of them may take was logged.
        return task_of(policy.policies[0], logs)
    if isinstance(policy, NamedActionPolicy):
        refuse_other_names(policy, logs, "the policy")
        every = {stage: list(policy.actions) for stage in range(1, policy.horizon + 1)}
        own = getattr(policy, "actions_by_stage", every)
        covariates = getattr(policy, "covariates", None)
        categories = getattr(policy, "categories", {})
        task = NamedActions(
            _with_logged(own, logs), fit_covariates(logs) if covariates is None else covariates, categories
        )
        return task.fitted(logs, policy.horizon)
    if logs.objects is None:
        raise ArgumentError(f"{type(policy).__name__} decides nothing about named actions, which the log is of")
    return task_by(policy, num_robots=robots_of(logs))


def robots_of(logs: Logs) -> int | None:
    """K of a log that tells what several robots did; None for any other."""
    # Policies of named actions do without the world.
    from halfseen.world.log_checks import robots_in

    return robots_in(logs) or None


def task_by(policy: Any, num_robots: int | None = None, **parameters: Any) -> Task:
    """Find the task of tables by which a policy of tables is evaluated: that of several robots if it is for such.

    Parameters
    ----------
    policy
        What decides.
    num_robots
        K of the log; None for what the policy says.
    **parameters
        Of the task.
    """
    grasp = getattr(policy, "grasp", None)
    of_policy = None if getattr(type(policy), "num_robots", None) == 1 else getattr(policy, "num_robots", None)
    known = num_robots or of_policy
    if known is None:
        return named_task("table", grasp=grasp, **parameters)
    return named_task("team", grasp=grasp, num_robots=known, base=None, is_evaluating=True, **parameters)


def refuse_other_names(policy: NamedActionPolicy, logs: Logs, who: str) -> None:
    """Refuse a policy whose actions are whole numbers where the log's are text, or the other way round.

    Raises
    ------
    ArgumentError
        It is such, or one of its actions is composed otherwise by Unicode; as 1 is not '1', it would seem to take what
        was never logged.
    """
    logged: list[Any] = logs.stages["action"].dropna().unique().tolist()
    composed_as = {composed(name): name for name in logged if isinstance(name, str)}
    for name in policy.actions:
        if isinstance(name, str) and name not in logged and composed(name) in composed_as:
            raise ArgumentError(
                f"the action {name!a} of {who} is {composed_as[composed(name)]!a} in the log, the same word "
                "composed otherwise by Unicode; write it there as the policy has it"
            )
    is_text = [{isinstance(name, str) for name in names} for names in (policy.actions, logged)]
    if len(is_text[0]) != 1 or len(is_text[1]) != 1 or is_text[0] == is_text[1]:
        return
    alike = next((name for name in logged if str(name) == str(policy.actions[0])), logged[0])
    words = ["text" if True in each else "whole numbers" for each in is_text]
    raise ArgumentError(
        f"the actions of {who} are {words[0]}, such as {shown(policy.actions[0])}, and the log's are {words[1]}, such "
        f"as {shown(alike)}; write the log's column action as {words[0]}"
    )


def _with_logged(own: dict[int, list[Hashable]], logs: Logs) -> dict[int, list[Hashable]]:
    stages = logs.stages

    def logged(stage: int) -> list[Hashable]:
        return sorted(stages.loc[stages["stage"] == stage, "action"].dropna().unique().tolist(), key=str)

    return {stage: list(dict.fromkeys([*names, *logged(stage)])) for stage, names in own.items()}


def is_alike(task: Task) -> bool:
    """Whether stages of a task are alike, as those of tables are, so that one model may serve them all."""
    return task.end_action is not None or bool(getattr(task, "is_joint", False))


def horizon_of(policy: Any, default: int) -> int:
    """Stages that a policy is for."""
    coefficients = getattr(policy, "coefficients", None)
    by_coefficients = None if coefficients is None else coefficients.shape[-3]
    return int(getattr(policy, "horizon", None) or by_coefficients or default)


def target_probabilities(
    policy: Any, logs: Logs, trajectories: TrajectoryArrays, task: Task
) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of every stage that was begun; 0 elsewhere.

    Parameters
    ----------
    policy
        What the task takes for a policy, or one for each fold.
    logs
        The log.
    trajectories
        The same, laid out.
    task
        Names the actions.

    Raises
    ------
    ArgumentError
        The policy is for other actions or another kind of log, takes an action that is not possible, or draws its
        actions and cannot say how.
    """
    horizon = trajectories.action.shape[1]
    if isinstance(policy, CrossFitted):
        probabilities = policy.target_probabilities(logs, horizon, task)
    else:
        probabilities = task.target_probabilities(policy, logs, horizon)
    probabilities = np.where(trajectories.is_begun[..., None], probabilities, 0.0)
    _refuse_unknown(probabilities, policy)
    _refuse_impossible(probabilities, trajectories)
    return probabilities


def _refuse_unknown(probabilities: Float[np.ndarray, "n T A"], policy: Any) -> None:
    if np.isnan(probabilities).any():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions and does not say the probability of each, which evaluation by "
            "a log needs; evaluate it by simulation"
        )


def _refuse_impossible(probabilities: Float[np.ndarray, "n T A"], trajectories: TrajectoryArrays) -> None:
    wrong = trajectories.is_begun[..., None] & (probabilities > 0) & ~trajectories.is_possible
    if wrong.any():
        trajectory, stage, action = np.argwhere(wrong)[0]
        raise ArgumentError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: the policy takes action number "
            f"{action + 1}, which is not possible there; give a policy for the actions of this stage"
        )
