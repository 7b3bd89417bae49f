"""A cell at work: a robot looks, fetches what it sees, and puts it back or into the rack."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from halfseen.cell.clearance import ranked, surroundings
from halfseen.cell.commands import Activity
from halfseen.cell.fetching import feels, fetch, let_go, put_back
from halfseen.cell.grasps import GRASPING
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.looking import Eye
from halfseen.cell.memory import Known, Memory, Trial
from halfseen.cell.model import Rack, Robot, cell_model
from halfseen.cell.planning import Plan, plan
from halfseen.cell.racking import put_away
from halfseen.cell.showing import is_in_hand, turned
from halfseen.cell.stops import Guard, Stops
from halfseen.errors import PlanError, SceneError
from halfseen.perception.clouds import Cloud
from halfseen.perception.labels import Labeller, StainCounter
from halfseen.perception.range_image import range_image
from halfseen.perception.view import SeenObject, View, perceive
from halfseen.scene.poses import Pose, from_matrix
from halfseen.scene.stains import Surface
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, Table

SETTLE_S = 0.3


@dataclass(frozen=True)
class Attempt:
    """How an attempt went, as the robot tells it.

    Parameters
    ----------
    is_held
        Whether the hand held something when it was lifted.
    duration_s
        From the decision until that was known [s].
    kind
        Of the grasp; None where there was none to try.
    reason
        Why it did not hold; empty where it did.
    """

    is_held: bool
    duration_s: float
    kind: str | None
    reason: str = ""


@dataclass(frozen=True)
class Errors:
    """How far the robot's idea of where its camera is may err.

    Parameters
    ----------
    position_m
        Standard deviation along each axis [m].
    angle_rad
        Standard deviation about each axis [rad].
    """

    position_m: float = 0.004
    angle_rad: float = float(np.deg2rad(0.5))

    def draw(self, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
        """Draw an error: a small motion of the world about the middle of the table."""
        error, pivot_m = np.eye(4), np.array([0.0, 0.0, TABLE_TOP_M])
        error[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, self.angle_rad, 3)).as_matrix()
        error[:3, 3] = pivot_m - error[:3, :3] @ pivot_m + rng.normal(0.0, self.position_m, 3)
        return error


class Workcell:
    """One table, one robot.

    Parameters
    ----------
    table
        The cups, where they begin, and the camera.
    rng
        Draws the sensor's noise, the error of the camera's place, where plans begin, and when the camera is lost.
    surfaces
        What is on the walls of each cup; None where nothing is to be told by colour.
    robot, rack
        Who works, and where washed cups go.
    frictions
        Of each cup on pads [-]; None for the usual one.
    grasping
        Which grasps are thought of: a name of `GRASPING`.
    labeller
        What tells dirty from clean.
    errors
        How far the camera is from where the robot believes it.
    stops
        What stops the cell; None for nothing.

    Raises
    ------
    SceneError
        A cup is not on the table.

    Attributes
    ----------
    memory
        What the robot knows.
    view, cloud
        What the last look showed, and what the camera returned; None before the first.
    planned
        How the object of the last attempt was to be fetched; None where there was no way, or no attempt.
    cell, table, surfaces
        The running cell, and what it was made of: the truth, which no decision may look at.
    """

    def __init__(
        self,
        table: Table,
        rng: np.random.Generator,
        surfaces: Sequence[Surface] | None = None,
        *,
        robot: Robot = Robot(),  # noqa: B008 - frozen
        rack: Rack = Rack(),  # noqa: B008 - frozen
        frictions: Sequence[float] | None = None,
        grasping: str = "completed",
        labeller: Labeller = StainCounter(),  # noqa: B008 - frozen
        errors: Errors = Errors(),
        stops: Stops | None = None,
    ) -> None:
        if not table.is_over_top.all():
            index = int(np.argmin(table.is_over_top))
            raise SceneError(
                f"{table.name}: the middle of cup {index} is at {table.centroid_m[index].round(2).tolist()} m, off the "
                f"table, whose top is {TABLE_TOP_M} m high and {TABLE_SIZE_M} m wide about the origin; put it there"
            )
        model = cell_model(table.cups, table.world_from_cup, (robot,), rack, frictions=frictions)
        self.table, self.surfaces = table, surfaces
        self.robot, self.rack, self.memory = robot, rack, Memory()
        self.view: View | None = None
        self.cloud: Cloud | None = None
        self.planned: Plan | None = None
        self.cell = LiveCell(model, [robot])
        self._rng, self._grasping, self._labeller = rng, GRASPING[grasping], labeller
        self._eye = Eye(self.cell, table.camera, surfaces=surfaces)
        self._believed: Pose = from_matrix(errors.draw(rng) @ table.camera.world_from_camera.matrix)
        self._num_racked = 0
        self.cell.wait(SETTLE_S)
        self._guard = None if stops is None else Guard(stops, self.cell.time_s, rng)
        if self._guard is not None:
            self.cell.watches.append(self._guard)

    @property
    def world_from_table(self) -> Float[np.ndarray, "4 4"]:
        """Takes homogeneous points of the table, as seen, to where the robot believes them [m]."""
        assert self.view is not None, "look first"
        return self._believed.matrix @ self.view.cloud_from_table

    def look(self) -> View:
        """Look at the table, and remember what is seen."""
        return self._take_in(self._eye.look(self._rng).cloud)

    def lift(self, number: int) -> Attempt:
        """Attempt to lift an object; it is turned before the camera and put back where it was.

        Parameters
        ----------
        number
            Of the object, as in `memory`.

        Raises
        ------
        StoppedError
            Something stopped the cell.
        """
        return self.cell.carry_out(self.robot, self.lifting(number))

    def wash(self, number: int) -> Attempt:
        """Attempt to put an object into the rack; its number, and what stops it, are as for `lift`."""
        return self.cell.carry_out(self.robot, self.washing(number))

    def lifting(self, number: int) -> Activity[Attempt]:
        """Do what `lift` does, command by command."""
        known = self.memory.objects[number]
        before, (attempt, done) = known.seen, (yield from self._fetched(number))
        if done is not None and before is not None and attempt.is_held:
            known.lifts += 1
            told: list[bool | None] = []

            def look_at(side: int) -> None:
                told.append(self._label_of_held(known, before, done, is_first=side == 0))

            yield from turned(self.cell, self.robot, done, self._rng, look_at)
            if any(label is not None for label in told):
                known.label(0.0, any(told), is_held=True)
            yield from put_back(self.cell, self.robot, done)
        return attempt

    def washing(self, number: int) -> Activity[Attempt]:
        """Do what `wash` does, command by command."""
        known = self.memory.objects[number]
        attempt, done = yield from self._fetched(number)
        if done is None or not attempt.is_held:
            return attempt
        slot_m = self.rack.slots_m[self._num_racked % len(self.rack.slots_m)]
        try:
            yield from put_away(self.cell, self.robot, done, known.middle_m, slot_m, self._rng)
        except PlanError as error:
            yield from put_back(self.cell, self.robot, done)
            known.trials[-1] = known.trials[-1]._replace(is_held=False)
            return replace(attempt, is_held=False, reason=str(error))
        known.is_racked, known.seen = True, None
        self._num_racked += 1
        return attempt

    def _take_in(self, cloud: Cloud, in_hand: Known | None = None) -> View:
        self.view, self.cloud = perceive(cloud), cloud
        self.memory.update(self.view, self.world_from_table, in_hand)
        if cloud.colours is not None:
            for seen, label in zip(self.view.objects, self._labeller(self.view, cloud), strict=True):
                number = self.memory.number_of(seen.id)
                if number is not None and label.is_dirty is not None:
                    known = self.memory.objects[number]
                    known.label(self.memory.occlusion(number), label.is_dirty, is_held=False)
        return self.view

    def _label_of_held(self, known: Known, before: SeenObject, done: Plan, *, is_first: bool) -> bool | None:
        """What one side of what is held looks like; at the first side, see what it hid, too."""
        cloud = self._eye.look(self._rng).cloud
        hand = self.cell.kinematics[self.robot.name].hand(self.cell.angles_rad(self.robot))
        is_held = is_in_hand(self._believed.apply(cloud.points_m), hand, done)
        if is_first:
            self._take_in(replace(cloud, points_m=np.where(is_held[:, None], np.nan, cloud.points_m)), known)
        if cloud.colours is None or not is_held.any():
            return None
        assert self.view is not None, "what is held was seen"
        held = replace(before, pixels=np.flatnonzero(is_held), occlusion=0.0)
        (label,) = self._labeller(replace(self.view, image=range_image(cloud), objects=(held,)), cloud)
        return label.is_dirty

    def _fetched(self, number: int) -> Activity[tuple[Attempt, Plan | None]]:
        """Try to fetch an object; the hand is home again, and open, where it holds nothing."""
        begin_s, occlusion = self.cell.time_s, self.memory.occlusion(number)
        known, self.planned = self.memory.objects[number], None
        try:
            planned = self.planned = self._planned(known)
        except PlanError as error:
            known.trials.append(Trial(occlusion, False, 0.0))
            return Attempt(False, 0.0, None, str(error)), None
        with self._guard.timing(begin_s) if self._guard else nullcontext():
            yield from fetch(planned)
        is_held, duration_s = feels(self.cell, self.robot, planned.grasp), self.cell.time_s - begin_s
        known.trials.append(Trial(occlusion, is_held, duration_s))
        if not is_held:
            known.failed.append(planned.grasp)
            yield from let_go(self.cell, self.robot, planned)
        reason = "" if is_held else "the hand closed on nothing, or lost it"
        return Attempt(is_held, duration_s, planned.grasp.kind, reason), planned

    def _planned(self, known: Known) -> Plan:
        if self.view is None or known.seen is None:
            raise PlanError("the object is not in view; look again, or clear what stands before it")
        around, gripper = surroundings(self.view, known.seen), self.robot.gripper
        grasps = ranked(self._grasping(known.seen, around.own_m, gripper), around, gripper, known.failed)
        kinematics = self.cell.kinematics[self.robot.name]
        return plan(grasps, self.world_from_table, kinematics, self.cell.angles_rad(self.robot), self._rng)
