"""Four ways to treat a path that was cut, as what a regression sees of it.

``weighted``
    Every completed stage, weighted by 1/Ĝ(U⁻): the paper's.
``unweighted``
    Every completed stage alike.
``dropped``
    Only paths that finished, all their stages alike.
``failures``
    Every completed stage alike, and the stage in which the cut fell counts as a failed attempt that ended the path:
    WASH costs what a failure costs, LIFT the time until the cut, and the dirty objects left are paid for as at every
    end.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from halfseen.censoring import stage_weights
from halfseen.errors import ArgumentError
from halfseen.study.design import TREATMENTS
from halfseen.world.action_space import Verb, verb_of
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes
from halfseen.world.recording import elapsed_s


class Treated(NamedTuple):
    """What the regression sees of each stage."""

    reward: Float[np.ndarray, "n T"]
    weight: Float[np.ndarray, "n T"]
    is_last: Bool[np.ndarray, "n T"]


def treat(cuts: CutEpisodes, treatment: str, config: WorldConfig) -> Treated:
    """Apply a treatment to a log."""
    if treatment not in TREATMENTS:
        raise ArgumentError(f"treatment is {treatment!r}; it is one of {', '.join(TREATMENTS)}")
    is_completed = cuts.is_completed
    reward = np.where(is_completed, np.asarray(cuts.episodes.reward, dtype=np.float64), 0.0)
    num_completed = is_completed.sum(axis=1)
    is_last = (np.arange(is_completed.shape[1]) == num_completed[:, None] - 1) & cuts.is_finished[:, None]
    if treatment == "weighted":
        return Treated(reward, stage_weights(elapsed_s(cuts), cuts.end_s, cuts.is_finished), is_last)
    if treatment == "dropped":
        return Treated(reward, np.where(cuts.is_finished[:, None], is_completed, 0.0), is_last)
    if treatment == "unweighted":
        return Treated(reward, is_completed.astype(np.float64), is_last)
    is_cut_stage = cuts.is_begun & ~is_completed
    failed = np.where(is_cut_stage, _failure_reward(cuts, config), reward)
    return Treated(failed, cuts.is_begun.astype(np.float64), is_last | is_cut_stage)


def _failure_reward(cuts: CutEpisodes, config: WorldConfig) -> Float[np.ndarray, "n T"]:
    verb = np.asarray(verb_of(cuts.episodes.action, cuts.episodes.states.num_objects))
    begun_s = np.nan_to_num(elapsed_s(cuts)).max(axis=1)
    lifted = config.reward_lift_per_s * (cuts.end_s - begun_s)
    attempt = np.select([verb == Verb.WASH, verb == Verb.LIFT], [config.reward_wash_failed, lifted[:, None]], 0.0)
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[:, None, :]
    dirty_left = np.sum(np.asarray(cuts.episodes.states.is_on_table) & is_dirty, axis=-1)
    return attempt + config.reward_dirty_left * dirty_left
