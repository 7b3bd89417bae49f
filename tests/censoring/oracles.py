"""Slow and plain: the definitions, written as loops."""

from fractions import Fraction

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
    """P(T > u), the usual Kaplan–Meier curve of the trajectories' own ends."""
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


def naive_cox(time, is_finished, covariates, beta, ties):
    """Log partial likelihood of the cuts, and the steps of the baseline at z = 0, at each cut time."""
    rows = range(len(time))
    risk = [float(np.exp(np.dot(covariates[i], beta))) for i in rows]
    log_likelihood, steps = 0.0, {}
    for s in sorted({time[i] for i in rows if not is_finished[i]}):
        cuts = [i for i in rows if time[i] == s and not is_finished[i]]
        watched = sum(risk[i] for i in rows if time[i] > s or i in cuts)
        steps[s] = 0.0
        for place, i in enumerate(cuts):
            gone = place / len(cuts) * sum(risk[j] for j in cuts) if ties == "efron" else 0.0
            log_likelihood += np.dot(covariates[i], beta) - np.log(watched - gone)
            steps[s] += 1.0 / (watched - gone)
    return log_likelihood, steps


def naive_local_survival(time, is_finished, covariates, u, z, bandwidth):
    """Kaplan–Meier of the cuts with Gaussian weights around z; covariates and z are standardised."""
    rows = range(len(time))
    near = [np.exp(-sum((covariates[i] - z) ** 2) / (2 * bandwidth**2)) for i in rows]
    survival = 1.0
    for s in sorted({time[i] for i in rows if not is_finished[i]}):
        if s < u:
            cut = sum(near[i] for i in rows if time[i] == s and not is_finished[i])
            watched = sum(near[i] for i in rows if time[i] > s or (time[i] == s and not is_finished[i]))
            survival *= 1.0 - cut / watched
    return survival


def redistribute_to_the_right(time, is_finished):
    """Efron's picture: each cut trajectory hands its mass to those still watched, ties excepted."""
    order = sorted(range(len(time)), key=lambda i: (time[i], not is_finished[i]))
    mass = [Fraction(1, len(time))] * len(time)
    for s in sorted(set(time)):
        cuts = [i for i in order if time[i] == s and not is_finished[i]]
        heirs = [i for i in order if time[i] > s]
        for i in cuts:
            for heir in heirs:
                mass[heir] += mass[i] / len(heirs)
            mass[i] = Fraction(0)
    return mass
