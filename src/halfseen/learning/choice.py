"""How likely each action is in a choice among those that are possible, how far that is from chance, and which count."""

from typing import Any

from jaxtyping import Bool, Float

from halfseen.arrays import library_of


def choice_probabilities(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """How likely each action is; 0 where it is not possible."""
    xp = library_of(utility)
    among = xp.where(is_possible, utility, -xp.inf)
    odds = xp.exp(among - among.max(axis=-1, keepdims=True))
    return odds / odds.sum(axis=-1, keepdims=True)


def leaning(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """How far the choice is from chance towards each action: 0 at one time in k or less, 1 at always.

    k counts the actions that there are to choose from.
    """
    xp = library_of(utility)
    chance = 1.0 / xp.maximum(is_possible.sum(axis=-1, keepdims=True), 2)
    return xp.clip((choice_probabilities(utility, is_possible) - chance) / (1.0 - chance), 0.0, 1.0)


def seen_among(allowed: Bool[Any, "*S A"], seen: Bool[Any, "*T A"]) -> Bool[Any, "*S A"]:
    """Keep the actions that were seen; all that are allowed where none was."""
    both = allowed & seen
    return both | (allowed & ~both.any(axis=-1, keepdims=True))
