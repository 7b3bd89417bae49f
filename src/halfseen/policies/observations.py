"""From files to what a policy decides from: covariates of one stage, or a cloud of a table and its history."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, CloudError, LogError, PolicyError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.logs import Logs, read_logs
from halfseen.logs.refusal import within
from halfseen.perception import Label, View, perceive, read_cloud
from halfseen.perception.kind import other_things_in_words
from halfseen.perception.label_files import labels_of
from halfseen.perception.labels import WORDS
from halfseen.policies.folder import StoredPolicy
from halfseen.policies.history import present_state
from halfseen.policies.named_decider import NamedObservation
from halfseen.tables.present import Present, first_state, labelled
from halfseen.world.scene import Scene
from halfseen.world.seeing import AssumedSeeing, KnownSeeing

STATE_FILES = (".json", ".csv")


@runtime_checkable
class SeenLaw(Protocol):
    """What a law of a cell tells of a view."""

    @property
    def seeing(self) -> KnownSeeing:
        """What labels tell."""
        ...

    def scene(self, view: View) -> Scene:
        """What is seen of a table, grips included."""
        ...


class TableSeen(NamedTuple):
    """A table in front of the camera."""

    present: Present
    """Where its path stands; where not all are cups, the first note says so."""
    view: View
    """What the camera sees."""
    other_things: str
    """That not all on it are cups; nothing where all may be."""


def read_observation(
    stored: StoredPolicy,
    file: Path,
    history: Path | None = None,
    stage: int | None = None,
    labels: Path | None = None,
    law: SeenLaw | None = None,
) -> NamedObservation | Present:
    """Read what a policy decides from.

    Parameters
    ----------
    stored
        The policy.
    file
        For tables a point cloud; for named actions covariates as .json or .csv, one state.
    history
        For tables, a folder of logs whose last path is the one so far.
    stage
        The stage to decide, from 1; None for what the file or the history says, or 1.
    labels
        For tables, what looks dirty, as `halfseen.perception.read_labels` takes it; None for what the colours of the
        cloud tell, if it has some.
    law
        For tables, what a cell's law tells of labels and grips; None for the law of labels that is assumed.

    Raises
    ------
    HalfseenError
        A file cannot be read, or does not fit the policy.
    """
    if stored.is_table:
        return read_table(stored, file, history, stage, labels, law).present
    for option, given in (("--history", history), ("--labels", labels)):
        if given is not None:
            raise ArgumentError(f"{option} is for tables; this policy looks at the covariates of the stage alone")
    row = _state_row(file, stored.policy)
    return NamedObservation(row, _stage_of(file, row, stage, stored.horizon))


def read_table(
    stored: StoredPolicy,
    file: Path,
    history: Path | None = None,
    stage: int | None = None,
    labels: Path | None = None,
    law: SeenLaw | None = None,
) -> TableSeen:
    """See the table, and put it where the path stands.

    Parameters
    ----------
    stored
        A policy of tables.
    file, history, stage, labels, law
        As `read_observation` takes them.

    Raises
    ------
    HalfseenError
        A file cannot be read, or does not fit the policy.
    """
    if file.suffix in STATE_FILES:
        raise PolicyError(f"{file}: the policy is of tables, and this is no point cloud; give .pcd, .ply or .npz")
    logs = None if history is None else read_logs(history)
    cloud = read_cloud(file)
    view = perceive(cloud)
    if not view.objects:
        raise CloudError(f"{file}: no objects on the table; put the table with its objects whole into the view")
    told, others = labels_of(view, cloud, labels), other_things_in_words(view)
    scene = view.scene() if law is None else law.scene(view)
    now = _present(stored, view, scene, logs, history, stage)
    if others:
        now = replace(now, notes=(others, *now.notes))
    if told is None:
        return TableSeen(now, view, others)
    source = "colour" if labels is None else str(labels)
    after = labelled(now, [label.is_dirty for label in told], AssumedSeeing() if law is None else law.seeing)
    return TableSeen(replace(after, seen=_seen(now, after, told, source)), view, others)


def _present(
    stored: StoredPolicy, view: View, scene: Scene, logs: Logs | None, history: Path | None, stage: int | None
) -> Present:
    dirty_share = stored.record["schema"]["dirty_share"]
    if logs is None:
        return first_state(scene, stored.horizon, dirty_share, stage or 1)
    places_m = np.array([seen.solid.middle_m for seen in view.objects])
    with within(history):
        now = present_state(scene, stored.horizon, logs, dirty_share=dirty_share, places_m=places_m)
    if stage not in (None, now.stage):
        raise ArgumentError(
            f"--stage is {stage}, but by {history} the path has come to stage {now.stage}; leave it out"
        )
    return now


def _seen(before: Present, after: Present, told: Sequence[Label], source: str) -> str:
    """Say what labels told, and how much they count."""
    named = {word: [k for k, label in enumerate(told) if label.word == word] for word in WORDS.values()}
    listed = "; ".join(f"{word}: {', '.join(map(str, objects))}" for word, objects in named.items() if objects)
    start = f"Labels by {source} ({listed})"
    if before.is_labelled:
        but = f", but for what is new to it: {', '.join(map(str, before.new))}" if before.new else ""
        return f"{start} are not counted again: the history holds what was seen at this stage{but}."
    moved = np.asarray(after.state.log_odds - before.state.log_odds, dtype=np.float64)[: len(told)]
    by = f"by {moved.min():+.2f} to {moved.max():+.2f}" if np.ptp(moved) else f"by {moved[0]:+.2f}"
    return f"{start} moved the log-odds of DIRTY {by}."


def _state_row(file: Path, policy: FlatPolicy) -> pd.DataFrame:
    """Read the covariates of one stage."""
    covariates = policy.covariates
    looks_at = ", ".join(covariates) or "no covariates"
    if file.suffix not in STATE_FILES:
        raise PolicyError(
            f"{file}: the policy is of named actions and looks at {looks_at}, not at clouds; give them as .json or .csv"
        )
    row = _read_states(file, policy.categories)
    if len(row) != 1:
        raise PolicyError(f"{file}: it holds {len(row)} states; give one: a JSON object, or a header and one row")
    missing = [name for name in covariates if name not in row.columns]
    if missing:
        raise PolicyError(
            f"{file}: the policy looks at {looks_at}, and there is no {missing[0]!r} among "
            f"{', '.join(map(str, row.columns)) or 'nothing'}; give what the policy was learned from"
        )
    try:
        policy.looks_at.encode(row)
    except LogError as error:
        raise PolicyError(f"{file}: {error}") from error
    return row


def _read_states(file: Path, texts: Iterable[str]) -> pd.DataFrame:
    try:
        if file.suffix == ".json":
            state = json.loads(file.read_text(encoding="utf-8"))
            return pd.DataFrame([state]) if isinstance(state, dict) else pd.DataFrame()
        exact: Any = {"float_precision": "round_trip", "converters": dict.fromkeys(texts, str)}
        return pd.read_csv(file, **exact)
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise PolicyError(f"{file}: it cannot be read ({reason}); give one state as .json or .csv") from error


def _stage_of(file: Path, row: pd.DataFrame, given: int | None, horizon: int) -> int:
    stage = row["stage"].iloc[0] if "stage" in row.columns else given or 1
    if isinstance(stage, bool) or not (hasattr(stage, "__index__") and 1 <= int(stage) <= horizon):
        raise PolicyError(f"{file}: stage is {stage}; it is a whole number from 1 to the policy's horizon, {horizon}")
    if given not in (None, int(stage)):
        raise ArgumentError(f"--stage is {given}, but {file} says {stage}; leave one of them out")
    return int(stage)
