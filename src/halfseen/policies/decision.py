"""The port: whatever decides is asked for a `Decision`, by a command line, a study or a server alike."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True)
class Decision:
    """What to do, and on what grounds.

    Parameters
    ----------
    action
        What to do, by name; on a table such as ``"LIFT 2"``.
    q_values
        Q of each action by name; None where it is not possible. Empty where the policy values nothing.
    reason
        Why it is best, in one sentence.
    warnings
        What is doubtful.
    """

    action: Any
    q_values: dict[str, float | None]
    reason: str
    warnings: tuple[str, ...] = ()


@runtime_checkable
class Decider(Protocol):
    """Decides from what is observed: a `NamedObservation`, or where a table's path stands (`Present`)."""

    def decide(self, observation: Any) -> Decision:
        """Decide once.

        Raises
        ------
        HalfseenError
            The observation is not one that the policy can decide from.
        """
        ...
