"""How far the lower confidence bounds of Q lie below it: ‖Mᵀ (1, φ)‖ of every action, M by steps to go and verb."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import Array, library_of


def margins(
    margin: Float[Array, "T K F F"],
    features: Float[Array, "*B A F1"],
    to_go: Int[Array, "*B"],
    blocks: Sequence[slice],
) -> Float[Array, "*B A"]:
    """Length of the deviations of every action.

    Parameters
    ----------
    margin
        M.
    features
        φ, without the constant.
    to_go
        Which M of the T.
    blocks
        Where the actions of each of the K blocks stand.
    """

    def length(each: Any, of: Any) -> Any:
        return library_of(of).sqrt(library_of(of).sum(_deviations(each, of, blocks) ** 2, axis=-1))

    return _by_steps(length, margin, features, to_go)


def deviations(
    margin: Float[Array, "T K F F"],
    features: Float[Array, "*B A F1"],
    to_go: Int[Array, "*B"],
    blocks: Sequence[slice],
) -> Float[Array, "*B A F"]:
    """Mᵀ (1, φ) of every action; parameters as `margins` has them."""
    return _by_steps(lambda each, of: _deviations(each, of, blocks), margin, features, to_go)


def _by_steps(
    asked: Callable[[Any, Any], Any], margin: Float[Array, "T K F F"], features: Any, to_go: Int[Array, "*B"]
) -> Any:
    """Ask for the states of each number of steps to go at once: to copy an M for each state takes far longer."""
    xp = library_of(margin, features, to_go)
    if xp is not np:
        return asked(xp.take(margin, to_go, axis=0), features)
    steps = np.unique(to_go)
    if len(steps) == 1:
        return asked(margin[steps[0]], features)
    states, place = features.reshape(-1, *features.shape[-2:]), np.ravel(to_go)
    order = np.argsort(place, kind="stable")
    found = np.concatenate([asked(margin[step], states[place == step]) for step in steps])
    return found[np.argsort(order)].reshape(*features.shape[:-1], *found.shape[2:])


def _deviations(margin: Any, features: Any, blocks: Sequence[slice]) -> Any:
    each = [margin[..., k, :1, :] + features[..., block, :] @ margin[..., k, 1:, :] for k, block in enumerate(blocks)]
    return library_of(features, margin).concatenate(each, axis=-2)
