"""A policy that is warm, and the next one, which takes its place between two requests."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from halfseen.policies import NamedDecider, decider_of, read_policy
from halfseen.policies.decision import Decider
from halfseen.policies.folder.kinds import kind_named
from halfseen.policies.folder.record import as_json
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.observations import UNDECIDED, refuse_team
from halfseen.policies.ranges import middle_of

MOST_WARMED = 12
"""Objects of the largest table that is compiled for before the first request; a larger one is when it comes."""


@dataclass(frozen=True, eq=False)
class InService:
    """A policy that answers; it never changes.

    Parameters
    ----------
    stored
        The policy.
    decider
        The same behind the port.
    digest
        What tells it from others: the first 12 digits of the SHA-256 of its record and its numbers.
    """

    stored: StoredPolicy
    decider: Decider
    digest: str

    @property
    def counts_views(self) -> bool:
        """Whether it learned from logs that count what has been in view, so that a cell's law tells what labels do."""
        return self.stored.is_table and self.stored.record["schema"].get("counts_views", False)


def taken_into_service(folder: Path, *, extrapolates: bool = False) -> InService:
    """Read a policy, check all of it, and let it decide once, so that no request waits for what loads late.

    Parameters
    ----------
    folder
        As `read_policy` takes it.
    extrapolates
        As `decider_of` takes it.

    Raises
    ------
    PolicyError
        It cannot be read, or decides for a team.
    """
    stored = read_policy(folder)
    refuse_team(stored, UNDECIDED, folder)
    decider = decider_of(stored, extrapolates=extrapolates)
    _warm(stored, decider)
    return InService(stored, decider, _digest(stored))


def _warm(stored: StoredPolicy, decider: Decider) -> None:
    """Decide once at each stage, or, of tables, for each number of objects in the logs: it is compiled then."""
    if isinstance(decider, NamedDecider):
        for stage in range(1, stored.horizon + 1):
            ranges = stored.ranges(stage)
            if ranges is not None:
                decider.decide_known({name: middle_of(seen) for name, seen in ranges.items()}, stage)
        return
    from halfseen.tables.present import first_state
    from halfseen.world.scene import Scene

    fewest, most = (stored.ranges(1) or {}).get("num_objects", (1, 0))
    for number in range(max(1, int(fewest)), min(int(most), MOST_WARMED) + 1):
        nothing_hidden = Scene(np.zeros((number, number)))
        decider.decide(first_state(nothing_hidden, stored.horizon, stored.record["schema"]["dirty_share"]))


def _digest(stored: StoredPolicy) -> str:
    digest = hashlib.sha256(as_json(stored.record))
    for name, array in sorted(kind_named(stored.record["kind"]).arrays_of(stored.policy).items()):
        digest.update(name.encode() + array.tobytes())
    return digest.hexdigest()[:12]
