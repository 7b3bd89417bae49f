"""Small runs to be watched."""

import numpy as np

from halfseen.view.shapes import convex_mesh, shadow
from halfseen.view.stage_view import Hand, Option, Part, Shown, StageView, Watched

EYE_M = np.array([0.0, -0.8, 0.7])
SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def solid_at(x_m, y_m):
    return convex_mesh(np.array([x_m, y_m, 0.05]) + SIGNS * 0.04)


def shown(number, x_m, y_m, is_dirty):
    solid = solid_at(x_m, y_m)
    middle_m, revealed_m = np.array([x_m, y_m, 0.05]), np.array([[x_m, y_m + 0.1, 0.04]] * 5)
    return Shown(number, is_dirty, 0.25 * number, middle_m, solid, shadow(solid, EYE_M), revealed_m)


def stage_view(number, num_points=2000, *, has_arm=True):
    rng = np.random.default_rng(number)
    points_m = rng.uniform([-0.4, -0.3, 0.0], [0.4, 0.4, 0.01], (num_points, 3)).astype(np.float32)
    colours = rng.integers(0, 255, (num_points, 3)).astype(np.uint8)
    unseen = Shown(7, 0.5, 0.9, np.array([0.2, 0.2, 0.05]), None, None, np.zeros((0, 3)))
    objects = (shown(0, 0.0, 0.0, 0.9), shown(1, 0.0, 0.12, 0.2), unseen)
    hides = np.zeros((3, 3))
    hides[1, 0] = 0.4
    options = (Option("LIFT 0", 2.5, 1.0, 4.0, 0.8), Option("FINISH", -1.0))
    poses = np.tile([0.3, 0.3, 0.1 * number, 1.0, 0.0, 0.0, 0.0], (3, 1, 1)) if has_arm else np.zeros((0, 0, 7))
    way_m = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.08]])
    return StageView(
        f"stage {number} of 3",
        points_m,
        colours,
        EYE_M,
        objects,
        hides,
        options,
        "LIFT 0",
        f"LIFT 0: worth {number} more than <FINISH>",
        ("it may be doubted",),
        (f"tried: {number}", "seen: 1 looks dirty"),
        poses,
        Hand(way_m, way_m[-1], np.diag([1.0, -1.0, -1.0]), 0.08) if has_arm else None,
    )


def run(num_stages=3, **more):
    stages = tuple(stage_view(number + 1, **more) for number in range(num_stages))
    return Watched("a small run", stages, (Part(solid_at(0.0, 0.0), (150, 150, 160)),))
