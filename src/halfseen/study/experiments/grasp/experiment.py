"""One repetition: from a log, cut as in Table 1, each model learns the probability of a grasp.

It is scored on the attempts of fresh trajectories that nothing cut, and serves in the strongest heuristic and in the
features of linear eq. 3: without laws, as laws that are fitted to the log have a grasp of their own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.logs.frames import FrameLike, as_frame
from halfseen.planners.heuristics import TrueGrasp
from halfseen.shapes import Float
from halfseen.study.experiment import PieceOf, Setting
from halfseen.study.experiments.grasp.design import (
    CLAIMED,
    MODEL_NAMES,
    NUM_BINS,
    ORACLE,
    REWARDS,
    RIVAL,
    SUCCESSION,
    GraspDesign,
)
from halfseen.study.experiments.grasp.section import section_of
from halfseen.study.experiments.grasp.tables import tables_of
from halfseen.study.pipeline import HELD_OUT, Source
from halfseen.study.policies import STRONGEST_RULE
from halfseen.tables.grasp_attempts import attempts, can_hold_out
from halfseen.tables.grasp_choice import fit_grip_effect
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp
from halfseen.tables.grasp_table import GraspEstimator, tabulate
from halfseen.workers.threads import one_thread
from halfseen.world.actions import ActionSpace
from halfseen.world.cuts import CutKind, cut
from halfseen.world.logs import to_logs
from halfseen.world.policy import GraspModel, Policy

CUT_KIND: CutKind = "independent"


class SuccessionRule:
    """The rule of succession, (1 + successes) / (2 + attempts), whatever is hidden; there is nothing to learn."""

    def fit(self, frame: FrameLike) -> "SuccessionRule":
        """Learn nothing."""
        return self

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds."""
        counts = as_frame("attempts", frame)[["successes", "failures"]].to_numpy(dtype=np.float64)
        probability = (1.0 + counts[:, 0]) / (2.0 + counts.sum(axis=1))
        return np.column_stack([1.0 - probability, probability])


@dataclass(frozen=True)
class Grasp(GraspDesign):
    """The experiment; its parameters are those of `GraspDesign`."""

    name: ClassVar[str] = "grasp"
    tabulate = tables_of
    section = section_of

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and value tables as they are set."""
        source = Source.of(setting)
        return {"rate": source.cut_rate(self.cut_share, CUT_KIND), "start": source.start_value(self.num_starts)}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn, score and play: one row for each model and size of log."""
        source = Source.of(setting, index)
        log = source.cut(source.play(max(self.num_trajectories)), prepared["rate"], CUT_KIND)
        tried = attempts(to_logs(log, CUT_KIND, setting.scenes), setting.world.horizon)
        held_out, oracle = self._held_out(setting, source)
        succeeded = held_out["succeeded"].to_numpy(dtype=bool)
        rows: list[dict[str, Any]] = []
        learners: list[Policy] = []
        rules: list[Policy] = []
        knowing: Any = STRONGEST_RULE.policy(setting.world)
        for size in self.num_trajectories:
            known = pd.DataFrame(tried[tried["trajectory"] < size])
            estimators = _fitted(known)
            for name in MODEL_NAMES:
                said = oracle if name == ORACLE else estimators[name].predict_proba(held_out)[:, 1]
                stands_in = name == CLAIMED and not can_hold_out(known)
                rows.append({"model": name, "num_trajectories": size, "stands_in": stands_in} | scored(said, succeeded))
                grasp = _inside(setting, estimators, name, known)
                trajectories = source.logged(log.episodes, None if name == SUCCESSION else grasp, laws=False)
                learners.append(trajectories.learn_one(log, size))
                rules.append(knowing if name == ORACLE else replace(knowing, grasp=grasp))
        num_episodes = self.episodes_per_scene * len(setting.scenes)
        for measure, policies in zip(REWARDS, (learners, rules), strict=True):
            each = source.control_each(policies, range(num_episodes), float(prepared["start"]))
            for row, played in zip(rows, each, strict=True):
                row[measure] = played.means()["reward"]
        return {"index": index, "grasp": rows}

    def _held_out(self, setting: Setting, source: Source) -> tuple[pd.DataFrame, Float[np.ndarray, " m"]]:
        """Attempts of fresh uncut trajectories, and the true probability of each given the object's history."""
        episodes = source.play(min(max(self.num_trajectories), self.most_held_out), HELD_OUT)
        uncut = cut(episodes, 0.0, CUT_KIND, np.random.default_rng(0))
        table = attempts(to_logs(uncut, CUT_KIND, setting.scenes), setting.world.horizon)
        at = table["trajectory"].to_numpy(), table["stage"].to_numpy() - 1
        target = ActionSpace(episodes.states.num_objects).target(np.asarray(episodes.action)[at])
        said = TrueGrasp(setting.world).probability(episodes.states).astype(np.float64)
        return table, said[*at, target]


def scored(said: Float[np.ndarray, " m"], succeeded: np.ndarray) -> dict[str, Any]:
    """Log-loss, Brier score, and by bin of predicted probabilities: attempts, sum of these, successes."""
    place = np.minimum((said * NUM_BINS).astype(int), NUM_BINS - 1)
    sums = {"attempts": None, "probabilities": said, "successes": succeeded}
    return {
        "log_loss": float(-np.mean(np.log(np.where(succeeded, said, 1.0 - said)))),
        "brier": float(np.mean(np.square(said - succeeded))),
        "bins": {name: np.bincount(place, each, NUM_BINS).tolist() for name, each in sums.items()},
    }


def _fitted(tried: pd.DataFrame) -> dict[str, GraspEstimator]:
    # Threads gain nothing on matrices this small, wait for one another on a busy machine (a fit was seen to take 21 s
    # in place of 0.2), and add up in an order that depends on their number.
    with one_thread():
        beta = BetaGrasp().fit(tried)
        return {
            SUCCESSION: SuccessionRule(),
            RIVAL: beta,
            "beta-dropped": BetaGrasp(censoring="none").fit(tried),
            # Where too few objects missed, λ cannot be chosen.
            CLAIMED: SVMGrasp().fit(tried) if can_hold_out(tried) else beta,
        }


def _inside(setting: Setting, estimators: Mapping[str, GraspEstimator], name: str, tried: pd.DataFrame) -> GraspModel:
    """The model as it runs inside a policy, with what shows of a grip as far as the attempts say."""
    horizon = setting.world.horizon
    return (
        TrueGrasp(setting.world)
        if name == ORACLE
        else tabulate(model := estimators[name], horizon, fit_grip_effect(model, tried))
    )
