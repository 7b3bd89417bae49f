"""Which tables are learned from, and which are held out; no table is ever both."""

from typing import NamedTuple

import numpy as np

from halfseen.shapes import Int
from halfseen.study.experiments.attempts.design import AttemptsDesign


class Split(NamedTuple):
    """Numbers of tables."""

    learned: Int[np.ndarray, " l"]
    """In the order in which they join the log that is learned from: smaller logs are their beginnings."""
    held_out: Int[np.ndarray, " h"]
    """Sorted."""


def split_of(design: AttemptsDesign, tables: Int[np.ndarray, " t"], seed: int, index: int) -> Split:
    """Deal the tables of a repetition; `design.num_folds` repetitions in a row hold out each table once.

    Parameters
    ----------
    design
        Number of folds.
    tables
        Their numbers, each once.
    seed, index
        Of the study, and of the repetition; nothing else decides.
    """
    deal, fold = divmod(index, design.num_folds)
    order = np.random.default_rng([seed, deal]).permutation(np.sort(tables))
    is_held_out = np.arange(len(order)) % design.num_folds == fold
    learned = np.random.default_rng([seed, deal, fold + 1]).permutation(order[~is_held_out])
    return Split(learned, np.sort(order[is_held_out]))


def sizes_of(design: AttemptsDesign, num_tables: int) -> tuple[int, ...]:
    """Sizes of logs that can be learned from in every repetition; all there is if none of the design's can."""
    most = num_tables - -(-num_tables // design.num_folds)
    return tuple(size for size in design.num_tables if size <= most) or (most,)
