"""A table in the physical cell, stage by stage as it is cleared."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot analyse.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi
from typing import Any, cast

import mujoco
import numpy as np

from halfseen.arrays import Points
from halfseen.cell.episode import Moment
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.planning import FetchPlan
from halfseen.cell.rewards import Run
from halfseen.cell.workcell import Workcell
from halfseen.policies.table_decider import TableDecider
from halfseen.scene.rays import FURNITURE_GROUP, ROBOT_GROUP
from halfseen.shapes import Float
from halfseen.tables.explain import TableExplanation, action_reason
from halfseen.tables.present import Present
from halfseen.view.shapes import convex_mesh, moved
from halfseen.view.stage_view import Hand, Option, Part, Shown, StageView, Watched
from halfseen.view.stages import coloured_points, eye_over_table, mesh_of, options_of, with_shadows
from halfseen.world import random
from halfseen.world.actions import ActionSpace
from halfseen.world.policy import ExploringPolicy, Policy

MOST_STAGES = 100  # the last stages kept of a long run: each holds its cloud
_BETWEEN_MOMENTS_S = 0.4
_NUM_AROUND, _NUM_UP = 20, 5
_ARMS, _WOOD = ((150, 158, 168), (214, 160, 96), (120, 170, 150)), (196, 170, 132)
"""Colours of the arms, used in turn, and of furniture."""
_OF_THE_ROOM_M = 1.0  # bodies that reach farther from their centre are walls or floors, which the cloud shows [m]
_KINDS = mujoco.mjtGeom


class TablesWatch:
    """Follows tables, one after another, each by a `CellWatch`.

    `watched` holds the last `MOST_STAGES` stages, None at first; `on_change` is called with it whenever it changes.
    """

    def __init__(self, policy: Policy, horizon: int) -> None:
        self._policy, self._horizon = policy, horizon
        self.on_change: Callable[[Watched], None] = lambda _: None
        self.watched: Watched | None = None

    def follow(self, index: int, cell: Workcell) -> "CellWatch":
        """Follow the table of this number; to be called before anything happens in its cell."""
        before = () if self.watched is None else self.watched.stages

        def changed() -> None:
            stages = (*before, *watch.stages)[-MOST_STAGES:]
            if stages:
                self.watched = Watched("the physical cell", stages, watch.parts)
                self.on_change(self.watched)

        watch = CellWatch(cell, self._policy, self._horizon, f"table {index}", changed)
        return watch


class CellWatch:
    """Follows a table: pass `decided` to `halfseen.cell.play`, and call `ended` with its result.

    It only observes: watching a table does not change its run. It is a `halfseen.cell.live_cell.Watch`, and adds itself
    to the cell.

    Parameters
    ----------
    cell
        The cell, before its first look.
    policy
        The policy that decides.
    horizon
        Horizon T of the policy [stages].
    name
        Name of the table.
    on_change
        Called on every new stage, and when more is known about the last one.

    Attributes
    ----------
    stages
        The stages so far.
    parts
        Bodies of the cell: of the arm, its hand, the table and the rack; not the cups.
    """

    def __init__(
        self, cell: Workcell, policy: Policy, horizon: int, name: str, on_change: Callable[[], None] = lambda: None
    ) -> None:
        self._cell, self._policy, self._horizon, self._name = cell, policy, horizon, name
        self._on_change = on_change
        self._geoms = _shown_geoms(cell.cell)
        self._poses: list[Any] = []
        self._arm = 0
        self._next_s = np.inf
        self._old_plan: FetchPlan | None = None
        self._events: list[str] = []
        self._num_known: dict[int, tuple[int, int]] = {}
        self.stages: list[StageView] = []
        self.parts = tuple(_part(cell.cell, geom) for geom in self._geoms)
        cell.cell.watches.append(self)

    def __call__(self, live: LiveCell) -> None:
        """Record the pose of the arm at regular intervals."""
        if live.time_s >= self._next_s:
            self._poses.append(_poses(live, self._geoms))
            self._next_s = live.time_s + _BETWEEN_MOMENTS_S

    def decided(self, moment: Moment) -> None:
        """Begin a stage."""
        self._complete()
        self._tell_what_was_learned()
        self.stages.append(self._begun(moment))
        live = self._cell.cell
        self._poses, self._next_s = [_poses(live, self._geoms)], live.time_s + _BETWEEN_MOMENTS_S
        self._arm, self._old_plan = moment.arm, self._cell.planned[moment.arm]
        self._complete()
        self._on_change()

    def ended(self, run: Run) -> None:
        """Add the outcome."""
        self._tell_what_was_learned()
        self._events.append("the table finished" if run.cause is None else f"cut: {run.cause}")
        self._events.append(
            f"{run.num_washed} of {run.num_dirty} dirty cups washed in {run.seconds:.0f} s, reward {run.reward:+.1f}"
        )
        self._complete()
        if self.stages:
            self.stages[-1] = replace(self.stages[-1], events=tuple(self._events))
        self._next_s = np.inf
        self._on_change()

    def _complete(self) -> None:
        """Add to the last stage what happened after its decision."""
        if self.stages and self._poses:
            planned = self._cell.planned[self._arm]
            hand = None if planned is None or planned is self._old_plan else _hand(self._cell, self._arm, planned)
            self.stages[-1] = replace(self.stages[-1], poses=np.stack(self._poses), hand=hand)

    def _begun(self, moment: Moment) -> StageView:
        cell, view, cloud = self._cell, self._cell.view, self._cell.cloud
        assert view is not None, "a decision follows a look"
        assert cloud is not None, "a look keeps its cloud"
        world_from_table, memory = cell.world_from_table, cell.memory
        table_from_world = np.linalg.inv(world_from_table)
        chances = 1.0 / (1.0 + np.exp(-np.asarray(moment.state.log_odds, dtype=np.float64)))
        there = [number for number, each in enumerate(memory.objects) if not each.is_gone]
        known = []
        for number in there:
            each = memory.objects[number]
            middle_m, solid = moved(each.middle_m[None], table_from_world)[0], each.seen and mesh_of(each.seen.solid)
            known.append(Shown(number, float(chances[number]), memory.occlusion(number), middle_m, solid))
        eye_m = eye_over_table(view, cloud)
        options, reason = ((), moment.words) if moment.of_team else explained(cast(Policy, self._policy), moment)
        return StageView(
            f"{self._name}, stage {moment.stage} of {self._horizon}",
            *coloured_points(cloud, world_from_table @ np.linalg.inv(view.cloud_from_table)),
            moved(eye_m[None], world_from_table)[0],
            with_shadows(known, eye_m, world_from_table),
            memory.hides[np.ix_(there, there)],
            options,
            moment.of_team or ActionSpace(moment.state.num_objects).names[moment.action],
            reason,
            memory.doubts,
            tuple(self._events),
        )

    def _tell_what_was_learned(self) -> None:
        """Add events for new attempts, objects and labels since the last call."""
        new, looks = [], {"dirty": [], "clean": []}
        for number, known in enumerate(self._cell.memory.objects):
            num_trials, num_glances = self._num_known.get(number, (0, 0))
            for trial in known.trials[num_trials:]:
                held = "held" if trial.is_held else "did not hold"
                self._events.append(f"tried: a grasp of {number}, which {held} after {trial.duration_s:.1f} s")
            if number not in self._num_known:
                new.append(number)
            for glance in known.glances[num_glances:]:
                looks["dirty" if glance.says_dirty else "clean"].append(number)
            self._num_known[number] = len(known.trials), len(known.glances)
        seen = [f"new: {_listed(new)}"] if new else []
        for word, numbers in looks.items():
            if numbers:
                seen.append(f"{_listed(numbers)} look{'s' if len(numbers) == 1 else ''} {word}")
        if seen:
            self._events.append(f"seen: {'; '.join(seen)}")


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def explained(policy: Policy, moment: Moment) -> tuple[tuple[Option, ...], str]:
    """Say how a policy valued its actions, and why it decided as it did.

    Returns
    -------
    tuple
        Its options, best first, none if the policy has no values; and the reason in one sentence.
    """
    state, name = moment.state, ActionSpace(moment.state.num_objects).names[moment.action]
    explanation = action_reason(TableExplanation.of(state), moment.action)
    if isinstance(policy, ExploringPolicy):
        base_key, _, _ = random.split(moment.key, 3)
        options, reason = explained(policy.base, moment._replace(key=base_key))
        usual = int(policy.base.decide(state, base_key).action)
        return options, reason if usual == moment.action else f"{name}: drawn at random, to explore; {explanation}."
    decision = TableDecider(policy).decide_with(Present(state, moment.stage), moment.key)
    options = options_of(decision)
    return options, decision.reason if decision.action == name else f"{name}: {explanation}."


def _hand(cell: Workcell, arm: int, planned: FetchPlan) -> Hand:
    kinematics = cell.cell.kinematics[cell.stations[arm].robot.name]
    angles = np.concatenate([planned.hover, planned.approach, planned.lift])
    way_m = np.array([kinematics.hand(each).position_m for each in angles], dtype=np.float64)
    at_m, axes = np.asarray(planned.held.position_m, dtype=np.float64), planned.held.rotation
    return Hand(way_m, at_m, axes, float(planned.grasp.opening_m))


def _shown_geoms(cell: LiveCell) -> list[int]:
    """Indices of the geoms that are shown: those of robots and furniture."""
    model = cell.model
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_group[geom] in (FURNITURE_GROUP, ROBOT_GROUP)
        and model.geom_type[geom] != _KINDS.mjGEOM_PLANE
        and model.geom_rbound[geom] < _OF_THE_ROOM_M
    ]


def _part(cell: LiveCell, geom: int) -> Part:
    solid, model = convex_mesh(_points(cell.model, geom)), cell.model
    if model.geom_group[geom] != ROBOT_GROUP:
        return Part(solid, _WOOD, is_robot=False)
    body = model.body(model.geom_bodyid[geom]).name
    (number,) = (k for k, name in enumerate(cell.kinematics) if body.startswith(f"{name}/"))
    return Part(solid, _ARMS[number % len(_ARMS)])


def _poses(cell: LiveCell, geoms: Sequence[int]) -> Float[np.ndarray, "parts 7"]:
    """Present poses of geoms: position [m] and quaternion (w, x, y, z)."""
    poses = np.zeros((len(geoms), 7))
    for row, geom in zip(poses, geoms, strict=True):
        row[:3] = cell.data.geom_xpos[geom]
        mujoco.mju_mat2Quat(row[3:], cell.data.geom_xmat[geom])
    return poses


def _points(model: mujoco.MjModel, geom: int) -> Points:
    """Points whose convex hull is a geom, or contains it."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _KINDS.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        return np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
    if kind == _KINDS.mjGEOM_BOX:
        return size * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    if kind == _KINDS.mjGEOM_CYLINDER:
        return np.concatenate([_ring(size[0], size[0], height_m) for height_m in (-size[1], size[1])])
    half_m = size[1] if kind == _KINDS.mjGEOM_CAPSULE else 0.0
    x_m, y_m, z_m = size if kind == _KINDS.mjGEOM_ELLIPSOID else np.full(3, size[0])
    rise = 0.5 * pi * np.linspace(-1.0, 1.0, 2 * _NUM_UP)
    rings = [
        _ring(np.cos(angle) * x_m, np.cos(angle) * y_m, np.sin(angle) * z_m + np.sign(angle) * half_m) for angle in rise
    ]
    return np.concatenate(rings)


def _ring(x_m: float, y_m: float, height_m: float) -> Points:
    angle = 2 * pi * np.arange(_NUM_AROUND) / _NUM_AROUND
    return np.stack([x_m * np.cos(angle), y_m * np.sin(angle), np.full(_NUM_AROUND, height_m)], axis=1)
