"""Logs that lack some of their covariates."""

import numpy as np

from halfseen.logs import Logs
from halfseen.logs.missing import KEEP, Missing
from text_logs import text_log

COLUMNS = ("x", "colour", "is_heavy")


def holed(logs, share=0.1, seed=0, columns=COLUMNS, missing: Missing = KEEP):
    """The same log without some values of some columns, whatever they are."""
    rng, stages = np.random.default_rng(seed), logs.stages.copy()
    for name in columns:
        is_lost = rng.uniform(size=len(stages)) < share
        stages[name] = stages[name].astype(object).where(~is_lost, None)
    return Logs(stages, logs.trajectories, logs.objects, missing=missing)


def holed_log(share=0.1, seed=0, missing: Missing = KEEP, **more):
    """A log with a number, text and a truth value, of which some are missing."""
    return holed(text_log(seed=seed, **more), share, seed, missing=missing)
