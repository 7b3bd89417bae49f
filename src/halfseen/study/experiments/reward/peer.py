"""The planner whose laws are fitted to the logs that the policy is learned from, beside what was learned from them.

It takes long, and so it plays few episodes of each repetition: others for every log, so that means over logs know more
than a single log does. What good decisions earn on an episode is known from all K learned policies of the repetition,
which play all of them. With M = mean of what these earned on an episode, what the learned policy earns over the planner
is

    mean (learned − M), on all episodes  +  mean (M − planner), on those that the planner played,

one number a repetition. Its mean is right, whatever M is, as each repetition has fresh episodes; and M, being a mean,
is nearer to the planner than any one policy: by the control variate a planner and M differ by some .25 on an episode,
a policy learned from 25 trajectories and M by .9.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from halfseen.shapes import Float
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.pipeline import Played, Source, episodes_in_turn
from halfseen.world.config import WorldConfig

Place = tuple[int, float]
"""Size of a log, and the proportion of its trajectories that is cut."""


def peers_beside(
    design: RewardDesign,
    source: Source,
    fitted: Mapping[Place, WorldConfig],
    learned: Mapping[Place, Played],
    start: float,
) -> list[dict[str, Any]]:
    """Plan at every size and proportion of cut trajectories: num_trajectories, cut_share and over_peer of each place.

    Parameters
    ----------
    design
        Which places.
    source
        The repetition.
    fitted
        Worlds with laws fitted to each log.
    learned
        What the policies learned from the same logs earned, on all episodes.
    start
        As `Source.control_each` takes it.
    """
    rows, places = [], list(product(design.num_trajectories, design.cut_shares))
    mean = np.mean([played.reward for played in learned.values()], axis=0)
    for rank, (size, share) in enumerate(places):
        some = episodes_in_turn(source.index * len(places) + rank, design.fitted_episodes, len(mean))
        (own,) = source.control_each([design.peer.policy(fitted[size, share])], some, start)
        gap = over_peer(learned[size, share].reward, mean, some, own.reward)
        rows.append({"num_trajectories": size, "cut_share": share, "over_peer": gap})
    return rows


def over_peer(
    learned: Float[np.ndarray, " B"], mean: Float[np.ndarray, " B"], some: Sequence[int], own: Float[np.ndarray, " E"]
) -> float:
    """What the learned policy earned over the planner, which played some of the B episodes.

    Parameters
    ----------
    learned
        What the learned policy earned on each.
    mean
        What all learned policies did, in the mean.
    some
        Those that the planner played.
    own
        What it earned on them.
    """
    return float((learned - mean).mean() + (mean[list(some)] - own).mean())
