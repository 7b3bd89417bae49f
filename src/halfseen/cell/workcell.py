"""A working cell: robots look, fetch the objects that they see, and put them back or into the rack.

With several robots, a look excludes objects that an arm partly hides. An object out of view is fetched from its last
sighting.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import islice

import numpy as np

from halfseen.arrays import Image, Transform
from halfseen.cell import fetching
from halfseen.cell.camera import CellCamera, PoseErrors, perceived_whole
from halfseen.cell.fetching import GaveWayError, ObservedAttempt
from halfseen.cell.grasps import GRASPING, ranked, surroundings
from halfseen.cell.live_cell import Activity, Guard, LiveCell, Reserve, Stops
from halfseen.cell.memory import KnownObject, Memory, Sighting, Trial
from halfseen.cell.model import MountedArm, Rack, Station, cell_model
from halfseen.cell.planning import FetchPlan, OutOfReachError, plans
from halfseen.errors import PlanError, SceneError
from halfseen.perception.clouds import Cloud, Vector
from halfseen.perception.labels import Labeller, StainCounter
from halfseen.perception.range_image import range_image
from halfseen.perception.view import SeenObject, View
from halfseen.scene.cups import Surface
from halfseen.scene.poses import Pose, from_matrix
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, Table
from halfseen.shapes import Bool

SETTLE_S = 0.3
MOST_TAKEN = 4  # plans blocked by another robot that are tried before waiting for the best of them


class Workcell:
    """One table with one or several robots.

    Parameters
    ----------
    table
        The cups, their initial poses, and the camera.
    rng
        Draws the sensor's noise, the camera's pose error, the start angles of plans, and when the camera is lost.
    surfaces
        Stains on the walls of each cup; None if colour gives no labels.
    stations
        The robots, each with its own rack.
    frictions
        Friction of each cup on the pads [-]; None for the default.
    grasping
        How candidate grasps are generated: a key of `GRASPING`.
    labeller
        Labels objects as dirty or clean.
    errors
        Error of the camera pose that the robot assumes.
    stops
        Conditions that stop the cell; None for none.

    Raises
    ------
    SceneError
        A cup is not on the table.

    Attributes
    ----------
    memory
        What the robot knows.
    view, cloud
        Perceived view and point cloud of the last look; None before the first.
    planned
        Plan of each robot's last attempt; None if there was no plan or no attempt.
    in_hand
        Objects on which hands have closed, by robot number.
    cell, table, surfaces
        The running cell and its ground truth, which no decision may use.
    """

    def __init__(
        self,
        table: Table,
        rng: np.random.Generator,
        surfaces: Sequence[Surface] | None = None,
        *,
        stations: Sequence[Station] = (Station(),),
        frictions: Sequence[float] | None = None,
        grasping: str = "completed",
        labeller: Labeller = StainCounter(),  # noqa: B008 - frozen
        errors: PoseErrors = PoseErrors(),  # noqa: B008 - frozen
        stops: Stops | None = None,
    ) -> None:
        if not table.is_over_top.all():
            index = int(np.argmin(table.is_over_top))
            raise SceneError(
                f"{table.name}: the middle of cup {index} is at {table.centroid_m[index].round(2).tolist()} m, "
                f"off the table, whose top is {TABLE_TOP_M} m high and {TABLE_SIZE_M} m wide about the origin; "
                "move it onto the table"
            )
        self.stations = tuple(stations)
        robots, racks = [each.robot for each in self.stations], [each.rack for each in self.stations]
        model = cell_model(table.cups, table.world_from_cup, robots, racks, frictions=frictions)
        self.table, self.surfaces = table, surfaces
        self.memory, self.in_hand = Memory(), dict[int, KnownObject]()
        self.view: View | None = None
        self.cloud: Cloud | None = None
        self.planned: list[FetchPlan | None] = [None] * len(robots)
        self.cell = LiveCell(model, robots)
        self._rng, self._grasping, self._labeller = rng, GRASPING[grasping], labeller
        self._eye = CellCamera(self.cell, table.camera, surfaces=surfaces)
        self._believed: Pose = from_matrix(errors.draw(rng) @ table.camera.world_from_camera.matrix)
        self._used_slots: list[list[int]] = [[] for _ in robots]
        self.cell.wait(SETTLE_S)
        self._guard = None if stops is None else Guard(stops, self.cell.time_s, rng)
        if self._guard is not None:
            self.cell.watches.append(self._guard)

    @property
    def robot(self) -> MountedArm:
        """The first robot."""
        return self.stations[0].robot

    @property
    def rack(self) -> Rack:
        """The first robot's rack."""
        return self.stations[0].rack

    @property
    def world_from_table(self) -> Transform:
        """Transform of homogeneous points from the perceived table to the world that the robot assumes [m]."""
        assert self.view is not None, "look first"
        return self._believed.matrix @ self.view.cloud_from_table

    def look(self) -> View:
        """Look at the table and update the memory."""
        look = self._eye.look(self._rng)
        return self._take_in(look.cloud, look.robots_m)

    def lift(self, number: int) -> ObservedAttempt:
        """Attempt to lift an object, turn it in front of the camera, and put it back where it was.

        Parameters
        ----------
        number
            Number of the object in `memory`.

        Raises
        ------
        StoppedError
            Something stopped the cell.
        """
        return self.cell.carry_out(self.robot, self.lifting(number))

    def wash(self, number: int) -> ObservedAttempt:
        """Attempt to put an object into the rack; parameter and errors as for `lift`."""
        return self.cell.carry_out(self.robot, self.washing(number))

    def lifting(self, number: int, arm: int = 0) -> Activity[ObservedAttempt]:
        """Do what `lift` does, command by command, with robot number `arm`."""
        known, robot = self.memory.objects[number], self.stations[arm].robot
        sight = self._sight(number)
        attempt, done = yield from self._fetched(number, arm)
        if done is not None and sight is not None and attempt.is_held:
            labels: list[bool | None] = []

            def look_at(side: int) -> None:
                # The arm may have to give way first. An object that showed no side does not count as lifted.
                known.lifts += side == 0
                labels.append(self._label_of_held(known, sight.seen, arm, is_first=side == 0))

            has_way = not (yield from fetching.turned(self.cell, robot, done, self._rng, look_at))
            if any(label is not None for label in labels):
                known.label(0.0, any(labels), is_held=True)
            yield from self._put_back(arm, done, has_way=has_way)
        return attempt

    def washing(self, number: int, arm: int = 0) -> Activity[ObservedAttempt]:
        """Do what `wash` does, command by command, with robot number `arm`."""
        known = self.memory.objects[number]
        attempt, done = yield from self._fetched(number, arm)
        if done is None or not attempt.is_held:
            return attempt
        try:
            slot = yield from self._put_away(arm, done, known.middle_m)
        except GaveWayError as error:
            yield from self._put_back(arm, done, has_way=True)
            return replace(attempt, is_held=False, reason=str(error))
        except PlanError as error:
            yield from self._put_back(arm, done, has_way=False)
            known.trials[-1] = known.trials[-1]._replace(is_held=False)
            return replace(attempt, is_held=False, reason=str(error))
        known.is_racked, known.seen = True, None
        self.in_hand.pop(arm)
        self._used_slots[arm].append(slot)
        return attempt

    def _put_away(self, arm: int, done: FetchPlan, middle_m: Vector) -> Activity[int]:
        """Put the held object into a free slot of the robot's rack and return the slot."""
        robot, rack = self.stations[arm].robot, self.stations[arm].rack
        used, slots_m = self._used_slots[arm], rack.slots_m
        free = [slot for slot in range(len(slots_m)) if slot not in used] or [len(used) % len(slots_m)]
        # A single robot tries only the next free slot.
        choice = free if len(self.stations) > 1 else free[:1]
        for slot in choice:
            try:
                yield from fetching.put_away(self.cell, robot, done, middle_m, slots_m[slot], self._rng)
            except GaveWayError:
                raise
            except PlanError:
                if slot == choice[-1]:
                    raise
            else:
                return slot
        raise AssertionError("the last slot is taken or refused")

    def _put_back(self, arm: int, done: FetchPlan, *, has_way: bool) -> Activity[None]:
        """Put the held object back; `has_way` is true if the way back is already reserved."""
        robot = self.stations[arm].robot
        if not has_way:
            way = fetching.with_home(self.cell, robot, done.way_back)
            yield Reserve(way, way, below_m=done.below_m)
        yield from fetching.put_down(done)
        # The object is on the table from now on. Otherwise a look would take it for another object.
        self.in_hand.pop(arm)
        yield from fetching.draw_back(self.cell, robot, done)

    def _take_in(self, cloud: Cloud, robots_m: Image) -> View:
        is_held = np.zeros(len(cloud.points_m), dtype=bool)
        for arm in self.in_hand:
            is_held |= self._is_in_hand(cloud, arm)
        in_hand = tuple(self.in_hand.values())
        self.view, self.cloud = perceived_whole(cloud, robots_m, is_held)
        self.memory.update(self.view, self.world_from_table, in_hand)
        if self.cloud.colours is not None:
            for seen, label in zip(self.view.objects, self._labeller(self.view, self.cloud), strict=True):
                number = self.memory.number_of(seen.id)
                if number is not None and label.is_dirty is not None:
                    known = self.memory.objects[number]
                    known.label(self.memory.occlusion(number, in_hand), label.is_dirty, is_held=False)
        return self.view

    def _is_in_hand(self, cloud: Cloud, arm: int) -> Bool[np.ndarray, " n"]:
        """Mask of the cloud points that belong to the object in an arm's hand."""
        plan, robot = self.planned[arm], self.stations[arm].robot
        assert plan is not None, "it was fetched"
        hand = self.cell.kinematics[robot.name].hand(self.cell.angles_rad(robot))
        return fetching.is_in_hand(self._believed.apply(cloud.points_m), hand, plan)

    def _label_of_held(self, known: KnownObject, before: SeenObject, arm: int, *, is_first: bool) -> bool | None:
        """Label one side of a held object; at the first side, also take in what the object had hidden."""
        look = self._eye.look(self._rng)
        cloud = look.cloud
        is_held = self._is_in_hand(cloud, arm)
        if is_first:
            self._take_in(cloud, look.robots_m)
        if cloud.colours is None or not is_held.any():
            return None
        assert self.view is not None, "what is held was seen"
        held = replace(before, pixels=np.flatnonzero(is_held), occlusion=0.0)
        (label,) = self._labeller(replace(self.view, image=range_image(cloud), objects=(held,)), cloud)
        return label.is_dirty

    def _fetched(self, number: int, arm: int) -> Activity[tuple[ObservedAttempt, FetchPlan | None]]:
        """Try to fetch an object; if the grasp fails, the hand opens and returns home."""
        occlusion, robot = self.memory.occlusion(number), self.stations[arm].robot
        known, self.planned[arm] = self.memory.objects[number], None
        try:
            planned = self.planned[arm] = yield from self._free_plan(number, arm)
        except PlanError as error:
            is_too_far = isinstance(error, OutOfReachError)
            # If another robot may reach the object, this failure is no evidence about it.
            if not (is_too_far and len(self.stations) > 1):
                known.trials.append(Trial(occlusion, False, 0.0, arm))
            return ObservedAttempt(False, 0.0, None, str(error), is_too_far=is_too_far), None
        if planned is None:
            return ObservedAttempt(False, 0.0, None, "another arm was in the way of every grasp"), None
        begin_s = self.cell.time_s
        with self._guard.timing(begin_s) if self._guard else nullcontext():
            yield from fetching.come(planned)
            self.in_hand[arm] = known
            yield from fetching.pick_up(planned)
        is_held, duration_s = fetching.feels(self.cell, robot, planned.grasp), self.cell.time_s - begin_s
        known.trials.append(Trial(occlusion, is_held, duration_s, arm))
        if not is_held:
            known.failed.append(planned.grasp)
            self.in_hand.pop(arm)
            way = fetching.with_home(self.cell, robot, planned.way_out)
            yield Reserve(way, way)
            yield from fetching.open_hand(planned)
            yield from fetching.draw_back(self.cell, robot, planned)
        reason = "" if is_held else "the hand closed on nothing, or lost the object"
        return ObservedAttempt(is_held, duration_s, planned.grasp.kind, reason), planned

    def _free_plan(self, number: int, arm: int) -> Activity[FetchPlan | None]:
        """The best plan not blocked by another robot; if all are blocked, the best plan once its way is free."""
        first: FetchPlan | None = None
        for found in islice(self._plans(number, arm), MOST_TAKEN):
            first = first or found
            if (yield Reserve(found.way_in, is_patient=False, below_m=found.below_m)):
                return found
        assert first is not None, "there is a plan, or an error"
        return first if (yield Reserve(first.way_in, below_m=first.below_m)) else None

    def _plans(self, number: int, arm: int) -> Iterator[FetchPlan]:
        sight = self._sight(number)
        if sight is None:
            raise PlanError("the object is not in view; look again, or clear what stands in front of it")
        robot = self.stations[arm].robot
        around, gripper = surroundings(sight.view, sight.seen), robot.gripper
        failed = self.memory.objects[number].failed
        grasps = ranked(self._grasping(sight.seen, around.own_m, gripper), around, gripper, failed)
        begin_rad = self.cell.angles_rad(robot)
        return plans(grasps, sight.world_from_table, self.cell.kinematics[robot.name], begin_rad, self._rng)

    def _sight(self, number: int) -> Sighting | None:
        """The last sighting of an object; a single robot uses only sightings from the latest look."""
        known = self.memory.objects[number]
        return known.sighting if known.seen is not None or len(self.stations) > 1 else None
