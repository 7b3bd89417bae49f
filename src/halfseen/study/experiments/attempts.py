"""Models of a grasp and of occlusion, scored on physical attempts: Figure 8, Table 4.

Repetitions share their tables, so they are not independent, and a test that assumed so would be anticonservative
[BengioGrandvalet2004]_. Let D_tr be the sum over the attempts of table t in repetition r, and W_tr the sum of their
weights. The mean is θ = Σ D / Σ W, and its residuals are e_tr = D_tr − θ W_tr. Residuals of one table are correlated,
as its objects and a model's errors on them are; so are residuals of one repetition, which share the log. The variance
allows for both [CameronGelbachMiller2011]_:

    V = (V_tables + V_repetitions − V_both) / (Σ W)²,    V_tables = G / (G − 1) · Σ_t (Σ_r e_tr)²,

the other terms likewise, with V no less than either alone; the interval is Student's, with the smaller number of
clusters less one as degrees of freedom. Large logs share most of their tables in all repetitions: for them the interval
covers the performance of such models on fresh tables [Bayle2020]_, not on fresh logs.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration import law
from halfseen.cell.calibration.attempts import HORIZON, OCCLUSION_EDGES, occlusion_bins, shares_by, trials
from halfseen.cell.calibration.fits import SCALES, fit_grasping
from halfseen.evaluation.estimate import Estimate, around
from halfseen.logs import read_logs
from halfseen.shapes import Float, Int
from halfseen.study.compare import LEVEL, Frame, Row, columns, four, grouped, holm, records, where
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.experiments import attempts_models as models
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts
from halfseen.wording import percent
from halfseen.workers.threads import one_thread

BETA, LAW, SVM, SVM_SET = models.BETA, models.LAW, models.SVM, models.SVM_SET
PAIRS = ((SVM, BETA), (models.SVM_FACTS, BETA), (SVM_SET, BETA), (LAW, BETA), (SVM_SET, LAW))
"""Pairs of models that are tested; the first is the paper's claim."""
COMPLETED, VISIBLE_ONLY = "completed", "visible-only"
PLANNERS = {COMPLETED: law.ATTEMPTS, VISIBLE_ONLY: law.VISIBLE_ONLY}
"""Way to plan grasps, with completed shape or by the visible part only → folder of its attempts within a law's."""
BETTER, WORSE, UNDECIDED = "better", "worse", "no significant difference"
NUM_PREDICTION_BINS = 5  # groups of attempts by predicted probability, of about equal size
BIN, ENDS = ["bin_from", "bin_to"], ["low", "high"]
TESTED = ["model", "rival", "measure", "num_tables", "p_value", "p_holm", "effect", *ENDS, "verdict"]
SHARES = ["attempts", "share_of_attempts", "tables", "mean_probability", "share_held", "difference", *ENDS]
HELD = ["planner", "is_lying", *BIN, "occlusion", "attempts", "tables", "share_held", *ENDS]
ByTable: TypeAlias = Float[np.ndarray, "tables repetitions"]


class Split(NamedTuple):
    """Numbers of tables; no table is both learned from and held out.

    The learning tables are in the order in which they join the log: smaller logs are prefixes. The held-out tables are
    sorted.
    """

    learned: Int[np.ndarray, " l"]
    held_out: Int[np.ndarray, " h"]


@dataclass(frozen=True)
class Attempts(Experiment):
    """Models that are learned from the attempts at `num_tables` tables, and scored on other tables.

    All tables are dealt into `num_folds` folds, and each fold is held out in turn; after that all are dealt again. A
    repetition is one fold.
    """

    num_tables: tuple[int, ...] = (25, 50, 100, 200, 400, 600)
    num_folds: int = 4
    most_repetitions: int | None = 20
    name: ClassVar[str] = "attempts"

    def prepare(self, setting: Setting) -> Piece:
        """Read the attempts of a law, by planner of grasps; empty without attempts."""
        folders = {} if setting.law is None else {name: setting.law / folder for name, folder in PLANNERS.items()}
        found = {name: folder for name, folder in folders.items() if folder.is_dir()}
        return {name: plain(trials(read_logs(folder), HORIZON)) for name, folder in found.items()}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn and score: one row for each model and size of log."""
        if COMPLETED not in prepared:
            return {"rows": []}
        tried = frame_of(prepared[COMPLETED])
        tables = np.unique(tried["trajectory"].to_numpy())
        split = self.split(tables, setting.seed, index)
        held_out = where(tried, trajectory=list(split.held_out))
        decided = checked_attempts(held_out)
        table = np.searchsorted(split.held_out, held_out["trajectory"].to_numpy()[decided.row])
        rows, said = [], {}
        for size, model in product(self.sizes(len(tables)), models.MODELS):
            learned = where(tried, trajectory=list(split.learned[:size]))
            # As in the experiment `grasp`: threads would only wait for one another.
            with one_thread():
                probability = models.predicted(model, learned, held_out)[decided.row]
            stands_in = model in models.SVMS and not can_hold_out(learned)
            losses = models.losses_of(probability, decided.succeeded)
            sums = {
                name: np.bincount(table, decided.weight * loss, len(split.held_out)) for name, loss in losses.items()
            }
            rows.append({"model": model, "num_tables": size, "stands_in": stands_in} | sums)
            # The next size replaces them: the largest log stays.
            said[model] = probability
        of = {"tables": split.held_out, "weight": np.bincount(table, decided.weight, len(split.held_out))}
        attempts = np.asarray(held_out.index)[decided.row]
        return of | {"rows": rows, "attempts": attempts, "row_weight": decided.weight, "said": said}

    def split(self, tables: Int[np.ndarray, " t"], seed: int, index: int) -> Split:
        """Deal tables, by their numbers; `num_folds` consecutive repetitions hold out each of them once."""
        deal, fold = divmod(index, self.num_folds)
        order = np.random.default_rng([seed, deal]).permutation(np.sort(tables))
        is_held_out = np.arange(len(order)) % self.num_folds == fold
        learned = np.random.default_rng([seed, deal, fold + 1]).permutation(order[~is_held_out])
        return Split(learned, np.sort(order[is_held_out]))

    def sizes(self, num_tables: int) -> tuple[int, ...]:
        """Log sizes available in every repetition; the largest possible size if none of the design's is."""
        most = num_tables - -(-num_tables // self.num_folds)
        return tuple(size for size in self.num_tables if size <= most) or (most,)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make all tables; none without attempts.

        Returns
        -------
        dict of pandas.DataFrame
            ``attempts``: planner, tables, decided, cut, held: counts.
            ``attempts_scores``: model, num_tables, repetitions, stood_in (repetitions in which a single rate replaced
            an SVM, as too few objects missed to fit one); and of each measure its mean, ``…_se``, ``…_low`` and
            ``…_high``, and the same of ``…_over_beta``, the difference from the Beta mean.
            ``attempts_tests``: model, rival, measure, num_tables, p_value, p_holm, effect, low, high, verdict:
            two-sided, adjusted within each pair of models; the effect is model − rival.
            ``attempts_calibration``: model, by (occlusion, or prediction), bin_from, bin_to, attempts,
            share_of_attempts, tables, mean_probability, share_held, difference, low, high: learned from the largest
            log.
            ``attempts_held``: planner, is_lying, bin_from, bin_to, occlusion, attempts, tables, share_held, low, high.
            ``attempts_law``: planner, parameter, estimate, se, low, high, p_value.
            ``attempts_slope``: law (of a planner, or assumed), is_lying, occlusion, share_held, low, high.
        """
        if COMPLETED not in pieces.prepared:
            return {}
        tried = {planner: frame_of(of) for planner, of in pieces.prepared.items()}
        fits = {planner: fit_grasping(of) for planner, of in tried.items()}
        counts = [
            {"planner": planner, "tables": tried[planner]["trajectory"].nunique(), "decided": fit.num_decided}
            | {"cut": fit.num_cut, "held": int(tried[planner]["succeeded"].sum())}
            for planner, fit in fits.items()
        ]
        scores, tests = _scored(pieces, setting.alpha)
        return {
            "attempts": pd.DataFrame(counts),
            "attempts_scores": scores,
            "attempts_tests": tests,
            "attempts_calibration": calibration_of(tried[COMPLETED], pieces.repetitions),
            "attempts_held": pd.concat([_held(*each) for each in tried.items()], ignore_index=True),
            "attempts_law": pd.concat([models.law_of(*each) for each in fits.items()], ignore_index=True),
            "attempts_slope": models.slopes_of(fits),
        }

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """Verdicts on the pairs by size, parameters of the law, and bins of occlusion in their order."""
        pairs = []
        for ours, other in PAIRS:
            rows = records(tables["attempts_tests"], model=ours, rival=other, measure=models.MEASURES[0])
            met = grouped(rows, lambda row: row["verdict"])
            found = [verdict for verdict in (BETTER, WORSE, UNDECIDED) if verdict in met]
            sizes = {verdict: [row["num_tables"] for row in met[verdict]] for verdict in found}
            pairs.append({"sizes": sizes, "first": rows[0], "last": rows[-1]})
        laws = grouped(records(tables["attempts_law"]), lambda row: row["planner"])
        laws = {planner: {row["parameter"]: row for row in rows} for planner, rows in laws.items()}
        bins = where(tables["attempts_calibration"], by="occlusion")
        bins = bins.assign(bin=bins["bin_from"].rank(method="dense") - 1)
        ends = where(bins, model=BETA)[[*BIN, "share_of_attempts"]].to_numpy()
        labels = [f"{low:g}–{high:g}\n{percent(share)}" for low, high, share in ends]
        return {"pairs": pairs, "laws": laws, "scales": SCALES, "bins": bins, "bin_labels": labels}


def plain(tried: Frame) -> dict[str, list[Any]]:
    """Attempts as plain columns; null where a value is missing."""
    return tried[models.COLUMNS].astype(object).where(tried[models.COLUMNS].notna(), None).to_dict("list")


def frame_of(columns: dict[str, list[Any]]) -> Frame:
    """Attempts, one row each."""
    return pd.DataFrame(columns).astype({"succeeded": "boolean"})


def _scored(pieces: Pieces, alpha: float) -> tuple[Frame, Frame]:
    """Means of the scores of every model and size, and the tests of the pairs."""
    names = np.unique(np.concatenate([piece["tables"] for piece in pieces.repetitions]))

    def aligned(values: Iterable[Any]) -> ByTable:
        """Sums by table and repetition; tables that a repetition did not hold out have 0."""
        of = np.zeros((len(names), len(pieces.repetitions)))
        for r, (piece, each) in enumerate(zip(pieces.repetitions, values, strict=True)):
            of[np.searchsorted(names, piece["tables"]), r] = each
        return of

    weights = aligned(piece["weight"] for piece in pieces.repetitions)
    cells = pieces.rows.groupby(["num_tables", "model"], sort=False)
    sums = {(*cell, measure): aligned(some[measure]) for cell, some in cells for measure in models.MEASURES}

    def over(size: int | np.integer, model: str, measure: str, rival: str) -> Estimate:
        return mean_of(sums[size, model, measure] - sums[size, rival, measure], weights)

    scores, tests = [], []
    for (size, model), some in cells:
        row: Row = {"model": model, "num_tables": size, "repetitions": len(some), "stood_in": some["stands_in"].sum()}
        for measure in models.MEASURES:
            row |= columns(mean_of(sums[size, model, measure], weights), four(measure))
            row |= columns(over(size, model, measure, BETA), four(f"{measure}_over_beta"))
        scores.append(row)
    places = [(measure, size) for measure in models.MEASURES for size in pieces.rows["num_tables"].unique()]
    for model, rival in PAIRS:
        effects = [over(size, model, measure, rival) for measure, size in places]
        p_holm = holm(np.array([effect.p_value for effect in effects]))
        for place, effect, p in zip(places, effects, p_holm, strict=True):
            verdict = UNDECIDED if p >= alpha else BETTER if effect.value < 0 else WORSE
            found = effect.p_value, p, effect.value, effect.low, effect.high, verdict
            tests.append(dict(zip(TESTED, (model, rival, *place, *found), strict=True)))
    return pd.DataFrame(scores), pd.DataFrame(tests)


def mean_of(sums: ByTable, weights: ByTable) -> Estimate:
    """Return the weighted mean with its 95 % confidence interval.

    Parameters
    ----------
    sums
        Weighted sums over the attempts at each table in each repetition; 0 if it was not held out.
    weights
        Sums of the weights of the attempts; 0 likewise.
    """
    is_met = weights.sum(axis=1) > 0
    sums, weights = sums[is_met], weights[is_met]
    total = float(weights.sum())
    mean = float(sums.sum() / total)
    residuals = sums - mean * weights
    by_table, by_repetition = residuals.sum(axis=1), residuals.sum(axis=0)
    tables, repetitions, both = (_sum_of_squares(each) for each in (by_table, by_repetition, residuals[weights > 0]))
    variance = max(tables + repetitions - both, tables, repetitions) / total**2
    num_clusters = min(residuals.shape)
    return around(mean, float(np.sqrt(variance)), num_clusters, num_clusters - 1, LEVEL)


def _sum_of_squares(residuals: Float[np.ndarray, " clusters"]) -> float:
    num = len(residuals)
    return float(num / max(num - 1, 1) * np.sum(np.square(residuals)))


def calibration_of(tried: Frame, repetitions: Sequence[Piece]) -> Frame:
    """Compare the observed shares held with predictions of models that had not seen the table.

    An attempt that was held out more than once counts once, with the mean of its predictions.

    Parameters
    ----------
    repetitions
        Repetitions with attempts (rows of `tried`), row_weight, and each model's predictions, learned from the largest
        log.
    """
    each = [pd.DataFrame(piece["said"] | {"weight": piece["row_weight"]}, piece["attempts"]) for piece in repetitions]
    said: Frame = pd.concat(each).groupby(level=0).mean()
    met = tried.iloc[said.index]
    by_occlusion, held = (occlusion_bins(met["occlusion"].to_numpy()), OCCLUSION_EDGES), met["succeeded"].astype(bool)
    tables = []
    for model in models.MODELS:
        for by, bins in {"occlusion": by_occlusion, "prediction": _alike(said[model].to_numpy())}.items():
            table = _shares(*bins, held, said[model], said["weight"], met["trajectory"]).assign(model=model, by=by)
            table["share_of_attempts"] = table["attempts"] / len(met)
            table["difference"] = table["share_held"] - table["mean_probability"]
            table[ENDS] = table[ENDS].sub(table["mean_probability"], axis=0)
            tables.append(table[["model", "by", *BIN, *SHARES]])
    return pd.concat(tables, ignore_index=True)


def _held(planner: str, tried: Frame) -> Frame:
    """Share held by occlusion, for standing and lying objects; attempts have weight 1/Ĝ."""
    decided, tables = checked_attempts(tried), []
    met = tried.iloc[decided.row].assign(weight=decided.weight, held=decided.succeeded, said=0.0)
    for lies, of in met.groupby(met["is_lying"].astype(bool)):
        bins = occlusion_bins(of["occlusion"].to_numpy())
        table = _shares(bins, OCCLUSION_EDGES, of["held"], of["said"], of["weight"], of["trajectory"])
        occlusion = of["occlusion"].groupby(bins).mean().to_numpy()
        tables.append(table.assign(planner=planner, is_lying=lies, occlusion=occlusion)[HELD])
    return pd.concat(tables)


def _shares(groups: Int[np.ndarray, " n"], edges: Float[np.ndarray, " edges"], *of: Any) -> Frame:
    """Shares that held by bin: of attempts that held or not, with predictions, weights and tables."""
    found = shares_by(groups, *(np.asarray(each) for each in of))
    rows = [dict(zip(BIN, edges[k : k + 2], strict=True)) | share._asdict() for k, share in found.items()]
    names = {"held": "share_held", "predicted": "mean_probability", "num_attempts": "attempts", "num_tables": "tables"}
    return pd.DataFrame(rows).rename(columns=names)


def _alike(said: Rows) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " edges"]]:
    """Group attempts by prediction into bins of about equal size; equal predictions stay together."""
    edges = np.unique(np.quantile(said, np.linspace(0.0, 1.0, NUM_PREDICTION_BINS + 1)))
    if len(edges) < 2:
        edges = np.repeat(edges, 2)
    return np.searchsorted(edges[1:-1], said, side="right").astype(np.int64), edges
