"""What the laws fitted to a log of the study are, and what is learned with their help: from its arrays, at every size.

A log is written and read once, for what it tells of laws; what its first n trajectories tell is a part of that. All
else that `halfseen.tables.learner` reads off `Logs` is at hand.
"""

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.errors import HalfseenError
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays
from halfseen.tables.assisted import RulePolicy
from halfseen.tables.evidence import Evidence, evidence_of
from halfseen.tables.grasp_choice import grasp_model_by
from halfseen.tables.grasp_models import BetaGrasp
from halfseen.tables.law_test import layouts_of, weighed
from halfseen.tables.learner import Assisted, Chosen, assisted_by, rule_or_linear
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes
from halfseen.world.logs import to_logs
from halfseen.world.scene import Scene
from halfseen.world.state import TableState

_NAMELESS = (Scene(np.zeros((1, 1))),)
"""What tables are called tells nothing of laws; nor does the cause of a cut."""


def told_by(cuts: CutEpisodes, world: WorldConfig) -> Evidence:
    """What a log tells of laws; of the world, prices and times are looked at."""
    return evidence_of(to_logs(cuts, "independent", _NAMELESS, world.dirty_share), world)


class LinearFit(NamedTuple):
    """Linear eq. 3 without laws, learned from a log."""

    policy: LinearTablePolicy
    model: QModel
    """Fitted to the log but for Q."""
    trajectories: TrajectoryArrays
    """The log as the model sees it."""


def helped(
    evidence: Evidence, states: TableState, world: WorldConfig, linear: LinearFit, tried: pd.DataFrame
) -> Assisted:
    """Fit laws to a log, and learn with their help, as `TableLearner` does.

    Parameters
    ----------
    evidence
        What the log tells of laws.
    states
        Its tables, axes (n, T).
    world
        Of which prices and times are known.
    linear
        What is learned without laws.
    tried
        The attempts of the log.
    """

    def without(rule: RulePolicy) -> Chosen:
        with suppress(HalfseenError):
            rule = replace(rule, grasp=grasp_model_by(BetaGrasp(), tried, world.horizon))
        return rule_or_linear(rule, *linear, states)

    log = weighed(linear.trajectories, states)
    return assisted_by(evidence, log, layouts_of(states), world, linear.model.random_state, without)
