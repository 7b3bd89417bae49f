"""A world whose laws were fitted to the log that a policy is learned from: what a fair planner knows.

A planner that knows the true laws is an oracle; who runs a cell has no true law. She knows what she pays for, how many
steps a trajectory may have, how long transport takes and when an attempt is given up; and she has the log. It tells of
which family the laws are, too.

Read down: `evidence` (logs → attempts, as far as each was watched, and what looks said; what all fits maximise) →
`grasping` and `seeing`, two families of laws each → `recorder` (whose law made the log-odds); and `prices`.
"""

from dataclasses import replace
from typing import NamedTuple

from halfseen.logs import Logs
from halfseen.planners.belief import known_seeing
from halfseen.tables.laws.evidence import Evidence, evidence_of
from halfseen.tables.laws.grasping import choose_grasping
from halfseen.tables.laws.recorder import seeing_of
from halfseen.world.config import WorldConfig


def fit_world(logs: Logs, known: WorldConfig) -> WorldConfig:
    """Fit laws of grasping and seeing to a log, under censoring, each by maximum likelihood.

    Of each there are two families, and the log chooses (`halfseen.tables.laws`): `AssumedGrasping` or
    `FittedGrasping`, `AssumedSeeing` or `PersistentSeeing`.

    Parameters
    ----------
    logs
        A log of tables.
    known
        Of which rewards, horizon, transport_s and the limit of an attempt are kept. Its laws are not looked at, and may
        be any.

    Returns
    -------
    WorldConfig
        With the fitted laws, and the share of dirty objects as `logged_dirty_share` reads it.

    Raises
    ------
    LogError
        The log breaks a rule of tables.

    Examples
    --------
    >>> import numpy as np
    >>> from halfseen.world import Scene, TableWorld, UniformPolicy, WorldConfig
    >>> scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]))
    >>> logs = TableWorld().simulate(scene, UniformPolicy(), episodes=400, seed=0, cut_share=0.5)
    >>> fitted = fit_world(logs, WorldConfig())
    >>> fitted.grasping.limit_s, round(fitted.seeing.accuracy(0.0), 1)
    (6.0, 0.8)
    """
    return fitted_to(evidence_of(logs, known), known)


def fitted_to(evidence: Evidence, known: WorldConfig) -> WorldConfig:
    """Fit the laws to what a log tells of them."""
    return fitted_laws(evidence, known).config


class FittedLaws(NamedTuple):
    """A world with laws that were fitted to a log, and what became of the recorder's."""

    config: WorldConfig
    is_mended: bool
    """Whether the log's own log-odds are not to be trusted."""
    sentence: str


def fitted_laws(evidence: Evidence, known: WorldConfig, prior: WorldConfig | None = None) -> FittedLaws:
    """Fit the laws to what a log tells of them.

    Parameters
    ----------
    evidence
        What it tells.
    known
        As `fit_world` takes it.
    prior
        Laws about which these are fitted; None for weak priors.
    """
    limit_s, told = float(known.grasping.limit_s), evidence.told
    grasping = choose_grasping(evidence.tried, limit_s, None if prior is None else prior.grasping)
    seen = seeing_of(told, evidence.dirty_share, None if prior is None else known_seeing(prior))
    config = replace(known, dirty_share=evidence.dirty_share, grasping=grasping, seeing=seen.law)
    is_mended = len(told.trajectory) > 0 and (seen.recorder is None or seen.is_rejected)
    family = "looks that show nothing new are no news" if told.is_persistent else "each look is news"
    if not len(told.trajectory):
        how = "no label tells how looks err"
    elif seen.recorder is None:
        how = f"no one law of seeing made the log’s log-odds: it is fitted to the labels ({family}), log-odds made anew"
    elif seen.is_rejected:
        how = "the labels contradict the recorder’s law of seeing: it is fitted to them, log-odds made anew"
    else:
        how = f"the law of seeing is read from the log’s own log-odds ({family}); its labels do not contradict it"
    return FittedLaws(config, is_mended, how)
