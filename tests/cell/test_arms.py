"""Arms: beside their maker's table and beside their files alone; what they carry, fetch, leave behind and refuse."""

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from cells import CUP, MUG, ROBOT, WORLD_FROM_TABLE, standing

from halfseen.cell import ArmFile, Gripper, LiveCell, MountedArm, SerialArm, cell_model, robot_of
from halfseen.cell.arm import JACO_2
from halfseen.cell.fetching import come, feels, pick_up
from halfseen.cell.grasps import UP, Grasp, hand_axes
from halfseen.cell.gripper import ROBOT as CONTACTS
from halfseen.cell.kinematics import Kinematics
from halfseen.cell.planning import STANDS_M, beginnings, plans
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose
from halfseen.scene.rays import FURNITURE_GROUP, UNSEEN_GROUP
from halfseen.scene.table import TABLE_TOP_M
from refusals import refused
from text_arms import HULL, SIX, seven

SIX_JOINTS = ("pan", "lift", "elbow", "roll", "pitch", "yaw")
NO_ROLL = tuple(name for name in SIX_JOINTS if name != "roll")
SEVEN_JOINTS = tuple(f"j{number}" for number in range(1, 8))
PLACE_M = (0.05, 0.05)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    (folder / "shapes").mkdir()
    for name, text in (("shapes/hull.obj", HULL), ("six.xml", SIX), ("seven.xml", seven())):
        (folder / name).write_text(text)
    return folder


@pytest.fixture(scope="module")
def six(folder):
    return ArmFile(folder / "six.xml")


@pytest.fixture(scope="module")
def robots(folder, six):
    robot = robot_of(six)
    return {"six": robot, "seven": robot_of(ArmFile(folder / "seven.xml"), stands_m=[robot.base_m])}


def put(model, names, angles):
    data = mujoco.MjData(model)
    for name, angle in zip(names, angles, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    return data


def ours(arm, angles):
    """Our model of an arm, with its joints at angles."""
    return put(arm.spec().compile(), [f"joint_{number + 1}" for number in range(arm.num_joints)], angles)


def of_the_maker(angles):
    """Flange of the arm by the table in the maker's guide: its lengths, tilts, and which way it counts."""
    d1, d2, d3, d4, d5, e2 = 0.2755, 0.41, 0.2073, 0.0741, 0.0741, 0.0098
    bend = np.deg2rad(30.0)
    fold = np.sin(bend) / np.sin(2 * bend)
    theta = angles * [-1, 1, 1, 1, 1, 1] + np.deg2rad([0, -90, 90, 0, -180, 90])
    alpha = [np.pi / 2, np.pi, np.pi / 2, 2 * bend, 2 * bend, np.pi]
    along_x = [0, d2, 0, 0, 0, 0]
    along_z = [d1, 0, -e2, -(d3 + fold * d4), -fold * (d4 + d5), -(fold * d5 + 0.02)]
    frame = np.eye(4)
    for t, a, x, z in zip(theta, alpha, along_x, along_z, strict=True):
        about_z = np.array([[np.cos(t), -np.sin(t), 0, 0], [np.sin(t), np.cos(t), 0, 0], [0, 0, 1, z], [0, 0, 0, 1]])
        about_x = np.array([[1, 0, 0, x], [0, np.cos(a), -np.sin(a), 0], [0, np.sin(a), np.cos(a), 0], [0, 0, 0, 1]])
        frame = frame @ about_z @ about_x
    return frame


def test_the_flange_is_where_the_makers_table_puts_it_and_links_end_where_the_next_ones_begin():
    model = JACO_2.spec().compile()
    for angles in np.random.default_rng(0).uniform(-3.0, 3.0, size=(20, 6)):
        data, expected = ours(JACO_2, angles), of_the_maker(angles)
        np.testing.assert_allclose(data.site("flange").xpos, expected[:3, 3], atol=1e-12)
        np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)
        half = data.geom_xmat.reshape(-1, 3, 3)[:, :, 2] * model.geom_size[:, 1:2]
        ends = np.stack([data.geom_xpos - half, data.geom_xpos + half], axis=1)[1:]
        for before, after in pairwise(ends):
            gap = np.linalg.norm(before[:, None] - after[None], axis=2).min()
            assert gap < 0.0098 + 1e-9  # the elbow's offset


@pytest.mark.parametrize(
    ("file", "given", "joints", "base", "flange"),
    [
        ("six.xml", {}, SIX_JOINTS, "base", ("site", "attachment_site")),
        # The joint that isn't named stays as it is.
        ("six.xml", {"joints": NO_ROLL}, NO_ROLL, "base", ("site", "attachment_site")),
        ("seven.xml", {}, SEVEN_JOINTS, "stand", ("body", "link7")),
    ],
)
def test_the_flange_is_where_the_file_alone_puts_it(folder, file, given, joints, base, flange):
    arm, alone = ArmFile(folder / file, **given), mujoco.MjModel.from_xml_path(str(folder / file))
    assert isinstance(arm, SerialArm)
    for angles in np.random.default_rng(0).uniform(-2.0, 2.0, size=(5, len(joints))):
        theirs, own = put(alone, joints, angles), ours(arm, angles).site("flange")
        there = getattr(theirs, flange[0])(flange[1])
        np.testing.assert_allclose(own.xpos, there.xpos - theirs.body(base).xpos, atol=1e-9)
        np.testing.assert_allclose(own.xmat, there.xmat, atol=1e-9)


def test_a_flange_may_be_a_body_and_the_hand_turned_on_it(six):
    """The claw's y points out of the arm."""
    turned = Pose((0.0, 0.01, 0.0), (0.5**0.5, -(0.5**0.5), 0.0, 0.0))
    data, usual = (ours(each, np.ones(6)) for each in (ArmFile(six.path, flange="claw", flange_from_hand=turned), six))
    out = usual.site("flange").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(data.site("flange").xpos, usual.site("flange").xpos + 0.01 * out, atol=1e-9)
    np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3)[:, 2], out, atol=1e-9)
    assert data.model.ngeom == usual.model.ngeom


def test_what_is_not_the_arm_is_left_behind(six):
    model, alone = six.spec().compile(), mujoco.MjModel.from_xml_path(str(six.path))
    kept = ("base", "shoulder", "upper", "fore", "wrist_a", "wrist_b", "wrist_c")
    assert (model.njnt, model.nu, model.nkey, model.nsensor, model.neq, model.ntendon) == (6, 6, 0, 0, 0, 0)
    assert model.body_mass.sum() == pytest.approx(sum(alone.body(name).mass[0] for name in kept))
    # One shape for each body: what is only seen counts where a link has nothing else.
    assert model.ngeom == len(kept)
    assert set(model.geom_conaffinity) == {CONTACTS["conaffinity"]}
    assert not np.isin(model.geom_group, (FURNITURE_GROUP, UNSEEN_GROUP)).any()


@pytest.mark.parametrize(
    ("kind", "angles"), [("jaco", [0.0, 3.0, 2.0, 0.0, 0.0, 0.0]), ("six", [0.3, -1.2, 1.5, 0.2, -0.4, 0.1])]
)
def test_an_arm_carries_itself_and_follows_its_servos(six, kind, angles):
    model = (six if kind == "six" else JACO_2).spec().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = angles
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=1e-6)
    data.ctrl[:] += 0.1
    mujoco.mj_step(model, data, 500)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=1e-3)


def test_the_makers_arm_has_its_masses_and_limits_and_searches_begin_within_them(six):
    model = JACO_2.spec().compile()
    assert model.body_mass.sum() == pytest.approx(sum(joint.mass_kg for joint in JACO_2.joints) + JACO_2.base_mass_kg)
    assert model.jnt_limited.tolist() == [0, 1, 1, 0, 0, 0]
    np.testing.assert_allclose(np.rad2deg(model.jnt_range[1:3]), [[47.0, 313.0], [19.0, 341.0]])
    least, largest = [-3.0, 2.0, 0.6, -3.0, -3.0, -3.0], [3.0, 4.3, 3.1, 3.0, 3.0, 3.0]
    kinematics, here = Kinematics(cell_model([], []), ROBOT), np.zeros(6)
    drawn = np.random.default_rng(5).uniform(least, largest, size=(3, 6))
    np.testing.assert_array_equal(
        beginnings(kinematics, here, np.random.default_rng(5))[1:],
        [kinematics.nearest_turn(angles, here) for angles in drawn],
    )
    np.testing.assert_allclose(replace(JACO_2, begins_rad=None).search_rad[:2, 1], [np.pi, np.deg2rad(313.0)])
    np.testing.assert_allclose(six.search_rad, np.full((6, 2), [-np.pi, np.pi]))
    np.testing.assert_array_equal(six.speeds_rad_s, np.ones(6))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "cup", "frictions"),
    [
        *(("jaco", cup, [friction]) for cup in (CUP, MUG) for friction in (0.15, 0.9)),
        ("six", CUP, None),
        ("seven", CUP, None),
    ],
)
def test_an_arm_fetches_a_cup_slippery_or_not(robots, kind, cup, frictions):
    robot = robots.get(kind, ROBOT)
    cell = LiveCell(cell_model([cup], standing(PLACE_M), [robot], frictions=frictions), [robot])
    # It closes along y, past the handle, which points along x.
    grasp = Grasp("around", np.array([*PLACE_M, cup.height_m - 0.02]), hand_axes(-UP, np.array([0.0, 1.0, 0.0])), 0.11)
    home, rng = np.array(robot.home_rad), np.random.default_rng(0)
    found = next(plans([grasp], WORLD_FROM_TABLE, cell.kinematics[robot.name], home, rng))
    cell.carry_out(robot, come(found))
    cell.carry_out(robot, pick_up(found))
    assert feels(cell, robot, grasp)
    assert cell.cup(0).position_m[2] - TABLE_TOP_M == pytest.approx(0.2, abs=0.02)
    assert 0.06 < cell.opening_m(robot) < 0.09


@pytest.mark.slow
def test_it_waits_behind_the_tables_left_the_same_every_time(robots, six):
    robot = robots["six"]
    kinematics, home = Kinematics(cell_model([], [], [robot]), robot), np.array(robot.home_rad)
    hand = kinematics.hand(home)
    np.testing.assert_allclose(hand.position_m, (-0.40, 0.58, 0.98), atol=1e-3)
    np.testing.assert_allclose(hand.rotation[:, 2], (0.0, 0.0, -1.0), atol=5e-3)
    kinematics.refuse_furniture([home])
    assert robot.base_m in STANDS_M
    assert robot_of(six, stands_m=[robot.base_m]).home_rad == robot.home_rad


JOINT, MOTOR, HAND = JACO_2.joints[1], JACO_2.joints[1].motor, Gripper()


@pytest.mark.parametrize(
    ("part", "changed", "message"),
    [
        (MOTOR, {"speed_rad_s": 0.0}, r"motor: speed_rad_s is 0\.0; give a positive number"),
        (MOTOR, {"stiffness_nm": -1.0}, r"motor: stiffness_nm is -1\.0"),
        (MOTOR, {"armature_kgm2": float("nan")}, "motor: armature_kgm2 is nan"),
        (JOINT, {"mass_kg": -0.1}, r"joint: mass_kg is -0\.1"),
        (JOINT, {"radius_m": 0.0}, r"joint: radius_m is 0\.0"),
        (JOINT, {"a_m": float("inf")}, "joint: a_m is inf; give a finite number"),
        (JOINT, {"limits_rad": (2.0, 1.0)}, r"joint: limits_rad is \(2\.0, 1\.0\); give the smaller angle first"),
        (JACO_2, {"joints": JACO_2.joints[:4]}, "has 4 joints; it needs at least 5"),
        (JACO_2, {"base_mass_kg": -1.0}, r"arm 'Kinova.*': base_mass_kg is -1\.0"),
        (JACO_2, {"flange_m": float("nan")}, "flange_m is nan; give a finite number"),
        (JACO_2, {"begins_rad": ((0.0, 1.0),)}, "has 6 joints and begins_rad has 1 ranges; give one for every joint"),
        (HAND, {"finger_m": -0.1}, r"gripper: finger_m is -0\.1; give a positive number"),
        (HAND, {"palm_m": (0.1, 0.2, 0.0)}, r"gripper: palm_m is \(0\.1, 0\.2, 0\.0\); give a positive number"),
        (HAND, {"stroke_m": 0.2}, r"gripper: stroke_m is 0\.2; make it less than palm_m\[1\], 0\.164"),
        (HAND, {"pad_length_m": 0.09}, "make it less than finger_m"),
        (HAND, {"pad_thickness_m": 0.02}, "make it less than finger_thickness_m"),
        (
            MountedArm(),
            {"home_rad": (0.0,) * 5},
            "home_rad has 5 angles and its arm has 6 joints; give one angle for every",
        ),
    ],
)
def test_numbers_that_cannot_be_are_refused(part, changed, message):
    with pytest.raises(SceneError, match=message):
        replace(part, **changed)


@pytest.mark.parametrize(
    ("text", "given", "message"),
    [
        (
            SIX,
            {"flange": "tip"},
            "no site or body for a flange is named 'tip'; available: attachment_site, block, base, should",
        ),
        (SIX, {"base": "root"}, "no body is named 'root'; available: block, base, shoulder"),
        (SIX, {"joints": ("pan", "bend")}, "no joint is named 'bend'; available: pan, lift, elbow, roll, pitch, yaw$"),
        (SIX, {"joints": (*SIX_JOINTS, "left")}, "joint 'left' is not a hinge; the hinges between them are pan, lift"),
        (SIX, {"joints": ("lift", "pan", *SIX_JOINTS[2:])}, "not in the order from base to flange, which is pan, lift"),
        (SIX, {"joints": SIX_JOINTS[:4]}, "has 4 joints .* needs 5 to point its hand"),
        (SIX, {"joints": ()}, "has 0 joints .* needs 5 to point its hand"),
        (SIX, {"joints": SIX_JOINTS, "flange": "fore"}, "'roll' does not lie between base and flange; .* are pan"),
        (SIX, {"joints": SIX_JOINTS, "base": "upper"}, "'pan' does not lie between base and flange; .* are elbow"),
        (SIX, {"flange": "left"}, "joint 'left' is not a hinge; name the joints that move .*; available: pan"),
        (SIX, {"flange": "base"}, "has 0 joints up to body 'base', .* name its flange or its joints"),
        (SIX, {"base": "block"}, "has 0 joints up to body 'block'"),
        (SIX, {"speed_rad_s": 0.0}, "speed_rad_s is 0.0; give a positive number"),
        (SIX, {"speed_rad_s": (1.0, 2.0)}, "has 6 joints and 2 speeds; give one, or one for each"),
        (None, {}, "no such file; give the path of an arm's MJCF file"),
        ("hello", {}, "cannot read it: XML parse error.*; give an arm's MJCF file"),
        ("<mujoco><worldbdy/></mujoco>", {}, "cannot read it: .*worldbdy"),
        ("<mujoco/>", {}, "has 0 joints"),
        (seven(hull="lost.obj"), {}, "cannot read it: .*lost.obj.*; give an arm's MJCF file, with its meshes"),
        (seven(joint='type="slide"'), {}, "joint 'j1' is not a hinge"),
    ],
)
def test_files_and_names_that_make_no_arm_are_refused_in_one_line(folder, text, given, message):
    path = folder / "some.xml"
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_text(text)
    with refused(message, SceneError) as caught:
        ArmFile(path, **given)
    assert str(path) in str(caught.value)
