"""Where cups start: a clutter in which some stand behind others as the camera sees it, and none inside another."""

from collections.abc import Sequence

import numpy as np

from halfseen.scene.cups import Cup, outline
from halfseen.scene.poses import Pose, about_axis, compose
from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Float

GAP_M = 0.01  # cups nearer than this might be one thing to the eye
_FREE_AREA_M = ((-0.27, 0.27), (-0.20, 0.20))  # where cups stand, from the table's middle
_DROP_M = 0.004
_FALLEN_SHARE = 0.3
_BEHIND_SHARE = 0.85  # of the cups are put behind or before another, along the line of sight
_NUM_TRIES = 60

Disc = tuple[float, float, float]  # centre x, y and radius [m]


def draw_cup(rng: np.random.Generator) -> Cup:
    """Draw a tumbler or a mug of ordinary size.

    Parameters
    ----------
    rng
        Source of randomness.

    Returns
    -------
    Cup
        7 to 15 cm high, 6 to 10 cm wide at the mouth; a mug has a handle.
    """
    rim_radius_m = rng.uniform(0.030, 0.050)
    is_mug = rng.random() < 0.35
    height_m = rng.uniform(0.075, 0.115) if is_mug else rng.uniform(0.07, min(0.15, 3.6 * rim_radius_m))
    taper = rng.uniform(0.9, 1.0) if is_mug else rng.uniform(0.68, 0.98)
    handle_m = rng.uniform(0.025, 0.035) if is_mug else 0.0
    rounded = [round(float(value), 4) for value in (height_m, rim_radius_m, taper * rim_radius_m, handle_m)]
    return Cup(rounded[0], rounded[1], rounded[2], wall_m=0.0035 if is_mug else 0.0025, handle_m=rounded[3])


def draw_layout(cups: Sequence[Cup], rng: np.random.Generator) -> tuple[Pose, ...] | None:
    """Draw where the cups are let go, some standing and some lying.

    Parameters
    ----------
    cups
        The cups.
    rng
        Source of randomness.

    Returns
    -------
    tuple of Pose, or None
        One pose a cup, a few millimetres above the table; None if the cups did not fit.
    """
    poses: list[Pose] = []
    taken: list[Disc] = []
    for cup in cups:
        quaternion = _draw_turn(rng)
        for _ in range(_NUM_TRIES):
            pose = _just_above_table(cup, _draw_place(poses, rng), quaternion)
            discs = _footprint(cup, pose)
            if _is_inside(discs) and not _overlap(discs, taken):
                poses.append(pose)
                taken.extend(discs)
                break
        else:
            return None
    return tuple(poses)


def _draw_turn(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Standing or lying, turned anyhow about the vertical; one that lies has rolled anyhow about its axis."""
    about_vertical = about_axis((0.0, 0.0, 1.0), rng.uniform(0, 2 * np.pi))
    rolled = about_axis((0.0, 0.0, 1.0), rng.uniform(0, 2 * np.pi))
    if rng.random() >= _FALLEN_SHARE:
        return about_vertical
    return compose(compose(rolled, about_axis((1.0, 0.0, 0.0), np.pi / 2)), about_vertical)


def _draw_place(poses: Sequence[Pose], rng: np.random.Generator) -> tuple[float, float]:
    """Anywhere, or behind or before a cup that is already there."""
    (left_m, right_m), (near_m, far_m) = _FREE_AREA_M
    if not poses or rng.random() >= _BEHIND_SHARE:
        return rng.uniform(left_m, right_m), rng.uniform(near_m, far_m)
    x_m, y_m, _ = poses[int(rng.integers(len(poses)))].position_m
    side = 1.0 if rng.random() < 0.5 else -1.0
    return x_m + rng.normal(0.0, 0.022), y_m + side * rng.uniform(0.075, 0.125)


def _just_above_table(cup: Cup, place_m: tuple[float, float], quaternion: tuple[float, float, float, float]) -> Pose:
    """Find the pose whose lowest point is a few millimetres above the table, and whose axis is centred over a place."""
    turned = Pose((0.0, 0.0, 0.0), quaternion)
    lowest_m = float(turned.apply(outline(cup))[:, 2].min())
    middle_m = turned.apply(np.array([[0.0, 0.0, cup.height_m / 2]]))[0]
    return Pose(
        (place_m[0] - float(middle_m[0]), place_m[1] - float(middle_m[1]), TABLE_TOP_M + _DROP_M - lowest_m), quaternion
    )


def _footprint(cup: Cup, pose: Pose) -> list[Disc]:
    """List discs that cover the cup as seen from above."""
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


def _overlap(discs: Sequence[Disc], taken: Sequence[Disc]) -> bool:
    return any(np.hypot(x - a, y - b) < r + s + GAP_M for x, y, r in discs for a, b, s in taken)
