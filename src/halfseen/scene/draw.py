"""Draw a table: cups dropped at random, kept if they lie well and each can be seen a little."""

from collections.abc import Sequence

import numpy as np

from halfseen.errors import SceneError
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.layout import GAP_M, draw_cup, draw_layout
from halfseen.scene.poses import Pose
from halfseen.scene.settle import settle, smallest_gap_m
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, Table
from halfseen.scene.truth import Truth, truth_of
from halfseen.scene.view import is_whole_in_picture, lone_depths_m, table_view
from halfseen.scene.xtion import XTION, loss_probability, xtion_at

NUM_CUPS = (5, 10)
MAX_OCCLUSION = 0.85
MIN_RETURNS_PX = 150
_NUM_PROPOSALS = 500
_RANGE_MARGIN_M = 0.1  # over three times the noise at the far end, where it is 3 cm
_EDGE_M = 0.04  # a cup's middle stays this far inside the table's edge


def random_table(seed: int) -> Table:
    """Draw a table with 5 to 10 cups at rest, some of them fallen.

    Proposals are drawn until one is kept: every cup rests on the table, stands or lies (none leans), is 1 cm or more
    from every other, lies whole in the picture, is at most 85 % hidden, and shows at least 150 pixels that are sure to
    return whatever the sensor's noise (lit by the projector, in range, not grazing).

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
        None of 500 proposals was kept.
    """
    rng = np.random.default_rng(seed)
    # The number is drawn once, so that rejection does not favour tables with few cups.
    num_cups = _num_cups(rng)
    for _ in range(_NUM_PROPOSALS):
        table = _propose(num_cups, f"table of seed {seed}", rng)
        if table is not None and _is_kept(table):
            return table
    raise SceneError(f"seed {seed}: none of {_NUM_PROPOSALS} tables with {num_cups} cups was kept; take another seed")


def num_cups_of(seed: int) -> int:
    """How many cups `random_table(seed)` has, without drawing it."""
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
    """Put a robot's head before the table: about 0.95 m from its middle, 25° to 32° below the horizontal."""
    target_m = np.array([rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), TABLE_TOP_M + 0.03])
    distance_m, down_rad, aside_rad = rng.uniform(0.92, 1.0), np.deg2rad(rng.uniform(25, 32)), rng.normal(0, 0.05)
    back = np.array([np.sin(aside_rad) * np.cos(down_rad), -np.cos(aside_rad) * np.cos(down_rad), np.sin(down_rad)])
    return look_at(target_m + distance_m * back, target_m)


def _is_kept(table: Table) -> bool:
    """Whether a proposal is a good table; the cheap questions come first."""
    if not (_is_on_table(table.cups, table.world_from_cup) and is_whole_in_picture(table)):
        return False
    if smallest_gap_m(table.cups, table.world_from_cup) < GAP_M:
        return False
    truth = truth_of(table, lone_depths_m(table))
    return bool(np.all(truth.occlusion <= MAX_OCCLUSION) and np.all(sure_returns_px(table, truth) >= MIN_RETURNS_PX))


def _is_on_table(cups: Sequence[Cup], world_from_cup: Sequence[Pose]) -> bool:
    """Whether every cup stands, or lies on the table top: not beside it, not on another, not leaning."""
    for cup, pose in zip(cups, world_from_cup, strict=True):
        x_m, y_m, z_m = pose.apply(np.array([[0.0, 0.0, cup.height_m / 2]]))[0]
        if abs(x_m) > TABLE_SIZE_M[0] / 2 - _EDGE_M or abs(y_m) > TABLE_SIZE_M[1] / 2 - _EDGE_M:
            return False
        upward = pose.rotation[2, 2]
        is_standing = upward > 0.995 and abs(z_m - TABLE_TOP_M - cup.height_m / 2) < 0.003
        is_lying = abs(upward) < 0.5 and z_m - TABLE_TOP_M < 1.1 * cup.rim_radius_m + cup.handle_m
        if not (is_standing or is_lying):
            return False
    return True


def sure_returns_px(table: Table, truth: Truth) -> np.ndarray:
    """Pixels of each cup that return whatever the noise: seen, lit by the projector, and not grazing [px].

    Parameters
    ----------
    table
        The table.
    truth
        Its truth.

    Returns
    -------
    numpy.ndarray
        (N,) counts.
    """
    view = table_view(table, XTION.baseline_m)
    is_sure = view.is_lit & (loss_probability(view.incidence_cosine) == 0)
    near_m, far_m = XTION.range_m
    is_sure &= (view.depth_m > near_m + _RANGE_MARGIN_M) & (view.depth_m < far_m - _RANGE_MARGIN_M)
    return np.array([np.sum(is_sure & (truth.labels == index)) for index in range(table.num_cups)])
