"""From a journal to the tables of `Logs`: where stages end, and where a trajectory that nobody ended was cut.

A stage of a trajectory on the recorder's own clock lasts until the next one begins, or the trajectory finishes: only
then is it known what the stage led to, and only then can anything be learned from it. So a trajectory that ends between
two stages is cut in the stage before, which it was seen to complete without being seen to reach the next. Nothing is
biased by that: all stages of all trajectories are completed by the same rule, at a time until which the trajectory was
watched, and the weights count the trajectory as at risk until its cut. Were the stage kept as completed, what follows
it would have to be made up.

Where clocks are given, no time passes between two stages. Such a cut then stands just before the completion that it
takes back: at equal times completions come before cuts, and a cut that stood at that time would leave the completion
of this trajectory unseen and unaccounted for. Of several robots, it takes back all stages that were completed at that
time, and whatever dropped out then.

A torn trajectory is cut at the last time at which it was known to run. That is up to a stage earlier than the crash, so
that Ĝ falls a little early and weights come out too large: where stages of 5 s are torn so often that two trajectories
in five crash, by up to 7 %. Call `TrajectoryRecorder.still_running` from the control loop and the time is known to half
a second; the same weights are then within 1 %. Where crashes are few, neither matters.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from halfseen.errors import LogError, NothingRecordedError, within
from halfseen.logs.checks import common_unit
from halfseen.logs.columns import CUT, FINISHED, ROBOT, STEPPED_BACK, is_own_reward, shown
from halfseen.logs.journal import JournalEvents, following, is_being_recorded, journal_parts, tell_missing
from halfseen.logs.missing import is_flag
from halfseen.reading import reason_of

JUST_BEFORE = 0.01
"""Of the time since the clock before it: how long before the end of a stage a trajectory ends that was cut after it. It
is less than others take to their next clock, and more than rounding (`halfseen.censoring.clocks`)."""
RESOLUTION_S = 1e-9
"""What a clock can tell apart [s]; a trajectory that was torn before its clock moved ends there."""
CRASH, STILL_RUNNING, RESUMED = "crash", "still-running", "resumed"
ROWS_A_CHUNK = 20_000
_TYPES = {
    "elapsed_s": pa.float64(),
    "reward": pa.float64(),
    "probability": pa.float64(),
    "end_s": pa.float64(),
    "cause": pa.string(),
    STEPPED_BACK: pa.string(),
}


def journal_log(folder: Path) -> dict[str, Any]:
    """Read the journal of a recorder, finished, torn or at work, as what `Logs` is made of.

    Rows go to Arrow in chunks, so that no more than a few thousand of them are Python objects at a time.

    Raises
    ------
    LogError
        The journal cannot be read, is corrupted, or holds no stage; or its parts count rewards in different units.
    """
    was_recorded, parts = is_being_recorded(folder), journal_parts(folder)
    tell_missing(parts)
    units: list[str | None] = []

    def ended() -> Iterator[RecordedTrajectory]:
        for part in parts:
            events = JournalEvents(part)
            for trajectory in recorded_trajectories(events):
                if trajectory.ending is None:
                    is_live = part == parts[-1] and (was_recorded or is_being_recorded(folder))
                    with following(events):
                        trajectory.end(CUT, None, STILL_RUNNING if is_live else CRASH)
                yield trajectory
            events.tell_holes()
            units.append(events.reward_unit)

    built = tables_of(ended())
    if not built:
        raise NothingRecordedError(f"{folder}: no stage is recorded yet; record one first")
    with within(folder):
        return {**built, "reward_unit": common_unit(units)}


def tables_of(trajectories: Iterable["RecordedTrajectory"]) -> dict[str, Any]:
    """Put the rows of trajectories that have ended together, as what `Logs` is made of; nothing where there is none."""
    tables = {"stages": _Table(), "trajectories": _Table(), "objects": _Table()}
    for trajectory in trajectories:
        for name, table in tables.items():
            table.add(trajectory.rows[name])
    built: dict[str, Any] = {name: table.build() for name, table in tables.items() if table}
    stages = built.get("stages")
    if stages is not None and "probability" in stages.column_names:
        is_never_given = stages["probability"].null_count == stages.num_rows
        stages = stages.drop_columns(["probability"]) if is_never_given else stages
    return built if stages is None else {**built, "stages": _with_whole_flags(stages)}


def _with_whole_flags(stages: pa.Table) -> pa.Table:
    """Where the policy of the time had no flag, nothing was said to be missing."""
    for k, name in enumerate(stages.column_names):
        if is_flag(name, stages.column_names) and stages[name].null_count:
            stages = stages.set_column(k, name, stages[name].fill_null(0))
    return stages


def recorded_trajectories(events: JournalEvents) -> Iterator["RecordedTrajectory"]:
    """Put the events of a journal together into trajectories; one that never ended has no ending, and is last."""
    trajectory = torn = None
    for event in events:
        with following(events):
            if event["event"] == "session":
                torn, trajectory = trajectory or torn, None
            elif event["event"] == RESUMED and torn is not None and torn.name == event["trajectory"]:
                trajectory, torn = torn, None
            elif torn is not None:
                torn.end(CUT, None, CRASH)
                yield torn
                torn = None
            if event["event"] == "hole" and trajectory is not None:
                trajectory.end(CUT, None, CRASH)
            elif event["event"] == "stage" and event["stage"] == 1:
                # A first stage is given twice where Ctrl-C came before the recorder knew of the first.
                if trajectory is not None and trajectory.name != event["trajectory"]:
                    name = event["trajectory"]
                    raise KeyError(f"trajectory {name!r} begins before trajectory {trajectory.name!r} ended")
                trajectory = RecordedTrajectory(event)
            elif trajectory is not None:
                trajectory.add(event)
        if trajectory is not None and trajectory.ending is not None:
            yield trajectory
            trajectory = None
    if torn is not None:
        torn.end(CUT, None, CRASH)
    last = trajectory or torn
    if last is not None:
        yield last


class RecordedTrajectory:
    """A trajectory as its events tell it.

    Parameters
    ----------
    event
        The beginning of its first stage.

    Attributes
    ----------
    name
        What it is called.
    rows
        Its rows of each table.
    ending
        "finished" or "cut"; None as long as it was not ended.
    """

    def __init__(self, event: dict[str, Any]) -> None:
        self.ending: str | None = None
        self.rows: dict[str, list[dict[str, Any]]] = {"stages": [], "trajectories": [], "objects": []}
        self.name = event["trajectory"]
        self._trajectory = {"trajectory": self.name, **event["columns"]}
        self._clock_s = 0.0
        self._done: dict[str, Any] | None = None
        self._out_s: dict[int, float] = {}
        self._out_cause: dict[int, str] = {}
        self._begin(event)

    def add(self, event: dict[str, Any]) -> None:
        """Take the next event."""
        match event["event"]:
            case "stage":
                if event["stage"] == len(self.rows["stages"]):
                    self._forget_stage()
                else:
                    self._complete(event.get("at_s"))
                self._begin(event)
            case "done":
                self._done = event
                self._clock_s = event["at_s"]
            case "running":
                self._clock_s = event["at_s"]
            case "out":
                self._clock_s = self._out_s[event["robot"]] = event["at_s"]
                self._out_cause[event["robot"]] = event["cause"]
            case "finished" | "cut" as ending:
                self.end(ending, event["at_s"], event.get("cause"))

    def end(self, ending: str, at_s: float | None, cause: str | None) -> None:
        """End the trajectory, at the last known clock where there is no other."""
        end_s = self._clock_s if at_s is None else at_s
        if ending == FINISHED:
            self._complete(end_s)
        elif self._done is not None and self._done.get("is_given"):
            end_s = self._just_before(self._done["at_s"])
            self._take_back(end_s)
        self.ending, end_s = ending, max(end_s, RESOLUTION_S)
        row = {**self._trajectory, "end_s": end_s, "ending": ending, "cause": cause}
        for robot, out_s in self._out_s.items():
            if out_s <= end_s:
                row |= {f"{robot}_out_s": out_s, f"{robot}_out_cause": self._out_cause[robot]}
        self.rows["trajectories"] = [row]

    def _begin(self, event: dict[str, Any]) -> None:
        key = {"trajectory": event["trajectory"], "stage": event["stage"]}
        row = {**key, "elapsed_s": None, "action": None, "object": None, "reward": None, "probability": None}
        row |= {name: event[name] for name in ("action", "object", "probability", ROBOT, STEPPED_BACK) if name in event}
        self.rows["stages"].append(row | event["covariates"])
        self.rows["objects"] += [{**key, **seen} for seen in event.get("objects", ())]

    def _forget_stage(self) -> None:
        """Ctrl-C came before the recorder knew that the stage had begun, and it was given again."""
        number = self.rows["stages"].pop()["stage"]
        self.rows["objects"] = [row for row in self.rows["objects"] if row["stage"] != number]

    def _just_before(self, at_s: float) -> float:
        clocks_s = [stage["elapsed_s"] or 0.0 for stage in self.rows["stages"]]
        before_s = max((each for each in [*clocks_s, *self._out_s.values()] if each < at_s), default=0.0)
        return at_s - JUST_BEFORE * (at_s - before_s)

    def _take_back(self, end_s: float) -> None:
        """Of several robots that decided at one time, it is cut in the first stage that had not ended before."""
        stages = self.rows["stages"]
        while len(stages) > 1 and stages[-2]["elapsed_s"] > end_s:
            self._forget_stage()
            last = stages[-1]
            last |= {name: None for name in last if name in ("elapsed_s", "reward") or is_own_reward(name)}

    def _complete(self, next_s: float | None) -> None:
        """Complete the stage in progress, by its own clock if that was given, else when the next one begins."""
        if self._done is None:
            raise KeyError("the stage before is not completed")
        at_s = self._done["at_s"] if self._done.get("is_given") or next_s is None else next_s
        shares = {f"{robot}_reward": share for robot, share in enumerate(self._done.get("own_rewards", ()))}
        self.rows["stages"][-1] |= {"elapsed_s": at_s, "reward": self._done["reward"], **shares}
        self._clock_s = at_s
        self._done = None


class _Table:
    """Rows on their way to Arrow."""

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self._chunks: list[pa.Table] = []

    def __bool__(self) -> bool:
        return bool(self._rows or self._chunks)

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        self._rows.extend(rows)
        if len(self._rows) >= ROWS_A_CHUNK:
            self._pack()

    def build(self) -> pa.Table:
        if self._rows:
            self._pack()
        # A column may be whole numbers in one chunk and fractions in the next, or lists that are all empty at first.
        try:
            return pa.concat_tables(self._chunks, promote_options="permissive")
        except pa.ArrowException as error:
            raise LogError(f"its rows make no table ({reason_of(error)}); record one kind in a column") from error

    def _pack(self) -> None:
        names = dict.fromkeys(name for row in self._rows for name in row)
        columns = {name: _column(name, [row.get(name) for row in self._rows]) for name in names}
        self._chunks.append(pa.table(columns))
        self._rows = []


def _column(name: str, values: list[Any]) -> pa.Array:
    try:
        name.encode()
        return pa.array(values, _TYPES.get(name))
    except (pa.ArrowException, OverflowError, UnicodeError) as error:
        raise LogError(
            f"what it holds of {shown(name)} makes no column ({reason_of(error)}); record one kind of value in it"
        ) from error


def followed(events: Sequence[dict[str, Any]]) -> RecordedTrajectory:
    """Follow the events of one trajectory, the beginning of its first stage first."""
    first, *others = events
    trajectory = RecordedTrajectory(first)
    for event in others:
        trajectory.add(event)
    return trajectory
