"""What was decided becomes the next log: one path (trajectory) at a time, a stage a decision.

A decision begins a stage, and a path where none is in progress; a reward completes it; then comes the next decision, or
the end. So the client is asked for no more than what `LogRecorder` is told, and that is what keeps it.
"""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.recording.recorder import LogRecorder, PathRecorder
from halfseen.serving.refusal import Refusal

STOPPED = "server stopped"
"""Cause of the cut of a path that was in progress when the server stopped."""


class RecordedPaths:
    """The paths of one cell, in a folder of logs.

    Parameters
    ----------
    folder
        Where to, as `LogRecorder` takes it.

    Raises
    ------
    HalfseenError
        The folder cannot be recorded into.
    """

    def __init__(self, folder: Path) -> None:
        self._recorder = LogRecorder(folder)
        self._path: PathRecorder | None = None
        self._num_begun = 0
        self._is_waiting = False

    def __enter__(self) -> "RecordedPaths":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._recorder.close(STOPPED)

    @property
    def next_stage(self) -> int:
        """Stage that the next decision begins, from 1.

        Raises
        ------
        Refusal
            The stage before has no reward yet.
        """
        if self._is_waiting:
            raise Refusal(409, f"{self._where}: it has no reward yet; POST it to /reward, or the path's end to /end")
        return self._num_begun + 1

    @property
    def facts(self) -> dict[str, Any]:
        """Where it stands, for a client that has forgotten it: the path, its last stage, and what is waited for."""
        waits_for = "reward" if self._is_waiting else "decision"
        return {"path": self._path and self._path.name, "stage": self._num_begun, "waits_for": waits_for}

    def decided(
        self,
        covariates: Mapping[str, Any],
        action: Any,
        probability: float,
        target: Any = None,
        objects: list[dict[str, Any]] | None = None,
    ) -> Any:
        """Begin a stage with what was seen and is done, and name its path.

        Parameters
        ----------
        covariates, action, probability, objects
            As `PathRecorder.begin_stage` takes them.
        target
            The object that is acted on, if any.

        Raises
        ------
        Refusal
            The stage before has no reward yet, or a value is none that this log takes.
        """
        _ = self.next_stage
        try:
            path = self._path or self._recorder.begin_path()
            path.begin_stage(covariates, objects, action=action, object=target, probability=probability)
        except LogError as error:
            if self._path is None:
                path.cut(STOPPED)  # nothing is written of a path that has no stage yet
            raise Refusal(422, f"nothing is decided, for it could not be recorded: {error}") from error
        self._path, self._num_begun, self._is_waiting = path, self._num_begun + 1, True
        return path.name

    def rewarded(self, reward: Any, elapsed_s: Any = None) -> dict[str, Any]:
        """Complete the stage in progress.

        Parameters
        ----------
        reward, elapsed_s
            As `PathRecorder.complete_stage` takes them.

        Raises
        ------
        Refusal
            No stage is in progress, or a value is none that a log takes.
        """
        if self._path is None or not self._is_waiting:
            raise Refusal(409, "no stage waits for a reward; POST what is seen to /decide first")
        try:
            self._path.complete_stage(reward, elapsed_s=elapsed_s)
        except LogError as error:
            raise Refusal(422, str(error)) from error
        self._is_waiting = False
        return self.facts

    def ended(self, cause: str | None, elapsed_s: Any = None) -> dict[str, Any]:
        """End the path in progress.

        Parameters
        ----------
        cause
            Why it was cut; None where it came to its own end.
        elapsed_s
            As `PathRecorder.finish` takes it.

        Raises
        ------
        Refusal
            No path is in progress, its last stage has no reward, or a value is none that a log takes.
        """
        if self._path is None:
            raise Refusal(409, "no path is in progress; POST what is seen to /decide, which begins one")
        if cause is None:
            _ = self.next_stage
        try:
            if cause is None:
                self._path.finish(elapsed_s=elapsed_s)
            else:
                self._path.cut(cause, elapsed_s=elapsed_s)
        except LogError as error:
            raise Refusal(422, str(error)) from error
        told = {"path": self._path.name, "stages": self._num_begun, "ending": "finished" if cause is None else "cut"}
        self._path, self._num_begun = None, 0
        self._is_waiting = False
        return told

    @property
    def _where(self) -> str:
        assert self._path is not None, "what waits has a path"
        return f"path {self._path.name}, stage {self._num_begun}"
