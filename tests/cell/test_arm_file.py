"""Arms from files: they move as the file alone does, leave all else behind, fetch a cup, and say what is wrong."""

from math import pi

import mujoco
import numpy as np
import pytest

from halfseen.cell import ArmFile, SerialArm, cell_model, robot_of
from halfseen.cell.contacts import ROBOT
from halfseen.cell.fetching import come, feels, pick_up
from halfseen.cell.grasps import Grasp, hand_axes
from halfseen.cell.home import STANDS_M
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.planning import plan
from halfseen.errors import SceneError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.rays import FURNITURE_GROUP, UNSEEN_GROUP
from halfseen.scene.table import TABLE_TOP_M
from text_arms import HULL, SIX, seven

SIX_JOINTS = ("pan", "lift", "elbow", "roll", "pitch", "yaw")
CUP, PLACE_M = Cup(0.1, 0.04, 0.035), (0.05, 0.05)
WORLD_FROM_TABLE = Pose((0.0, 0.0, TABLE_TOP_M)).matrix


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    (folder / "shapes").mkdir()
    (folder / "shapes" / "hull.obj").write_text(HULL)
    (folder / "six.xml").write_text(SIX)
    (folder / "seven.xml").write_text(seven())
    return folder


@pytest.fixture(scope="module")
def six(folder):
    return ArmFile(folder / "six.xml")


@pytest.fixture(scope="module")
def robots(folder, six):
    return {"six": robot_of(six), "seven": robot_of(seven_of(folder))}


def put(model, names, angles):
    data = mujoco.MjData(model)
    for name, angle in zip(names, angles, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    return data


def seven_of(folder):
    return ArmFile(folder / "seven.xml")


def numbered(arm):
    return [f"joint_{number + 1}" for number in range(arm.num_joints)]


@pytest.mark.parametrize(
    ("file", "joints", "base", "flange"),
    [
        ("six.xml", SIX_JOINTS, "base", ("site", "attachment_site")),
        ("seven.xml", [f"j{number}" for number in range(1, 8)], "stand", ("body", "link7")),
    ],
)
def test_the_flange_is_where_the_file_alone_puts_it(folder, file, joints, base, flange):
    arm, alone = ArmFile(folder / file), mujoco.MjModel.from_xml_path(str(folder / file))
    assert isinstance(arm, SerialArm)
    model, rng = arm.spec().compile(), np.random.default_rng(0)
    for _ in range(5):
        angles = rng.uniform(-2.0, 2.0, size=len(joints))
        theirs, ours = put(alone, joints, angles), put(model, numbered(arm), angles).site("flange")
        there = getattr(theirs, flange[0])(flange[1])
        np.testing.assert_allclose(ours.xpos, there.xpos - theirs.body(base).xpos, atol=1e-9)
        np.testing.assert_allclose(ours.xmat, there.xmat, atol=1e-9)


def test_what_is_not_the_arm_is_left_behind(six):
    model, alone = six.spec().compile(), mujoco.MjModel.from_xml_path(str(six.path))
    kept = ("base", "shoulder", "upper", "fore", "wrist_a", "wrist_b", "wrist_c")
    assert (model.njnt, model.nu, model.nkey, model.nsensor, model.neq, model.ntendon) == (6, 6, 0, 0, 0, 0)
    assert model.body_mass.sum() == pytest.approx(sum(alone.body(name).mass[0] for name in kept))
    # One shape for each body: what is only seen counts where a link has nothing else.
    assert model.ngeom == len(kept)
    assert set(model.geom_conaffinity) == {ROBOT["conaffinity"]}
    assert not np.isin(model.geom_group, (FURNITURE_GROUP, UNSEEN_GROUP)).any()


def test_it_carries_itself_and_follows_its_servos(six):
    model = six.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = [0.3, -1.2, 1.5, 0.2, -0.4, 0.1]
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=1e-6)
    data.ctrl[:] += 0.1
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=1e-3)


def test_a_joint_that_is_not_named_stays_as_it_is(six):
    named = tuple(name for name in SIX_JOINTS if name != "roll")
    arm, alone = ArmFile(six.path, joints=named), mujoco.MjModel.from_xml_path(str(six.path))
    angles = np.linspace(-1.0, 1.0, 5)
    theirs, ours = put(alone, named, angles), put(arm.spec().compile(), numbered(arm), angles)
    there_m = theirs.site("attachment_site").xpos - theirs.body("base").xpos
    np.testing.assert_allclose(ours.site("flange").xpos, there_m, atol=1e-9)


def test_a_flange_may_be_a_body_and_the_hand_turned_on_it(six):
    """The claw's y points out of the arm."""
    turned = Pose((0.0, 0.01, 0.0), (0.5**0.5, -(0.5**0.5), 0.0, 0.0))
    arm = ArmFile(six.path, flange="claw", flange_from_hand=turned)
    data, usual = (put(each.spec().compile(), numbered(each), np.ones(6)) for each in (arm, six))
    out = usual.site("flange").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(data.site("flange").xpos, usual.site("flange").xpos + 0.01 * out, atol=1e-9)
    np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3)[:, 2], out, atol=1e-9)
    assert data.model.ngeom == usual.model.ngeom


@pytest.mark.parametrize("kind", ["six", "seven"])
def test_it_fetches_a_cup(robots, kind):
    robot = robots[kind]
    cell = LiveCell(cell_model([CUP], [Pose((*PLACE_M, TABLE_TOP_M))], [robot]), [robot])
    down = hand_axes(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    grasp = Grasp("around", np.array([*PLACE_M, CUP.height_m - 0.02]), down, 0.11)
    home, rng = np.array(robot.home_rad), np.random.default_rng(0)
    found = plan([grasp], WORLD_FROM_TABLE, cell.kinematics[robot.name], home, rng)
    cell.carry_out(robot, come(found))
    cell.carry_out(robot, pick_up(found))
    assert feels(cell, robot, grasp)
    assert cell.cup(0).position_m[2] - TABLE_TOP_M == pytest.approx(0.2, abs=0.02)
    assert 0.06 < cell.opening_m(robot) < 0.085


def test_it_waits_behind_the_tables_left_the_same_every_time(robots, six):
    robot = robots["six"]
    cell = LiveCell(cell_model([], [], [robot]), [robot])
    hand = cell.kinematics[robot.name].hand(np.array(robot.home_rad))
    np.testing.assert_allclose(hand.position_m, (-0.40, 0.58, 0.98), atol=1e-3)
    np.testing.assert_allclose(hand.rotation[:, 2], (0.0, 0.0, -1.0), atol=5e-3)
    cell.kinematics[robot.name].refuse_furniture([np.array(robot.home_rad)])
    assert robot.base_m in STANDS_M
    assert robot_of(six, stands_m=[robot.base_m]).home_rad == robot.home_rad


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"flange": "tip"}, "no site or body 'tip' for a flange; there are attachment_site, block, base, shoulder"),
        ({"base": "root"}, "no body 'root'; there are block, base, shoulder"),
        ({"joints": ("pan", "bend")}, "no joint 'bend'; there are pan, lift, elbow, roll, pitch, yaw$"),
        ({"joints": (*SIX_JOINTS, "left")}, "joint 'left' is no hinge; those that do are pan, lift"),
        ({"joints": SIX_JOINTS[1::-1] + SIX_JOINTS[2:]}, "not in the order from base to flange, which is pan, lift"),
        ({"joints": SIX_JOINTS[:4]}, "has 4 joints .* needs 5 to point its hand"),
        ({"joints": ()}, "has 0 joints .* needs 5 to point its hand"),
        (
            {"joints": SIX_JOINTS, "flange": "fore"},
            "'roll' does not lie between base and flange; those that do are pan",
        ),
        (
            {"joints": SIX_JOINTS, "base": "upper"},
            "'pan' does not lie between base and flange; those that do are elbow",
        ),
        ({"flange": "left"}, "joint 'left' is no hinge; name those that are its joints, .*: there are pan"),
        ({"flange": "base"}, "has 0 joints as far as body 'base', .* name its flange, or its joints"),
        ({"base": "block"}, "has 0 joints as far as body 'block'"),
        ({"speed_rad_s": 0.0}, "speed_rad_s is 0.0; give a positive number"),
        ({"speed_rad_s": (1.0, 2.0)}, "has 6 joints and 2 speeds; give one, or one for each"),
    ],
)
def test_names_and_numbers_that_do_not_fit_are_refused(six, given, message):
    with pytest.raises(SceneError, match=message) as refused:
        ArmFile(six.path, **given)
    assert "six.xml: " in str(refused.value)
    assert "\n" not in str(refused.value)


def test_searches_begin_within_the_limits_and_within_one_turn(six):
    expected = np.full((6, 2), [-pi, pi])
    np.testing.assert_allclose(six.search_rad, expected)
    np.testing.assert_array_equal(six.speeds_rad_s, np.ones(6))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file; give the path of an arm's MJCF file"),
        ("hello", "cannot read it: XML parse error.*; give an arm's MJCF file"),
        ("<mujoco><worldbdy/></mujoco>", "cannot read it: .*worldbdy"),
        ("<mujoco/>", "has 0 joints"),
        (seven(hull="lost.obj"), "cannot read it: .*lost.obj.*; give an arm's MJCF file, with meshes"),
        (seven(joint='type="slide"'), "joint 'j1' is no hinge"),
    ],
)
def test_files_that_are_no_arms_are_refused(tmp_path, text, message):
    path = tmp_path / "some.xml"
    if text is not None:
        path.write_text(text)
        (tmp_path / "shapes").mkdir()
        (tmp_path / "shapes" / "hull.obj").write_text(HULL)
    with pytest.raises(SceneError, match=message) as refused:
        ArmFile(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
