"""Draws as a function of (seed, episode, step): the counter-based generator Threefry-2×32 [Salmon2011]_.

A key is two 32-bit words, the last axis of an array with any leading axes; each member of a batch draws from its own
key. Draws have no state, so they do not depend on batch size, backend or number of workers. NumPy and JAX compute the
same bits, those of `jax.random` with its default generator.
"""

import math
from typing import Any

import numpy as np

from halfseen.arrays import first_last, library_of
from halfseen.shapes import Bool, Float, Int, UInt32

Key = UInt32[Any, "*B 2"]
_PARITY = np.uint32(0x1BD11BDA)
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_TURNS = [[(np.array(by, dtype=np.uint32), np.array(32 - by, dtype=np.uint32)) for by in of] for of in _ROTATIONS]
"""Left and right shifts of each rotation; NumPy handles zero-dimensional arrays faster than scalars."""
_CENTRAL = (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503)
_CENTRAL += (-0.00417768164, 0.246640727, 1.50140941)
_TAIL = (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613)
_TAIL += (0.00943887047, 1.00167406, 2.83297682)
_TINY = float(np.finfo(np.float32).tiny)
_ABOVE_MINUS_1 = float(np.nextafter(np.float32(-1.0), np.float32(0.0)))


def key_of(seed: int) -> UInt32[np.ndarray, "2"]:
    """Key of a seed: its two 32-bit words."""
    return np.array([(int(seed) >> 32) & 0xFFFFFFFF, int(seed) & 0xFFFFFFFF], dtype=np.uint32)


def fold_in(key: UInt32[Any, "*#B 2"], number: Int[Any, "*#B"] | int) -> UInt32[Any, "*S 2"]:
    """Derive the key of a numbered part: an episode, a step, an object."""
    xp = library_of(key, number)
    word, one, other = xp.asarray(number).astype(np.uint32), key[..., 0], key[..., 1]
    word = word.reshape((1,) * (max(one.ndim - word.ndim, 0) + 1) + word.shape)
    return first_last(xp.stack(_threefry(one, other, word))[:, 0])


def split(key: Key, num: int = 2) -> tuple[Key, ...]:
    """Split a key into `num` keys for independent draws."""
    numbers = library_of(key).arange(num).reshape((num,) + (1,) * (key.ndim - 1))
    return tuple(fold_in(key[None], numbers))


def keys_of(key: Key, num: int) -> UInt32[Any, "*B S 2"]:
    """Split each key into `num` keys along a new axis."""
    return fold_in(key[..., None, :], library_of(key).arange(num))


def uniform(key: Key, *shape: int) -> Float[Any, "*S"]:
    """Draw uniformly from [0, 1), an array of `shape` for each key; float32."""
    words = _words(key, shape)
    # A float32 in [1, 2) holds 23 of the 32 bits.
    return (words >> np.uint32(9)).astype(np.float32) * np.float32(2.0**-23)


def _between(key: Key, shape: tuple[int, ...], low: float) -> Any:
    """Draw uniformly from [low, 1)."""
    least = np.float32(low)
    found = uniform(key, *shape) * (np.float32(1.0) - least) + least
    return library_of(found).maximum(found, least)


def exponential(key: Key, *shape: int) -> Float[Any, "*S"]:
    """Draw from Exp(1)."""
    drawn = uniform(key, *shape)
    return -library_of(drawn).log1p(-drawn)


def log_uniform(key: Key, *shape: int) -> Float[Any, "*S"]:
    """Draw the logarithm of a uniform number in [0, 1), which may be −∞."""
    drawn = uniform(key, *shape)
    xp = library_of(drawn)
    return xp.where(drawn > 0.0, xp.log(xp.where(drawn > 0.0, drawn, np.float32(1.0))), np.float32(-np.inf))


def normal(key: Key, *shape: int) -> Float[Any, "*S"]:
    """Draw from N(0, 1), by the inverse error function [Giles2012]_."""
    drawn = _between(key, shape, _ABOVE_MINUS_1)
    xp = library_of(drawn)
    width = -xp.log1p(-drawn * drawn)
    is_central = width < 5.0
    near, far = width - np.float32(2.5), xp.sqrt(xp.maximum(width, np.float32(5.0))) - np.float32(3.0)
    inverse = xp.where(is_central, _polynomial(_CENTRAL, near), _polynomial(_TAIL, far)) * drawn
    return np.float32(math.sqrt(2.0)) * inverse


def _polynomial(coefficients: tuple[float, ...], at: Any) -> Any:
    total = np.float32(coefficients[0])
    for coefficient in coefficients[1:]:
        total = np.float32(coefficient) + total * at
    return total


def categorical(key: Key, logits: Float[Any, "*S A"]) -> Int[Any, "*S"]:
    """Draw an index with probabilities proportional to exp(logits), by the Gumbel-max trick.

    If logits have more leading axes than the keys, each row has its own draw.
    """
    xp = library_of(key, logits)
    drawn = _between(key, logits.shape[key.ndim - 1 :], _TINY)
    return xp.argmax(logits - xp.log(-xp.log(drawn)), axis=-1).astype(np.int32)


def one_of(key: Key, is_possible: Bool[Any, "*B A"]) -> Int[Any, "*B"]:
    """Draw one of the possible indices, each with the same probability."""
    xp = library_of(key, is_possible)
    # Equals `categorical` with equal logits: its scaling and logarithms do not change the order of the draws.
    drawn = (_words(key, is_possible.shape[-1:]) >> np.uint32(9)).astype(np.int32)
    drawn = xp.where(is_possible, drawn, np.int32(-1))
    # On booleans, NumPy's argmax stops at the first and makes no copy.
    return xp.argmax(drawn == xp.max(drawn, axis=-1, keepdims=True), axis=-1).astype(np.int32)


def _words(key: Key, shape: tuple[int, ...]) -> UInt32[Any, "*S"]:
    xp, num = library_of(key), math.prod(shape)
    one, other = key[..., 0], key[..., 1]
    count = xp.arange(num, dtype=np.uint32).reshape((num,) + (1,) * one.ndim)
    first, second = _threefry(one, other, count)
    # Memory layout as in `state.batch_last`.
    return first_last(first ^ second).reshape(key.shape[:-1] + shape)


def _threefry(one: Any, other: Any, second: Any) -> tuple[Any, Any]:
    """Threefry-2×32 with 20 rounds: the counter (0, second) under a key of two words; at least one axis."""
    words = (one, other, one ^ other ^ _PARITY)
    first, second = one + (second & np.uint32(0)), second + other
    for group in range(5):
        for left, right in _TURNS[group % 2]:
            first = first + second
            second = ((second << left) | (second >> right)) ^ first
        # The key schedule adds to both words after every four rounds.
        first, second = first + words[(group + 1) % 3], second + words[(group + 2) % 3] + np.uint32(group + 1)
    return first, second
