"""From a journal to the tables of `Logs`: when stages end, and when an interrupted trajectory was cut.

On the recorder's own clock, a stage lasts until the next one begins or the trajectory finishes. Only then is its
outcome observed, and only then can a policy learn from it. So a trajectory that ends between two stages is cut in the
earlier one, which was observed to complete but not to reach the next. This introduces no bias: the same rule completes
all stages of all trajectories, at a time up to which the trajectory was observed, and the importance weights count the
trajectory as at risk until its cut. If the stage were kept as completed, its successor would have to be invented.

With given clocks, no time passes between two stages. Such a cut is then placed just before the completion that it
undoes: at equal times completions precede cuts, so a cut at that very time would leave the completion of this
trajectory unobserved and unaccounted for. With several robots, it undoes all stages that were completed at that
time, and all drop-outs at that time.

An interrupted trajectory is cut at the last time at which it was known to run. That is up to one stage before the
crash, so Ĝ falls slightly early and weights are too large: by up to 7 % with stages of 5 s, if two trajectories in five
crash. With `TrajectoryRecorder.still_running` called from the control loop, the time is known to half a second, and the
same weights are within 1 %. If crashes are rare, neither matters.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from halfseen.errors import LogError, NothingRecordedError, within
from halfseen.logs.checks import common_unit
from halfseen.logs.columns import CUT, FINISHED, NUMBERS, ROBOT, STEPPED_BACK, is_own_reward, shown
from halfseen.logs.journal import JournalEvents, following, is_being_recorded, journal_parts, tell_missing
from halfseen.logs.missing import is_flag
from halfseen.reading import reason_of

JUST_BEFORE = 0.01
"""How long before the end of a stage a cut after it is placed, as a fraction of the time since the previous clock. It
is less than the time to the next clock of other trajectories, and more than rounding (`halfseen.censoring.clocks`)."""
RESOLUTION_S = 1e-9
"""Resolution of a clock [s]; also the end of a trajectory that was interrupted before its clock moved."""
CRASH, STILL_RUNNING, RESUMED = "crash", "still-running", "resumed"
ROWS_A_CHUNK = 20_000
_TYPES = dict.fromkeys(NUMBERS, pa.float64()) | dict.fromkeys(("cause", STEPPED_BACK), pa.string())


def journal_log(folder: Path) -> dict[str, Any]:
    """Read the journal of a recorder, whether finished, interrupted or running, as the arguments of `Logs`.

    Rows go to Arrow in chunks, so that no more than a few thousand of them are Python objects at a time.

    Raises
    ------
    LogError
        The journal cannot be read, is corrupted, or has no stage; or the reward units of its parts differ.
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
    """Collect the rows of ended trajectories as the arguments of `Logs`; empty if there are none."""
    rows: dict[str, list[dict[str, Any]]] = {"stages": [], "trajectories": [], "objects": []}
    chunks: dict[str, list[pa.Table]] = {name: [] for name in rows}
    for trajectory in trajectories:
        for name, held in rows.items():
            held += trajectory.rows[name]
            if len(held) >= ROWS_A_CHUNK:
                chunks[name].append(_packed(held))
                held.clear()
    for name, held in rows.items():
        chunks[name] += [_packed(held)] if held else []
    # A column may have whole numbers in one chunk and fractions in the next, or only empty lists at first.
    try:
        built: dict[str, Any] = {
            name: pa.concat_tables(of, promote_options="permissive") for name, of in chunks.items() if of
        }
    except pa.ArrowException as error:
        raise LogError(
            f"its rows do not form a table ({reason_of(error)}); record one kind of value in a column"
        ) from error
    stages = built.get("stages")
    if stages is not None and "probability" in stages.column_names:
        is_never_given = stages["probability"].null_count == stages.num_rows
        stages = stages.drop_columns(["probability"]) if is_never_given else stages
    return built if stages is None else {**built, "stages": _with_whole_flags(stages)}


def _with_whole_flags(stages: pa.Table) -> pa.Table:
    """Set null flags of missing covariates to 0, or false: the policy at that time had no such flag."""
    for k, name in enumerate(stages.column_names):
        kind = stages[name].type
        is_none = pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind)
        if is_none and is_flag(name, stages.column_names) and stages[name].null_count:
            stages = stages.set_column(k, name, stages[name].fill_null(pa.scalar(0).cast(kind)))
    return stages


def recorded_trajectories(events: JournalEvents) -> Iterator["RecordedTrajectory"]:
    """Assemble the events of a journal into trajectories; one that never ended has no ending, and comes last."""
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
                # A first stage is written twice if Ctrl-C came before the recorder stored the first.
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
    """A trajectory built from its events.

    Parameters
    ----------
    event
        The beginning of its first stage.

    Attributes
    ----------
    name
        Name of the trajectory.
    rows
        Its rows of each table.
    ending
        "finished" or "cut"; None until it has ended.
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
        """Add the next event."""
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
        """End the trajectory, at the last known clock if `at_s` is None."""
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
        """Drop the last stage, such as one written again because Ctrl-C came before the recorder stored it."""
        number = self.rows["stages"].pop()["stage"]
        self.rows["objects"] = [row for row in self.rows["objects"] if row["stage"] != number]

    def _just_before(self, at_s: float) -> float:
        clocks_s = [stage["elapsed_s"] or 0.0 for stage in self.rows["stages"]]
        before_s = max((each for each in [*clocks_s, *self._out_s.values()] if each < at_s), default=0.0)
        return at_s - JUST_BEFORE * (at_s - before_s)

    def _take_back(self, end_s: float) -> None:
        """Undo stages back to the first that had not ended by `end_s`, as several robots may decide at one time."""
        stages = self.rows["stages"]
        while len(stages) > 1 and stages[-2]["elapsed_s"] > end_s:
            self._forget_stage()
            last = stages[-1]
            last |= {name: None for name in last if name in ("elapsed_s", "reward") or is_own_reward(name)}

    def _complete(self, next_s: float | None) -> None:
        """Complete the stage in progress at its own clock if given, else when the next one begins."""
        if self._done is None:
            raise KeyError("the stage before is not completed")
        at_s = self._done["at_s"] if self._done.get("is_given") or next_s is None else next_s
        shares = {f"{robot}_reward": share for robot, share in enumerate(self._done.get("own_rewards", ()))}
        self.rows["stages"][-1] |= {"elapsed_s": at_s, "reward": self._done["reward"], **shares}
        self._clock_s = at_s
        self._done = None


def _packed(rows: list[dict[str, Any]]) -> pa.Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _column(name, [row.get(name) for row in rows]) for name in names})


def _column(name: str, values: list[Any]) -> pa.Array:
    try:
        name.encode()
        return pa.array(values, _TYPES.get(name))
    except (pa.ArrowException, OverflowError, UnicodeError) as error:
        raise LogError(
            f"what it holds of {shown(name)} does not form a column ({reason_of(error)}); record one kind of value "
            "in it"
        ) from error


def followed(events: Sequence[dict[str, Any]]) -> RecordedTrajectory:
    """Build a trajectory from its events, which start with the beginning of its first stage."""
    first, *others = events
    trajectory = RecordedTrajectory(first)
    for event in others:
        trajectory.add(event)
    return trajectory
