"""The cell in physics: it rests, the gripper opens and closes evenly, and what is gripped is held."""

import mujoco
import numpy as np
import pytest

from halfseen.cell.gripper import Gripper
from halfseen.cell.kinematics import Kinematics
from halfseen.cell.model import Rack, Robot, cell_model
from halfseen.errors import SceneError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.rays import UNSEEN_GROUP
from halfseen.scene.room import room_model
from halfseen.scene.table import TABLE_TOP_M

CUP = Cup(0.1, 0.04, 0.035)
MUG = Cup(0.09, 0.042, 0.04, handle_m=0.03)
ROBOT = Robot()
RAISED = np.array([0.0, 3.0, 1.2, 0.0, 0.0, 0.0])


def at_rest(model, angles=RAISED):
    data = mujoco.MjData(model)
    for name, angle in zip(ROBOT.joint_names, angles, strict=True):
        data.joint(name).qpos = data.actuator(name).ctrl = angle
    return data


def step(model, data, seconds):
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


def test_fingers_open_and_close_alike():
    model = cell_model([], [])
    data = at_rest(model)
    for wanted in (Gripper().stroke_m, 0.0):
        for name in ROBOT.slide_names:
            data.actuator(name).ctrl = 0.5 * wanted
        step(model, data, 1.0)
        left, right = (data.geom(ROBOT.of(f"gripper/pad_{side}")).xpos for side in ("left", "right"))
        assert np.linalg.norm(left - right) - Gripper().pad_thickness_m == pytest.approx(wanted, abs=1e-3)


@pytest.mark.parametrize("friction", [0.15, 0.9])
@pytest.mark.parametrize("cup", [CUP, MUG], ids=["cup", "mug"])
def test_a_cup_that_is_gripped_around_is_lifted(cup, friction):
    place = (0.05, 0.05)
    model = cell_model([cup], [Pose((*place, TABLE_TOP_M))], frictions=[friction], rack=Rack())
    kinematics, rng = Kinematics(model, ROBOT), np.random.default_rng(0)
    begins = [rng.uniform([-3, 2, 0.6, -3, -3, -3], [3, 4.3, 5, 3, 3, 3]) for _ in range(12)]
    height_m = TABLE_TOP_M + cup.height_m - 0.02
    # It closes along y, past the handle, which points along x.
    turned = Pose((*place, height_m), (0.0, 1.0, 0.0, 0.0))
    held = kinematics.solve_from(turned, begins, begins[0])
    assert held is not None
    path = [held]
    for rise_m in np.linspace(0.01, 0.15, 15):
        path.append(kinematics.solve(Pose((*place, height_m + rise_m), turned.quaternion), path[-1]))
    data = at_rest(model, held)
    for name in ROBOT.slide_names:
        data.joint(name).qpos = data.actuator(name).ctrl = 0.5 * Gripper().stroke_m
    step(model, data, 0.2)
    for name in ROBOT.slide_names:
        data.actuator(name).ctrl = 0.0
    step(model, data, 0.7)
    for angles in path:
        for name, angle in zip(ROBOT.joint_names, angles, strict=True):
            data.actuator(name).ctrl = angle
        step(model, data, 0.1)
    step(model, data, 0.5)
    assert data.body("cup_0").xpos[2] - TABLE_TOP_M == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"world_from_cup": []}, "1 cups and 0 poses; give one for every cup"),
        ({"frictions": [0.5, 0.5]}, "1 cups and 2 frictions; give one for every cup"),
        ({"robots": [Robot("one"), Robot("one")]}, "2 robots are called 'one'; give each a name of its own"),
    ],
)
def test_what_does_not_fit_together_is_refused(changed, message):
    given = {"cups": [CUP], "world_from_cup": [Pose((0.0, 0.0, TABLE_TOP_M))]}
    with pytest.raises(SceneError, match=message):
        cell_model(**(given | changed))


def test_cups_and_arm_stay_where_they_are():
    model = cell_model([CUP, MUG], [Pose((0.0, 0.0, TABLE_TOP_M)), Pose((0.2, 0.1, TABLE_TOP_M))])
    data = at_rest(model)
    step(model, data, 1.0)
    for name, place in (("cup_0", (0.0, 0.0)), ("cup_1", (0.2, 0.1))):
        np.testing.assert_allclose(data.body(name).xpos, [*place, TABLE_TOP_M], atol=2e-3)
    now = [data.joint(name).qpos[0] for name in ROBOT.joint_names]
    np.testing.assert_allclose(now, RAISED, atol=1e-4)


def test_walls_weigh_nothing_and_are_not_seen():
    bare = cell_model([MUG], [Pose((0.0, 0.0, TABLE_TOP_M))], robots=())
    walls = bare.geom_group == UNSEEN_GROUP
    assert walls.sum() == 16 + 1 + 5
    plain = room_model([MUG], [Pose((0.0, 0.0, TABLE_TOP_M))], is_free=True)
    assert bare.body("cup_0").mass == plain.body("cup_0").mass
    np.testing.assert_array_equal(bare.body("cup_0").inertia, plain.body("cup_0").inertia)
