"""Tables drawn by casting rays at planes, cylinders, boxes and cards: depth images whose truth can be worked out."""

from dataclasses import dataclass

import numpy as np

from halfseen.perception import Cloud

NUM_ROWS, NUM_COLUMNS = 240, 320
K = np.array([[290.0, 0.0, 159.5], [0.0, 290.0, 119.5], [0.0, 0.0, 1.0]])
EYE_M = np.array([0.0, -0.75, 0.50])  # over the table: right, away, up
DOWN_RAD = np.deg2rad(33.0)
PROJECTOR_M = EYE_M + np.array([0.075, 0.0, 0.0])
TABLE_HALF_M = (0.45, 0.32)
# Rows are the camera's right, down and forward in the frame of the table.
TABLE_FROM_CAMERA = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, -np.sin(DOWN_RAD), -np.cos(DOWN_RAD)],
        [0.0, np.cos(DOWN_RAD), -np.sin(DOWN_RAD)],
    ]
).T


@dataclass(frozen=True)
class Can:
    """A standing cylinder, open at the top or closed."""

    x_m: float
    y_m: float
    radius_m: float = 0.04
    height_m: float = 0.10
    is_open: bool = True


@dataclass(frozen=True, eq=False)
class Drawn:
    cloud: Cloud
    depth_m: np.ndarray
    labels: np.ndarray
    silhouettes: np.ndarray
    occlusion: np.ndarray


def rays() -> np.ndarray:
    """Directions in the frame of the table, with 1 along the optical axis."""
    row, column = np.mgrid[:NUM_ROWS, :NUM_COLUMNS]
    seen = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones(row.shape)], axis=-1)
    return seen @ TABLE_FROM_CAMERA.T


def hit_can(can: Can, origin: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Distance in units of `way` to the first meeting with a can; infinite where there is none."""
    first = np.full(way.shape[:-1], np.inf)
    start = origin[..., :2] - [can.x_m, can.y_m]
    a, b = (way[..., :2] ** 2).sum(-1), (start * way[..., :2]).sum(-1)
    for radius in (can.radius_m, can.radius_m - 0.003) if can.is_open else (can.radius_m,):
        inside = b**2 - a * ((start**2).sum(-1) - radius**2)
        root = np.sqrt(np.maximum(inside, 0.0))
        for t in ((-b - root) / a, (-b + root) / a):
            height = origin[..., 2] + t * way[..., 2]
            met = (inside > 0) & (t > 1e-6) & (height >= 0) & (height <= can.height_m)
            first = np.where(met & (t < first), t, first)
    t = ((0.005 if can.is_open else can.height_m) - origin[..., 2]) / way[..., 2]
    across = start + t[..., None] * way[..., :2]
    met = (t > 1e-6) & ((across**2).sum(-1) <= can.radius_m**2)
    return np.where(met & (t < first), t, first)


def hit_room(origin: np.ndarray, way: np.ndarray, is_bare: bool, wall_m: float) -> np.ndarray:
    """Distance to the table, and unless bare to the floor below and the wall behind."""
    t = -origin[..., 2] / way[..., 2]
    across = origin[..., :2] + t[..., None] * way[..., :2]
    first = np.where((t > 0) & (np.abs(across) <= TABLE_HALF_M).all(-1), t, np.inf)
    if is_bare:
        return first
    floor, wall = (-0.72 - origin[..., 2]) / way[..., 2], (wall_m - origin[..., 1]) / way[..., 1]
    for t in (floor, wall):
        first = np.where((t > 0) & (t < first), t, first)
    return first


def draw(
    *cans: Can,
    has_shadow: bool = False,
    is_bare: bool = False,
    noise_m: float = 0.0,
    seed: int = 0,
    name: str = "drawn",
    wall_m: float = 1.4,
) -> Drawn:
    way = rays()
    origin = np.broadcast_to(EYE_M, way.shape)
    alone = np.stack([hit_can(can, origin, way) for can in cans]) if cans else np.zeros((0, *way.shape[:2]))
    stacked = np.concatenate([hit_room(origin, way, is_bare, wall_m)[None], alone])
    depth, labels = stacked.min(axis=0), stacked.argmin(axis=0) - 1
    silhouettes = np.isfinite(alone)
    seen = np.array([(labels == i).sum() for i in range(len(cans))])
    occlusion = 1.0 - seen / silhouettes.sum(axis=(1, 2))
    returned = np.isfinite(depth)
    if has_shadow:
        points = EYE_M + np.where(returned, depth, 0.0)[..., None] * way
        ray = points - PROJECTOR_M
        lamp = np.broadcast_to(PROJECTOR_M, ray.shape)
        for can in cans:
            returned &= hit_can(can, lamp, ray) > 0.995
    depth = np.where(returned, depth, np.nan)
    if noise_m:
        depth = depth + noise_m * np.random.default_rng(seed).standard_normal(depth.shape)
    return Drawn(Cloud.from_depth(depth, K, name), depth, labels, silhouettes, occlusion)


def camera_point(table_m: np.ndarray) -> np.ndarray:
    return (np.asarray(table_m) - EYE_M) @ TABLE_FROM_CAMERA


TURN_RAD = 0.6
BOXES_M = ((-0.16, 0.0, 0.05, 0.035, 0.11), (0.12, -0.04, 0.04, 0.06, 0.09))
"""Each box: middle (right, away), half its width and depth, and its height [m]."""


def boxes_cloud(boxes_m=BOXES_M):
    """What a camera sees of boxes that are turned by 0.6 radians."""
    way = rays()
    depth = -EYE_M[2] / np.where(way[..., 2] < 0, way[..., 2], -1e-9)
    across = EYE_M[:2] + depth[..., None] * way[..., :2]
    depth[(np.abs(across) > TABLE_HALF_M).any(axis=-1)] = np.inf
    for box in boxes_m:
        depth = np.minimum(depth, hit_box(np.array(box), way))
    return Cloud.from_depth(np.where(np.isfinite(depth), depth, np.nan), K, "boxes")


def hit_box(box, way):
    """Depth at which each ray enters a box; infinite where it does not."""
    turn = np.array([[np.cos(TURN_RAD), np.sin(TURN_RAD)], [-np.sin(TURN_RAD), np.cos(TURN_RAD)]])
    start = np.append(turn @ (EYE_M[:2] - box[:2]), EYE_M[2])
    ray = np.concatenate([way[..., :2] @ turn.T, way[..., 2:]], axis=-1)
    ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    low, high = np.array([-box[2], -box[3], 0.0]), np.array([box[2], box[3], box[4]])
    one, other = (low - start) / ray, (high - start) / ray
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


TWO_CARDS = ((-0.05, 0.06, 0.8), (0.0, 0.12, 0.95))
"""Each card of 12 cm: left, right, and how far ahead [m]; the first stands before the second."""


def depth_of_cards(*cards, shape=(240, 320), k=K):
    """Depth image [m]; NaN where nothing returns."""
    row, column = np.indices(shape)
    down, across = (row - k[1, 2]) / k[1, 1], (column - k[0, 2]) / k[0, 0]
    scale = np.cos(0.6) - np.sin(0.6) * down
    down = np.tan(np.arctan(down) + 0.6)
    forward = np.where(down > 0.01, 0.6 / np.maximum(down, 0.01), np.inf)
    forward[(forward > 1.6) | (forward < 0.3)] = np.nan
    for left, right, ahead in cards:
        aside, drop = across / scale * ahead, down * ahead
        is_card = (aside > left) & (aside < right) & (drop > 0.48) & (drop < 0.6)
        forward = np.where(is_card & ~(forward < ahead), ahead, forward)
    return np.where(np.isfinite(forward), forward / scale, np.nan)
