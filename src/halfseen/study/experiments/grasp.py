"""Models of the probability of a grasp, including a Beta mean and an SVM: Figure 5, Table 3, the paper's claim.

Each learns from a log, cut as in Table 1. It is scored on the attempts of fresh uncut trajectories, and used in the
strongest heuristic and in the features of linear eq. 3; without laws, as fitted laws have a grasp model of their own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.logs.frames import FrameLike, as_frame
from halfseen.planners.heuristics import TrueGrasp
from halfseen.shapes import Float
from halfseen.study.compare import Frame, Row, adjusted, better, four, means, over_repetitions, wide
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.pipeline import CUT_KIND, HELD_OUT, Source
from halfseen.study.policies import STRONGEST_RULE
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import attempts, can_hold_out
from halfseen.tables.grasp_choice import fit_grip_effect
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp
from halfseen.tables.grasp_table import GraspEstimator, tabulate
from halfseen.workers.threads import one_thread
from halfseen.world.actions import ActionSpace
from halfseen.world.cuts import cut
from halfseen.world.logs import to_logs
from halfseen.world.policy import Policy

MODELS = SUCCESSION, RIVAL, DROPPED, CLAIMED, ORACLE = "succession", "beta", "beta-dropped", "svm", "oracle"
"""Models of the probability of a grasp."""
CELL = ["num_trajectories", "model"]
REWARDS = ("learned_reward", "heuristic_reward")
MEASURES = ("log_loss", "brier", *REWARDS)
"""Measures of the models; smaller scores are better, and larger rewards."""
NUM_BINS = 10  # bins of predicted probabilities, evenly over [0, 1]


@dataclass(frozen=True)
class GraspModels(Experiment):
    """Models of the probability of a grasp, learned from logs of `num_trajectories`, of which `cut_share` are cut.

    All are scored on fresh trajectories, with some six attempts each: on as many as were learned from, at most
    `most_held_out`. The mean of V° over initial tables is estimated from `num_starts`.
    """

    num_trajectories: tuple[int, ...] = (50, 200, 800)
    cut_share: float = 1 / 2
    most_held_out: int = 400
    episodes_per_scene: int = 5
    num_starts: int = 100_000
    most_repetitions: int | None = 12
    name: ClassVar[str] = "grasp"

    def prepare(self, setting: Setting) -> Piece:
        """Calibrate the cuts, and value the initial tables."""
        source = Source.of(setting)
        return {"rate": source.cut_rate(self.cut_share, CUT_KIND), "start": source.start_value(self.num_starts)}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn, score and play: one row for each model and size of log."""
        source, world = Source.of(setting, index), setting.world
        log = source.cut(source.play(max(self.num_trajectories)), prepared["rate"], CUT_KIND)
        tried = attempts(to_logs(log, CUT_KIND, setting.scenes), world.horizon)
        held_out, oracle = self._held_out(setting, source)
        succeeded = held_out["succeeded"].to_numpy(dtype=bool)
        rows: list[Row] = []
        policies: dict[str, list[Policy]] = {measure: [] for measure in REWARDS}
        knowing: Any = STRONGEST_RULE.policy(world)
        for size in self.num_trajectories:
            known = pd.DataFrame(tried[tried["trajectory"] < size])
            estimators = _fitted(known)
            for name in MODELS:
                said = oracle if name == ORACLE else estimators[name].predict_proba(held_out)[:, 1]
                stands_in = name == CLAIMED and not can_hold_out(known)
                rows.append({"model": name, "num_trajectories": size, "stands_in": stands_in} | scored(said, succeeded))
                # The model as it runs inside a policy, with the visible covariates of a grip, if any.
                grasp = TrueGrasp(world)
                if name != ORACLE:
                    grasp = tabulate(estimators[name], world.horizon, fit_grip_effect(estimators[name], known))
                trajectories = source.logged(log.episodes, None if name == SUCCESSION else grasp, laws=False)
                policies[REWARDS[0]].append(trajectories.learn_one(log, size))
                policies[REWARDS[1]].append(knowing if name == ORACLE else replace(knowing, grasp=grasp))
        num_episodes = self.episodes_per_scene * len(setting.scenes)
        for measure, those in policies.items():
            each = source.control_each(those, range(num_episodes), float(prepared["start"]))
            for row, played in zip(rows, each, strict=True):
                row[measure] = played.means()["reward"]
        return {"rows": rows}

    def _held_out(self, setting: Setting, source: Source) -> tuple[Frame, Float[np.ndarray, " m"]]:
        """Attempts of fresh uncut trajectories, and the true probability of each given the object's history."""
        episodes = source.play(min(max(self.num_trajectories), self.most_held_out), HELD_OUT)
        uncut = cut(episodes, 0.0, CUT_KIND, np.random.default_rng(0))
        table = attempts(to_logs(uncut, CUT_KIND, setting.scenes), setting.world.horizon)
        at = table["trajectory"].to_numpy(), table["stage"].to_numpy() - 1
        target = ActionSpace(episodes.states.num_objects).target(np.asarray(episodes.action)[at])
        said = TrueGrasp(setting.world).probability(episodes.states).astype(np.float64)
        return table, said[*at, target]

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make all tables.

        Returns
        -------
        dict of pandas.DataFrame
            ``grasp``: model, num_trajectories, cut_share, repetitions, and stood_in, in how many the Beta mean replaced
            it; and of each measure its mean, ``…_se``, ``…_low`` and ``…_high``, and the same of
            ``…_over_oracle``, the paired difference from the true model.
            ``grasp_tests``: measure, num_trajectories, svm, beta, p_value, p_holm, effect, supported, effect_low,
            effect_high: whether the SVM is better than the Beta mean, tests as in Table 1; the effect is svm − beta.
            ``figure5``: model, num_trajectories, bin_from, attempts, mean_probability, share_succeeded, difference, se,
            low, high: calibration; the difference is share_succeeded − mean_probability.
        """
        rows = pieces.rows
        cells = {measure: wide(rows, CELL, measure) for measure in MEASURES}
        stood_in = wide(rows, CELL, "stands_in")
        tables = [pd.DataFrame({"repetitions": stood_in.shape[1], "stood_in": stood_in.sum(axis=1).astype(int)})]
        tests = []
        for measure, of in cells.items():
            oracle = of.xs(ORACLE, level="model").reindex(of.index.get_level_values(0)).to_numpy()
            tables += [means(of, four(measure)), means(of - oracle, four(f"{measure}_over_oracle"))]
            for size in self.num_trajectories:
                ours, other = (of.loc[size, model].to_numpy(dtype=float) for model in (CLAIMED, RIVAL))
                row = {"measure": measure, "num_trajectories": size, CLAIMED: ours.mean(), RIVAL: other.mean()}
                tests.append(row | better(ours, other, measure).columns)
        grasp = pd.concat(tables, axis=1).reset_index()
        grasp.insert(0, "model", grasp.pop("model"))
        grasp.insert(2, "cut_share", self.cut_share)
        bins = [line for cell, some in rows.groupby(CELL, sort=False) for line in _calibration(cell, some["bins"])]
        return {"grasp": grasp, "grasp_tests": adjusted(tests, setting.alpha), "figure5": pd.DataFrame(bins)}


class SuccessionRule:
    """The rule of succession, (1 + successes) / (2 + attempts), regardless of occlusion."""

    def fit(self, frame: FrameLike) -> "SuccessionRule":
        """Learn nothing."""
        return self

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds."""
        counts = as_frame("attempts", frame)[["successes", "failures"]].to_numpy(dtype=np.float64)
        probability = (1.0 + counts[:, 0]) / (2.0 + counts.sum(axis=1))
        return np.column_stack([1.0 - probability, probability])


def _fitted(tried: Frame) -> Mapping[str, GraspEstimator]:
    # Threads gain nothing on matrices this small, wait for one another on a busy machine (one fit took 21 s instead of
    # 0.2 s), and sum in an order that depends on their number.
    with one_thread():
        beta = BetaGrasp().fit(tried)
        dropped = BetaGrasp(censoring="none").fit(tried)
        # λ cannot be chosen if too few objects missed.
        svm = SVMGrasp().fit(tried) if can_hold_out(tried) else beta
    return {SUCCESSION: SuccessionRule(), RIVAL: beta, DROPPED: dropped, CLAIMED: svm}


def scored(said: Float[np.ndarray, " m"], succeeded: np.ndarray) -> Row:
    """Log-loss, Brier score, and by bin of predicted probabilities: attempts, sum of the probabilities, successes."""
    place = np.minimum((said * NUM_BINS).astype(int), NUM_BINS - 1)
    sums = {"attempts": None, "probabilities": said, "successes": succeeded}
    return {
        "log_loss": float(-np.mean(np.log(np.where(succeeded, said, 1.0 - said)))),
        "brier": float(np.mean(np.square(said - succeeded))),
        "bins": {name: np.bincount(place, each, NUM_BINS).tolist() for name, each in sums.items()},
    }


def _calibration(cell: Any, bins: pd.Series) -> list[Row]:
    """Proportion of attempts that succeeded against the mean predicted probability, by bin of predictions.

    The interval of their difference is over repetitions: attempts of one trajectory are not independent.
    """
    names = ("attempts", "probabilities", "successes")
    attempted, said, won = (np.array([of[name] for of in bins], dtype=np.float64) for name in names)
    lines = []
    for k in np.flatnonzero(attempted.sum(axis=0)):
        total = attempted[:, k].sum()
        mean, share = said[:, k].sum() / total, won[:, k].sum() / total
        # The standard error of the ratio is that of the mean of its residuals.
        residual = won[:, k] - said[:, k] - (share - mean) * attempted[:, k]
        error = over_repetitions(residual * len(attempted) / total)
        line = {"model": cell[1], "num_trajectories": cell[0], "bin_from": k / NUM_BINS}
        line |= {"attempts": int(total), "mean_probability": mean, "share_succeeded": share, "difference": share - mean}
        ends = {"low": share - mean + error.low, "high": share - mean + error.high}
        lines.append(line | {"se": error.standard_error} | ends)
    return lines
