"""From messages in the order of time to trajectories and stages."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE, shown
from halfseen.logs.formats.ros_mapping import BagMapping
from halfseen.logs.formats.ros_messages import Event

CRASH = "crash"
_COVARIATE = "covariates."


@dataclass
class BagTrajectory:
    """A trajectory that a bag tells of.

    Parameters
    ----------
    name
        What it is called.
    end_s
        When it ended, or its last message came [s].
    ending, cause
        As in `trajectories` of `Logs`.
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
    """Split a bag at the messages that begin a trajectory: name (None without one) and messages of each trajectory."""
    if mapping.trajectory is None:
        if events:
            yield None, events
        return
    begins = [i for i, event in enumerate(events) if event.source.key == "trajectory"]
    for begin, end in pairwise([*begins, len(events)]):
        yield events[begin].value, events[begin:end]


def follow(name: Any, events: list[Event], mapping: BagMapping) -> BagTrajectory:
    """Follow a trajectory from its first message, where its clock is 0, to its last.

    Raises
    ------
    LogError
        The messages are in no order that makes stages; the trajectory, the stage and the remedy are named.
    """
    trajectory, stage, seen = BagTrajectory(name), {}, {}
    for event in events:
        key, clock_s = event.source.key, (event.stamp_ns - events[0].stamp_ns) / 1e9
        if trajectory.ending is not None:
            _check_after(trajectory, key, clock_s)
            continue
        trajectory.end_s = clock_s
        if key.startswith(_COVARIATE) or key == "cloud":
            seen[key.removeprefix(_COVARIATE)] = event.value
        elif key == "action":
            _begin(trajectory, stage, seen, event, clock_s)
        elif key in ("object", "probability"):
            stage[key] = event.value
        elif key == "reward":
            _complete(trajectory, stage, event, clock_s, mapping)
            stage = {}
        elif key == "ending":
            _end(trajectory, stage, event, mapping)
    if trajectory.ending is None:
        trajectory.ending = CUT
    if trajectory.ending == CUT:
        _add(trajectory, {"seen": dict(seen), **stage})
    return trajectory


def missing(trajectory: BagTrajectory, mapping: BagMapping) -> list[str]:
    """What had not been seen yet in the first stage of a trajectory: topics of covariates and clouds."""
    topics = [source.topic for name, source in mapping.covariates.items() if name not in trajectory.stages[0]]
    if mapping.cloud is not None and trajectory.clouds[0] is None:
        topics.append(mapping.cloud.topic)
    return topics


def _begin(
    trajectory: BagTrajectory, stage: dict[str, Any], seen: dict[str, Any], event: Event, clock_s: float
) -> None:
    if "action" in stage:
        _refuse(
            trajectory,
            f"action {shown(event.value)} comes at {clock_s:g} s, yet {shown(stage['action'])} before it has no "
            "reward; record a reward after every action",
        )
    stage |= {"action": event.value, "seen": dict(seen)}


def _complete(
    trajectory: BagTrajectory, stage: dict[str, Any], event: Event, clock_s: float, mapping: BagMapping
) -> None:
    if "action" not in stage:
        _refuse(
            trajectory, f"reward {event.value} comes at {clock_s:g} s with no action before it; record every action"
        )
    _add(trajectory, {**stage, "elapsed_s": clock_s, "reward": float(event.value)})
    topics = missing(trajectory, mapping)
    if topics:
        raise LogError(
            f"trajectory {shown(trajectory.name)}, stage 1: no message of {', '.join(topics)} came before its action; "
            "begin the trajectory after the first, or leave the covariate out of the mapping"
        )


def _end(trajectory: BagTrajectory, stage: dict[str, Any], event: Event, mapping: BagMapping) -> None:
    if event.value not in mapping.finished:
        trajectory.ending, trajectory.cause = CUT, str(event.value) or UNKNOWN_CAUSE
        return
    if "action" in stage or not trajectory.stages:
        _refuse(
            trajectory, "the trajectory finished, yet the stage has no reward; record the last reward before the ending"
        )
    trajectory.ending, trajectory.cause = FINISHED, None


def _add(trajectory: BagTrajectory, stage: dict[str, Any]) -> None:
    seen = stage.pop("seen")
    trajectory.clouds.append(seen.pop("cloud", None))
    trajectory.stages.append({"elapsed_s": None, "reward": None, "action": None, **seen, **stage})


def _check_after(trajectory: BagTrajectory, key: str, clock_s: float) -> None:
    if key in ("action", "reward", "ending"):
        raise LogError(
            f"trajectory {shown(trajectory.name)}: {key} comes at {clock_s:g} s, after its ending at "
            f"{trajectory.end_s:g} s; map [trajectory], the message that begins a trajectory, if the bag holds several"
        )


def _refuse(trajectory: BagTrajectory, trouble: str) -> None:
    raise LogError(f"trajectory {shown(trajectory.name)}, stage {len(trajectory.stages) + 1}: {trouble}")
