"""Draw a table: cups start in a clutter and drop; the table is accepted if all rest properly and are partly visible.

In the clutter some cups stand behind others as seen by the camera; none is inside another.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from itertools import combinations, product

import mujoco
import numpy as np

from halfseen.errors import SceneError
from halfseen.scene.cups import Cup, outline
from halfseen.scene.poses import Pose, Quaternion, about_axis, compose, pose_of
from halfseen.scene.rays import at_rest
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, Table, Truth, look_at, truth_of
from halfseen.scene.view import TIMESTEP_S, cup_name, is_whole_in_picture, lone_depths_m, room_spec, table_view
from halfseen.scene.xtion import XTION, loss_probability, xtion_at
from halfseen.shapes import Float

GAP_M = 0.01  # closer cups might look like one object
_FREE_AREA_M = ((-0.27, 0.27), (-0.20, 0.20))  # area of the cups, from the table's middle
_DROP_M = 0.004
_FALLEN_SHARE = 0.3
_BEHIND_SHARE = 0.85  # share of the cups put behind or in front of another, along the line of sight
_NUM_TRIES = 60

Disc = tuple[float, float, float]  # centre x, y and radius [m]


def draw_cup(rng: np.random.Generator) -> Cup:
    """Draw a tumbler or a mug of ordinary size: 7 to 15 cm high, 6 to 10 cm wide at the mouth; a mug has a handle."""
    rim_radius_m = rng.uniform(0.030, 0.050)
    is_mug = rng.random() < 0.35
    height_m = rng.uniform(0.075, 0.115) if is_mug else rng.uniform(0.07, min(0.15, 3.6 * rim_radius_m))
    taper = rng.uniform(0.9, 1.0) if is_mug else rng.uniform(0.68, 0.98)
    handle_m = rng.uniform(0.025, 0.035) if is_mug else 0.0
    rounded = [round(float(value), 4) for value in (height_m, rim_radius_m, taper * rim_radius_m, handle_m)]
    return Cup(rounded[0], rounded[1], rounded[2], wall_m=0.0035 if is_mug else 0.0025, handle_m=rounded[3])


def draw_layout(cups: Sequence[Cup], rng: np.random.Generator) -> tuple[Pose, ...] | None:
    """Draw the poses from which the cups drop, a few millimetres above the table, some standing and some lying.

    None if the cups do not fit.
    """
    poses: list[Pose] = []
    taken: list[Disc] = []
    for cup in cups:
        quaternion = _draw_turn(rng)
        for _ in range(_NUM_TRIES):
            pose = _just_above_table(cup, _draw_place(poses, rng), quaternion)
            discs = _footprint(cup, pose)
            is_apart = all(np.hypot(x - a, y - b) >= r + s + GAP_M for x, y, r in discs for a, b, s in taken)
            if _is_inside(discs) and is_apart:
                poses.append(pose)
                taken.extend(discs)
                break
        else:
            return None
    return tuple(poses)


def _draw_turn(rng: np.random.Generator) -> Quaternion:
    """Draw an orientation: standing or lying, with a uniform turn about the vertical and, if lying, about its axis."""
    about_vertical = about_axis((0.0, 0.0, 1.0), rng.uniform(0, 2 * np.pi))
    rolled = about_axis((0.0, 0.0, 1.0), rng.uniform(0, 2 * np.pi))
    if rng.random() >= _FALLEN_SHARE:
        return about_vertical
    return compose(compose(rolled, about_axis((1.0, 0.0, 0.0), np.pi / 2)), about_vertical)


def _draw_place(poses: Sequence[Pose], rng: np.random.Generator) -> tuple[float, float]:
    """Draw a place: anywhere, or behind or in front of a placed cup."""
    (left_m, right_m), (near_m, far_m) = _FREE_AREA_M
    if not poses or rng.random() >= _BEHIND_SHARE:
        return rng.uniform(left_m, right_m), rng.uniform(near_m, far_m)
    x_m, y_m, _ = poses[int(rng.integers(len(poses)))].position_m
    side = 1.0 if rng.random() < 0.5 else -1.0
    return x_m + rng.normal(0.0, 0.022), y_m + side * rng.uniform(0.075, 0.125)


def _just_above_table(cup: Cup, place_m: tuple[float, float], quaternion: Quaternion) -> Pose:
    """Pose with its lowest point a few millimetres above the table and its axis centred over a place."""
    turned = Pose((0.0, 0.0, 0.0), quaternion)
    lowest_m = float(turned.apply(outline(cup))[:, 2].min())
    middle_m = turned.apply(np.array([[0.0, 0.0, cup.height_m / 2]]))[0]
    return pose_of([*(place_m - middle_m[:2]), TABLE_TOP_M + _DROP_M - lowest_m], quaternion)


def _footprint(cup: Cup, pose: Pose) -> list[Disc]:
    """Discs that cover the cup as seen from above."""
    spots: Float[np.ndarray, "n 3"] = np.array([[0.0, 0.0, share * cup.height_m] for share in (0.1, 0.5, 0.9)])
    radii_m = [cup.radius_at(float(z_m)) for z_m in spots[:, 2]]
    if cup.handle_m > 0:
        spots = np.vstack([spots, [cup.rim_radius_m + cup.handle_m / 2, 0.0, cup.height_m / 2]])
        radii_m.append(cup.handle_m / 2)
    seen_m = pose.apply(spots)
    return [(float(x), float(y), radius) for (x, y, _), radius in zip(seen_m, radii_m, strict=True)]


def _is_inside(discs: Sequence[Disc]) -> bool:
    (left_m, right_m), (near_m, far_m) = _FREE_AREA_M
    return all(left_m <= x <= right_m and near_m <= y <= far_m for x, y, _ in discs)


REST_SPEED = 2e-3  # largest speed of a cup at rest [m/s, rad/s]
_QUIET_S = 0.2  # time for which a cup must stay that slow: a rocking cup is slow for an instant as it turns back
_PATIENCE_S = 4.0


def settle(cups: Sequence[Cup], world_from_cup: Sequence[Pose]) -> tuple[Pose, ...] | None:
    """Let the cups fall, and return their poses at rest; None if a cup still moves after 4 s."""
    model = room_spec(cups, world_from_cup, is_free=True).compile()
    data = mujoco.MjData(model)
    num_quiet = 0
    for _ in range(round(_PATIENCE_S / TIMESTEP_S)):
        mujoco.mj_step(model, data)
        num_quiet = num_quiet + 1 if np.max(np.abs(data.qvel)) < REST_SPEED else 0
        if num_quiet * TIMESTEP_S >= _QUIET_S:
            bodies = [data.body(cup_name(index)) for index in range(len(cups))]
            return tuple(pose_of(body.xpos, body.xquat).rounded() for body in bodies)
    return None


def smallest_gap_m(cups: Sequence[Cup], world_from_cup: Sequence[Pose], beyond_m: float = 0.1) -> float:
    """Smallest distance between the convex hulls of any two cups, at most `beyond_m` [m].

    It is negative if cups overlap.
    """
    if beyond_m <= 0:
        raise SceneError(f"smallest gap: beyond_m is {beyond_m}; give a positive length")
    model = room_spec(cups, world_from_cup, is_free=False).compile()
    data = at_rest(model)
    geoms = [np.flatnonzero(model.geom_bodyid == model.body(cup_name(index)).id) for index in range(len(cups))]
    pairs = (pair for of_cups in combinations(geoms, 2) for pair in product(*of_cups))
    gaps_m = (mujoco.mj_geomDistance(model, data, int(one), int(other), beyond_m, None) for one, other in pairs)
    return float(min(gaps_m, default=beyond_m))


NUM_CUPS = (5, 10)
MAX_OCCLUSION = 0.85
MIN_RETURNS_PX = 150
_NUM_PROPOSALS = 500
_RANGE_MARGIN_M = 0.1  # over three times the noise at the far end, 3 cm
_EDGE_M = 0.04  # a cup's middle stays this far inside the table's edge


def random_table(seed: int) -> Table:
    """Draw a table with 5 to 10 cups at rest, some of them fallen.

    Proposals are drawn until one is accepted: every cup rests on the table, stands or lies (none leans), is 1 cm or
    more from every other, is entirely in the picture and at most 85 % hidden, and shows at least 150 pixels that return
    whatever the sensor's noise (lit by the projector, in range, not grazing).

    Parameters
    ----------
    seed
        The same seed gives the same table.

    Returns
    -------
    Table
        The cups, their poses at rest, and the camera.

    Raises
    ------
    SceneError
        None of 500 proposals was accepted.
    """
    rng = np.random.default_rng(seed)
    # The number is drawn once: rejection must not favour tables with few cups.
    num_cups = _num_cups(rng)
    for _ in range(_NUM_PROPOSALS):
        table = _propose(num_cups, f"table of seed {seed}", rng)
        if table is not None and _is_kept(table):
            return table
    raise SceneError(f"seed {seed}: none of {_NUM_PROPOSALS} tables with {num_cups} cups was kept; choose another seed")


def num_cups_of(seed: int) -> int:
    """Number of cups of `random_table(seed)`, without drawing the table."""
    return _num_cups(np.random.default_rng(seed))


def _num_cups(rng: np.random.Generator) -> int:
    return int(rng.integers(NUM_CUPS[0], NUM_CUPS[1] + 1))


def _propose(num_cups: int, name: str, rng: np.random.Generator) -> Table | None:
    cups = tuple(draw_cup(rng) for _ in range(num_cups))
    starts = draw_layout(cups, rng)
    camera = xtion_at(_draw_camera_pose(rng))
    if starts is None:
        return None
    ends = settle(cups, starts)
    return None if ends is None else Table(cups, ends, camera, name)


def _draw_camera_pose(rng: np.random.Generator) -> Pose:
    """Draw a camera pose in front of the table: about 0.95 m from its middle, looking 25° to 32° downwards."""
    target_m = np.array([rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), TABLE_TOP_M + 0.03])
    distance_m, down_rad, aside_rad = rng.uniform(0.92, 1.0), np.deg2rad(rng.uniform(25, 32)), rng.normal(0, 0.05)
    back = np.array([np.sin(aside_rad) * np.cos(down_rad), -np.cos(aside_rad) * np.cos(down_rad), np.sin(down_rad)])
    return look_at(target_m + distance_m * back, target_m)


def _is_kept(table: Table) -> bool:
    """Whether a proposal is accepted; the cheap checks come first."""
    if not (_is_on_table(table) and is_whole_in_picture(table)):
        return False
    if smallest_gap_m(table.cups, table.world_from_cup) < GAP_M:
        return False
    truth = truth_of(table, lone_depths_m(table))
    return bool(np.all(truth.occlusion <= MAX_OCCLUSION) and np.all(sure_returns_px(table, truth) >= MIN_RETURNS_PX))


def _is_on_table(table: Table) -> bool:
    """Whether every cup stands or lies on the table top: not beside it, not on another cup, not leaning."""
    half_m, middle_m = np.array(TABLE_SIZE_M) / 2, table.centroid_m
    upward = np.array([pose.rotation[2, 2] for pose in table.world_from_cup])
    reach_m, above_m = [1.1 * cup.rim_radius_m + cup.handle_m for cup in table.cups], middle_m[:, 2] - TABLE_TOP_M
    is_standing = (upward > 0.995) & (np.abs(above_m - table.height_m / 2) < 0.003)
    is_lying = (np.abs(upward) < 0.5) & (above_m < reach_m)
    return bool((np.abs(middle_m[:, :2]) <= half_m - _EDGE_M).all() and (is_standing | is_lying).all())


def sure_returns_px(table: Table, truth: Truth) -> np.ndarray:
    """Pixels of each cup that return whatever the noise: visible, lit by the projector, and not grazing [px]."""
    view = table_view(table, XTION.baseline_m)
    is_sure = view.is_lit & (loss_probability(view.incidence_cosine) == 0)
    near_m, far_m = XTION.range_m
    is_sure &= (view.depth_m > near_m + _RANGE_MARGIN_M) & (view.depth_m < far_m - _RANGE_MARGIN_M)
    return np.array([np.sum(is_sure & (truth.labels == index)) for index in range(table.num_cups)])
