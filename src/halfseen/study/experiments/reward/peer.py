"""The planner whose laws are fitted to the logs that the policy is learned from, beside what was learned from them.

It takes long, and so it plays few episodes of each repetition: others for every log, so that means over logs know more
than a single log does.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

from halfseen.study.experiment import Setting
from halfseen.study.experiments.reward.beside import beside
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.pipeline import Played, Source, episodes_in_turn
from halfseen.tables.fitted_world import Evidence, evidence_of, fitted_to
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.recording import to_logs

Place = tuple[int, float]
"""Size of a log, and the proportion of its paths that is cut."""


def told_by(cuts: CutEpisodes, kind: CutKind, setting: Setting) -> Evidence:
    """What a log tells of the laws."""
    return evidence_of(to_logs(cuts, kind, setting.scenes, setting.world.dirty_share), setting.world)


def peers_beside(
    design: RewardDesign, source: Source, evidence: Mapping[float, Evidence], learned: Mapping[Place, Played]
) -> list[dict[str, Any]]:
    """Fit and plan at every size and proportion of cut paths: each place with `beside` of what was learned there.

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
    for rank, (size, share) in enumerate(places):
        played = learned[size, share]
        some = episodes_in_turn(source.index * len(places) + rank, design.fitted_episodes, len(played.reward))
        own = planned(design, source, evidence[share].first(size), some)
        rows.append({"num_paths": size, "cut_share": share} | beside(played, some, own))
    return rows


def planned(design: RewardDesign, source: Source, evidence: Evidence, episodes: list[int]) -> Played:
    """Fit the laws, and plan with them; of the true world, what an engineer knows is used."""
    return source.evaluate_some(design.peer.policy(fitted_to(evidence, source.world)), episodes)
