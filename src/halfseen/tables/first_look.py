"""What one look at a table tells of dirt: labels, and P(DIRTY) after them; the same wherever it is shown."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.perception.clouds import Cloud
from halfseen.perception.labels import WORDS, Label, labels_of
from halfseen.perception.view import View
from halfseen.tables.present import Present, first_state, labelled
from halfseen.world.config import WorldConfig
from halfseen.world.seeing import AssumedSeeing, KnownSeeing

PRIOR = float(WorldConfig.dirty_share)
"""P(DIRTY) before any label, where no policy says another."""


class FirstLook(NamedTuple):
    """Labels of a view, and what they tell."""

    labels: Sequence[Label] | None
    """One an object; None where there is neither colour nor a file."""
    chances: list[float]
    """P(DIRTY) of each object; the prior where nothing can be told."""
    words: str
    """Both in a sentence; empty without labels."""


def first_look(
    view: View,
    cloud: Cloud,
    file: Path | None = None,
    dirty_share: float = PRIOR,
    seeing: KnownSeeing = AssumedSeeing(),  # noqa: B008 - frozen
) -> FirstLook:
    """Label what is seen, as a file says or else by colour, and say how likely each object is dirty.

    Parameters
    ----------
    view, cloud
        The cloud, and what was seen in it.
    file
        Labels, as `halfseen.perception.read_labels` takes them.
    dirty_share
        P(DIRTY) before any label, in (0, 1).
    seeing
        What labels tell.

    Raises
    ------
    ArgumentError
        The file cannot be read, or does not label these objects.
    """
    labels, now = labels_of(view, cloud, file), first_state(view.scene(), 1, dirty_share)
    if labels is None:
        return FirstLook(None, chances_of(now), "")
    now = labelled(now, [label.is_dirty for label in labels], seeing)
    return FirstLook(labels, chances_of(now), f"{labels_in_words(labels, file)}; {chances_in_words(now)}.")


def chances_of(present: Present) -> list[float]:
    """P(DIRTY) of each object, by all labels so far."""
    return expit(np.asarray(present.state.log_odds, dtype=np.float64)).tolist()


def labels_in_words(labels: Sequence[Label], file: Path | None) -> str:
    """Say which objects look how, and by what.

    `file` is where they were read; None for those by colour.
    """
    named = {word: [k for k, label in enumerate(labels) if label.word == word] for word in WORDS.values()}
    listed = "; ".join(f"{word}: {', '.join(map(str, objects))}" for word, objects in named.items() if objects)
    return f"Labels by {'colour' if file is None else file} ({listed})"


def chances_in_words(present: Present) -> str:
    """Say how likely each object is dirty."""
    return f"P(dirty) is {', '.join(f'{k}: {chance:.2f}' for k, chance in enumerate(chances_of(present)))}"
