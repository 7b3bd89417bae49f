"""What happened last: the decision in progress, and the trajectories that ended since the server began."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from msgspec import UNSET

from halfseen.logs.columns import STEPPED_BACK
from halfseen.logs.recorded import followed
from halfseen.monitoring.dealing import ARM
from halfseen.serving.models import Decided, Recorded
from halfseen.serving.watching import Watch

MOST_TRAJECTORIES = 12


@dataclass(eq=False)
class Recent:
    """What happened last.

    Parameters
    ----------
    watch
        Holds the log against what was promised; None where nobody does.
    decision
        The last one; None before the first.
    seen
        Covariates that it was about.
    trajectories
        The newest first.
    """

    watch: Watch | None = None
    decision: Decided | None = None
    seen: Mapping[str, Any] = field(default_factory=dict)
    trajectories: deque[Recorded] = field(default_factory=partial(deque, maxlen=MOST_TRAJECTORIES))

    def decided(self, seen: Mapping[str, Any], decision: Decided) -> None:
        """Keep a decision, and what it was about."""
        self.seen, self.decision = seen, decision

    def ended(self, events: Sequence[dict[str, Any]]) -> None:
        """Keep a trajectory that is over, and have the log watched again."""
        rows = followed(events).rows
        (trajectory,), stages = rows["trajectories"], rows["stages"]
        recorded = Recorded(
            trajectory=trajectory["trajectory"],
            arm=trajectory.get(ARM, UNSET),
            stages=len(stages),
            stepped_back=sum(stage.get(STEPPED_BACK) is not None for stage in stages),
            reward=sum(stage["reward"] or 0.0 for stage in stages),
            ending=trajectory["ending"],
            cause=trajectory["cause"],
        )
        self.trajectories.appendleft(recorded)
        if self.watch is not None:
            self.watch.ended()
