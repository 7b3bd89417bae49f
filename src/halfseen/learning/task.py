"""The decision problem: the interface between eq. 3, which runs on arrays, and the logs and policies of one task.

`NamedActions` is the task of named actions on plain covariates; `halfseen.tables` has that of a table of objects. A
custom task needs the names below and nothing else.
"""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.lazy import Frame
from halfseen.learning.q_space import KernelMap
from halfseen.shapes import Bool, Float, Int

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Policies use this module but load no log.

AUTO: Literal["auto"] = "auto"

ACTION = "action"
"""Name of the action taken, for use among the names of censoring covariates."""

TASKS = {"table": "halfseen.tables.task:TableTask", "team": "halfseen.tables.task:TeamTask"}
"""Named tasks; each is loaded on first use."""


class Encoded(NamedTuple):
    """Inputs of the Q-functions and actions taken; stages that a trajectory does not have hold zeros."""

    features: Float[np.ndarray, "n T A F"]
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    outcome: Float[np.ndarray, "n T Z"] | None = None
    """The outcome of each stage, if the task's `reduce_variance` needs more than the other arrays hold."""
    policy: Float[np.ndarray, "n T A"] | None = None
    """π(a | S_t), 0 or 1, of the policy to evaluate; None for the optimal policy."""

    @property
    def taken(self) -> Float[np.ndarray, "n T F"]:
        """Features of the action taken."""
        return np.take_along_axis(self.features, self.action[..., None, None], axis=2)[:, :, 0]


class RewardedStages(NamedTuple):
    """Rewards and weights of the stages of a log."""

    encoded: Encoded
    reward: Float[np.ndarray, "n T"]
    """0 if not completed."""
    weight: Float[np.ndarray, "n T"]
    """Weight of completed stages in eq. 3; 0 elsewhere."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages with which a trajectory finished."""


class LearnedQ(NamedTuple):
    """Q-functions, or a batch of them, and what a policy needs besides; T counts steps to go, one step first."""

    coefficients: Float[np.ndarray, "*B T K F"]
    """The intercept first."""
    kernel_map: KernelMap | None = None
    """Features of the RKHS; None if Q is linear."""
    is_seen: Bool[np.ndarray, "T K"] | None = None
    """Blocks that have a value; None if all have one."""
    margin: Float[np.ndarray, "*B T K F F"] | None = None
    """M of the lower confidence bound Q̂ − ‖Mᵀ (1, features)‖; None without pessimism."""
    behaviour: Float[np.ndarray, "K G"] | None = None
    """Coefficients of the behaviour policy, which reduces margins (`behaviour`); None if it is not known."""
    behaviour_weight: float = 0.0
    """τ: weight of a nat of log b relative to Q (`behaviour`)."""


@runtime_checkable
class Task(Protocol):
    """How the logs of one kind of problem become arrays, and Q-functions become a policy.

    A task may report choices that it makes from the log, and why, in `chosen`, a tuple of sentences. A task whose
    features distinguish the kinds of actions, so that one block of coefficients serves them all, sets `is_joint`;
    `block_names` then names the kinds. A task that encodes a policy to evaluate, whose actions are then not random,
    sets `is_of_policy`.
    """

    @property
    def block_names(self) -> tuple[str, ...]:
        """Name of each of the K blocks of coefficients, e.g. an action or a verb."""
        ...

    @property
    def end_action(self) -> int | None:
        """Action that ends a trajectory wherever it is taken; None if there is none."""
        ...

    @property
    def is_shared(self) -> bool:
        """Whether all actions of a state have the same features and differ only by block."""
        ...

    def fitted(self, logs: Logs, horizon: int) -> "Task":
        """Fit what the features need to a log, or a sample of its trajectories; the task itself if nothing."""
        ...

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log.

        Raises
        ------
        LogError
            An action was not possible, or a column is missing.
        """
        ...

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of coefficients of each action."""
        ...

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """1 for each feature that belongs to these covariates, 0 for the others."""
        ...

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_trajectory: bool) -> Frame:
        """Covariates that cuts may depend on, one row per stage of the log; `names` None for all."""
        ...

    def fitted_to_rewards(self, parts: Iterable["RewardedStages"]) -> "Task":
        """Fit what `reduce_variance` needs to a whole log, given in parts; return the task itself if nothing."""
        ...

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards of equal mean and less noise, and control variates of mean 0; unchanged and None if unknown."""
        ...

    def policy(self, learned: LearnedQ) -> Any:
        """Policy that follows Q-functions, or a batch of them, and takes only actions that have a value."""
        ...

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy in every stage of a log.

        Raises
        ------
        ArgumentError
            The policy does not apply to such logs, or is random and cannot give its probabilities.
        """
        ...


def named_task(name: str, **parameters: Any) -> Task:
    """Make a task by its name."""
    if name not in TASKS:
        raise ArgumentError(f"task is {name!r}; give {', '.join(map(repr, TASKS))}, or an object that is a Task")
    module, attribute = TASKS[name].split(":")
    return getattr(import_module(module), attribute)(**parameters)


LAWS = {
    "table": "halfseen.tables.learner:TableLearner",
    "team": "halfseen.tables.learner:TeamLearner",
}
"""Learners that fit laws to the log, by the name of the task."""
OF_LINEAR = {"q_function": AUTO, "stages": AUTO, "reg": "cv", "pessimism": AUTO, "half_life": None}
"""Parameters of eq. 3 without laws, with their defaults; giving one selects eq. 3 without laws."""


def learner_of(name: str, plain: type, laws: str | None, parameters: Mapping[str, Any]) -> type:
    """Choose the learner of a named task: with the help of laws, or by eq. 3 alone.

    Eq. 3 alone is chosen if `laws` is None or a parameter of it is given; an argument about laws is then refused.
    """
    if laws not in (AUTO, None):
        raise ArgumentError(f"laws is {laws!r}; give 'auto', or None for eq. 3 without laws")
    if laws is not None and all(parameters.get(each, default) == default for each, default in OF_LINEAR.items()):
        module, attribute = LAWS[name].split(":")
        return getattr(import_module(module), attribute)
    for said in ("prior_law", "world"):
        if parameters.get(said) is not None:
            raise ArgumentError(
                f"{said} is given, but no laws are used with laws=None or any of {', '.join(OF_LINEAR)}; leave "
                "one of them out"
            )
    return plain
