"""Recording trajectories as they happen, so that a kill at any moment loses at most the stage in progress.

::

    with LogRecorder("logs") as recorder:
        trajectory = recorder.begin_trajectory(scene="cell 3")
        while not is_over:
            trajectory.begin_stage(covariates=seen, action=action, probability=probability)
            ...                                      # the robot acts
            trajectory.complete_stage(reward=1.0)
        trajectory.finish()                                # or trajectory.cut("operator")

`halfseen.logs.read_logs` reads the folder at any time, also while it is being recorded. A trajectory that a crash tore
is read as cut by ``crash`` at the last time at which it was known to run; `halfseen.logs.recorded` says how, and why
that is fair.

Where several robots work at once, each stage says which of them decides (``begin_stage(…, robot=1)``), and `drop_out`
tells that one of them is gone while the others go on.

What a recorder knows is a value that is replaced whole. An event and what is known after it are taken over in one
assignment, which Ctrl-C cannot part: it comes before both, and the event is then taken back, or after both.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.checks import EARLIEST_DATE_S, LARGEST, UNIT_TOLERANCE, thousandfold
from halfseen.logs.columns import CUT, FINISHED, STEPPED_BACK, UNKNOWN_CAUSE, checked_unit, shown
from halfseen.logs.folder import MANIFEST
from halfseen.logs.journal import PART_BYTES, JournalWriter, synced_events
from halfseen.logs.logs import Logs
from halfseen.logs.recorded import CRASH, RESOLUTION_S, RESUMED, STILL_RUNNING, RecordedTrajectory, tables_of
from halfseen.logs.values import Schema, checked_number, checked_robot, checked_text

_CLOCK_REMEDY = "give the time since the trajectory began [s]"


@dataclass(frozen=True)
class TrajectoryState:
    """Where a trajectory that is being recorded stands, and its clock, which never goes back.

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
    at_s
        Time of the last event [s].
    is_given
        Whether times are given, not read from the machine's clock; None before the first.
    began_s
        When the trajectory began, on the machine's clock [s].
    completed_s
        When its last stage was completed [s].
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
    at_s: float = 0.0
    is_given: bool | None = None
    began_s: float = 0.0
    completed_s: float = 0.0
    noted_s: float = 0.0
    events: tuple[dict[str, Any], ...] = ()

    @classmethod
    def of(cls, events: Sequence[dict[str, Any]]) -> "TrajectoryState":
        """Where a trajectory stands whose events a journal has; its clock is one that is given from now on."""
        last = next(event for event in reversed(events) if event["event"] == "stage")
        done = [event for event in events if event["event"] == "done"]
        return cls(
            name=last["trajectory"],
            number=1,
            stage=last["stage"],
            is_in_stage=not done or events.index(done[-1]) < events.index(last),
            has_action="action" in last,
            at_s=max(event.get("at_s", 0.0) for event in events),
            is_given=True,
            completed_s=done[-1]["at_s"] if done else 0.0,
            events=tuple(events),
        )

    def started(self) -> "TrajectoryState":
        """The state whose clock begins to count now."""
        return replace(self, began_s=time.monotonic())

    def read_s(self) -> float:
        """Read the machine's clock [s], in nanoseconds, and never the same twice, however coarse that clock is."""
        return max(round(time.monotonic() - self.began_s, 9), round(self.at_s + RESOLUTION_S, 9))

    def after(self, at_s: float, elapsed_s: Any, **changed: Any) -> "TrajectoryState":
        """The state after an event at a time that was given as `elapsed_s` or, if None, read."""
        return replace(self, at_s=at_s, is_given=elapsed_s is not None, **changed)

    def time_of(self, elapsed_s: Any, where: str, *, is_later: bool = False) -> float:
        """Time of an event [s], given or, if None, read; checked to be no earlier (or later) than the last event."""
        if self.is_given not in (None, elapsed_s is not None):
            word = "missing" if elapsed_s is None else "given"
            raise LogError(f"{where}: elapsed_s is {word}, unlike before in this trajectory; give it always or never")
        if elapsed_s is None:
            return self.read_s()
        at_s = checked_number(elapsed_s, "elapsed_s", where, _CLOCK_REMEDY)
        trouble = None
        if at_s < self.at_s or (is_later and at_s == self.at_s):
            trouble = f"{'is before' if at_s < self.at_s else 'is still'} the {self.at_s} of the event before"
        elif 0.0 < at_s < RESOLUTION_S:
            trouble = f"is less than the {RESOLUTION_S} s that clocks tell apart"
        elif at_s >= EARLIEST_DATE_S:
            trouble = "is a date or no seconds"
        if trouble is not None:
            raise LogError(f"{where}: elapsed_s {at_s} {trouble}; {_CLOCK_REMEDY}")
        return at_s

    def end_s(self, elapsed_s: Any, where: str) -> float:
        """Time of the trajectory's end [s]: without a word about it, a clock that is given stands at the last event."""
        return self.at_s if self.is_given and elapsed_s is None else self.time_of(elapsed_s, where)

    def check_units(self, end_s: float, where: str) -> None:
        """Refuse a given end at a power of a thousand times the last stage's clock, which `Logs` takes for a unit."""
        times = float(thousandfold(end_s, self.completed_s, 2 * UNIT_TOLERANCE)) if self.is_given else 0.0
        if times > 1.0:
            raise LogError(
                f"{where}: elapsed_s {end_s} is {times:.0e} times the {self.completed_s} of the completed stage, as if "
                "units were mixed; give both in seconds"
            )


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


CAUSES = ("operator", "emergency-stop", "time-out", "battery", "sensor-lost", CRASH)
"""Usual causes of cuts; any other text will do."""

STILL_RUNNING_EVERY_S = 0.5


def log_so_far(events: Sequence[dict[str, Any]]) -> Logs:
    """Give the log of one trajectory in progress, cut at its last event.

    Parameters
    ----------
    events
        Of the trajectory, as a journal has them, the beginning of its first stage first.

    Raises
    ------
    LogError
        What happened so far is none that a log takes.
    """
    first, *others = events
    trajectory = RecordedTrajectory(first)
    for event in others:
        trajectory.add(event)
    trajectory.end(CUT, None, STILL_RUNNING)
    return Logs(**tables_of([trajectory]))


def ended_rows(events: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Give the rows of one trajectory that has ended, by their table, as its log has them.

    Parameters
    ----------
    events
        Of the trajectory, as `TrajectoryRecorder.events` has them.
    """
    first, *others = events
    trajectory = RecordedTrajectory(first)
    for event in others:
        trajectory.add(event)
    return trajectory.rows


def torn_by(events: list[dict[str, Any]], event: dict[str, Any]) -> list[dict[str, Any]]:
    """Events of the trajectory in progress after one more; empty where none is."""
    match event["event"]:
        case "stage" if event["stage"] == 1:
            return [event]
        case "finished" | "cut" | "hole":
            return []
        case "stage" | "done" | "running" | "out" if events:
            events.append(event)
    return events


class TrajectoryRecorder:
    """A trajectory that is being recorded; `LogRecorder.begin_trajectory` makes it.

    Its clock is read from `time.monotonic`, and each stage then lasts until the next begins. Or it is given as
    ``elapsed_s``, always, and each stage then lasts as long as is said. That of several robots may stand still: where
    two are free at once, the stage between their decisions takes no time.
    """

    def __init__(
        self,
        journal: JournalWriter,
        name: int | str,
        columns: dict[str, Any],
        schema: Schema,
        check: Callable[[Logs], object] | None,
        keeps_events: bool = False,
    ) -> None:
        known = journal.known
        self.name = name
        self._journal = journal
        self._columns = columns
        self._trajectory_schema = schema
        self._check = check
        self._keeps_events = keeps_events or check is not None
        self._number = 1 if known.trajectory is None else known.trajectory.number + 1
        journal.known = replace(known, trajectory=TrajectoryState(name, self._number))

    @property
    def is_ended(self) -> bool:
        """Whether it is finished or cut."""
        state = self._state
        return state is None or state.is_ended

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Its events so far, where the recorder keeps them; else none."""
        state = self._state
        return () if state is None else state.events

    @property
    def is_in_stage(self) -> bool:
        """Whether a stage is in progress."""
        state = self._state
        return state is not None and state.is_in_stage

    @property
    def _state(self) -> TrajectoryState | None:
        """Where it stands; None once another has begun."""
        state = self._journal.known.trajectory
        return state if state is not None and state.number == self._number else None

    def begin_stage(
        self,
        covariates: Any = None,
        objects: Any = None,
        action: Any = None,
        object: Any = None,  # noqa: A002
        probability: Any = None,
        robot: Any = None,
        stepped_back: Any = None,
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
            What is done, as a whole number or text. It may be left out only in a stage in which the trajectory is then
            cut.
        object
            What it is done to, if anything.
        probability
            The probability in (0, 1] with which the policy chose it; always or never.
        robot
            Of several robots, the number of the one that decides; always or never.
        stepped_back
            Why a rule decided in the policy's place, such as "out-of-range"; None where it did not.

        Raises
        ------
        LogError
            A stage is in progress, or a value is none that a log takes: of several robots also where two are at one
            object, or one decides that dropped out.
        """
        state, recorded = self._running(), self._journal.known
        where = self._where(state.stage + 1)
        if state.is_in_stage:
            raise LogError(f"{self._where(state.stage)}: it is in progress; complete_stage() it before the next begins")
        schema = recorded.schema if state.stage else self._trajectory_schema
        chosen = {"robot": robot, "action": action, "object": object, "probability": probability}
        chosen[STEPPED_BACK] = stepped_back
        schema, seen = schema.with_stage(covariates or {}, objects, chosen, where)
        event: dict[str, Any] = {"event": "stage", "trajectory": self.name, "stage": state.stage + 1}
        if state.stage == 0:
            state = state.started()
            event |= {"at_s": 0.0, "columns": self._columns}
        elif not state.is_given:
            event["at_s"] = state.read_s()
        at_s = event.get("at_s", state.at_s)
        begun = replace(state, stage=state.stage + 1, is_in_stage=True, has_action=action is not None)
        begun = replace(begun, at_s=at_s, noted_s=at_s)
        self._write(event | seen, replace(recorded, schema=schema), begun, is_news=True)

    def complete_stage(self, reward: Any, *, elapsed_s: Any = None, own_rewards: Any = ()) -> None:
        """Complete the stage in progress.

        Parameters
        ----------
        reward
            What it earned.
        elapsed_s
            Time since the trajectory began [s], where the recorder shall not read it from its own clock.
        own_rewards
            What each of several robots brought, robot 0 first, for the columns 0_reward, 1_reward and so on; of the
            same robots in every stage of the folder.

        Raises
        ------
        LogError
            No stage is in progress, a reward is no number or beyond 1e75, one of a robot is missing, or the clock does
            not run forward; of several robots, it may stand.
        """
        state, recorded = self._running(), self._journal.known
        where = self._where(state.stage)
        if not state.is_in_stage:
            what = "no stage has begun" if state.stage == 0 else f"stage {state.stage} is completed already"
            raise LogError(f"trajectory {shown(self.name)}: {what}; begin_stage() first")
        if not state.has_action:
            raise LogError(f"{where}: it began without an action; a stage without one can only be cut")
        earned = checked_number(reward, "reward", where, "give the finite reward that it earned")
        if abs(earned) > LARGEST:
            raise LogError(f"{where}: reward is {earned:g}; give rewards in another unit")
        shares = self._checked_shares(own_rewards, where)
        at_s = state.time_of(elapsed_s, where, is_later=not recorded.schema.has_robot)
        event = {"event": "done", "at_s": at_s, "reward": earned} | ({"own_rewards": shares} if shares else {})
        event |= {} if elapsed_s is None else {"is_given": True}
        completed = state.after(at_s, elapsed_s, is_in_stage=False, completed_s=at_s)
        self._write(event, replace(recorded, num_shares=len(shares)), completed)

    def _checked_shares(self, own_rewards: Any, where: str) -> list[float]:
        """Rewards of robots as numbers, of as many robots as in the stages before."""
        remedy, known = "give the finite reward that the robot brought", self._journal.known.num_shares
        if not isinstance(own_rewards, Sequence | np.ndarray) or isinstance(own_rewards, str):
            raise LogError(f"{where}: own_rewards is {own_rewards!r}; give a list with the reward of each robot")
        if known not in (None, len(own_rewards)):
            raise LogError(
                f"{where}: own_rewards has {len(own_rewards)} numbers, and the stages before it have {known}; give one "
                "for each robot, in every stage or in none"
            )
        return [checked_number(each, f"{robot}_reward", where, remedy) for robot, each in enumerate(own_rewards)]

    def drop_out(self, robot: Any, cause: Any, *, elapsed_s: Any = None) -> None:
        """Note that one of several robots dropped out alone; the trajectory goes on without it.

        Tell it before the stage in which it happens is completed.

        Parameters
        ----------
        robot
            Its number.
        cause
            Why, as in `cut`.
        elapsed_s
            Time since the trajectory began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            No robot decided so far, this one has dropped out before or is none of them, the cause is no text, or the
            clock goes back.
        """
        state = self._running()
        self._check_cause(cause)
        where = self._where(state.stage)
        if not (state.events and self._journal.known.schema.has_robot):
            raise LogError(f"{where}: no robot has decided yet, so none drops out; begin_stage() with its robot first")
        number = checked_robot(robot, where)
        if any(event["event"] == "out" and event["robot"] == number for event in state.events):
            raise LogError(f"{where}: robot {number} has dropped out before; once is for good")
        at_s = state.time_of(elapsed_s, where)
        event = {"event": "out", "at_s": at_s, "robot": number, "cause": cause}
        self._write(event, self._journal.known, state.after(at_s, elapsed_s), is_news=True)

    def still_running(self, *, elapsed_s: Any = None) -> None:
        """Note that the trajectory is in progress, at most twice a second; call it from the control loop.

        After a crash the trajectory is then known to have run until the last call, not only until its last stage began.
        Worth it where crashes are many and stages long: see `halfseen.logs.recorded`.
        """
        state, recorded = self._running(), self._journal.known
        if state.stage == 0:
            return
        at_s = state.time_of(elapsed_s, self._where(state.stage))
        runs = state.after(at_s, elapsed_s)
        if at_s >= state.noted_s + STILL_RUNNING_EVERY_S:
            self._write({"event": "running", "at_s": at_s}, recorded, replace(runs, noted_s=at_s))
        else:
            self._journal.known = replace(recorded, trajectory=runs)

    def finish(self, *, elapsed_s: Any = None) -> None:
        """End the trajectory where the task ended: it was finished, the table is cleared, the horizon is reached.

        Raises
        ------
        LogError
            A stage is in progress, or none was completed.
        """
        state = self._running()
        if state.stage == 0 or state.is_in_stage:
            what = "it has no stage" if state.stage == 0 else f"stage {state.stage} is in progress"
            raise LogError(
                f"trajectory {shown(self.name)}: {what}; complete it before finish(), or cut() the trajectory"
            )
        where = self._where(state.stage)
        state.check_units(state.end_s(elapsed_s, where), where)
        self._end({"event": FINISHED}, state, elapsed_s)

    def cut(self, cause: Any, *, elapsed_s: Any = None) -> None:
        """End the trajectory where something outside the task ended it.

        Between two stages, the cut falls into the stage before: what that led to was not seen. If it was, begin the
        next stage with its covariates first. Before the first stage nothing was seen, and nothing is written.

        Parameters
        ----------
        cause
            Why: "operator", "emergency-stop", "time-out", "battery", "sensor-lost", "crash", or free text.
        elapsed_s
            Time since the trajectory began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            The cause is no text, or the clock goes back.
        """
        state = self._running()
        self._check_cause(cause)
        self._end({"event": CUT, "cause": cause}, state, elapsed_s)

    def _end(self, event: dict[str, Any], state: TrajectoryState, elapsed_s: Any) -> None:
        recorded, ended = self._journal.known, replace(state, is_ended=True, is_in_stage=False)
        if state.stage == 0:
            self._journal.known = replace(recorded, trajectory=ended)
            return
        at_s = state.end_s(elapsed_s, self._where(state.stage))
        self._write({**event, "at_s": at_s}, recorded, ended)

    def _write(
        self, event: dict[str, Any], recorded: Recorded, state: TrajectoryState, *, is_news: bool = False
    ) -> None:
        """Write an event; where somebody reads the trajectory as it grows, let them refuse one with news."""
        if self._keeps_events or recorded.schema.has_robot:
            state = replace(state, events=(*state.events, event))
            if is_news and (self._check is not None or recorded.schema.has_robot):
                logs = log_so_far(state.events)
                if self._check is not None:
                    self._check(logs)
        self._journal.append(event, replace(recorded, trajectory=state))

    def _check_cause(self, cause: Any) -> None:
        if not isinstance(cause, str) or not cause.strip():
            raise LogError(
                f"trajectory {shown(self.name)}: cause {cause!r} is no cause; say {', '.join(CAUSES)}, or why"
            )
        checked_text(cause, f"trajectory {shown(self.name)}", "cause")

    def _running(self) -> TrajectoryState:
        state = self._state
        if state is None or state.is_ended:
            raise LogError(f"trajectory {shown(self.name)}: it has ended; begin another")
        return state

    def _where(self, stage: int) -> str:
        return f"trajectory {shown(self.name)}, stage {stage}"


class LogRecorder:
    """Record trajectories into a folder, stage by stage.

    One recorder at a time has a folder; a folder that was recorded before is gone on with. Each call is checked and
    then handed to the operating system in one write before it returns. What is refused leaves no trace, and the
    trajectory goes on.

    Parameters
    ----------
    folder
        Where to; it is made where it is not there.
    fsync
        When to wait for the disk: "never"; each "trajectory", when it ends; each "stage", when it begins; or each
        "event". Without it, nothing that was written is lost when the process dies, but a loss of power or a crash of
        the operating system may take the last half minute. With it they take, as far as the disk keeps its word, no
        more than the trajectory, stage or event in progress; a call that waits takes as long as the disk does, commonly
        0.1 to 20 ms (`benchmarks/recorder.py` measures it). True is "event", False is "never".
    reward_unit
        What rewards are counted in, such as "parts": a short text, for people; None for what was said before, if
        anything was.
    check
        What a trajectory must hold beyond what every log must, such as `halfseen.world.check_log` for robots at a
        table: called with the trajectory so far, cut just now, when a stage begins or a robot drops out, and raises
        `LogError` where that is to be refused. It reads all of the trajectory each time: meant for stages of a second
        or more.
    part_bytes
        Size of the journal from which on a trajectory begins in another file of the folder [B].
    keeps_events
        Whether `TrajectoryRecorder.events` of the last trajectory can be asked for.

    Raises
    ------
    ArgumentError
        Another recorder has the folder, it holds finished logs, or it cannot be written; or `part_bytes` is no
        positive whole number.
    LogError
        What was recorded there before is no journal or in another unit, or the unit is no short text.

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
        folder, unit = Path(folder), checked_unit(reward_unit)
        if (folder / MANIFEST).exists():
            raise ArgumentError(f"{folder}: it holds logs that are written for good; record into another folder")
        if not isinstance(part_bytes, int) or part_bytes < 1:
            raise ArgumentError(f"part_bytes is {part_bytes!r}; give a whole number of bytes, such as {PART_BYTES}")
        self._check, self._keeps_events = check, keeps_events
        self._names: set[int | str] = set()
        self._torn: list[dict[str, Any]] = []
        self._restored = Recorded()
        self._trajectory: TrajectoryRecorder | None = None
        self._journal = JournalWriter(folder, synced_events(fsync), self._restore, unit, part_bytes)
        self._journal.known = self._restored

    def __enter__(self) -> "LogRecorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close(UNKNOWN_CAUSE if kind is None else "operator" if kind is KeyboardInterrupt else CRASH)

    def begin_trajectory(self, name: Any = None, /, **columns: Any) -> TrajectoryRecorder:
        """Begin a trajectory; its clock starts with its first stage, and before that nothing of it is on disk.

        Parameters
        ----------
        name
            What it is called, once in the folder: always a whole number or always text; counted on if left out.
        **columns
            What else is known of it, such as the scene.

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
        """Go on with the trajectory that was torn when the folder was left; None where none was.

        Call it before the first trajectory begins. Its clock must be given: what passed meanwhile no clock of this
        process has seen.

        Raises
        ------
        LogError
            The disk is full.
        """
        is_read = any(event["event"] == "done" and not event.get("is_given") for event in self._torn)
        if not self._torn or is_read or self._trajectory is not None:
            return None
        known, state = self._journal.known, TrajectoryState.of(self._torn)
        columns, more = self._torn[0]["columns"], (self._check, self._keeps_events)
        trajectory = TrajectoryRecorder(self._journal, state.name, columns, known.schema, *more)
        self._journal.append({"event": RESUMED, "trajectory": state.name}, replace(known, trajectory=state))
        self._trajectory = trajectory
        return trajectory

    @property
    def trajectory(self) -> TrajectoryRecorder | None:
        """The trajectory that began last; None before the first."""
        return self._trajectory

    def close(self, cause: str | None = UNKNOWN_CAUSE) -> None:
        """Cut the trajectory in progress, if there is one, and let the folder go; without a cause it may be resumed.

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
        number = len(self._names) + 1
        while (str(number) if is_text else number) in self._names:
            number += 1
        return str(number) if is_text else number

    def _restore(self, event: dict[str, Any]) -> None:
        """Learn names and columns from what the folder holds."""
        known = self._restored
        self._torn = torn_by(self._torn, event)
        if event["event"] == "done":
            self._restored = replace(known, num_shares=len(event.get("own_rewards", ())))
        if event["event"] != "stage":
            return
        schema, where = known.schema, f"trajectory {shown(event['trajectory'])}, stage {event['stage']}"
        if event["stage"] == 1:
            schema, name, _ = schema.with_trajectory(event["trajectory"], event["columns"])
            self._names.add(name)
        schema, _ = schema.with_stage(event["covariates"], event.get("objects"), event, where)
        self._restored = replace(known, schema=schema)
