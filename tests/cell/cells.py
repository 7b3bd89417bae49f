"""Cells to test with: one arm or two, cups where they are put, and the camera before the table."""

import numpy as np

from halfseen.cell import LiveCell, MountedArm, cell_model
from halfseen.cell.grasps import hand_axes
from halfseen.cell.model import PAIR
from halfseen.cell.workcell import Workcell
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M, Camera, Table, look_at
from halfseen.scene.xtion import xtion_at

ROBOT = MountedArm()
HOME = np.array(ROBOT.home_rad)
ROBOTS = LEFT, RIGHT = [station.robot for station in PAIR]
HOMES = [np.array(robot.home_rad) for robot in ROBOTS]
FULL_CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
_FOCAL_PX = (FULL_CAMERA.focal_px[0] / 2, FULL_CAMERA.focal_px[1] / 2)
CAMERA = Camera(FULL_CAMERA.world_from_camera, _FOCAL_PX, (159.5, 119.5), 240, 320)
"""Of half the rows and columns: looks take a quarter of their time."""
WORLD_FROM_TABLE = Pose((0.0, 0.0, TABLE_TOP_M)).matrix
DOWN = (0.0, 1.0, 0.0, 0.0)
DOWN_AXES = hand_axes(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
CUP, SLIM = Cup(0.1, 0.04, 0.035), Cup(0.10, 0.036, 0.032)
MUG = Cup(0.09, 0.042, 0.04, handle_m=0.03)
TWO_CUPS = (Cup(0.10, 0.040, 0.034), Cup(0.09, 0.042, 0.036))
TWO_POSES = (Pose((0.0, -0.02, TABLE_TOP_M)), Pose((0.02, 0.10, TABLE_TOP_M)))
"""The first of two cups hides a part of the second."""


def standing(*places_m):
    """Poses of cups that stand at places (x, y) on the table."""
    return tuple(Pose((x_m, y_m, TABLE_TOP_M)) for x_m, y_m in places_m)


def one_arm_cell(seed=0, cups=TWO_CUPS, poses=TWO_POSES, camera=CAMERA, **options):
    return Workcell(Table(tuple(cups), tuple(poses), camera), np.random.default_rng(seed), **options)


def two_arm_cell(*places_m, seed=0, **options):
    return one_arm_cell(seed, [SLIM] * len(places_m), standing(*places_m), stations=PAIR, **options)


def live_pair(racks=True):
    """Two arms and no cup."""
    return LiveCell(cell_model([], [], ROBOTS, [station.rack for station in PAIR] if racks else []), ROBOTS)


def over(kinematics, home_rad, place_m):
    """Angles with the hand at a place, pointing down."""
    begins = [home_rad, *np.random.default_rng(0).uniform(*kinematics.search_rad.T, size=(20, 6))]
    found = kinematics.solve_from(Pose(tuple(place_m), DOWN), begins, home_rad)
    assert found is not None
    return found
