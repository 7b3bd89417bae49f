"""Recording trajectories as they happen; a kill at any moment loses at most the stage in progress.

::

    with LogRecorder("logs") as recorder:
        trajectory = recorder.begin_trajectory(scene="cell 3")
        while not is_over:
            trajectory.begin_stage(covariates=seen, action=action, probability=probability)
            ...                                      # the robot acts
            trajectory.complete_stage(reward=1.0)
        trajectory.finish()                                # or trajectory.cut("operator")

`halfseen.logs.read_logs` reads the folder at any time, even during recording. A trajectory that was interrupted by a
crash is read as cut by ``crash`` at the last time at which it was known to run; `halfseen.logs.recorded` explains how,
and the effect on estimates.

With several robots at once, each stage names the one that decides (``begin_stage(…, robot=1)``), and `drop_out`
notes that one of them is gone while the others go on.

The recorder's state is replaced as a whole, never changed in place. An event and the state after it are stored in one
assignment, which Ctrl-C cannot split: it comes before both, and the event is then rolled back, or after both.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.checks import checked_unit
from halfseen.logs.columns import UNKNOWN_CAUSE, shown
from halfseen.logs.journal import PART_BYTES
from halfseen.logs.journal_writer import JournalWriter, synced_events
from halfseen.logs.logs import Logs
from halfseen.logs.parquet import MANIFEST
from halfseen.logs.recorded import CRASH, RESUMED
from halfseen.logs.recording_state import RecordingState, TrajectoryState
from halfseen.logs.trajectory_recorder import TrajectoryRecorder
from halfseen.writing import path_of


class LogRecorder:
    """Record trajectories into a folder, stage by stage.

    One recorder at a time holds a folder. It appends to a folder that was recorded before. Each call is checked and
    then handed to the operating system in one write before it returns. A refused call leaves no trace, and the
    trajectory goes on.

    Parameters
    ----------
    folder
        Target folder; it is created if missing.
    fsync
        When to wait for the disk: "never"; each "trajectory", when it ends; each "stage", when it begins; or each
        "event". With "never", no written event is lost when the process dies, but a power failure or a crash of
        the operating system may lose the last half minute. Otherwise they lose, if the disk honours fsync, no
        more than the trajectory, stage or event in progress; a call that waits takes as long as the disk does, commonly
        0.1 to 20 ms (`benchmarks/recorder.py` measures it). True is "event", False is "never".
    reward_unit
        Unit of the rewards, such as "parts": a short text, for people; None for the unit recorded before, if any.
    check
        Extra check of a trajectory, such as `halfseen.world.check_log` for robots at a table. It is called with the
        trajectory so far, cut just now, when a stage begins or a robot drops out, and raises `LogError` to refuse
        that. It reads the whole trajectory each time: meant for stages of a second or more.
    part_bytes
        Size of a journal file above which the next trajectory begins another file of the folder [B].
    keeps_events
        Whether to keep the events of the last trajectory for `TrajectoryRecorder.events`.

    Raises
    ------
    ArgumentError
        Another recorder holds the folder, it contains finished logs, or it cannot be written; or `part_bytes` is not
        a positive whole number.
    LogError
        The existing recording is not a journal or has another unit, or the unit is not a short text.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = mkdtemp()
    >>> with LogRecorder(folder) as recorder:
    ...     trajectory = recorder.begin_trajectory(scene="cell 3")
    ...     trajectory.begin_stage(covariates={"x": 0.1}, action="PICK")
    ...     trajectory.complete_stage(reward=1.0, elapsed_s=2.5)
    ...     trajectory.finish()
    >>> from halfseen.logs import read_logs
    >>> print(read_logs(folder).summary())
    1 trajectory of up to 1 stage and 2.5 s: 1 finished, 0 cut (0%).
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        fsync: bool | str = False,
        reward_unit: str | None = None,
        check: Callable[[Logs], object] | None = None,
        part_bytes: int = PART_BYTES,
        keeps_events: bool = False,
    ) -> None:
        folder, unit = path_of(folder), checked_unit(reward_unit)
        if (folder / MANIFEST).exists():
            raise ArgumentError(f"{folder}: it holds finished logs; record into another folder")
        if not isinstance(part_bytes, int) or part_bytes < 1:
            raise ArgumentError(f"part_bytes is {part_bytes!r}; give a whole number of bytes, such as {PART_BYTES}")
        self._folder, self._check, self._keeps_events = folder, check, keeps_events
        self._names: set[int | str] = set()
        self._torn: list[dict[str, Any]] = []
        self.num_earlier_stages = 0
        """Number of stages that the folder held before."""
        self._restored = RecordingState()
        self._trajectory: TrajectoryRecorder | None = None
        self._journal = JournalWriter(folder, synced_events(fsync), self._restore, unit, part_bytes)
        self._journal.known = self._restored

    def __enter__(self) -> "LogRecorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close(UNKNOWN_CAUSE if kind is None else "operator" if kind is KeyboardInterrupt else CRASH)

    def begin_trajectory(self, name: Any = None, /, **columns: Any) -> TrajectoryRecorder:
        """Begin a trajectory. Its clock starts with its first stage; before that, nothing of it is on disk.

        Parameters
        ----------
        name
            Its name, unique in the folder: always a whole number or always text; the next number if left out.
        **columns
            Further columns of it, such as the scene.

        Raises
        ------
        LogError
            A trajectory is in progress, or the name is taken.
        """
        if self._trajectory is not None and not self._trajectory.is_ended:
            raise LogError(
                f"trajectory {shown(self._trajectory.name)}: it is in progress; finish() or cut() it before the next "
                "one begins"
            )
        known = self._journal.known
        if known.trajectory is not None and known.trajectory.stage:
            self._names.add(known.trajectory.name)
        wanted = self._next_name() if name is None else name
        schema, label, row = known.schema.with_trajectory(wanted, columns)
        if label in self._names:
            raise LogError(f"trajectory {shown(label)}: it is in the folder already; choose another name, or give none")
        self._trajectory = TrajectoryRecorder(self._journal, label, row, schema, self._check, self._keeps_events)
        return self._trajectory

    def resume(self) -> TrajectoryRecorder | None:
        """Resume the trajectory that was in progress when the folder was last closed; None if there was none.

        Call it before the first trajectory begins. Its clock must be given: no clock of this process has measured the
        time in between.

        Raises
        ------
        LogError
            The disk is full.
        """
        is_read = any(event["event"] == "done" and not event.get("is_given") for event in self._torn)
        if not self._torn or is_read or self._trajectory is not None:
            return None
        known, name, columns = self._journal.known, self._torn[0]["trajectory"], self._torn[0]["columns"]
        trajectory = TrajectoryRecorder(self._journal, name, columns, known.schema, self._check, self._keeps_events)
        state = reduce(TrajectoryState.after, self._torn, TrajectoryState(name, number=1))
        state = replace(state, is_given=True, noted_s=0.0, events=tuple(self._torn))
        self._journal.append({"event": RESUMED, "trajectory": name}, replace(known, trajectory=state))
        self._trajectory = trajectory
        return trajectory

    @property
    def trajectory(self) -> TrajectoryRecorder | None:
        """The trajectory that began last; None before the first."""
        return self._trajectory

    @property
    def kinds(self) -> dict[str, str] | None:
        """Kinds of the covariates, such as "number", "truth value" or "text"; None before the first stage."""
        return self._journal.known.schema.covariates

    @property
    def kinds_of_objects(self) -> dict[str, str] | None:
        """The same for the columns of objects; empty if stages have no objects."""
        return self._journal.known.schema.objects

    def check_choice(self, action: Any, probability: Any) -> None:
        """Refuse a choice of an action that the next stage could not hold, whatever else it holds.

        Raises
        ------
        LogError
            Actions so far are of another kind, or come without a probability, or with a robot.
        """
        schema = self._journal.known.schema
        if schema.covariates is not None:
            chosen = {"action": action, "probability": probability}
            replace(schema, covariates=None, objects=None).with_stage({}, None, chosen, str(self._folder))

    def close(self, cause: str | None = UNKNOWN_CAUSE) -> None:
        """Cut the trajectory in progress, if any, and release the folder; without a cause it may be resumed.

        Leaving a ``with`` block does the same, with the cause "operator" after Ctrl-C and "crash" after an error.
        """
        try:
            last = None if self._journal.is_closed or cause is None else self._trajectory
            if last is not None and not last.is_ended:
                last.cut(cause)
        finally:
            self._journal.close()

    def _next_name(self) -> int | str:
        is_text = self._journal.known.schema.labels.get("trajectory") == "text"
        names = map(str if is_text else int, count(len(self._names) + 1))
        return next(name for name in names if name not in self._names)

    def _restore(self, event: dict[str, Any]) -> None:
        """Update names and columns with one event of the existing journal."""
        known = self._restored
        self._torn = torn_by(self._torn, event)
        if event["event"] == "done":
            self._restored = replace(known, num_shares=len(event.get("own_rewards", ())))
        if event["event"] != "stage":
            return
        self.num_earlier_stages += 1
        schema, where = known.schema, f"trajectory {shown(event['trajectory'])}, stage {event['stage']}"
        if event["stage"] == 1:
            schema, name, _ = schema.with_trajectory(event["trajectory"], event["columns"])
            self._names.add(name)
        schema, _ = schema.with_stage(event["covariates"], event.get("objects"), event, where)
        self._restored = replace(known, schema=schema)


def torn_by(events: list[dict[str, Any]], event: dict[str, Any]) -> list[dict[str, Any]]:
    """Events of the trajectory in progress after one more event; empty if none is in progress."""
    match event["event"]:
        case "stage" if event["stage"] == 1:
            return [event]
        case "finished" | "cut" | "hole":
            return []
        case "stage" | "done" | "running" | "out" if events:
            events.append(event)
    return events
