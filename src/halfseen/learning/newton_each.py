"""Minimise several smooth functions of few numbers at once, by Newton steps of bounded length.

Where a function is not convex, the eigenvalues of its Hessian are taken by their size, so that each step leads downhill
[NocedalWright2006]_. A step that did not lower its function is taken again, shorter; functions that are done wait for
the others.
"""

from collections.abc import Callable

import numpy as np

from halfseen.shapes import Float

Thetas = Float[np.ndarray, "K p"]
Derivatives = tuple[Float[np.ndarray, " K"], Thetas, Float[np.ndarray, "K p p"]]
"""Of each function: its value, gradient and Hessian."""

MAX_STEPS = 200
ENOUGH = 1e-12
"""A step that promises less than this share of the value, and 1, is the last."""
LONGEST = 2.0
"""A step changes no number by more than this at first, and by no more than it later."""
_SHORTEST, _SHORTER, _LONGER = 1e-9, 0.25, 2.0


def minimise_each(derivatives: Callable[[Thetas], Derivatives], start: Thetas) -> Thetas:
    """Find a minimum of each function from its own start.

    Parameters
    ----------
    derivatives
        Of all K functions at K places.
    start
        Where to begin.
    """
    theta, reach = start.copy(), np.full(len(start), LONGEST)
    value, gradient, hessian = derivatives(theta)
    for _ in range(MAX_STEPS):
        step = _downhill(gradient, hessian)
        promise = -(gradient * step).sum(axis=1)
        is_open = (promise > ENOUGH * (1.0 + np.abs(value))) & (reach > _SHORTEST)
        if not is_open.any():
            # What rounding hides in the values still shows in the gradients.
            return theta + np.where((reach > _SHORTEST)[:, None], step, 0.0)
        length = np.abs(step).max(axis=1)
        step = np.where(is_open[:, None], step * np.minimum(1.0, reach / np.maximum(length, _SHORTEST))[:, None], 0.0)
        tried = derivatives(theta + step)
        is_better = is_open & (tried[0] <= value)
        theta = np.where(is_better[:, None], theta + step, theta)
        value = np.where(is_better, tried[0], value)
        gradient = np.where(is_better[:, None], tried[1], gradient)
        hessian = np.where(is_better[:, None, None], tried[2], hessian)
        shorter = _SHORTER * np.minimum(reach, length)
        reach = np.where(is_better, np.minimum(_LONGER * reach, LONGEST), np.where(is_open, shorter, reach))
    return theta


def _downhill(gradient: Thetas, hessian: Float[np.ndarray, "K p p"]) -> Thetas:
    size, axes = np.linalg.eigh(hessian)
    along = np.einsum("kij,ki->kj", axes, gradient) / np.maximum(np.abs(size), np.finfo(float).tiny)
    return -np.einsum("kij,kj->ki", axes, along)
