"""Logs from ROS 2 bags (SQLite or MCAP storage) and ROS 1 bags, by a mapping file.

Reading order: `mapping` (which topic carries which value) → `bag_messages` (values in the order of time) → here.
Standard message types suffice: ``std_msgs`` for actions, rewards and endings, ``sensor_msgs/PointCloud2`` for clouds.

How messages become stages:

- A trajectory begins with the message that ``[trajectory]`` maps or, without it, with the first mapped message of
  the bag. Its clock starts at 0.
- If the clock falls back by more than a second and no message was merely late, a simulation was reset: a trajectory
  ends there, and without ``[trajectory]`` another begins.
- An action message begins a stage. Its covariates and cloud are the latest received, which the policy saw. A reward
  message completes the stage.
- An ending message finishes the trajectory or names the cause of its cut. A trajectory without one was cut by ``crash``
  at its last message. A cut trajectory keeps the stage in which it was cut, with its covariates.
- Every topic of the mapping must be in one of the bags read together; a bag that broke off early may lack some.
- A trajectory that was cut before all covariates were received has no stage; it is left out with a warning.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise, takewhile
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, LogError, warn, within
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE, shown
from halfseen.logs.formats.bag_messages import Event, check_topics, points_of, read_clouds, read_events
from halfseen.logs.formats.mapping import BagMapping, read_mapping
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.suggestions import folded

CRASH = "crash"
_COVARIATE = "covariates."

See: TypeAlias = Callable[[np.ndarray, tuple[int, int], str], Mapping[str, Any]]
"""Maps points, shape (n, 3) [m], the rows and columns of the image, and a name to columns of `objects`."""

_PART = re.compile(r"(.*_)(\d+)\.\w+")
"""Name of a part of a recording."""
_PARTS = "if they are parts of one recording, give their folder with its metadata.yaml, which ros2 bag reindex writes"

Keep: TypeAlias = Callable[[np.ndarray, tuple[int, int], str], str]
"""Maps the same to the stage's value in column ``cloud``: the name of the written file."""


def read_bag(
    bags: str | Path | Sequence[str | Path],
    mapping: str | Path | BagMapping,
    *,
    see: See | None = None,
    keep: Keep | None = None,
    missing: Missing = None,
) -> Logs:
    """Read ROS bags as one log.

    Parameters
    ----------
    bags
        Folder or storage file of a bag, or several of them.
    mapping
        Mapping of the topics: a file, as in `MAPPING_TEMPLATE`, or the result of `read_mapping`.
    see
        Turns the cloud of a stage into its objects; without it the log has none.
    keep
        Writes the cloud of a stage to a file, whose name goes into the stage's column ``cloud``.
    missing
        What replaces NaN in covariates, as in `Logs`.

    Returns
    -------
    Logs
        Trajectories have the name of their bag in the column ``bag``; those without a name are numbered.

    Raises
    ------
    ArgumentError
        rosbags is not installed, or the mapping does not fit the bag; the message names its file and key.
    LogError
        A bag is missing or broken, or its messages do not form stages.
    """
    mapping = mapping if isinstance(mapping, BagMapping) else read_mapping(mapping)
    if mapping.cloud is None and (see is not None or keep is not None):
        raise ArgumentError(f"{mapping.file}, cloud: it is missing, so no cloud is read or stored; name its topic")
    files = [Path(bags)] if isinstance(bags, str | Path) else [Path(bag) for bag in bags]
    check_topics(files, mapping)
    needed = {name: source.topic for name, source in mapping.covariates.items()}
    needed |= {} if mapping.cloud is None else {"cloud": mapping.cloud.topic}
    begin = None if mapping.trajectory is None else mapping.trajectory.topic
    found, objects = list[tuple[Trajectory, str]](), list[pd.DataFrame]()
    named, numbers = dict[str, str](), count(1)
    for bag in files:
        of_bag = []
        runs = read_events(bag, mapping, named)
        _warn_of_early(bag, runs, begin)
        for name, events in split(bag, runs, begin, mapping.file, mapping.kept):
            trajectory = Trajectory(next(numbers) if name is None else name, needed, mapping.ending.finished)
            if begin is not None:
                trajectory.remedy = f"record a message of {begin} before it"
            with within(bag):
                trajectory.follow(events)
            of_bag.append(trajectory)
        of_bag = usable(bag, of_bag)
        if see is not None or keep is not None:
            objects += _objects(bag, of_bag, mapping, see, keep)
        found += [(trajectory, bag.name) for trajectory in of_bag]
    if begin is None:
        _warn_of_parts(found)
    place, trajectories = ", ".join(map(str, files)), [each for each, _ in found]
    return logs_of(place, mapping.file, trajectories, objects, missing, bag=[bag for _, bag in found])


def _warn_of_early(bag: Path, runs: list[list[Event]], begin: str | None) -> None:
    """Warn about deeds before the first beginning, as in the later parts of a recording."""
    first = runs[0] if runs and begin is not None else []
    num_early = len(_deeds(list(takewhile(lambda event: event.key != "trajectory", first))))
    if num_early:
        warn(
            bag,
            f"{num_early} actions, rewards and endings come before the first message of {begin}, and are left out; "
            f"{_PARTS}",
        )


def _warn_of_parts(found: "Sequence[tuple[Trajectory, str]]") -> None:
    """Warn about a bag whose name continues that of a bag without an ending."""
    for (before, name), (_, after) in pairwise(found):
        one, other = (_PART.fullmatch(each) for each in (name, after))
        if one and other and one[1] == other[1] and int(other[2]) == int(one[2]) + 1 and before.cause == CRASH:
            warn(after, f"its name continues that of {name}, which has no ending, but each is a trajectory; {_PARTS}")
            return


def logs_of(
    place: str,
    mapping: str,
    found: "Sequence[Trajectory]",
    objects: Sequence[pd.DataFrame] = (),
    missing: Missing = None,
    **known: Sequence[Any],
) -> Logs:
    """Make one log from trajectories.

    Raises
    ------
    LogError
        There are no trajectories, or they violate an invariant.
    """
    if not found:
        raise LogError(f"{place}: no trajectory with a stage was found; check [trajectory] in {mapping}")
    ends = {key: [getattr(each, key) for each in found] for key in ("end_s", "ending", "cause")}
    trajectories = {"trajectory": [each.name for each in found], **ends, **known}
    stages = [
        {"trajectory": each.name, "stage": t, **row} for each in found for t, row in enumerate(each.stages, start=1)
    ]
    with within(place):
        seen = pd.concat(list(objects), ignore_index=True) if objects else None
        return Logs(pd.DataFrame(stages), pd.DataFrame(trajectories), seen, missing=missing)


def split(
    bag: Path, runs: list[list[Event]], begin_topic: str | None, mapping: str, kept: Collection[str] = ()
) -> Iterator[tuple[Any, list[Event]]]:
    """Split the runs of a recording's clock into trajectories: name (None without one) and messages of each.

    A trajectory begins with a message of `begin_topic` or, if that is None, with a run, and with the latest values of
    the keys in `kept`. `mapping` is its file, for error messages.
    """
    latest: dict[str, Event] = {}

    def begun(events: list[Event]) -> list[Event]:
        before = [event._replace(stamp_ns=events[0].stamp_ns) for event in latest.values()] if events else []
        latest.update({event.key: event for event in events if event.key in kept})
        return before + events

    if begin_topic is None:  # a run with covariates alone, between two resets, is not a trajectory
        yield from ((None, begun(events)) for events in list(filter(_deeds, runs)) or runs[:1])
        return
    begins = [[i for i, event in enumerate(events) if event.key == "trajectory"] for events in runs]
    for events, at in list(zip(runs, begins, strict=True))[1:]:
        for event in _deeds(events[: min(at, default=len(events))]):
            raise LogError(
                f"{bag}: {event.key} {shown(event.value)} comes after the clock was reset and before a message of "
                f"{begin_topic}; record the beginning after the reset, or set clock = 'log' in {mapping}"
            )
    for events, at in zip(runs, begins, strict=True):
        begun(events[: min(at, default=len(events))])
        for begin, end in pairwise([*at, len(events)]):
            yield events[begin].value, begun(events[begin:end])


def _deeds(events: list[Event]) -> list[Event]:
    """Messages of actions, rewards and endings."""
    return [event for event in events if event.key in ("action", "reward", "ending")]


def usable(place: str | Path, found: "list[Trajectory]") -> "list[Trajectory]":
    """Return the trajectories that have a stage with all its covariates; warn of others, once for each trouble."""
    kept, left = [], dict[str, list[Trajectory]]()
    for each in found:
        if each.missing:
            left.setdefault(f"before any message of {', '.join(each.missing)} came", []).append(each)
        elif each.end_s == 0 and each.stages[0]["reward"] is None:
            left.setdefault("as it began; give the time of the cut", []).append(each)
        else:
            kept.append(each)
    for when, of in left.items():
        warn(place, f"{len(of):,} of {len(found):,} trajectories are left out, such as {shown(of[0].name)}: cut {when}")
    return kept


def _objects(
    bag: Path, trajectories: "list[Trajectory]", mapping: BagMapping, see: See | None, keep: Keep | None
) -> Iterator[pd.DataFrame]:
    """Pass the cloud of each stage to `see` and `keep`; only clouds of stages are read."""
    assert mapping.cloud is not None
    stages_of: dict[int, list[tuple[Trajectory, int]]] = {}
    for trajectory in trajectories:
        for t, number in enumerate(trajectory.clouds):
            if number is not None:
                stages_of.setdefault(number, []).append((trajectory, t))
    for number, message in read_clouds(bag, mapping.cloud.topic, set(stages_of)):
        name = f"{bag.stem}-{number}"
        cloud = *points_of(message, f"{bag}, {mapping.cloud.topic}, cloud {number}"), name
        columns = None if see is None else see(*cloud)
        file = None if keep is None else keep(*cloud)
        for trajectory, t in stages_of[number]:
            if file is not None:
                trajectory.stages[t]["cloud"] = file
            if columns is not None:
                yield pd.DataFrame({"trajectory": trajectory.name, "stage": t + 1, **columns})


@dataclass
class Trajectory:
    """A trajectory built from the events of a bag or a table."""

    name: Any
    needed: Mapping[str, str]
    """Inputs required before an action, covariates and "cloud", with their sources."""
    finished: Collection[Any]
    end_s: float = 0.0
    """Time of its ending or of its last message [s]."""
    ending: str | None = None
    cause: str | None = CRASH
    """As in `trajectories` of `Logs`; at first the cause for a trajectory without an ending."""
    stages: list[dict[str, Any]] = field(default_factory=list)
    """One entry per stage: its recorded columns."""
    clouds: list[int | None] = field(default_factory=list)
    """Number of the cloud of each stage; None if none had been received."""
    place: str = ""
    """Place of the last event, for messages."""
    remedy: str = "map [trajectory], the message that begins a trajectory, if there are several"
    """Remedy for events after an ending, for messages."""
    or_later: str = ""
    """Another remedy for an action without a reward, and the reverse, for messages."""

    @property
    def missing(self) -> list[str]:
        """Sources of covariates and clouds not yet received in its first stage."""
        is_there = {**dict.fromkeys(self.stages[0], True), "cloud": self.clouds[0] is not None}
        return [topic for name, topic in self.needed.items() if not is_there.get(name)]

    def follow(self, events: list[Event]) -> None:
        """Process its messages from the first, where its clock is 0, to the last.

        Raises
        ------
        LogError
            The order of the messages does not form stages; the error names the trajectory, the stage and the remedy.
        """
        stage: dict[str, Any] = {}
        seen: dict[str, Any] = {}
        for event in events:
            key, clock_s = event.key, (event.stamp_ns - events[0].stamp_ns) / 1e9
            self.place = event.place
            if self.ending is not None:
                self._check_after(key, clock_s)
                continue
            self.end_s = clock_s
            if key.startswith(_COVARIATE) or key == "cloud":
                seen[key.removeprefix(_COVARIATE)] = event.value
            elif key == "action":
                self._check_action(stage, event)
                stage |= {"action": event.value, "seen": dict(seen)}
            elif key in ("object", "probability"):
                stage[key] = event.value
            elif key == "reward":
                self._complete(stage, event)
                stage = {}
            elif key == "ending":
                self._end(stage, event)
        self.ending = self.ending or CUT
        if self.ending == CUT:
            self._add({"seen": dict(seen), **stage})

    def _check_action(self, stage: dict[str, Any], event: Event) -> None:
        if "action" in stage:
            self._refuse(
                f"action {shown(event.value)} comes at {self.end_s:g} s, yet {shown(stage['action'])} before it has no "
                f"reward; record a reward after every action{self.or_later}"
            )

    def _complete(self, stage: dict[str, Any], event: Event) -> None:
        if "action" not in stage:
            self._refuse(
                f"reward {event.value} comes at {self.end_s:g} s with no action before it; record every action"
                f"{self.or_later}"
            )
        self._add({**stage, "elapsed_s": self.end_s, "reward": float(event.value)})
        if self.missing:
            raise LogError(
                f"{self.place}trajectory {shown(self.name)}, stage 1: no message of {', '.join(self.missing)} came "
                "before its action; begin the trajectory after the first, or leave the covariate out of the mapping; "
                "if what begins a trajectory is mapped, and a value from before it holds, set keeps = true"
            )

    def _end(self, stage: dict[str, Any], event: Event) -> None:
        if event.value not in self.finished:
            meant = {folded(text): text for text in self.finished if isinstance(text, str)}
            if isinstance(event.value, str) and folded(event.value) in meant:
                same = shown(meant[folded(event.value)])
                self._refuse(f"ending {shown(event.value)} differs from {same} only in spelling; name both in finished")
            self.ending, self.cause = CUT, str(event.value) or UNKNOWN_CAUSE
            return
        if "action" in stage or not self.stages:
            self._refuse(
                "the trajectory finished, yet the stage has no reward; record the last reward before the ending"
            )
        self.ending, self.cause = FINISHED, None

    def _add(self, stage: dict[str, Any]) -> None:
        seen = stage.pop("seen")
        self.clouds.append(seen.pop("cloud", None))
        self.stages.append({"elapsed_s": None, "reward": None, "action": None, **seen, **stage})

    def _check_after(self, key: str, clock_s: float) -> None:
        if key in ("action", "reward", "ending"):
            raise LogError(
                f"{self.place}trajectory {shown(self.name)}: {key} comes at {clock_s:g} s, after its ending at "
                f"{self.end_s:g} s; {self.remedy}"
            )

    def _refuse(self, trouble: str) -> NoReturn:
        raise LogError(f"{self.place}trajectory {shown(self.name)}, stage {len(self.stages) + 1}: {trouble}")
