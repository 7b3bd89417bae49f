"""The attempts of cut episodes, as `halfseen.tables.attempts` reads them from their log, without writing it."""

import numpy as np
import pandas as pd

from halfseen.world.actions import FINISH, ActionSpace
from halfseen.world.cuts import CutEpisodes
from halfseen.world.logs import elapsed_s, history_of


def tried_in(cuts: CutEpisodes) -> pd.DataFrame:
    """List every attempt to WASH or LIFT whose end, or cut, was seen.

    Parameters
    ----------
    cuts
        The episodes; trajectory k is number k.

    Returns
    -------
    DataFrame
        As `attempts` gives it.
    """
    states, action = cuts.episodes.states, np.asarray(cuts.episodes.action)
    elapsed = elapsed_s(cuts)
    begun_s = np.pad(np.nan_to_num(elapsed), ((0, 0), (1, 0)))[:, :-1]
    time_s = np.where(cuts.is_completed, elapsed, cuts.end_s[:, None]) - begun_s
    is_last = np.arange(action.shape[1]) == action.shape[1] - 1
    trajectory, stage = np.nonzero(cuts.is_begun & (action != FINISH) & ~is_last & (time_s > 0.0))
    target = ActionSpace(states.num_objects).target(action[trajectory, stage])
    occluded, successes, failures = (np.asarray(leaf, dtype=np.float64) for leaf in history_of(states))
    at, after = (trajectory, stage, target), (trajectory, stage + 1, target)
    is_finished = cuts.is_completed[trajectory, stage]
    return pd.DataFrame(
        {
            "trajectory": trajectory,
            "stage": stage + 1,
            "object": pd.factorize(trajectory * states.num_objects + target)[0],
            "occlusion": occluded[at],
            "grip": np.asarray(states.grip, dtype=np.float64)[at],
            "successes": successes[at],
            "failures": failures[at],
            "succeeded": pd.Series(successes[after] > successes[at], dtype="boolean").mask(~is_finished),
            "time_s": time_s[trajectory, stage],
            "is_finished": is_finished,
        }
    )
