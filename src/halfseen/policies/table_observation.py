"""Observations of tables, from a point cloud and the history of the table."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from halfseen.errors import ArgumentError, CloudError, PolicyError, within
from halfseen.perception import View, perceive, read_cloud
from halfseen.perception.labels import labels_of
from halfseen.perception.view import left_out_in_words, other_things_in_words, remedy_without_objects
from halfseen.policies.folder.stored import StoredPolicy, refuse_log_of_team
from halfseen.policies.named_decider import STATE_FILES
from halfseen.tables.first_look import chances_in_words, labels_in_words
from halfseen.tables.present import Present, first_state, labelled
from halfseen.world.scene import Scene
from halfseen.world.seeing import AssumedSeeing, KnownSeeing

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # A table without a history has none.


@runtime_checkable
class SeenLaw(Protocol):
    """A cell's law of views."""

    @property
    def seeing(self) -> KnownSeeing:
        """The law of labels."""
        ...

    def scene(self, view: View) -> Scene:
        """The scene in a view, grips included."""
        ...


class Past(NamedTuple):
    """The trajectory so far of a table that was seen before."""

    logs: Logs
    """Logs whose last trajectory it is."""
    held: bool | None = None
    """Whether its last action held; None if unknown."""
    folder: Path | None = None
    """Where the logs were read, for messages; None if nowhere."""


class TableSeen(NamedTuple):
    """A table in front of the camera."""

    present: Present
    """The present state of its trajectory; if not all objects are cups, the first note says so."""
    view: View
    """The view of the camera."""
    other_things: str
    """A note that not all objects are cups; empty if all may be."""


def past_in(folder: Path | None) -> Past | None:
    """The last trajectory of a folder of logs; None without a folder."""
    if folder is None:
        return None
    from halfseen.logs import read_logs

    return Past(read_logs(folder), folder=folder)


def see_table(
    stored: StoredPolicy,
    file: Path,
    past: Past | None = None,
    stage: int | None = None,
    labels: Path | None = None,
    law: SeenLaw | None = None,
    horizon: int | None = None,
) -> TableSeen:
    """Perceive the table, and place it in its trajectory.

    Parameters
    ----------
    stored
        A policy of tables.
    file
        A point cloud.
    past
        The trajectory so far; None at its beginning.
    stage
        The stage to decide, from 1; None for that of the trajectory so far, or 1.
    labels
        Which objects look dirty, in the format of `halfseen.perception.read_labels`; None for the colours of the cloud,
        if it has any.
    law
        A cell's law of labels and grips; None for the assumed law of labels.
    horizon
        Last stage that is accepted; None for the policy's.

    Raises
    ------
    HalfseenError
        A file cannot be read, or does not fit the policy.
    """
    if file.suffix in STATE_FILES:
        raise PolicyError(f"{file}: the policy is of tables, but this is not a point cloud; give .pcd, .ply or .npz")
    cloud = read_cloud(file)
    view = perceive(cloud)
    if not view.objects:
        cleared = "" if past is None else "; if it is cleared, the trajectory is over"
        raise CloudError(f"{file}: no objects on the table; {remedy_without_objects(view)}{cleared}")
    seen_labels, others = labels_of(view, cloud, labels), other_things_in_words(view)
    scene = view.scene() if law is None else law.scene(view)
    now = _present(stored, view, scene, past, stage, horizon or stored.horizon)
    now = replace(now, notes=(*filter(None, (others, left_out_in_words(view))), *now.notes))
    if seen_labels is None:
        return TableSeen(now, view, others)
    after = labelled(now, [label.is_dirty for label in seen_labels], AssumedSeeing() if law is None else law.seeing)
    return TableSeen(replace(after, seen=_seen(now, after, labels_in_words(seen_labels, labels))), view, others)


def _present(
    stored: StoredPolicy, view: View, scene: Scene, past: Past | None, stage: int | None, horizon: int
) -> Present:
    dirty_share = stored.record["schema"]["dirty_share"]
    if past is None:
        return first_state(scene, horizon, dirty_share, stage or 1)
    from halfseen.policies.history import present_state

    with nullcontext() if past.folder is None else within(past.folder):
        refuse_log_of_team(stored, past.logs)
        now = present_state(scene, horizon, past.logs, dirty_share=dirty_share, places_m=view.places_m, held=past.held)
    if stage not in (None, now.stage):
        raise ArgumentError(
            f"--stage is {stage}, but the trajectory in {past.folder} is at stage {now.stage}; leave --stage out"
        )
    return now


def _seen(before: Present, after: Present, said: str) -> str:
    """Say what labels showed, and their weight."""
    if not before.is_labelled:
        return f"{said}; {chances_in_words(after)}."
    but = f", except for new objects: {', '.join(map(str, before.new))}" if before.new else ""
    kept = f"{said} are not counted again: the history holds what was seen at this stage{but}"
    return f"{kept}; {chances_in_words(after)}."
