"""The port: whatever decides is asked for a `Decision`, by a command line, a study or a server alike."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True)
class Decision:
    """What to do, and on what grounds.

    Parameters
    ----------
    action
        What to do, by name; on a table such as ``"LIFT 2"``.
    q_values
        What the policy goes by: Q of each action by name, with pessimism lowered by its margin [reward]; None where it
        is not possible. Empty where the policy values nothing.
    reason
        Why it is best, in one sentence.
    warnings
        What is doubtful, the gravest first.
    intervals
        95 % interval of Q itself, by name of each possible action [reward]; empty where nobody knows it.
    chance_best
        Probability that no action is better, by name of each possible action; empty where nobody knows it.
    """

    action: Any
    q_values: dict[str, float | None]
    reason: str
    warnings: tuple[str, ...] = ()
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance_best: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Decider(Protocol):
    """Decides from what is observed: a `NamedObservation`, or where a table's trajectory stands (`Present`)."""

    def decide(self, observation: Any) -> Decision:
        """Decide once.

        Raises
        ------
        HalfseenError
            The observation is not one that the policy can decide from.
        """
        ...
