"""What a learner sees of a cut log: its arrays under each treatment of what was cut.

``imputed``
    Every begun stage, with an imputed target where it was cut, and Q at its lower confidence bound: what the product
    does where nothing is said.
``weighted``
    Every completed stage, weighted by 1/Ĝ(U⁻): the paper's.
``unweighted``
    Every completed stage alike.
``dropped``
    Only trajectories that finished, all their stages alike.
``failures``
    Every completed stage alike, and the stage in which the cut fell counts as a failed attempt that ended the
    trajectory: WASH costs what a failure costs, LIFT the time until the cut, and the dirty objects left are paid for as
    at every end.
"""

import numpy as np

from halfseen.censoring import StageClocks
from halfseen.errors import ArgumentError
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.task import Encoded
from halfseen.shapes import Float
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes
from halfseen.world.logs import elapsed_s

TREATMENTS = ("imputed", "weighted", "unweighted", "dropped", "failures")
CENSORING = {"imputed": "auto", "weighted": "kaplan-meier"}
"""Treatment → what the learner is told of cuts; nothing where it is not here."""


def trajectory_arrays(cuts: CutEpisodes, encoded: Encoded) -> TrajectoryArrays:
    """A log as arrays: what reading back its `Logs` gives, without writing them."""
    clocks = StageClocks(
        trajectory_ids=np.arange(len(cuts.end_s)),
        elapsed_s=elapsed_s(cuts),
        end_s=cuts.end_s,
        is_finished=cuts.is_finished,
        is_begun=cuts.is_begun,
        covariates=np.zeros((*cuts.is_begun.shape, 0)),
        covariate_names=(),
    )
    return TrajectoryArrays(
        clocks=clocks,
        encoded=encoded,
        has_action=cuts.is_begun,
        probability=np.asarray(cuts.episodes.probability, dtype=np.float64),
        reward=np.where(cuts.is_completed, np.asarray(cuts.episodes.reward, dtype=np.float64), 0.0),
    )


def treated(trajectories: TrajectoryArrays, cuts: CutEpisodes, treatment: str, world: WorldConfig) -> TrajectoryArrays:
    """What a learner sees of a log under one of `TREATMENTS`."""
    if treatment not in TREATMENTS:
        raise ArgumentError(f"treatment is {treatment!r}; it is one of {', '.join(TREATMENTS)}")
    clocks = trajectories.clocks
    if treatment == "dropped":
        kept = cuts.is_finished[:, None]
        elapsed = np.where(kept, clocks.elapsed_s, np.nan)
        return trajectories._replace(clocks=clocks._replace(is_begun=clocks.is_begun & kept, elapsed_s=elapsed))
    if treatment == "failures":
        is_cut_stage = cuts.is_begun & ~cuts.is_completed
        elapsed = np.where(is_cut_stage, cuts.end_s[:, None], clocks.elapsed_s)
        ended = clocks._replace(elapsed_s=elapsed, is_finished=np.ones_like(clocks.is_finished))
        return trajectories._replace(
            reward=np.where(is_cut_stage, _failure_reward(cuts, world), trajectories.reward), clocks=ended
        )
    return trajectories


def _failure_reward(cuts: CutEpisodes, world: WorldConfig) -> Float[np.ndarray, "n T"]:
    verb = np.asarray(ActionSpace(cuts.episodes.states.num_objects).verb(cuts.episodes.action))
    begun_s = np.nan_to_num(elapsed_s(cuts)).max(axis=1)
    lifted = world.reward_lift_per_s * (cuts.end_s - begun_s)
    attempt = np.select([verb == Verb.WASH, verb == Verb.LIFT], [world.reward_wash_failed, lifted[:, None]], 0.0)
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[:, None, :]
    dirty_left = np.sum(np.asarray(cuts.episodes.states.is_on_table) & is_dirty, axis=-1)
    return attempt + world.reward_dirty_left * dirty_left
