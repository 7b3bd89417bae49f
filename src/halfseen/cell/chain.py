"""The kinematic chain of the arm in a robot model: from a fixed body, along hinges, to the flange.

Parts that the user does not name are found. The base is the world's child that carries the arm. The arm extends from
there until it ends or branches into fingers. The flange is a site on the last link, or else a body fixed to it, whose
name contains one of `FLANGE_WORDS`; otherwise it is the last link's own frame.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco

from halfseen.cell.arm import LEAST_JOINTS
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose, pose_of

FLANGE_WORDS = frozenset({"attachment", "flange", "tool", "tool0", "ee", "eef", "hand", "gripper", "wristsite"})
"""Words in names that mark the flange, separated by characters other than letters and digits."""

_WORLD = 0
_BODY, _JOINT, _SITE = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtObj.mjOBJ_SITE
_HINGE, _FREE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_FREE
_MOST_NAMES = 30


@dataclass(frozen=True)
class Flange:
    """Mount of the hand: a pose in a body, and whether that body begins the hand and is not part of the arm."""

    body: int
    pose: Pose
    is_of_hand: bool


@dataclass(frozen=True)
class Chain:
    """The arm of a model: bodies from the fixed base on, joints in order, and the flange."""

    bodies: tuple[int, ...]
    joints: tuple[int, ...]
    flange: Flange


def find_chain(
    model: mujoco.MjModel, name: str, base: str | None, flange: str | None, joints: Sequence[str] | None
) -> Chain:
    """Find the arm in a model.

    Parameters
    ----------
    model
        Model of a robot, possibly with its surroundings.
    base, flange, joints
        Names of the fixed body, of the site or body where a hand is mounted, and of the hinges from the base on. None
        to find them.

    Raises
    ------
    SceneError
        A name does not exist, the joints are not consecutive hinges between base and flange, or there are too few.
    """
    named = None if joints is None else tuple(_number(model, name, _JOINT, joint) for joint in joints)
    mounted = None if flange is None else _named_flange(model, name, flange)
    still = None if base is None else _number(model, name, _BODY, base)
    if named:
        tip = int(model.jnt_bodyid[named[-1]])
    else:
        tip = _trunk(model, still or _WORLD)[-1] if mounted is None else mounted.body
    still = _standing(model, tip) if still is None else still
    found = _joints_between(model, name, still, tip) if named is None else named
    if len(found) < LEAST_JOINTS:
        raise SceneError(
            f"{name}: the arm has {len(found)} joints up to body {model.body(tip).name!r}, but needs "
            f"{LEAST_JOINTS} to point its hand; name its flange or its joints; available: {_listed(_hinges(model))}"
        )
    last = int(model.jnt_bodyid[found[-1]])
    mounted = mounted or _found_flange(model, last)
    path = _path(model, still, mounted.body)
    _require_row(model, name, found, path)
    is_of_hand = mounted.is_of_hand and mounted.body != last
    return Chain(_carried(model, still, path), found, Flange(mounted.body, mounted.pose, is_of_hand))


def _number(model: mujoco.MjModel, name: str, kind: mujoco.mjtObj, wanted: str) -> int:
    number = mujoco.mj_name2id(model, kind, wanted)
    if number < 0:
        what = {_BODY: "body", _JOINT: "joint"}[kind]
        there = _hinges(model) if kind == _JOINT else _names(model, _BODY)
        raise SceneError(f"{name}: no {what} is named {wanted!r}; available: {_listed(there)}")
    return number


def _named_flange(model: mujoco.MjModel, name: str, wanted: str) -> Flange:
    site, body = (mujoco.mj_name2id(model, kind, wanted) for kind in (_SITE, _BODY))
    if site >= 0:
        return _at_site(model, site)
    if body >= 0:
        return Flange(body, Pose((0.0, 0.0, 0.0)), is_of_hand=True)
    there = [*_names(model, _SITE), *_names(model, _BODY)]
    raise SceneError(f"{name}: no site or body for a flange is named {wanted!r}; available: {_listed(there)}")


def _found_flange(model: mujoco.MjModel, last: int) -> Flange:
    fixed = [last]
    for body in range(last + 1, model.nbody):
        if model.body_parentid[body] in fixed and not model.body_jntnum[body]:
            fixed.append(body)
    for site in range(model.nsite):
        if model.site_bodyid[site] in fixed and _tells(model.site(site).name):
            return _at_site(model, site)
    carrier = next((body for body in fixed[1:] if _tells(model.body(body).name)), last)
    return Flange(carrier, Pose((0.0, 0.0, 0.0)), is_of_hand=True)


def _tells(name: str) -> bool:
    return not FLANGE_WORDS.isdisjoint(re.split(r"[^a-z0-9]+", name.lower()))


def _at_site(model: mujoco.MjModel, site: int) -> Flange:
    pose = pose_of(model.site_pos[site], model.site_quat[site])
    return Flange(int(model.site_bodyid[site]), pose, is_of_hand=False)


def _trunk(model: mujoco.MjModel, begin: int) -> list[int]:
    """Bodies from `begin` on, up to a branch or the last joint; of several robots in a world, the longest chain."""
    moves = [bool(_own_joints(model, body)) for body in range(model.nbody)]
    for body in range(model.nbody - 1, _WORLD, -1):
        moves[model.body_parentid[body]] |= moves[body]
    ways = [body for body in range(begin + 1, model.nbody) if model.body_parentid[body] == begin and moves[body]]
    if begin == _WORLD and ways:
        trunks = (_trunk(model, way) for way in ways)
        return max(trunks, key=lambda trunk: sum(len(_own_joints(model, body)) for body in trunk))
    return [begin, *_trunk(model, ways[0])] if len(ways) == 1 else [begin]


def _own_joints(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints of a body, without a free joint."""
    begin, number = model.body_jntadr[body], model.body_jntnum[body]
    return [joint for joint in range(begin, begin + number) if model.jnt_type[joint] != _FREE]


def _standing(model: mujoco.MjModel, tip: int) -> int:
    """The world's child that carries a body; the world itself if that child has joints."""
    root = int(model.body_rootid[tip])
    return _WORLD if _own_joints(model, root) else root


def _path(model: mujoco.MjModel, begin: int, end: int) -> list[int]:
    """Bodies from after `begin` to `end`; from the world on if `begin` does not carry `end`."""
    path, body = [], end
    while body not in (begin, _WORLD):
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def _joints_between(model: mujoco.MjModel, name: str, begin: int, end: int) -> tuple[int, ...]:
    found = [joint for body in _path(model, begin, end) for joint in _own_joints(model, body)]
    hinges = [joint for joint in found if model.jnt_type[joint] == _HINGE]
    if len(found) > len(hinges):
        other = next(joint for joint in found if joint not in hinges)
        raise SceneError(
            f"{name}: the arm's joint {model.joint(other).name!r} is not a hinge; name the joints that move "
            f"(the others stay fixed); available: {_listed(_hinges(model))}"
        )
    return tuple(hinges)


def _require_row(model: mujoco.MjModel, name: str, joints: Sequence[int], path: Sequence[int]) -> None:
    """Refuse joints that are not hinges, or not in order between base and flange."""
    between = [joint for body in path for joint in _own_joints(model, body) if model.jnt_type[joint] == _HINGE]
    listed = _listed(model.joint(joint).name for joint in between)
    for joint in joints:
        if joint not in between:
            trouble = "is not a hinge" if model.jnt_type[joint] != _HINGE else "does not lie between base and flange"
            raise SceneError(
                f"{name}: joint {model.joint(joint).name!r} {trouble}; the hinges between them are {listed}"
            )
    if sorted(set(joints), key=between.index) != list(joints):
        given = _listed(model.joint(joint).name for joint in joints)
        raise SceneError(f"{name}: the joints {given} are not in the order from base to flange, which is {listed}")


def _carried(model: mujoco.MjModel, base: int, path: Sequence[int]) -> tuple[int, ...]:
    """The bodies of the path, and jointless bodies fixed to it before the flange."""
    bodies = [base]
    for body in range(base + 1, model.nbody):
        parent = int(model.body_parentid[body])
        is_fixed = not model.body_jntnum[body] and parent != _WORLD and parent != path[-1]
        if body in path or (is_fixed and parent in bodies):
            bodies.append(body)
    return tuple(bodies)


def _hinges(model: mujoco.MjModel) -> list[str]:
    return [model.joint(joint).name for joint in range(model.njnt) if model.jnt_type[joint] == _HINGE]


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    number = {_BODY: model.nbody, _SITE: model.nsite}[kind]
    return [mujoco.mj_id2name(model, kind, each) for each in range(int(kind == _BODY), number)]


def _listed(names: Iterable[str | None]) -> str:
    named = [name for name in names if name]
    return ", ".join(named[:_MOST_NAMES]) + (", …" if len(named) > _MOST_NAMES else "") if named else "none with names"
