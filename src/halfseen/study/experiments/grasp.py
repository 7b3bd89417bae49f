"""Models of the probability of a grasp, including a Beta mean and an SVM: Figure 5, Table 3, the paper's claim.

Each learns from a log, cut as in Table 1. It is scored on the attempts of fresh uncut trajectories, and used in the
strongest heuristic and in the features of linear eq. 3; without laws, as fitted laws have a grasp model of their own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen import figures as pages
from halfseen.figures import BLUE, INK, ORANGE, RED, SKY
from halfseen.logs.frames import FrameLike, as_frame
from halfseen.planners.heuristics import TrueGrasp
from halfseen.shapes import Float
from halfseen.study import compare, figures
from halfseen.study.compare import EFFECT, estimated_in, four, is_reward, mean_columns, records, row_of, three, where
from halfseen.study.experiment import Drawing, Listing, PieceOf, Pieces, Row, Section, Tables, words
from halfseen.study.pipeline import CUT_KIND, HELD_OUT, Source
from halfseen.study.policies import STRONGEST_RULE
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import attempts, can_hold_out
from halfseen.tables.grasp_choice import fit_grip_effect
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp
from halfseen.tables.grasp_table import GraspEstimator, tabulate
from halfseen.wording import SUPPORTED, Claim, amount, capitalised, listed
from halfseen.workers.threads import one_thread
from halfseen.world.actions import ActionSpace
from halfseen.world.cuts import cut
from halfseen.world.logs import to_logs
from halfseen.world.policy import Policy

SUCCESSION, ORACLE, CLAIMED, RIVAL = "succession", "oracle", "svm", "beta"
MODEL_NAMES = {
    SUCCESSION: "rule of succession",
    RIVAL: "Beta mean",
    "beta-dropped": "Beta mean, cut attempts dropped",
    CLAIMED: "SVM",
    ORACLE: "true model",
}
"""Model of the probability of a grasp → its name in text."""
MODEL_COLOURS = {SUCCESSION: ORANGE, RIVAL: BLUE, "beta-dropped": SKY, CLAIMED: RED, ORACLE: INK}
LOOKS = figures.looks(MODEL_COLOURS, MODEL_NAMES)
FITTED = (RIVAL, "beta-dropped", CLAIMED)
SCORE, REWARDS = "log_loss", ("learned_reward", "heuristic_reward")
"""The measure for the paper's claim, a proper score that needs no policy; and rewards."""
MEASURES = {
    SCORE: "log-loss on held-out attempts",
    "brier": "Brier score on held-out attempts",
    REWARDS[0]: "reward of the policy by linear eq. 3",
    REWARDS[1]: "reward of the heuristic",
}
"""Measures of the models; smaller scores are better, and larger rewards."""
NUM_BINS, FEWEST_SHOWN = 10, 100
"""Number of bins of predicted probabilities, evenly over [0, 1]; attempts below which a bin is not drawn."""


@dataclass(frozen=True)
class GraspModels:
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

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and value the initial tables."""
        source = Source.of(setting)
        return {"rate": source.cut_rate(self.cut_share, CUT_KIND), "start": source.start_value(self.num_starts)}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
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
            for name in MODEL_NAMES:
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
        rows = compare.stacked(pieces.repetitions, "grasp", *MEASURES, "bins", "stands_in")
        found = {(row["num_trajectories"], row["model"]): row for row in rows}
        means, tests = [], []
        for (size, model), values in found.items():
            row: Row = {"model": model, "num_trajectories": size, "cut_share": self.cut_share}
            row |= {"repetitions": len(values["bins"]), "stood_in": int(values["stands_in"].sum())}
            for measure in MEASURES:
                row |= mean_columns(values[measure], four(measure))
                row |= mean_columns(values[measure] - found[size, ORACLE][measure], four(f"{measure}_over_oracle"))
            means.append(row)
        for measure in MEASURES:
            for size in self.num_trajectories:
                ours, other = found[size, CLAIMED][measure], found[size, RIVAL][measure]
                row = {"measure": measure, "num_trajectories": size}
                row |= {CLAIMED: float(ours.mean()), RIVAL: float(other.mean())}
                tests.append(row | compare.better(ours, other, measure).columns)
        return {
            "grasp": pd.DataFrame(means),
            "grasp_tests": compare.adjusted(pd.DataFrame(tests), setting.alpha),
            "figure5": pd.DataFrame([line for row in rows for line in _calibration(row)]),
        }

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say whether an SVM predicts the probability of a grasp better than the mean of a Beta."""
        grasp, tests = tables["grasp"], tables["grasp_tests"]
        verbs = ("predicts grasps better than", "predicts grasps worse than")
        score = self._claim(setting, tests, SCORE, verbs, MEASURES[SCORE])
        reward = self._claim(setting, tests, REWARDS[0], ("earns more than", "earns less than"), "")
        sentence = (
            f"{score.sentence[:-1]}; what linear eq. 3 learns with it earns more than with the Beta: {reward.verdict} "
            f"({reward.numbers})."
        )
        svm, logging_rule = where(grasp, model=CLAIMED), STRONGEST_RULE.label
        caption = words(self.name, "caption", design=self, svm=svm, fewest=FEWEST_SHOWN, logging_rule=logging_rule)
        drawing = Drawing("figure5", "Figure 5", _title(tests), caption, partial(_draw, self, tables))
        heading = "The probability of a grasp: the mean of a Beta, or an SVM?"
        return Section(heading, (sentence,), (drawing,), (_tests(setting, tests), _numbers(grasp)))

    def _claim(self, setting: Setting, tests: pd.DataFrame, measure: str, verbs: tuple[str, str], note: str) -> Claim:
        """The paper's claim on a measure, from the largest log."""
        largest = max(self.num_trajectories)
        row = row_of(tests, measure=measure, num_trajectories=largest)
        subject, test = f"An SVM {compare.learned_from(largest, self.cut_share)}", (float(row["p_holm"]), setting.alpha)
        gain, rival = compare.gain_in(row), "the mean of a Beta"
        return Claim(subject, *verbs, rival, gain, *test, note, _decimals(measure))


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


def _fitted(tried: pd.DataFrame) -> Mapping[str, GraspEstimator]:
    # Threads gain nothing on matrices this small, wait for one another on a busy machine (one fit took 21 s instead of
    # 0.2 s), and sum in an order that depends on their number.
    with one_thread():
        beta = BetaGrasp().fit(tried)
        dropped = BetaGrasp(censoring="none").fit(tried)
        # λ cannot be chosen if too few objects missed.
        svm = SVMGrasp().fit(tried) if can_hold_out(tried) else beta
    return {SUCCESSION: SuccessionRule(), RIVAL: beta, "beta-dropped": dropped, CLAIMED: svm}


def scored(said: Float[np.ndarray, " m"], succeeded: np.ndarray) -> Row:
    """Log-loss, Brier score, and by bin of predicted probabilities: attempts, sum of the probabilities, successes."""
    place = np.minimum((said * NUM_BINS).astype(int), NUM_BINS - 1)
    sums = {"attempts": None, "probabilities": said, "successes": succeeded}
    return {
        "log_loss": float(-np.mean(np.log(np.where(succeeded, said, 1.0 - said)))),
        "brier": float(np.mean(np.square(said - succeeded))),
        "bins": {name: np.bincount(place, each, NUM_BINS).tolist() for name, each in sums.items()},
    }


def _calibration(row: Row) -> list[Row]:
    """Proportion of attempts that succeeded against the mean predicted probability, by bin of predictions.

    The interval of their difference is over repetitions: attempts of one trajectory are not independent.
    """
    names = ("attempts", "probabilities", "successes")
    attempted, said, won = (np.array([bins[name] for bins in row["bins"]], dtype=np.float64) for name in names)
    lines = []
    for k in np.flatnonzero(attempted.sum(axis=0)):
        total = attempted[:, k].sum()
        mean, share = said[:, k].sum() / total, won[:, k].sum() / total
        # The standard error of the ratio is that of the mean of its residuals.
        residual = won[:, k] - said[:, k] - (share - mean) * attempted[:, k]
        error = compare.over_repetitions(residual * len(attempted) / total)
        line = {"model": row["model"], "num_trajectories": row["num_trajectories"], "bin_from": k / NUM_BINS}
        line |= {"attempts": int(total), "mean_probability": mean, "share_succeeded": share, "difference": share - mean}
        ends = {"low": share - mean + error.low, "high": share - mean + error.high}
        lines.append(line | {"se": error.standard_error} | ends)
    return lines


def _title(tests: pd.DataFrame) -> str:
    rows = records(tests, measure=SCORE)
    won = [str(row["num_trajectories"]) for row in rows if compare.verdict_of(row) == SUPPORTED]
    if not won:
        return "The SVM does not predict grasps significantly better than the Beta mean"
    start = "The SVM predicts grasps better than the Beta mean"
    return (
        f"{start}, from logs of every size"
        if len(won) == len(rows)
        else f"{start} only from {listed(won)} trajectories"
    )


def _draw(design: GraspModels, tables: Tables, title: str) -> Figure:
    """Scores and calibration above, rewards below."""
    grasp, place = tables["grasp"], {"left": 0.07, "right": 0.985, "bottom": 0.07, "hspace": 0.36, "wspace": 0.18}
    figure, top, panels = figures.panels(title, (9.0, 7.6), (2, 2), 0.11, (False, False), **place)
    all_models, of = (SUCCESSION, *FITTED), "over the true model's"
    shown = {
        SCORE: (panels[0, 0], FITTED, "log-loss on held-out attempts, above the true model's"),
        REWARDS[0]: (panels[1, 0], all_models, f"reward of the policy by linear eq. 3, {of}"),
        REWARDS[1]: (panels[1, 1], all_models, f"reward of the heuristic, {of}"),
    }
    for measure, (axes, models, title_of) in shown.items():
        pages.draw_zero(axes, MODEL_COLOURS[ORACLE])
        series, columns = {model: LOOKS[model] for model in models}, three(f"{measure}_over_oracle")
        figures.draw_series(axes, grasp, ("model", "num_trajectories"), series, columns, dodge=1.10)
        pages.mark_sizes(axes, design.num_trajectories)
        figures.name_panel(axes, title_of, "trajectories that it was learned from (log scale)")
    above = float(row_of(grasp, model=SUCCESSION)[f"{SCORE}_over_oracle"])
    note = f"the rule of succession, which ignores occlusion, lies {amount(above)} above"
    at: Any = {"xycoords": "axes fraction", "ha": "right", "va": "top", "fontsize": 8.0}
    panels[0, 0].annotate(note, (0.98, 0.98), color=MODEL_COLOURS[SUCCESSION], **at)
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(low, high + 0.12 * (high - low))
    _draw_calibration(panels[0, 1], max(design.num_trajectories), tables["figure5"])
    figures.write_names(figure, top - 0.012, MODEL_NAMES, *panels.flat, columnspacing=1.4)
    return figure


def _draw_calibration(axes: Any, largest: int, figure5: pd.DataFrame) -> None:
    """Share of successes less the predicted probability, for the largest log."""
    pages.draw_zero(axes)
    for model in (*FITTED, ORACLE):
        rows = where(figure5, model=model, num_trajectories=largest)
        rows = rows.loc[rows["attempts"] >= FEWEST_SHOWN].sort_values(by="mean_probability")
        estimates = rows[["difference", "low", "high"]]
        pages.draw_curve(axes, rows["mean_probability"], estimates, linewidth=1.2, **LOOKS[model])
    axes.set(xlim=(0.0, 1.0), xticks=np.linspace(0.0, 1.0, 6))
    pages.draw_grid(axes)
    name = f"proportion that succeeded, less predicted ({largest} trajectories)"
    figures.name_panel(axes, name, "predicted probability of a grasp")


def _decimals(measure: str) -> int:
    return 2 if is_reward(measure) else 4


def _tests(setting: Setting, tests: pd.DataFrame) -> Listing:
    caption = words(GraspModels.name, "tests", setting=setting)
    cells: dict[str, Callable[[Row], str]] = {
        "logged trajectories": lambda row: str(row["num_trajectories"]),
        "SVM": lambda row: amount(row[CLAIMED], _decimals(row["measure"])),
        "Beta": lambda row: amount(row[RIVAL], _decimals(row["measure"])),
        "difference": lambda row: estimated_in(row, EFFECT, _decimals(row["measure"])),
        **compare.TEST_CELLS,
    }
    rows = records(tests)
    return Listing.of("Table 3", caption, rows, cells, lambda row: capitalised(MEASURES[row["measure"]]), False)


def _numbers(grasp: pd.DataFrame) -> Listing:
    cells: dict[str, Callable[[Row], str]] = {
        "model": lambda row: MODEL_NAMES[row["model"]],
        "logged trajectories": lambda row: str(row["num_trajectories"]),
    }
    names = ("log-loss", "Brier score", "reward, learned", "reward, heuristic")
    for name, measure in zip(names, MEASURES, strict=True):
        cells[name] = partial(estimated_in, names=three(measure), decimals=_decimals(measure))
    return Listing.of("The numbers of Figure 5", "", records(grasp), cells)
