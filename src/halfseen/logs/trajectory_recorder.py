"""Recording one trajectory: each call is checked, then written as one event of a journal."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from halfseen.errors import LogError
from halfseen.logs.checks import LARGEST, UNIT_TOLERANCE, thousandfold
from halfseen.logs.columns import CUT, FINISHED, STEPPED_BACK, shown
from halfseen.logs.journal_writer import JournalWriter
from halfseen.logs.logs import Logs
from halfseen.logs.recorded import CRASH, STILL_RUNNING, followed, tables_of
from halfseen.logs.recording_state import Schema, TrajectoryState, checked_number, checked_text

CAUSES = ("operator", "emergency-stop", "time-out", "battery", "sensor-lost", CRASH)
"""Usual causes of cuts; any other text is accepted."""

STILL_RUNNING_EVERY_S = 0.5


def log_so_far(events: Sequence[dict[str, Any]]) -> Logs:
    """Build the log of one trajectory in progress, cut at its last event.

    Raises
    ------
    LogError
        The trajectory so far violates an invariant of logs.
    """
    trajectory = followed(events)
    trajectory.end(CUT, None, STILL_RUNNING)
    return Logs(**tables_of([trajectory]))


class TrajectoryRecorder:
    """A trajectory that is being recorded, created by `LogRecorder.begin_trajectory`.

    Its clock is either read from `time.monotonic`, and each stage lasts until the next begins, or always given as
    ``elapsed_s``. With several robots the given clock may stand still: if two are free at once, the stage between
    their decisions takes no time.
    """

    def __init__(
        self,
        journal: JournalWriter,
        name: int | str,
        columns: dict[str, Any],
        schema: Schema,
        check: Callable[[Logs], object] | None,
        keeps_events: bool,
    ) -> None:
        before = journal.known.trajectory
        self.name = name
        self._journal = journal
        self._columns = columns
        self._trajectory_schema = schema
        self._check = check
        self._keeps_events = keeps_events or check is not None
        self._number = 1 if before is None else before.number + 1
        self._keep(TrajectoryState(name, self._number))

    @property
    def is_ended(self) -> bool:
        """Whether it is finished or cut."""
        return self._state.is_ended

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """Its events so far, if the recorder keeps them; else empty."""
        return self._state.events

    @property
    def is_in_stage(self) -> bool:
        """Whether a stage is in progress."""
        return self._state.is_in_stage

    @property
    def _state(self) -> TrajectoryState:
        """Its current state; it has ended once another trajectory has begun."""
        state: TrajectoryState = self._journal.known.trajectory
        return state if state.number == self._number else TrajectoryState(self.name, is_ended=True)

    def begin_stage(
        self,
        covariates: Any = None,
        objects: Any = None,
        action: Any = None,
        object: Any = None,  # noqa: A002
        probability: Any = None,
        robot: Any = None,
        stepped_back: Any = None,
    ) -> None:
        """Begin a stage with its covariates and the chosen action.

        Parameters
        ----------
        covariates
            What the policy saw, by name: numbers, text or flat lists, of Python or NumPy; the same names in every
            stage.
        objects
            A list with a dict for each object present, with its name as "object" and its covariates; None
            if stages have no objects.
        action
            The action, as a whole number or text. It may be left out only in a stage in which the trajectory is then
            cut.
        object
            The object of the action, if any.
        probability
            The probability in (0, 1] with which the policy chose the action; always or never.
        robot
            With several robots, the number of the one that decides; always or never.
        stepped_back
            Why a rule decided in the policy's place, such as "out-of-range"; None if the policy decided.

        Raises
        ------
        LogError
            A stage is in progress, or a log does not accept a value. With several robots also: two are at one
            object, or one that dropped out decides.
        """
        state = self._running()
        where = self._where(state.stage + 1)
        if state.is_in_stage:
            raise LogError(
                f"{self._where(state.stage)}: it is in progress; call complete_stage() before the next begins"
            )
        schema = self._journal.known.schema if state.stage else self._trajectory_schema
        chosen = {"robot": robot, "action": action, "object": object, "probability": probability}
        chosen |= {STEPPED_BACK: stepped_back}
        schema, seen = schema.with_stage(covariates or {}, objects, chosen, where)
        event: dict[str, Any] = {"event": "stage", "trajectory": self.name, "stage": state.stage + 1}
        if state.stage == 0:
            state = state.started()
            event |= {"at_s": 0.0, "columns": self._columns}
        elif not state.is_given:
            event["at_s"] = state.read_s()
        self._write(event | seen, state, is_news=True, schema=schema)

    def complete_stage(self, reward: Any, *, elapsed_s: Any = None, own_rewards: Any = ()) -> None:
        """Complete the stage in progress.

        Parameters
        ----------
        reward
            Reward of the stage.
        elapsed_s
            Time since the trajectory began [s]; left out to read the recorder's own clock.
        own_rewards
            Reward of each of several robots, robot 0 first, for the columns 0_reward, 1_reward and so on; for the
            same robots in every stage of the folder.

        Raises
        ------
        LogError
            No stage is in progress, a reward is not a number or beyond 1e75, a robot's reward is missing, or the clock
            does not advance; with several robots it may stand still.
        """
        state = self._running()
        where = self._where(state.stage)
        if not state.is_in_stage:
            what = "no stage has begun" if state.stage == 0 else f"stage {state.stage} is completed already"
            raise LogError(f"trajectory {shown(self.name)}: {what}; begin_stage() first")
        if not state.has_action:
            raise LogError(f"{where}: it began without an action; a stage without one can only be cut")
        earned = checked_number(reward, "reward", where, "give the finite reward that it earned")
        if abs(earned) > LARGEST:
            raise LogError(f"{where}: reward is {earned:g}; give rewards in another unit")
        shares = self._checked_shares(own_rewards, where)
        state = state.timed(elapsed_s, where, is_later=not self._journal.known.schema.has_robot)
        event = {"event": "done", "at_s": state.at_s, "reward": earned} | ({"own_rewards": shares} if shares else {})
        self._write(event | ({"is_given": True} if state.is_given else {}), state, num_shares=len(shares))

    def _checked_shares(self, own_rewards: Any, where: str) -> list[float]:
        """Rewards of the robots as numbers, for as many robots as in the stages before."""
        remedy, known = "give the finite reward that the robot brought", self._journal.known.num_shares
        if not isinstance(own_rewards, Sequence | np.ndarray) or isinstance(own_rewards, str):
            raise LogError(f"{where}: own_rewards is {own_rewards!r}; give a list with the reward of each robot")
        if known not in (None, len(own_rewards)):
            raise LogError(
                f"{where}: own_rewards has {len(own_rewards)} numbers, but the stages before it have {known}; give one "
                "for each robot, in every stage or in none"
            )
        return [checked_number(each, f"{robot}_reward", where, remedy) for robot, each in enumerate(own_rewards)]

    def drop_out(self, robot: Any, cause: Any, *, elapsed_s: Any = None) -> None:
        """Note that one of several robots dropped out alone; the trajectory goes on without it.

        Call it before the stage in which this happens is completed.

        Parameters
        ----------
        robot
            Its number.
        cause
            Why, as in `cut`.
        elapsed_s
            Time since the trajectory began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            No robot has decided so far, this one has already dropped out or does not exist, the cause is not text, or
            the clock goes back.
        """
        state = self._running()
        self._check_cause(cause)
        where = self._where(state.stage)
        if not (state.events and self._journal.known.schema.has_robot):
            raise LogError(
                f"{where}: no robot has decided yet, so none can drop out; begin_stage() with its robot first"
            )
        number = robot.item() if isinstance(robot, np.generic) else robot
        if not isinstance(number, int) or isinstance(number, bool) or number < 0:
            raise LogError(f"{where}: robot {shown(number)} is not a robot's number; give 0, 1, …")
        if any(event["event"] == "out" and event["robot"] == number for event in state.events):
            raise LogError(f"{where}: robot {number} has already dropped out, which is final")
        state = state.timed(elapsed_s, where)
        self._write({"event": "out", "at_s": state.at_s, "robot": number, "cause": cause}, state, is_news=True)

    def still_running(self, *, elapsed_s: Any = None) -> None:
        """Note that the trajectory is in progress; call it from the control loop. It writes at most twice a second.

        After a crash the trajectory is then known to have run until the last call, not only until its last stage began.
        This pays off if crashes are frequent and stages long: see `halfseen.logs.recorded`.
        """
        state = self._running()
        if state.stage == 0:
            return
        state = state.timed(elapsed_s, self._where(state.stage))
        if state.at_s >= state.noted_s + STILL_RUNNING_EVERY_S:
            self._write({"event": "running", "at_s": state.at_s}, state)
        else:
            self._keep(state)

    def finish(self, *, elapsed_s: Any = None) -> None:
        """End the trajectory because the task ended: it was finished, the table is cleared, the horizon is reached.

        Raises
        ------
        LogError
            A stage is in progress, or no stage was completed.
        """
        state = self._running()
        if state.stage == 0 or state.is_in_stage:
            what = "it has no stage" if state.stage == 0 else f"stage {state.stage} is in progress"
            raise LogError(
                f"trajectory {shown(self.name)}: {what}; complete it before finish(), or cut() the trajectory"
            )
        where = self._where(state.stage)
        end_s = state.end_s(elapsed_s, where)
        # `Logs` would suspect another unit.
        times = float(thousandfold(end_s, state.completed_s, 2 * UNIT_TOLERANCE)) if state.is_given else 0.0
        if times > 1.0:
            raise LogError(
                f"{where}: elapsed_s {end_s} is {times:.0e} times the {state.completed_s} of the completed stage, as "
                "if units were mixed; give both in seconds"
            )
        self._end({"event": FINISHED}, state, elapsed_s)

    def cut(self, cause: Any, *, elapsed_s: Any = None) -> None:
        """End the trajectory because something outside the task ended it.

        Between two stages, the cut falls into the earlier stage, since its outcome was not observed. If it was, begin
        the next stage with its covariates first. Before the first stage nothing was observed, and nothing is written.

        Parameters
        ----------
        cause
            Why: "operator", "emergency-stop", "time-out", "battery", "sensor-lost", "crash", or free text.
        elapsed_s
            Time since the trajectory began [s], as in `complete_stage`.

        Raises
        ------
        LogError
            The cause is not text, or the clock goes back.
        """
        state = self._running()
        self._check_cause(cause)
        self._end({"event": CUT, "cause": cause}, state, elapsed_s)

    def _end(self, event: dict[str, Any], state: TrajectoryState, elapsed_s: Any) -> None:
        if state.stage == 0:
            self._keep(state.after(event))
        else:
            self._write({**event, "at_s": state.end_s(elapsed_s, self._where(state.stage))}, state)

    def _keep(self, state: TrajectoryState) -> None:
        """Store a state without an event."""
        self._journal.known = replace(self._journal.known, trajectory=state)

    def _write(self, event: dict[str, Any], state: TrajectoryState, *, is_news: bool = False, **changed: Any) -> None:
        """Write an event; if the trajectory is checked as it grows, the check may first refuse an event with news."""
        state, recorded = state.after(event), replace(self._journal.known, **changed)
        if self._keeps_events or recorded.schema.has_robot:
            state = replace(state, events=(*state.events, event))
            if is_news and (self._check is not None or recorded.schema.has_robot):
                logs = log_so_far(state.events)
                if self._check is not None:
                    self._check(logs)
        self._journal.append(event, replace(recorded, trajectory=state))

    def _check_cause(self, cause: Any) -> None:
        if not isinstance(cause, str) or not cause.strip():
            raise LogError(
                f"trajectory {shown(self.name)}: cause {cause!r} is not a cause; give {', '.join(CAUSES)}, or why"
            )
        checked_text(cause, f"trajectory {shown(self.name)}", "cause")
        if cause == STILL_RUNNING:
            raise LogError(
                f"trajectory {shown(self.name)}: {cause} marks a trajectory in progress; give the cause that cut "
                "this one"
            )

    def _running(self) -> TrajectoryState:
        state = self._state
        if state.is_ended:
            raise LogError(f"trajectory {shown(self.name)}: it has ended; begin another")
        return state

    def _where(self, stage: int) -> str:
        return f"trajectory {shown(self.name)}, stage {stage}"
