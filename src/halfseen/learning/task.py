"""What is decided: the seam between eq. 3, which runs on arrays, and the logs and policies of one kind of problem.

`NamedActions` is the task of named actions on plain covariates; `halfseen.tables` holds that of a table of objects. A
task of one's own needs the names below and nothing else.
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
    Logs = Any  # Policies know what a task is, and load no log.

AUTO: Literal["auto"] = "auto"

ACTION = "action"
"""Among the names of censoring covariates, this one stands for the action that was taken."""

TASKS = {"table": "halfseen.tables.task:TableTask", "team": "halfseen.tables.task:TeamTask"}
"""Tasks that have a name; they load where they are asked for."""


class Encoded(NamedTuple):
    """What the Q-functions look at, and what was done; stages that a trajectory does not have hold zeros."""

    features: Float[np.ndarray, "n T A F"]
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]
    outcome: Float[np.ndarray, "n T Z"] | None = None
    """What became of each stage, where the task's `reduce_variance` asks for more than the rest tells."""
    policy: Float[np.ndarray, "n T A"] | None = None
    """π(a | S_t) of the policy whose Q is wanted, 0 or 1; None for the best one's."""

    @property
    def taken(self) -> Float[np.ndarray, "n T F"]:
        """Features of the action that was taken."""
        return np.take_along_axis(self.features, self.action[..., None, None], axis=2)[:, :, 0]


class RewardedStages(NamedTuple):
    """What the stages of a log paid."""

    encoded: Encoded
    reward: Float[np.ndarray, "n T"]
    """0 where not completed."""
    weight: Float[np.ndarray, "n T"]
    """Of completed stages in eq. 3; 0 elsewhere."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which a trajectory had come to its own end."""


class LearnedQ(NamedTuple):
    """Q-functions, or a batch of them, and what a policy needs beside them; T counts steps to go, one step first."""

    coefficients: Float[np.ndarray, "*B T K F"]
    """The offset first."""
    kernel_map: KernelMap | None = None
    """Features of the RKHS; None where Q is linear."""
    is_seen: Bool[np.ndarray, "T K"] | None = None
    """Blocks that have a value; None if all have."""
    margin: Float[np.ndarray, "*B T K F F"] | None = None
    """M of the lower confidence bound Q̂ − ‖Mᵀ (1, features)‖; None without pessimism."""
    behaviour: Float[np.ndarray, "K G"] | None = None
    """Coefficients of the behaviour policy, which waives margins (`behaviour`); None where it is not known."""
    behaviour_weight: float = 0.0
    """τ: what a nat of log b counts for beside Q (`behaviour`)."""


@runtime_checkable
class Task(Protocol):
    """How the logs of one kind of problem become arrays, and Q-functions a policy.

    A task that chooses something by the log may say what and why in `chosen`, a tuple of sentences. One whose features
    tell the kinds of actions apart by themselves, so that one block of coefficients serves them all, says so by
    `is_joint`; `block_names` are then the kinds. One that encodes a policy whose Q is wanted, which then draws nothing,
    says so by `is_of_policy`.
    """

    @property
    def block_names(self) -> tuple[str, ...]:
        """Name of each of the K blocks of coefficients: an action, or a verb."""
        ...

    @property
    def end_action(self) -> int | None:
        """Action that ends a trajectory wherever it is taken, if there is one."""
        ...

    @property
    def is_shared(self) -> bool:
        """Whether every action of a state has the same features, apart by its block alone."""
        ...

    def fitted(self, logs: Logs, horizon: int) -> "Task":
        """Learn from a log, or a sample of its trajectories, what the features need; the task itself if nothing."""
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
        """What cuts may depend on, a row for each stage of the log; None for all."""
        ...

    def fitted_to_rewards(self, parts: Iterable["RewardedStages"]) -> "Task":
        """Learn from a log in parts what `reduce_variance` needs of all of it; the task itself if nothing."""
        ...

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards of the same mean and less noise, and control variates of mean 0; as they are and None if unknown."""
        ...

    def policy(self, learned: LearnedQ) -> Any:
        """Policy that follows Q-functions, or a batch of them, and takes what has a value."""
        ...

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy in every stage of a log.

        Raises
        ------
        ArgumentError
            The policy decides nothing about such logs, or draws its actions and cannot say how.
        """
        ...


def named_task(name: str, **parameters: Any) -> Task:
    """Make a task that has a name."""
    if name not in TASKS:
        raise ArgumentError(f"task is {name!r}; it is {', '.join(map(repr, TASKS))}, or an object that is a Task")
    module, attribute = TASKS[name].split(":")
    return getattr(import_module(module), attribute)(**parameters)


LAWS = {
    "table": "halfseen.tables.learner:TableLearner",
    "team": "halfseen.tables.learner:TeamLearner",
}
"""Learners that fit laws to the log, by the name of the task."""
OF_LINEAR = {"q_function": AUTO, "stages": AUTO, "reg": "cv", "pessimism": AUTO, "half_life": None}
"""Parameters of eq. 3 without laws; where one is given, that is what is wanted."""


def learner_of(name: str, plain: type, laws: str | None, parameters: Mapping[str, Any]) -> type:
    """Choose who learns a task that has a name: with the help of laws, or by eq. 3 alone.

    That is where laws are None or something is said of it; what is said of laws where none help is refused.
    """
    if laws not in (AUTO, None):
        raise ArgumentError(f"laws is {laws!r}; it is 'auto', or None for eq. 3 without laws")
    if laws is not None and all(parameters.get(each, default) == default for each, default in OF_LINEAR.items()):
        module, attribute = LAWS[name].split(":")
        return getattr(import_module(module), attribute)
    for said in ("prior_law", "world"):
        if parameters.get(said) is not None:
            raise ArgumentError(
                f"{said} is given, but no law helps to learn where laws=None or one of {', '.join(OF_LINEAR)} is; "
                "leave one of them out"
            )
    return plain
