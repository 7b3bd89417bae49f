"""What a recorder knows of its folder and of the trajectory in progress, as values that are replaced whole.

An event and what is known after it are taken over in one assignment, which Ctrl-C cannot part: it comes before both,
and the event is then taken back, or after both.
"""

from dataclasses import dataclass, field
from typing import Any

from halfseen.logs.journal.clock import TrajectoryClock
from halfseen.logs.journal.values import Schema


@dataclass(frozen=True)
class TrajectoryState:
    """Where a trajectory that is being recorded stands.

    Parameters
    ----------
    name
        What it is called.
    number
        Its number among the trajectories that this recorder began.
    stage
        Number of the stage that began last; 0 before the first.
    is_in_stage, has_action
        Whether that stage is in progress, and began with an action.
    is_ended
        Whether the trajectory is finished or cut.
    clock
        Its clock at the last event.
    noted_s
        When it was last known on disk to be running [s].
    events
        Its events so far, where somebody checks the trajectory as it grows; else empty.
    """

    name: int | str
    number: int = 0
    stage: int = 0
    is_in_stage: bool = False
    has_action: bool = False
    is_ended: bool = False
    clock: TrajectoryClock = field(default_factory=TrajectoryClock)
    noted_s: float = 0.0
    events: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class Recorded:
    """What a folder holds.

    Parameters
    ----------
    schema
        Names and kinds of what was recorded so far.
    num_shares
        Of how many robots each stage tells the rewards; None before the first completed stage.
    trajectory
        The trajectory that began last; None before the first of this recorder.
    """

    schema: Schema = field(default_factory=Schema)
    num_shares: int | None = None
    trajectory: TrajectoryState | None = None
