"""Recording of decisions as the next log: one trajectory at a time, one stage per decision.

A decision begins a stage, and a trajectory if none is in progress. A reward completes the stage. Then comes the next
decision, or the end. `LogRecorder` stores the log, and the client supplies only what it needs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET

from halfseen.errors import LogError, PolicyError, StorageError
from halfseen.logs import Logs
from halfseen.logs.columns import shown
from halfseen.logs.missing import is_flag
from halfseen.logs.recorder import LogRecorder, TrajectoryRecorder
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.rule_files import FINISH
from halfseen.serving.models import DecisionAnswer, EndAnswer, RecordingProgress, Refusal

TEXT, TRUTH = "text", "truth value"
STOPPED = "server stopped"
"""Cause of the cut of a trajectory in progress when the server stopped."""
NOTHING_RECORDED = RecordingProgress(None, 0, "decision")


@dataclass(frozen=True, eq=False)
class Begun:
    """Recorded data of a stage that begins, except its action.

    Parameters
    ----------
    covariates, objects
        As in `TrajectoryRecorder.begin_stage`.
    columns
        Columns of its trajectory, if this is the first stage.
    is_of_cloud
        Whether the objects come from a cloud.
    """

    covariates: Mapping[str, Any] = field(default_factory=dict)
    objects: list[dict[str, Any]] | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    is_of_cloud: bool = False


class SoFar(NamedTuple):
    """A trajectory in progress."""

    logs: Logs
    """The trajectory alone, as it would be read from the log."""
    objects: list[dict[str, Any]]
    """Objects of its last stage."""
    held: bool | None
    """Whether its last attempt held; None if unknown."""


class RecordedTrajectories:
    """The trajectories of one cell, in a folder of logs.

    Parameters
    ----------
    folder
        Output folder, as in `LogRecorder`.
    is_of_tables
        Whether stages are of tables: then stages that break a rule of tables are not recorded, and `so_far` gives the
        trajectory in progress.
    resumes
        Whether an unfinished trajectory in the folder is resumed, and one in progress is left unfinished on exit;
        then `elapsed_s` is always required.

    Raises
    ------
    HalfseenError
        The folder cannot be recorded into.

    Attributes
    ----------
    facts
        Current state, for a client that has lost track.
    """

    def __init__(self, folder: Path, *, is_of_tables: bool = False, resumes: bool = False) -> None:
        check = self._check_table if is_of_tables else None
        self._folder, self._recorder = folder, LogRecorder(folder, check=check, keeps_events=True)
        self._is_of_tables, self._resumes = is_of_tables, resumes
        self._checked: Logs | None = None
        self._trajectory: TrajectoryRecorder | None = None
        self.facts = NOTHING_RECORDED
        self._begun = Begun()
        self._held: bool | None = None
        if resumes:
            self._resume()

    def _resume(self) -> None:
        """Resume an unfinished trajectory from its events, if there is one."""
        self._trajectory = self._recorder.resume()
        if self._trajectory is None:
            return
        last = [event for event in self.events if event["event"] == "stage"][-1]
        waits = ("reward", last["action"]) if self._trajectory.is_in_stage else ("decision",)
        self.facts = RecordingProgress(self._trajectory.name, last["stage"], *waits)
        self._begun = Begun(last["covariates"])

    def __enter__(self) -> "RecordedTrajectories":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._recorder.close(None if self._resumes else STOPPED)

    def draws(self, seed: int) -> np.random.Generator:
        """Generator to explore by: another each time that recording begins, and other than that of a comparison."""
        return np.random.default_rng([seed, self._recorder.num_earlier_stages, 1])

    def check_in_progress(self, trajectory: Any) -> None:
        """Refuse a request that names another trajectory than that in progress; one that names none passes.

        Raises
        ------
        Refusal
            The two are not the same, so another client asks, too.
        """
        now = self.facts.trajectory
        if trajectory is not None and (now is None or str(trajectory) != str(now)):
            there = "none is in progress; leave it out to begin one" if now is None else f"{now} is in progress"
            raise Refusal(409, f"trajectory is {trajectory!r:.40}, but {there}; give each client a server of its own")

    def next_stage(self, trajectory: Any = None, *, is_of_cloud: bool = False) -> int:
        """Stage that the next decision begins, from 1.

        Parameters
        ----------
        trajectory
            As in `check_in_progress`.
        is_of_cloud
            As in `Begun`.

        Raises
        ------
        Refusal
            Another trajectory is in progress, the previous stage has no reward yet, or the form of the state differs
            from that of earlier stages.
        """
        self.check_in_progress(trajectory)
        self._check_rewarded()
        if is_of_cloud and not self._is_of_tables:
            raise Refusal(409, "recording began with a policy without tables; record this one into another folder")
        if self._trajectory is not None and self._begun.is_of_cloud != is_of_cloud:
            began, other = ("a cloud", "JSON") if self._begun.is_of_cloud else ("JSON", "a cloud")
            raise Refusal(409, f"{self._where}: it came as {began}, but now {other}; keep one form throughout")
        return self.facts.stage + 1

    def _check_rewarded(self) -> None:
        if self.facts.waits_for == "reward":
            remedy = "POST it to /reward, or the trajectory's end to /end"
            raise Refusal(409, f"{self._where}: it has no reward yet; {remedy}")

    def refuse_other_log(self, stored: StoredPolicy) -> None:
        """Refuse to continue a log in which the decisions of a policy cannot be recorded.

        Raises
        ------
        PolicyError
            The log has objects, or no probabilities, or other kinds of actions or covariates than the policy.
        """
        policy, kinds = stored.policy, self._recorder.kinds
        if kinds is None:
            return
        if stored.is_table != bool(self._recorder.kinds_of_objects):
            wants = "takes objects" if stored.is_table else "takes no objects"
            raise PolicyError(f"the policy {wants}, unlike {self._folder}; record into another folder")
        try:
            self._recorder.check_choice(FINISH if stored.is_table else policy.actions[0], probability=1.0)
        except LogError as error:
            raise PolicyError(f"the decisions do not fit the log: {error}, or record into another folder") from error
        filling = getattr(policy, "filling", None)
        flags = () if filling is None else filling.flags
        for name in getattr(policy, "covariates", ()):
            kind, wants_text = kinds.get(name), name in policy.categories
            if name not in flags if kind is None else (kind == TEXT) != wants_text:
                has = "lacks it" if kind is None else f"has a {kind} there"
                wants = "text" if wants_text else "a number"
                raise PolicyError(
                    f"the policy takes {wants} as {shown(name)}, but {self._folder} {has}; record into another folder"
                )

    def fitted(self, begun: Begun) -> tuple[Begun, list[str]]:
        """A stage as this log holds it, so that no decision is lost to a client's change; and warnings."""
        covariates, doubts = _fitted(begun.covariates, self._recorder.kinds)
        if begun.objects is None or not self._recorder.kinds_of_objects:
            return replace(begun, covariates=covariates), doubts
        kinds = {"object": "name", **self._recorder.kinds_of_objects}
        rows = [_fitted(row, kinds) for row in begun.objects]
        doubts += dict.fromkeys(f"of objects, {doubt}" for _, of_row in rows for doubt in of_row)
        return replace(begun, covariates=covariates, objects=[row for row, _ in rows]), doubts

    @property
    def so_far(self) -> SoFar | None:
        """The trajectory of tables in progress; None if there is none."""
        if self._trajectory is None or self._checked is None or self._begun.objects is None:
            return None
        return SoFar(self._checked, self._begun.objects, self._held)

    @property
    def columns(self) -> Mapping[str, Any]:
        """Columns of the trajectory in progress; empty if there is none."""
        return {} if self._trajectory is None or not self.events else self.events[0]["columns"]

    @property
    def last(self) -> Mapping[str, Any] | None:
        """Covariates of the last stage of the trajectory in progress; None if there is none."""
        return None if self._trajectory is None else self._begun.covariates

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Events of the latest trajectory."""
        last = self._recorder.trajectory
        return () if last is None else last.events

    def decided(self, begun: Begun, reply: DecisionAnswer) -> int | str:
        """Begin a stage with a state and its decision, and return the name of the trajectory.

        Parameters
        ----------
        begun
            The state.
        reply
            The answer.

        Raises
        ------
        Refusal
            The previous stage has no reward yet, or a value does not fit this log.
        StorageError
            The disk cannot store it.
        """
        self.next_stage(is_of_cloud=begun.is_of_cloud)
        verb, target = reply.verb or reply.action, None if reply.object is UNSET else reply.object
        before = self._checked
        try:
            trajectory = self._trajectory or self._recorder.begin_trajectory(**begun.columns)
            trajectory.begin_stage(
                begun.covariates,
                begun.objects,
                action=verb,
                object=target,
                probability=reply.probability,
                stepped_back=None if reply.stepped_back is UNSET else reply.stepped_back,
            )
        except Exception as error:
            self._checked, begun_trajectory = before, self._recorder.trajectory
            if self._trajectory is None and begun_trajectory is not None and not begun_trajectory.is_ended:
                begun_trajectory.cut(STOPPED)  # a trajectory without stages is not written
            if isinstance(error, StorageError) or not isinstance(error, LogError):
                raise
            raise Refusal(422, f"nothing is decided, as it could not be recorded: {error}") from error
        self._trajectory, self._begun, self._held = trajectory, begun, None
        self.facts = RecordingProgress(trajectory.name, self.facts.stage + 1, "reward", reply.action, reply.object)
        return trajectory.name

    def _check_table(self, logs: Logs) -> None:
        from halfseen.world.log_checks import checked_tables

        checked_tables(logs, is_team=False)
        self._checked = logs

    def rewarded(self, reward: float, elapsed_s: float | None = None, held: bool | None = None) -> RecordingProgress:
        """Complete the stage in progress.

        Parameters
        ----------
        reward, elapsed_s
            As in `TrajectoryRecorder.complete_stage`.
        held
            For a trajectory of clouds, whether the attempt held; None if unknown.

        Raises
        ------
        LogError, Refusal
            A value does not fit a log; no stage is in progress.
        """
        if self._trajectory is None or self.facts.waits_for == "decision":
            raise Refusal(409, "no stage waits for a reward; POST the state to /decide first")
        if held is not None and not self._begun.is_of_cloud:
            raise Refusal(422, f"{self._where}: held is for clouds, but this came as JSON, whose objects show it")
        if held is not None and self.facts.object is None:
            raise Refusal(422, f"{self._where}: held is {held}, but {self.facts.action} moves nothing")
        self._trajectory.complete_stage(reward, elapsed_s=elapsed_s)
        self.facts, self._held = RecordingProgress(self.facts.trajectory, self.facts.stage, "decision"), held
        return self.facts

    def ended(self, cause: str | None, elapsed_s: float | None = None) -> EndAnswer:
        """End the trajectory in progress.

        Parameters
        ----------
        cause
            Cause of the cut; None if it finished.
        elapsed_s
            As in `TrajectoryRecorder.finish`.

        Raises
        ------
        LogError, Refusal
            A value does not fit a log; no trajectory is in progress, or its last stage has no reward.
        """
        if self._trajectory is None:
            raise Refusal(409, "no trajectory is in progress; POST the state to /decide, which begins one")
        if cause is None:
            self._check_rewarded()
            self._trajectory.finish(elapsed_s=elapsed_s)
        else:
            self._trajectory.cut(cause, elapsed_s=elapsed_s)
        ended = EndAnswer(self._trajectory.name, self.facts.stage, "finished" if cause is None else "cut")
        self._trajectory, self._checked, self.facts = None, None, NOTHING_RECORDED
        return ended

    @property
    def _where(self) -> str:
        return f"trajectory {self.facts.trajectory}, stage {self.facts.stage}"


def _fitted(covariates: Mapping[str, Any], kinds: Mapping[str, str] | None) -> tuple[dict[str, Any], list[str]]:
    """Covariates, or columns of an object, as the log holds them, and a warning for each that is not recorded.

    Truth values become 0 and 1 where the log has numbers, and the other way round. `kinds` are as in
    `LogRecorder.kinds`; None for a log that begins.
    """
    if kinds is None:
        return dict(covariates), []
    new = [name for name in covariates if name not in kinds and not is_flag(name, kinds)]
    kept = {name: _as(kinds.get(name), value) for name, value in covariates.items() if name not in new}
    return kept, [f"{shown(name)} is not in the log so far, and is not recorded" for name in new]


def _as(kind: str | None, value: Any) -> Any:
    if kind == TRUTH and not isinstance(value, bool) and value in (0, 1):
        return bool(value)
    return int(value) if isinstance(value, bool) and kind not in (None, TRUTH) else value
