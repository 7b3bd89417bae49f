"""Recent events of a server, and the monitoring of its log against the promise.

`halfseen monitor` runs in its own process, at low priority and with a limited rate, after a trajectory has ended, so
that no decision waits for it. Its last result stands until the next one.
"""

import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from msgspec import UNSET

from halfseen.errors import HalfseenError, NothingRecordedError
from halfseen.logs.columns import ARM, STEPPED_BACK
from halfseen.logs.recorded import followed
from halfseen.serving.models import DecisionAnswer, LoggedTrajectory

EVERY_S = 30.0
MOST_WORK = 0.1
"""Largest share of a core that it takes, for a log of any length."""
NICE = 10
FIGURES, WORK = "figures", "work_s"


@dataclass(eq=False)
class Watch:
    """Monitors a log beside the server that records it.

    Parameters
    ----------
    policy, logs
        Folders.
    every_s
        Shortest time between the starts of two looks at the log [s].
    say
        Receives the sentence of the first alarm, and the reason if the log cannot be watched.
    digest
        Identifier of the policy that decides, which the folder may hold no more; "" if unknown.
    """

    policy: Path
    logs: Path
    every_s: float = EVERY_S
    say: Callable[[str], object] = print
    digest: str = ""
    found: dict[str, Any] | None = field(default=None, init=False)
    """Result of `found_of`; None before the first look has ended."""

    def __post_init__(self) -> None:
        self._is_new, self._is_over, self._began_s, self._next_s = False, False, 0.0, 0.0
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._next_s, self._is_over = float("inf"), True
        if self._process is not None:
            self._process.kill()
        if self._thread is not None:
            self._thread.join()

    @property
    def age_s(self) -> float:
        """Time since the last finished look started [s]."""
        return time.monotonic() - self._began_s

    def ended(self) -> None:
        """Note that a trajectory has ended, and look again, now or at the next call of `look`."""
        self._is_new = True
        self.look()

    def restart(self, digest: str) -> None:
        """Watch another policy, by its identifier."""
        self.digest, self._is_new, self.found = digest, False, None

    def look(self) -> None:
        """Start a look at the log if there is news, no look is running, and one is due."""
        is_busy = self._thread is not None and self._thread.is_alive()
        if self._is_new and not is_busy and time.monotonic() >= self._next_s:
            self._is_new = False
            thread = threading.Thread(target=self._look, daemon=True)
            thread.start()
            self._thread = thread

    def _look(self) -> None:
        began_s, digest = time.monotonic(), self.digest
        found = self._asked()
        before = self.found or {}
        self._next_s = began_s + max(self.every_s, found.pop(WORK, 0.0) / MOST_WORK)
        if digest != self.digest:
            return
        self.found, self._began_s = found or None, began_s
        if found.get("is_alarm") and not before.get("is_alarm"):
            self.say(found["sentence"])
        if "error" in found and "error" not in before and not self._is_over:
            self.say(f"The log is not monitored: {found['error']}")

    def _asked(self) -> dict[str, Any]:
        words = [sys.executable, "-m", __name__, str(self.policy), str(self.logs), self.digest]
        alone = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        pipes: Any = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        try:
            with subprocess.Popen(words, env=alone, encoding="utf-8", **pipes) as self._process:
                text, trouble = self._process.communicate()
        except OSError as error:
            return {"error": f"no process can be started ({error.strerror})"}
        if self._process.returncode:
            return {"error": (trouble.strip().splitlines() or [f"it ended with {self._process.returncode}"])[-1]}
        return json.loads(text)


def found_of(policy: Path, logs: Path, digest: str = "") -> dict[str, Any]:
    """Result of `halfseen monitor --json`, with figures if matplotlib is installed; or an error in one line.

    Empty before the policy has decided a trajectory of the log.
    """
    from halfseen.logs import read_logs
    from halfseen.monitoring.monitor import monitored
    from halfseen.policies.folder import read_policy

    try:
        stored = read_policy(policy)
        if digest not in ("", stored.digest):
            return {"error": f"{policy} holds a different policy than the one in use; POST /reload to use it"}
        read = read_logs(logs, missing=stored.missing())
        found = monitored(stored, read)
    except NothingRecordedError:
        return {}
    except HalfseenError as error:
        return {"error": str(error)}
    if find_spec("matplotlib") is None:
        return found.as_dict()
    from halfseen.view.monitor_page import figures_of

    return found.as_dict() | {FIGURES: figures_of(found, read.reward_unit)}


if __name__ == "__main__":
    if hasattr(os, "nice"):
        os.nice(NICE)
    what = found_of(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
    print(json.dumps({**what, WORK: time.process_time()}, allow_nan=False))


MOST_TRAJECTORIES = 12


@dataclass(eq=False)
class Recent:
    """The latest events.

    Parameters
    ----------
    watch
        Monitors the log; None for no monitoring.
    decision
        The last decision; None before the first.
    seen
        Covariates of that decision.
    trajectories
        Recent trajectories, the newest first.
    """

    watch: Watch | None = None
    decision: DecisionAnswer | None = None
    seen: Mapping[str, Any] = field(default_factory=dict)
    trajectories: deque[LoggedTrajectory] = field(default_factory=partial(deque, maxlen=MOST_TRAJECTORIES))

    def decided(self, seen: Mapping[str, Any], decision: DecisionAnswer) -> None:
        """Keep a decision and its covariates."""
        self.seen, self.decision = seen, decision

    def ended(self, events: Sequence[dict[str, Any]]) -> None:
        """Keep a trajectory that has ended, and look at the log again."""
        rows = followed(events).rows
        (trajectory,), stages = rows["trajectories"], rows["stages"]
        recorded = LoggedTrajectory(
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
