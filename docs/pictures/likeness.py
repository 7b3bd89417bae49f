"""Whether two pictures are alike: other machines round other digits, and nobody sees those."""

import io
import re

import numpy as np
from PIL import Image, ImageSequence

MOST_LEVELS = 24
"""Levels of grey, of 255, that a pixel may differ by."""
MOST_SHARE, MOST_SHARE_OF_FILM = 0.002, 0.005
"""Share of the pixels that may differ by more. Of a film more may: what a cell sees is another in its last digits where
another processor rounds, and what is completed from that moves 0.003 of the pixels."""
MOST_UNITS = 0.5
"""By so much numbers of a drawing may differ: in an SVG of ours they are points."""
_NUMBER = re.compile(rb"-?\d+\.\d+(?:e-?\d+)?|-?\d+")


def are_alike(kept: bytes, made: bytes) -> bool:
    """Whether two pictures of one kind look the same."""
    if kept == made:
        return True
    if kept.lstrip().startswith(b"<"):
        return _are_alike_drawings(kept, made)
    frames, others = _frames(kept), _frames(made)
    share = MOST_SHARE if len(frames) == 1 else MOST_SHARE_OF_FILM
    return len(frames) == len(others) and all(
        _are_alike_pixels(frame, other, share) for frame, other in zip(frames, others, strict=True)
    )


def _are_alike_drawings(kept: bytes, made: bytes) -> bool:
    """Compare two SVGs: the same words and marks, at nearly the same places."""
    # The identities that Matplotlib gives hang on all digits of what they name.
    texts = [re.sub(rb'(?:id="|#)[mpc][0-9a-f]{10}', b"", text) for text in (kept, made)]
    if _NUMBER.sub(b"0", texts[0]) != _NUMBER.sub(b"0", texts[1]):
        return False
    numbers = [np.array([float(number) for number in _NUMBER.findall(text)]) for text in texts]
    return bool(np.all(np.abs(numbers[0] - numbers[1]) <= MOST_UNITS))


def _frames(content: bytes) -> list[np.ndarray]:
    with Image.open(io.BytesIO(content)) as image:
        return [np.asarray(frame.convert("RGB"), dtype=np.int16) for frame in ImageSequence.Iterator(image)]


def _are_alike_pixels(kept: np.ndarray, made: np.ndarray, most_share: float) -> bool:
    if kept.shape != made.shape:
        return False
    return float((np.abs(kept - made).max(axis=-1) > MOST_LEVELS).mean()) <= most_share
