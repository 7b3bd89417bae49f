"""What a robot tells of an attempt on an object."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Attempt:
    """How an attempt went, as the robot tells it.

    Parameters
    ----------
    is_held
        Whether the hand held something when it was lifted, and, of what was to be washed, put it into the rack.
    duration_s
        From the decision until that was known [s].
    kind
        Of the grasp; None where there was none to try.
    reason
        Why it did not hold; empty where it did.
    is_too_far
        Whether the robot reaches no grasp of it.
    """

    is_held: bool
    duration_s: float
    kind: str | None
    reason: str = ""
    is_too_far: bool = False
