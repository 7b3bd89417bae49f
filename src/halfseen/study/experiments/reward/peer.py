"""The planner whose laws are fitted to the logs that the policy is learned from, beside what was learned from them.

It takes long, and so it plays few episodes of each repetition: others for every log, so that means over logs know more
than a single log does. Which episodes are hard is known from all K learned policies of the repetition, which play all
of them. With M = mean of what these earned on an episode, what the learned policy earns over the planner is

    mean (learned − M), on all episodes  +  mean (M − planner), on those that the planner played,

one number a repetition. Its mean is right, whatever M is, as each repetition has fresh episodes; and M, being a mean,
is less noisy than any one policy.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from halfseen.shapes import Float
from halfseen.study.experiment import Setting
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.pipeline import Played, Source, episodes_in_turn
from halfseen.tables.laws import fitted_to
from halfseen.tables.laws.evidence import Evidence, evidence_of
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.logs import to_logs

Place = tuple[int, float]
"""Size of a log, and the proportion of its paths that is cut."""


def told_by(cuts: CutEpisodes, kind: CutKind, setting: Setting) -> Evidence:
    """What a log tells of the laws."""
    return evidence_of(to_logs(cuts, kind, setting.scenes, setting.world.dirty_share), setting.world)


def peers_beside(
    design: RewardDesign, source: Source, evidence: Mapping[float, Evidence], learned: Mapping[Place, Played]
) -> list[dict[str, Any]]:
    """Fit and plan at every size and proportion of cut paths: num_paths, cut_share and over_peer of each place.

    Parameters
    ----------
    design
        Which places.
    source
        The repetition.
    evidence
        By proportion of cut paths.
    learned
        What the policies learned from the same logs earned, on all episodes.
    """
    rows, places = [], list(product(design.num_paths, design.cut_shares))
    mean = np.mean([played.reward for played in learned.values()], axis=0)
    for rank, (size, share) in enumerate(places):
        some = episodes_in_turn(source.index * len(places) + rank, design.fitted_episodes, len(mean))
        own = planned(design, source, evidence[share].first(size), some)
        gap = over_peer(learned[size, share].reward, mean, some, own.reward)
        rows.append({"num_paths": size, "cut_share": share, "over_peer": gap})
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


def planned(design: RewardDesign, source: Source, evidence: Evidence, episodes: list[int]) -> Played:
    """Fit the laws, and plan with them; of the true world, what an engineer knows is used."""
    return source.evaluate_some(design.peer.policy(fitted_to(evidence, source.world)), episodes)
