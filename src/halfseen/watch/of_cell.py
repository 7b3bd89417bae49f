"""A table in the physical cell, stage by stage as it is cleared."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from halfseen.cell.episode import Moment
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.planning import Plan
from halfseen.cell.rewards import Run
from halfseen.cell.workcell import Workcell
from halfseen.policies.table_decider import TableDecider
from halfseen.tables.explain import Grounds, table_grounds
from halfseen.tables.present import Present
from halfseen.watch.cell_parts import CellParts
from halfseen.watch.of_cloud import options_of
from halfseen.watch.seen_objects import Known, coloured_points, eye_over_table, shown_objects
from halfseen.watch.shapes import moved
from halfseen.watch.stage_view import Hand, Option, Part, StageView, Watched
from halfseen.world import random
from halfseen.world.actions import ActionSpace
from halfseen.world.policy import ExploringPolicy, Policy

MOST_STAGES = 100
"""So many are kept of a long run: each holds its cloud."""
_BETWEEN_MOMENTS_S = 0.4


class CellWatch:
    """Follows a table: give `decided` to `halfseen.cell.play`, and call `ended` with what it gives back.

    It looks and changes nothing: a table that is watched goes as one that is not. It is a
    `halfseen.cell.live_cell.Watch`, and adds itself to the cell.

    Parameters
    ----------
    cell
        The cell, before its first look.
    policy
        Who decides.
    horizon
        T of it [stages].
    name
        Of the table.
    on_change
        Called whenever there is a new stage, or more is known of the last.

    Attributes
    ----------
    stages
        So far.
    parts
        Bodies of the cell.
    """

    def __init__(
        self,
        cell: Workcell,
        policy: Policy,
        horizon: int,
        name: str,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self._cell, self._policy, self._horizon, self._name = cell, policy, horizon, name
        self._on_change, self._bodies = on_change, CellParts(cell.cell)
        self._poses: list[Any] = []
        self._arm = 0
        self._next_s = np.inf
        self._old_plan: Plan | None = None
        self._events: list[str] = []
        self._num_trials: dict[int, int] = {}
        self._num_glances: dict[int, int] = {}
        self.stages: list[StageView] = []
        self.parts: tuple[Part, ...] = self._bodies.parts
        cell.cell.watches.append(self)

    def __call__(self, live: LiveCell) -> None:
        """Keep where the arm is, if it is time."""
        if live.time_s >= self._next_s:
            self._poses.append(self._bodies.poses(live))
            self._next_s = live.time_s + _BETWEEN_MOMENTS_S

    def decided(self, moment: Moment) -> None:
        """Begin a stage."""
        self._complete()
        self._tell_what_was_learned()
        self.stages.append(self._begun(moment))
        self._poses, self._next_s = [self._bodies.poses(self._cell.cell)], self._cell.cell.time_s + _BETWEEN_MOMENTS_S
        self._arm, self._old_plan = moment.arm, self._cell.planned[moment.arm]
        self._complete()
        self._on_change()

    def ended(self, run: Run) -> None:
        """Tell what came of it."""
        self._tell_what_was_learned()
        is_cut = run.cause is not None
        self._events.append(f"cut: {run.cause}" if is_cut else "the table came to its own end")
        self._events.append(
            f"{run.num_washed} of {run.num_dirty} dirty cups washed in {run.seconds:.0f} s, reward {run.reward:+.1f}"
        )
        self._complete()
        if self.stages:
            self.stages[-1] = replace(self.stages[-1], events=tuple(self._events))
        self._next_s = np.inf
        self._on_change()

    def _complete(self) -> None:
        """Add to the last stage what came after its decision."""
        if self.stages and self._poses:
            planned = self._cell.planned[self._arm]
            if planned is self._old_plan:
                planned = None
            hand = None if planned is None else _hand(self._cell, self._arm, planned)
            self.stages[-1] = replace(self.stages[-1], poses=np.stack(self._poses), hand=hand)

    def _begun(self, moment: Moment) -> StageView:
        cell, view, cloud = self._cell, self._cell.view, self._cell.cloud
        assert view is not None, "what is decided on was looked at"
        assert cloud is not None, "and so there is its cloud"
        world_from_table = cell.world_from_table
        table_from_world = np.linalg.inv(world_from_table)
        chances = 1.0 / (1.0 + np.exp(-np.asarray(moment.state.log_odds, dtype=np.float64)))
        there = [number for number, known in enumerate(cell.memory.objects) if not known.is_gone]
        known = [
            Known(
                number,
                float(chances[number]),
                cell.memory.occlusion(number),
                moved(each.middle_m[None], table_from_world)[0],
                None if each.seen is None else each.seen.solid,
            )
            for number, each in enumerate(cell.memory.objects)
            if number in there
        ]
        eye_m = eye_over_table(view, cloud)
        points_m, colours = coloured_points(cloud, world_from_table @ np.linalg.inv(view.cloud_from_table))
        options, reason = ((), moment.words) if moment.of_team else explained(cast(Policy, self._policy), moment)
        return StageView(
            f"{self._name}, stage {moment.stage} of {self._horizon}",
            points_m,
            colours,
            moved(eye_m[None], world_from_table)[0],
            shown_objects(known, eye_m, world_from_table),
            cell.memory.hides[np.ix_(there, there)],
            options,
            moment.of_team or ActionSpace(moment.state.num_objects).names[moment.action],
            reason,
            cell.memory.doubts,
            tuple(self._events),
        )

    def _tell_what_was_learned(self) -> None:
        """Tell of attempts, objects and labels that are new since it was asked last."""
        new, looks = [], {"dirty": [], "clean": []}
        for number, known in enumerate(self._cell.memory.objects):
            for trial in known.trials[self._num_trials.get(number, 0) :]:
                held = "held" if trial.is_held else "did not hold"
                self._events.append(f"tried: a grasp of {number}, which {held} after {trial.duration_s:.1f} s")
            if number not in self._num_trials:
                new.append(number)
            for glance in known.glances[self._num_glances.get(number, 0) :]:
                looks["dirty" if glance.says_dirty else "clean"].append(number)
            self._num_trials[number], self._num_glances[number] = len(known.trials), len(known.glances)
        told = [f"new: {_listed(new)}"] if new else []
        told += [
            f"{_listed(numbers)} look{'s' if len(numbers) == 1 else ''} {word}"
            for word, numbers in looks.items()
            if numbers
        ]
        if told:
            self._events.append(f"seen: {'; '.join(told)}")


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


class TablesWatch:
    """Follows tables, one after another.

    Parameters
    ----------
    policy, horizon
        As for `CellWatch`.
    on_change
        Called with what there is to show whenever it changes.

    Attributes
    ----------
    watched
        The last `MOST_STAGES` stages; None before the first.
    """

    def __init__(self, policy: Policy, horizon: int, on_change: Callable[[Watched], None] = lambda _: None) -> None:
        self._policy, self._horizon, self.on_change = policy, horizon, on_change
        self._before: tuple[StageView, ...] = ()
        self.watched: Watched | None = None

    def follow(self, index: int, cell: Workcell) -> CellWatch:
        """Follow the next table.

        Parameters
        ----------
        index
            Its number.
        cell
            Its cell, before anything happens.
        """
        self._before = () if self.watched is None else self.watched.stages

        def changed() -> None:
            stages = (*self._before, *watch.stages)[-MOST_STAGES:]
            if stages:
                self.watched = Watched("the physical cell", stages, watch.parts)
                self.on_change(self.watched)

        watch = CellWatch(cell, self._policy, self._horizon, f"table {index}", changed)
        return watch


def explained(policy: Policy, moment: Moment) -> tuple[tuple[Option, ...], str]:
    """Say what a policy valued when it decided, and why it did.

    Parameters
    ----------
    policy
        Who decided.
    moment
        What, and from what.

    Returns
    -------
    tuple
        Its options, best first, none where it values nothing; and the reason in one sentence.
    """
    state, name = moment.state, ActionSpace(moment.state.num_objects).names[moment.action]
    if isinstance(policy, ExploringPolicy):
        base_key, _, _ = random.split(moment.key, 3)
        options, reason = explained(policy.base, moment._replace(key=base_key))
        usual = int(policy.base.decide(state, base_key).action)
        grounds = table_grounds(Grounds.of(state), moment.action)
        return options, reason if usual == moment.action else f"{name}: by chance, to explore; {grounds}."
    decision = TableDecider(policy).decide_with(Present(state, moment.stage), moment.key)
    options = options_of(decision.q_values, decision.intervals, decision.chance_best)
    is_same = decision.action == name
    return options, decision.reason if is_same else f"{name}: {table_grounds(Grounds.of(state), moment.action)}."


def _hand(cell: Workcell, arm: int, planned: Plan) -> Hand:
    kinematics = cell.cell.kinematics[cell.stations[arm].robot.name]
    angles = np.concatenate([planned.hover, planned.approach, planned.lift])
    way_m = np.array([kinematics.hand(each).position_m for each in angles], dtype=np.float64)
    at_m, axes = np.asarray(planned.held.position_m, dtype=np.float64), planned.held.rotation
    return Hand(way_m, at_m, axes, float(planned.grasp.opening_m))
