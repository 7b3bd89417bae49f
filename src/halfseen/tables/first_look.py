"""Dirt after one look at a table: labels, and P(DIRTY) given them. All displays share this module."""

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
"""P(DIRTY) before any label, unless a policy specifies another."""


class FirstLook(NamedTuple):
    """Labels of a view, and P(DIRTY) given them."""

    labels: Sequence[Label] | None
    """One for each object; None if there is neither colour nor a file."""
    chances: list[float]
    """P(DIRTY) of each object; the prior for unlabelled ones."""
    words: str
    """Both in a sentence; empty without labels."""


def first_look(
    view: View,
    cloud: Cloud,
    file: Path | None = None,
    dirty_share: float = PRIOR,
    seeing: KnownSeeing = AssumedSeeing(),  # noqa: B008 - frozen
) -> FirstLook:
    """Label the objects of a view, from a file or else by colour, and compute P(DIRTY) of each.

    Parameters
    ----------
    view, cloud
        The cloud, and the objects segmented in it.
    file
        Labels, in the format of `halfseen.perception.read_labels`.
    dirty_share
        P(DIRTY) before any label, in (0, 1).
    seeing
        The accuracy of labels.

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
    """P(DIRTY) of each object given all labels so far."""
    return expit(np.asarray(present.state.log_odds, dtype=np.float64)).tolist()


def labels_in_words(labels: Sequence[Label], file: Path | None) -> str:
    """List the objects of each label, and the source of the labels.

    `file` is the file that they were read from; None for labels by colour.
    """
    named = {word: [k for k, label in enumerate(labels) if label.word == word] for word in WORDS.values()}
    listed = "; ".join(f"{word}: {', '.join(map(str, objects))}" for word, objects in named.items() if objects)
    return f"Labels by {'colour' if file is None else file} ({listed})"


def chances_in_words(present: Present) -> str:
    """P(DIRTY) of each object, in words."""
    return f"P(dirty) is {', '.join(f'{k}: {chance:.2f}' for k, chance in enumerate(chances_of(present)))}"
