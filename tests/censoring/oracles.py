"""Slow and plain: the definitions, written as loops."""

import numpy as np
from hypothesis import strategies as st


def naive_survival(time, is_finished, u):
    """P(C ≥ u): the product over all times of a cut before u."""
    survival = 1.0
    for s in sorted(set(time)):
        if s < u:
            watched = sum(1 for x, d in zip(time, is_finished, strict=True) if x > s or (x == s and not d))
            cuts = sum(1 for x, d in zip(time, is_finished, strict=True) if x == s and not d)
            if cuts:
                survival *= 1.0 - cuts / watched
    return survival


def naive_event_survival(time, is_finished, u):
    """P(T > u), the usual Kaplan–Meier curve of the paths' own ends."""
    survival = 1.0
    for s in sorted(set(time)):
        if s <= u:
            at_risk = sum(1 for x in time if x >= s)
            events = sum(1 for x, d in zip(time, is_finished, strict=True) if x == s and d)
            survival *= 1.0 - events / at_risk
    return survival


@st.composite
def tied_ends(draw, min_size=1):
    """Ends on a coarse clock, so that finishes and cuts fall together."""
    rows = draw(st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=min_size, max_size=30))
    time, is_finished = zip(*rows, strict=True)
    return np.array(time, dtype=float), np.array(is_finished, dtype=bool)
