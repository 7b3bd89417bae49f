"""Recording paths (trajectories) as they happen, so that a kill at any moment loses at most the stage in progress.

::

    with LogRecorder("logs") as recorder:
        path = recorder.begin_path(scene="cell 3")
        while not is_over:
            path.begin_stage(covariates=seen, action=action, probability=probability)
            ...                                      # the robot acts
            path.complete_stage(reward=1.0)
        path.finish()                                # or path.cut("operator")

`halfseen.logs.read_logs` reads the folder at any time, also while it is being recorded. A path that a crash tore is
told as cut by ``crash`` at the last time at which it was known to run; `journal_tables` says how, and why that is fair.

Where several robots work at once, each stage says which of them decides (``begin_stage(…, robot=1)``), and `drop_out`
tells that one of them is gone while the others go on.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.columns import UNKNOWN_CAUSE
from halfseen.logs.folder import MANIFEST
from halfseen.logs.journal_tables import CRASH
from halfseen.logs.journal_values import Schema, checked_number, checked_robot
from halfseen.logs.journal_writer import JournalWriter
from halfseen.logs.log_so_far import log_so_far
from halfseen.logs.logs import Logs
from halfseen.logs.path_clock import PathClock
from halfseen.logs.refusal import shown
from halfseen.logs.reward_unit import checked_unit

CAUSES = ("operator", "emergency-stop", "time-out", "battery", "sensor-lost", CRASH)
"""Usual causes of cuts; any other text will do."""

STILL_RUNNING_EVERY_S = 0.5


class LogRecorder:
    """Record paths into a folder, stage by stage.

    One recorder at a time has a folder; a folder that was recorded before is gone on with. Each call is checked and
    then handed to the operating system in one write before it returns. What is refused leaves no trace, and the path
    goes on.

    Parameters
    ----------
    folder
        Where to; it is made where it is not there.
    fsync
        Force each event to the disk. Without it, nothing that was written is lost when the process dies, but a power
        cut or a crash of the operating system may lose the last seconds. With it, they are not, as far as the disk
        keeps its word; an event then takes as long as the disk does, commonly 0.1 to 20 ms.
    reward_unit
        What rewards are counted in, such as "parts": a short text, for people; None for what was said before, if
        anything was.
    check
        What a path must hold beyond what every log must, such as `halfseen.team.check_log` for a team at a table:
        called with the path so far, cut just now, when a stage begins or a robot drops out, and raises `LogError`
        where that is to be refused. It reads all of the path each time: meant for stages of a second or more.

    Raises
    ------
    ArgumentError
        Another recorder has the folder, it holds finished logs, or it cannot be written.
    LogError
        What was recorded there before is corrupted or in another unit, or the unit is no short text.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = mkdtemp()
    >>> with LogRecorder(folder) as recorder:
    ...     path = recorder.begin_path(scene="cell 3")
    ...     path.begin_stage(covariates={"x": 0.1}, action="PICK")
    ...     path.complete_stage(reward=1.0, elapsed_s=2.5)
    ...     path.finish()
    >>> from halfseen.logs import read_logs
    >>> print(read_logs(folder).summary())
    1 path of up to 1 stage and 2.5 s: 1 finished, 0 cut (0%).
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        fsync: bool = False,
        reward_unit: str | None = None,
        check: Callable[[Logs], object] | None = None,
    ) -> None:
        folder, unit = Path(folder), checked_unit(reward_unit)
        if (folder / MANIFEST).exists():
            raise ArgumentError(f"{folder}: it holds logs that are written for good; record into another folder")
        self._check = check
        self._schema = Schema()
        self._names: set[int | str] = set()
        self._num_shares: int | None = None
        self._path: PathRecorder | None = None
        self._journal = JournalWriter(folder, fsync, self._restore, unit)

    def __enter__(self) -> "LogRecorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close(UNKNOWN_CAUSE if kind is None else "operator" if kind is KeyboardInterrupt else CRASH)

    def begin_path(self, name: Any = None, /, **columns: Any) -> "PathRecorder":
        """Begin a path; its clock starts with its first stage, and before that nothing of it is on disk.

        Parameters
        ----------
        name
            What it is called, once in the folder: always a whole number or always text; counted on if left out.
        **columns
            What else is known of it, such as the scene.

        Raises
        ------
        LogError
            A path is in progress, or the name is taken.
        """
        if self._path is not None and not self._path.is_ended:
            raise LogError(
                f"path {shown(self._path.name)}: it is in progress; finish() or cut() it before the next one begins"
            )
        wanted = self._next_name() if name is None else name
        schema, label, row = self._schema.with_path(wanted, columns)
        if label in self._names:
            raise LogError(f"path {shown(label)}: it is in the folder already; choose another name, or give none")
        self._path = PathRecorder(self, label, row, schema)
        return self._path

    def close(self, cause: str = UNKNOWN_CAUSE) -> None:
        """Cut the path in progress, if there is one, and let the folder go.

        Leaving a ``with`` block does the same, with the cause "operator" after Ctrl-C and "crash" after an error.
        """
        try:
            if self._path is not None and not self._path.is_ended and not self._journal.is_closed:
                self._path.cut(cause)
        finally:
            self._journal.close()

    def _next_name(self) -> int | str:
        is_text = self._schema.labels.get("path") == "text"
        number = len(self._names) + 1
        while (str(number) if is_text else number) in self._names:
            number += 1
        return str(number) if is_text else number

    def _restore(self, event: dict[str, Any]) -> None:
        """Learn names and columns from what the folder holds."""
        if event["event"] == "done":
            self._num_shares = len(event.get("own_rewards", ()))
        if event["event"] != "stage":
            return
        where = f"path {shown(event['path'])}, stage {event['stage']}"
        if event["stage"] == 1:
            self._schema, name, _ = self._schema.with_path(event["path"], event["columns"])
            self._names.add(name)
        self._schema, _ = self._schema.with_stage(event["covariates"], event.get("objects"), event, where)

    def _write(self, event: dict[str, Any], schema: Schema | None = None) -> None:
        self._journal.append(event)
        if schema is not None:
            self._schema = schema
            self._names.add(event["path"])


class PathRecorder:
    """A path that is being recorded; `LogRecorder.begin_path` makes it.

    Its clock is read from `time.monotonic`, and each stage then lasts until the next begins. Or it is given as
    ``elapsed_s``, always, and each stage then lasts as long as is said. That of several robots may stand still: where
    two are free at once, the stage between their decisions takes no time.
    """

    def __init__(self, recorder: LogRecorder, name: int | str, columns: dict[str, Any], schema: Schema) -> None:
        self.name = name
        self.is_ended = False
        self._recorder = recorder
        self._columns = columns
        self._path_schema = schema
        self._stage = 0
        self._is_in_stage = False
        self._has_action = False
        self._is_checked = False
        self._events: list[dict[str, Any]] = []
        self._clock = PathClock()
        self._noted_s = 0.0
        self._completed_s = 0.0

    def begin_stage(
        self,
        covariates: Any = None,
        objects: Any = None,
        action: Any = None,
        object: Any = None,  # noqa: A002
        probability: Any = None,
        robot: Any = None,
    ) -> None:
        """Begin a stage: what was seen, and what is done about it.

        Parameters
        ----------
        covariates
            What the policy saw, by name: numbers, text or flat lists, of Python or NumPy; the same names in every
            stage.
        objects
            A list with a dict for each object that stood there, with its name as "object" and its covariates; None
            where stages have no objects.
        action
            What is done, as a whole number or text. It may be left out only in a stage in which the path is then cut.
        object
            What it is done to, if anything.
        probability
            The probability in (0, 1] with which the policy chose it; always or never.
        robot
            Of several robots, the number of the one that decides; always or never.

        Raises
        ------
        LogError
            A stage is in progress, or a value is none that a log takes: of several robots also where two are at one
            object, or one decides that dropped out.
        """
        self._check_running()
        where = self._where(self._stage + 1)
        if self._is_in_stage:
            raise LogError(f"{self._where(self._stage)}: it is in progress; complete_stage() it before the next begins")
        schema = self._recorder._schema if self._stage else self._path_schema
        chosen = {"robot": robot, "action": action, "object": object, "probability": probability}
        schema, seen = schema.with_stage(covariates or {}, objects, chosen, where)
        event: dict[str, Any] = {"event": "stage", "path": self.name, "stage": self._stage + 1}
        if self._stage == 0:
            self._clock.start()
            event |= {"at_s": 0.0, "columns": self._columns}
        elif not self._clock.is_given:
            event["at_s"] = self._clock.read_s()
        event |= seen
        self._is_checked = bool(schema.has_robot) or self._recorder._check is not None
        if self._is_checked:
            self._check_path(event)
        self._write(event, schema)
        self._stage += 1
        self._is_in_stage, self._has_action = True, action is not None
        self._clock.at_s = self._noted_s = event.get("at_s", self._clock.at_s)

    def complete_stage(self, reward: Any, *, elapsed_s: Any = None, own_rewards: Sequence[Any] = ()) -> None:
        """Complete the stage in progress.

        Parameters
        ----------
        reward
            What it earned.
        elapsed_s
            Time since the path began [s], where the recorder shall not read it from its own clock.
        own_rewards
            What each of several robots brought, robot 0 first, for the columns 0_reward, 1_reward and so on; of the
            same robots in every stage of the folder.

        Raises
        ------
        LogError
            No stage is in progress, a reward is no number, one of a robot is missing, or the clock does not run
            forward; of several robots, it may stand.
        """
        self._check_running()
        where = self._where(self._stage)
        if not self._is_in_stage:
            what = "no stage has begun" if self._stage == 0 else f"stage {self._stage} is completed already"
            raise LogError(f"path {shown(self.name)}: {what}; begin_stage() first")
        if not self._has_action:
            raise LogError(f"{where}: it began without an action; a stage without one can only be cut")
        earned = checked_number(reward, "reward", where, "give the finite reward that it earned")
        shares = self._checked_shares(own_rewards, where)
        at_s = self._clock.time_of(elapsed_s, where, is_later=not self._recorder._schema.has_robot)
        event = {"event": "done", "at_s": at_s, "reward": earned} | ({"own_rewards": shares} if shares else {})
        self._write(event if elapsed_s is None else event | {"is_given": True})
        self._recorder._num_shares = len(shares)
        self._is_in_stage = False
        self._completed_s = at_s
        self._clock.advance(at_s, elapsed_s)

    def _checked_shares(self, own_rewards: Sequence[Any], where: str) -> list[float]:
        """Rewards of robots as numbers, of as many robots as in the stages before."""
        remedy, known = "give the finite reward that the robot brought", self._recorder._num_shares
        if known not in (None, len(own_rewards)):
            raise LogError(
                f"{where}: own_rewards has {len(own_rewards)} numbers, and the stages before it have {known}; give one "
                "for each robot, in every stage or in none"
            )
        return [checked_number(each, f"{robot}_reward", where, remedy) for robot, each in enumerate(own_rewards)]

    def drop_out(self, robot: Any, cause: str, *, elapsed_s: Any = None) -> None:
        """Note that one of several robots dropped out alone; the path goes on without it.

        Tell it before the stage in which it happens is completed.

        Parameters
        ----------
        robot
            Its number.
        cause
            Why, as in `cut`.
        elapsed_s
            Time since the path began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            No robot decided so far, this one has dropped out before or is none of them, the cause is no text, or the
            clock goes back.
        """
        self._check_running()
        self._check_cause(cause)
        where = self._where(self._stage)
        if not (self._events and self._recorder._schema.has_robot):
            raise LogError(f"{where}: no robot has decided yet, so none drops out; begin_stage() with its robot first")
        number = checked_robot(robot, where)
        if any(event["event"] == "out" and event["robot"] == number for event in self._events):
            raise LogError(f"{where}: robot {number} has dropped out before; once is for good")
        at_s = self._clock.time_of(elapsed_s, where)
        event = {"event": "out", "at_s": at_s, "robot": number, "cause": cause}
        self._check_path(event)
        self._write(event)
        self._clock.advance(at_s, elapsed_s)

    def still_running(self, *, elapsed_s: Any = None) -> None:
        """Note that the path is in progress, at most twice a second; call it from the control loop.

        After a crash the path is then known to have run until the last call, not only until its last stage began.
        Worth it where crashes are many and stages long: see `journal_tables`.
        """
        self._check_running()
        if self._stage == 0:
            return
        at_s = self._clock.time_of(elapsed_s, self._where(self._stage))
        if at_s >= self._noted_s + STILL_RUNNING_EVERY_S:
            self._write({"event": "running", "at_s": at_s})
            self._noted_s = at_s
        self._clock.advance(at_s, elapsed_s)

    def finish(self, *, elapsed_s: Any = None) -> None:
        """End the path where the task ended: it was finished, the table is cleared, the horizon is reached.

        Raises
        ------
        LogError
            A stage is in progress, or none was completed.
        """
        self._check_running()
        if self._stage == 0 or self._is_in_stage:
            what = "it has no stage" if self._stage == 0 else f"stage {self._stage} is in progress"
            raise LogError(f"path {shown(self.name)}: {what}; complete it before finish(), or cut() the path")
        self._clock.check_units(elapsed_s, self._completed_s, self._where(self._stage))
        self._end({"event": "finished"}, elapsed_s)

    def cut(self, cause: str, *, elapsed_s: Any = None) -> None:
        """End the path where something outside the task ended it.

        Between two stages, the cut falls into the stage before: what that led to was not seen. If it was, begin the
        next stage with its covariates first. Before the first stage nothing was seen, and nothing is written.

        Parameters
        ----------
        cause
            Why: "operator", "emergency-stop", "time-out", "battery", "sensor-lost", "crash", or free text.
        elapsed_s
            Time since the path began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            The cause is no text, or the clock goes back.
        """
        self._check_running()
        self._check_cause(cause)
        self._end({"event": "cut", "cause": cause}, elapsed_s)

    def _end(self, event: dict[str, Any], elapsed_s: Any) -> None:
        if self._stage:
            at_s = self._clock.end_s(elapsed_s, self._where(self._stage))
            self._write({**event, "at_s": at_s})
        self.is_ended = True

    def _write(self, event: dict[str, Any], schema: Schema | None = None) -> None:
        self._recorder._write(event, schema)
        if self._is_checked:
            self._events.append(event)

    def _check_path(self, event: dict[str, Any]) -> None:
        """Let those who will read the path refuse an event now."""
        logs = log_so_far([*self._events, event])
        if self._recorder._check is not None:
            self._recorder._check(logs)

    def _check_cause(self, cause: Any) -> None:
        if not isinstance(cause, str) or not cause.strip():
            raise LogError(f"path {shown(self.name)}: cause {cause!r} is no cause; say {', '.join(CAUSES)}, or why")

    def _check_running(self) -> None:
        if self.is_ended:
            raise LogError(f"path {shown(self.name)}: it has ended; begin another")

    def _where(self, stage: int) -> str:
        return f"path {shown(self.name)}, stage {stage}"
