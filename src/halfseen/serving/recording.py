"""What was decided becomes the next log: one trajectory at a time, a stage a decision.

A decision begins a stage, and a trajectory where none is in progress; a reward completes it; then comes the next
decision, or the end. So the client is asked for no more than what `LogRecorder` is told, and that is what keeps it.

Now and then another action than the best is drawn at random, so that the log tells what it is worth. With ε and k
possible actions, the best is taken with probability 1 − ε + ε/k and each other with ε/k: every action that is possible
has a probability above 0, and the log says which. A table draws the actions that it names instead, each with a
probability of its own, where they are wanted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.recorder import LogRecorder, TrajectoryRecorder
from halfseen.policies.decision import Decision
from halfseen.serving.models import Decided, Ended, Progress, Refusal

STOPPED = "server stopped"
"""Cause of the cut of a trajectory that was in progress when the server stopped."""


@dataclass(frozen=True, eq=False)
class Begun:
    """What is recorded of a stage that begins, besides what is done.

    Parameters
    ----------
    covariates, objects
        As `TrajectoryRecorder.begin_stage` takes them.
    columns
        Of its trajectory, if this is the first stage.
    is_of_cloud
        Whether the objects are what a cloud shows.
    """

    covariates: Mapping[str, Any] = field(default_factory=dict)
    objects: list[dict[str, Any]] | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    is_of_cloud: bool = False


class SoFar(NamedTuple):
    """A trajectory in progress, to go on from."""

    logs: Logs
    """It alone, as anyone who reads it later has it."""
    objects: list[dict[str, Any]]
    """Of its last stage."""
    held: bool | None
    """Whether its last action held; None if nobody said."""


class Waiting(NamedTuple):
    """What was decided in the stage that waits for its reward."""

    action: int | str
    object: Any = UNSET


class RecordedTrajectories:
    """The trajectories of one cell, in a folder of logs.

    Parameters
    ----------
    folder
        Where to, as `LogRecorder` takes it.
    is_of_tables
        Whether stages are of tables: then what would break a rule of theirs is not recorded, and a trajectory can be
        gone on from.
    resumes
        Whether a trajectory that was in progress when the folder was left goes on, and this one is left so, too; then
        `elapsed_s` must be given always.

    Raises
    ------
    HalfseenError
        The folder cannot be recorded into.
    """

    def __init__(self, folder: Path, *, is_of_tables: bool = False, resumes: bool = False) -> None:
        check = self._check_table if is_of_tables else None
        self._recorder = LogRecorder(folder, check=check, keeps_events=True)
        self._is_of_tables, self._resumes = is_of_tables, resumes
        self._checked: Logs | None = None
        self._trajectory: TrajectoryRecorder | None = None
        self._num_begun = 0
        self._begun = Begun()
        self._unrewarded: Waiting | None = None
        self._held: bool | None = None
        if resumes:
            self._resume()

    def _resume(self) -> None:
        """Take up where the events of a trajectory in progress end, if there is one."""
        self._trajectory = self._recorder.resume()
        if self._trajectory is None:
            return
        last = [event for event in self.events if event["event"] == "stage"][-1]
        self._num_begun, self._begun = last["stage"], Begun(last["covariates"])
        self._unrewarded = Waiting(last["action"]) if self._trajectory.is_in_stage else None

    def __enter__(self) -> "RecordedTrajectories":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._recorder.close(None if self._resumes else STOPPED)

    def next_stage(self, *, is_of_cloud: bool = False) -> int:
        """Stage that the next decision begins, from 1.

        Parameters
        ----------
        is_of_cloud
            As `Begun` has it.

        Raises
        ------
        Refusal
            The stage before has no reward yet, or the trajectory goes on in another form than it began.
        """
        self._check_rewarded()
        if is_of_cloud and not self._is_of_tables:
            raise Refusal(
                409, "recording began with a policy that is not of tables; serve this one into another folder"
            )
        if self._trajectory is not None and self._begun.is_of_cloud != is_of_cloud:
            began, other = ("a cloud", "JSON") if self._begun.is_of_cloud else ("JSON", "a cloud")
            raise Refusal(409, f"{self._where}: it came as {began}, and now {other}; give one form from end to end")
        return self._num_begun + 1

    def _check_rewarded(self) -> None:
        if self._unrewarded is not None:
            remedy = "POST it to /reward, or the trajectory's end to /end"
            raise Refusal(409, f"{self._where}: it has no reward yet; {remedy}")

    @property
    def so_far(self) -> SoFar | None:
        """The trajectory of tables in progress; None where none is."""
        if self._trajectory is None or self._checked is None or self._begun.objects is None:
            return None
        return SoFar(self._checked, self._begun.objects, self._held)

    @property
    def columns(self) -> Mapping[str, Any]:
        """Of the trajectory in progress; none where none is."""
        return {} if self._trajectory is None or not self.events else self.events[0]["columns"]

    @property
    def last(self) -> Mapping[str, Any] | None:
        """Covariates of the last stage of the trajectory in progress; None where none is."""
        return None if self._trajectory is None else self._begun.covariates

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Of the trajectory that began last."""
        last = self._recorder.trajectory
        return () if last is None else last.events

    @property
    def facts(self) -> Progress:
        """Where it stands, for a client that has forgotten it."""
        name, waits = self._trajectory and self._trajectory.name, self._unrewarded
        action = () if waits is None else waits
        return Progress(name, self._num_begun, "reward" if action else "decision", *action)

    def decided(self, begun: Begun, reply: Decided) -> int | str:
        """Begin a stage with what was seen and is done, and name its trajectory.

        Parameters
        ----------
        begun
            What was seen.
        reply
            What is answered.

        Raises
        ------
        Refusal
            The stage before has no reward yet, or a value is none that this log takes.
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
                begun_trajectory.cut(STOPPED)  # nothing is written of a trajectory that has no stage yet
            if not isinstance(error, LogError):
                raise
            raise Refusal(422, f"nothing is decided, for it could not be recorded: {error}") from error
        self._begun, self._held = begun, None
        self._trajectory, self._num_begun = trajectory, self._num_begun + 1
        self._unrewarded = Waiting(reply.action, reply.object)
        return trajectory.name

    def _check_table(self, logs: Logs) -> None:
        from halfseen.world.log_checks import checked_tables

        checked_tables(logs, is_team=False)
        self._checked = logs

    def rewarded(self, reward: float, elapsed_s: float | None = None, held: bool | None = None) -> Progress:
        """Complete the stage in progress.

        Parameters
        ----------
        reward, elapsed_s
            As `TrajectoryRecorder.complete_stage` takes them.
        held
            Of a trajectory of clouds, whether the attempt held; None if nobody knows.

        Raises
        ------
        LogError, Refusal
            A value is none that a log takes; no stage is in progress.
        """
        if self._trajectory is None or self._unrewarded is None:
            raise Refusal(409, "no stage waits for a reward; POST what is seen to /decide first")
        if held is not None and not self._begun.is_of_cloud:
            raise Refusal(422, f"{self._where}: held is for clouds, and this came as JSON, which tells it itself")
        if held is not None and self._unrewarded.object is None:
            raise Refusal(422, f"{self._where}: held is {held}, but {self._unrewarded.action} tries nothing")
        self._trajectory.complete_stage(reward, elapsed_s=elapsed_s)
        self._unrewarded, self._held = None, held
        return self.facts

    def ended(self, cause: str | None, elapsed_s: float | None = None) -> Ended:
        """End the trajectory in progress.

        Parameters
        ----------
        cause
            Why it was cut; None where it came to its own end.
        elapsed_s
            As `TrajectoryRecorder.finish` takes it.

        Raises
        ------
        LogError, Refusal
            A value is none that a log takes; no trajectory is in progress, or its last stage has no reward.
        """
        if self._trajectory is None:
            raise Refusal(409, "no trajectory is in progress; POST what is seen to /decide, which begins one")
        if cause is None:
            self._check_rewarded()
            self._trajectory.finish(elapsed_s=elapsed_s)
        else:
            self._trajectory.cut(cause, elapsed_s=elapsed_s)
        ended = Ended(self._trajectory.name, self._num_begun, "finished" if cause is None else "cut")
        self._trajectory, self._checked, self._num_begun, self._unrewarded = None, None, 0, None
        return ended

    @property
    def _where(self) -> str:
        assert self._trajectory is not None, "what waits has a trajectory"
        return f"trajectory {self._trajectory.name}, stage {self._num_begun}"


def chance_of(decision: Decision, shares: Mapping[str, float], action: str) -> float:
    """Probability with which `taken` takes an action."""
    possible = {name: share for name, share in shares.items() if decision.q_values.get(name) is not None}
    rest = 1.0 - sum(possible.values()) if action == str(decision.action) else 0.0
    return rest + possible.get(action, 0.0)


class Taken(NamedTuple):
    """What is done, and how likely that was."""

    decision: Decision
    """With the action that is taken; where it was drawn, the reason says so."""
    probability: float
    """With which it is taken; above 0."""
    is_explored: bool
    """Whether another than the best was drawn."""


def uniform_shares(decision: Decision, epsilon: float) -> dict[str, float]:
    """ε/k of each action that is possible."""
    possible = [name for name, q in decision.q_values.items() if q is not None]
    return {name: epsilon / len(possible) for name in possible} if epsilon > 0.0 else {}


def taken(decision: Decision, shares: Mapping[str, float], rng: np.random.Generator) -> Taken:
    """Take the action of a decision, or one that is drawn.

    Parameters
    ----------
    decision
        What the policy decides, with the Q of each possible action.
    shares
        Probability with which each action is drawn; of impossible ones it is left to the decision.
    rng
        What is drawn with; it is left alone where nothing can be drawn.

    Examples
    --------
    >>> best = Decision("A", {"A": 1.0, "B": 0.5, "C": None}, "A: worth 0.50 more than B.")
    >>> taken(best, {}, np.random.default_rng(0)).probability
    1.0
    >>> shares = uniform_shares(best, 0.5)
    >>> drawn = [taken(best, shares, np.random.default_rng(seed)) for seed in range(99)]
    >>> sorted({(one.decision.action, one.probability) for one in drawn})
    [('A', 0.75), ('B', 0.25)]
    """
    possible = {name: share for name, share in shares.items() if decision.q_values.get(name) is not None}
    if not possible:
        return Taken(decision, 1.0, False)
    best, luck = str(decision.action), rng.random()
    reached = np.cumsum(list(possible.values()))
    drawn = [*possible, best][int(np.searchsorted(reached, luck, side="right"))]
    if drawn == best:
        return Taken(decision, 1.0 - float(reached[-1]) + possible.get(best, 0.0), False)
    reason = f"{drawn}: by chance, to explore; left to itself the policy takes {decision.reason}"
    return Taken(replace(decision, action=type(decision.action)(drawn), reason=reason), possible[drawn], True)
