"""From messages in the order of time to paths and stages."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE
from halfseen.logs.formats.ros_mapping import BagMapping
from halfseen.logs.formats.ros_messages import Event
from halfseen.logs.refusal import shown

CRASH = "crash"
_COVARIATE = "covariates."


@dataclass
class BagPath:
    """A path that a bag tells of.

    Parameters
    ----------
    name
        What it is called.
    end_s
        When it ended, or its last message came [s].
    ending, cause
        As in `paths` of `Logs`.
    stages
        One entry a stage: the columns that were recorded.
    clouds
        Number of the cloud of each stage, None where none had come.
    """

    name: Any
    end_s: float = 0.0
    ending: str | None = None
    cause: str | None = CRASH
    stages: list[dict[str, Any]] = field(default_factory=list)
    clouds: list[int | None] = field(default_factory=list)


def split(events: list[Event], mapping: BagMapping) -> Iterator[tuple[Any, list[Event]]]:
    """Split a bag at the messages that begin a path: name (None without one) and messages of each path."""
    if mapping.path is None:
        if events:
            yield None, events
        return
    begins = [i for i, event in enumerate(events) if event.source.key == "path"]
    for begin, end in pairwise([*begins, len(events)]):
        yield events[begin].value, events[begin:end]


def follow(name: Any, events: list[Event], mapping: BagMapping) -> BagPath:
    """Follow a path from its first message, where its clock is 0, to its last.

    Raises
    ------
    LogError
        The messages are in no order that makes stages; the path, the stage and the remedy are named.
    """
    path, stage, seen = BagPath(name), {}, {}
    for event in events:
        key, clock_s = event.source.key, (event.stamp_ns - events[0].stamp_ns) / 1e9
        if path.ending is not None:
            _check_after(path, key, clock_s)
            continue
        path.end_s = clock_s
        if key.startswith(_COVARIATE) or key == "cloud":
            seen[key.removeprefix(_COVARIATE)] = event.value
        elif key == "action":
            _begin(path, stage, seen, event, clock_s)
        elif key in ("object", "probability"):
            stage[key] = event.value
        elif key == "reward":
            _complete(path, stage, event, clock_s, mapping)
            stage = {}
        elif key == "ending":
            _end(path, stage, event, mapping)
    if path.ending is None:
        path.ending = CUT
    if path.ending == CUT:
        _add(path, {"seen": dict(seen), **stage})
    return path


def missing(path: BagPath, mapping: BagMapping) -> list[str]:
    """What had not been seen yet in the first stage of a path: topics of covariates and clouds."""
    topics = [source.topic for name, source in mapping.covariates.items() if name not in path.stages[0]]
    if mapping.cloud is not None and path.clouds[0] is None:
        topics.append(mapping.cloud.topic)
    return topics


def _begin(path: BagPath, stage: dict[str, Any], seen: dict[str, Any], event: Event, clock_s: float) -> None:
    if "action" in stage:
        _refuse(
            path,
            f"action {shown(event.value)} comes at {clock_s:g} s, yet {shown(stage['action'])} before it has no "
            "reward; record a reward after every action",
        )
    stage |= {"action": event.value, "seen": dict(seen)}


def _complete(path: BagPath, stage: dict[str, Any], event: Event, clock_s: float, mapping: BagMapping) -> None:
    if "action" not in stage:
        _refuse(path, f"reward {event.value} comes at {clock_s:g} s with no action before it; record every action")
    _add(path, {**stage, "elapsed_s": clock_s, "reward": float(event.value)})
    topics = missing(path, mapping)
    if topics:
        raise LogError(
            f"path {shown(path.name)}, stage 1: no message of {', '.join(topics)} came before its action; begin the "
            "path after the first, or leave the covariate out of the mapping"
        )


def _end(path: BagPath, stage: dict[str, Any], event: Event, mapping: BagMapping) -> None:
    if event.value not in mapping.finished:
        path.ending, path.cause = CUT, str(event.value) or UNKNOWN_CAUSE
        return
    if "action" in stage or not path.stages:
        _refuse(path, "the path finished, yet the stage has no reward; record the last reward before the ending")
    path.ending, path.cause = FINISHED, None


def _add(path: BagPath, stage: dict[str, Any]) -> None:
    seen = stage.pop("seen")
    path.clouds.append(seen.pop("cloud", None))
    path.stages.append({"elapsed_s": None, "reward": None, "action": None, **seen, **stage})


def _check_after(path: BagPath, key: str, clock_s: float) -> None:
    if key in ("action", "reward", "ending"):
        raise LogError(
            f"path {shown(path.name)}: {key} comes at {clock_s:g} s, after its ending at {path.end_s:g} s; map [path], "
            "the message that begins a path, if the bag holds several"
        )


def _refuse(path: BagPath, trouble: str) -> None:
    raise LogError(f"path {shown(path.name)}, stage {len(path.stages) + 1}: {trouble}")
