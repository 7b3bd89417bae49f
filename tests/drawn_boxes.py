"""Boxes on a table, drawn by casting rays: what is no cup, from beside and above."""

import numpy as np

from drawn_tables import EYE_M, TABLE_HALF_M, K, rays
from halfseen.perception import Cloud

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
        depth = np.minimum(depth, _hit(np.array(box), way))
    return Cloud.from_depth(np.where(np.isfinite(depth), depth, np.nan), K, "boxes")


def _hit(box, way):
    """Depth at which each ray enters a box; infinite where it does not."""
    turn = np.array([[np.cos(TURN_RAD), np.sin(TURN_RAD)], [-np.sin(TURN_RAD), np.cos(TURN_RAD)]])
    start = np.append(turn @ (EYE_M[:2] - box[:2]), EYE_M[2])
    ray = np.concatenate([way[..., :2] @ turn.T, way[..., 2:]], axis=-1)
    ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    low, high = np.array([-box[2], -box[3], 0.0]), np.array([box[2], box[3], box[4]])
    one, other = (low - start) / ray, (high - start) / ray
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
