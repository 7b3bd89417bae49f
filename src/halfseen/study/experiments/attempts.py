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

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import expit, logit

from halfseen.arrays import Rows
from halfseen.cell.calibration.attempts import OCCLUSION_EDGES, occlusion_bins, shares_by
from halfseen.cell.calibration.fits import NAMES, GraspFit, held_share
from halfseen.evaluation.estimate import Estimate, around
from halfseen.shapes import Float, Int
from halfseen.study.compare import LEVEL, columns, four, holm
from halfseen.study.experiment import PieceOf, Pieces, Row, Section, Tables
from halfseen.study.experiments import attempts_repetition as known
from halfseen.study.experiments.attempts_repetition import AttemptsRepetition, Source, fit_of, frame_of
from halfseen.study.experiments.attempts_words import ASSUMED, BETTER, UNDECIDED, WORSE, section_of
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import checked_attempts
from halfseen.world.config import WorldConfig

NUM_PREDICTION_BINS = 5  # groups of attempts by predicted probability, of about equal size
SHOWN: Float[np.ndarray, " shown"] = np.linspace(0.0, 0.8, 17)  # occlusions at which curves are drawn
_Z = float(stats.norm.ppf(0.5 + LEVEL / 2))
_STEP = 1e-5
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(41)
ByTable = Float[np.ndarray, "tables repetitions"]
Scores = dict[tuple[int, str, str], ByTable]  # sums by table and repetition, by size of log, model and measure


@dataclass(frozen=True)
class Attempts(AttemptsRepetition):
    """The experiment; its parameters are those of `AttemptsRepetition`."""

    name: ClassVar[str] = "attempts"

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
        if known.COMPLETED not in pieces.prepared:
            return {}
        weights, scores = _scores(pieces)
        sources = pieces.prepared
        return {
            "attempts": pd.DataFrame([_counts(*each) for each in sources.items()]),
            "attempts_scores": _means(weights, scores, pieces),
            "attempts_tests": _tests(weights, scores, setting.alpha),
            "attempts_calibration": calibration_of(frame_of(sources[known.COMPLETED]), pieces.repetitions),
            "attempts_held": pd.DataFrame([row for each in sources.items() for row in held_by_occlusion(*each)]),
            "attempts_law": pd.concat([_law(*each) for each in sources.items()], ignore_index=True),
            "attempts_slope": _slopes(sources),
        }

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Report the findings from attempts, or that there are none."""
        return section_of(self, setting, tables)


def _scores(pieces: Pieces) -> tuple[ByTable, Scores]:
    """Align the sums of all repetitions; tables that a repetition did not hold out have 0."""
    names = np.unique(np.concatenate([piece["tables"] for piece in pieces.repetitions]))
    shape = len(names), len(pieces.repetitions)
    weights, scores = np.zeros(shape), {}
    for r, piece in enumerate(pieces.repetitions):
        place = np.searchsorted(names, piece["tables"])
        weights[place, r] = piece["weight"]
        for row in piece["scores"]:
            for measure in known.MEASURES:
                key = row["num_tables"], row["model"], measure
                scores.setdefault(key, np.zeros(shape))[place, r] = row[measure]
    return weights, scores


def _means(weights: ByTable, scores: Scores, pieces: Pieces) -> pd.DataFrame:
    stood_in = Counter(
        (row["num_tables"], row["model"]) for piece in pieces.repetitions for row in piece["scores"] if row["stands_in"]
    )
    rows: dict[tuple[int, str], Row] = {}
    for (size, model, measure), sums in scores.items():
        place = {"model": model, "num_tables": size, "repetitions": weights.shape[1]}
        place["stood_in"] = stood_in[size, model]
        row = rows.setdefault((size, model), place)
        for name, of in ((measure, sums), (f"{measure}_over_beta", sums - scores[size, known.BETA, measure])):
            row |= columns(mean_of(of, weights), *four(name))
    return pd.DataFrame(list(rows.values()))


def _tests(weights: ByTable, scores: Scores, alpha: float) -> pd.DataFrame:
    sizes, rows = sorted({size for size, *_ in scores}), []
    for model, rival in known.PAIRS:
        places = [(measure, size) for measure in known.MEASURES for size in sizes]
        effects = [
            mean_of(scores[size, model, measure] - scores[size, rival, measure], weights) for measure, size in places
        ]
        p_holm = holm(np.array([effect.p_value for effect in effects]))
        for (measure, size), effect, p in zip(places, effects, p_holm, strict=True):
            verdict = UNDECIDED if p >= alpha else BETTER if effect.value < 0 else WORSE
            row = {"model": model, "rival": rival, "measure": measure, "num_tables": size}
            row |= {"p_value": effect.p_value, "p_holm": float(p), "effect": effect.value}
            rows.append(row | {"low": effect.low, "high": effect.high, "verdict": verdict})
    return pd.DataFrame(rows)


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


def calibration_of(tried: pd.DataFrame, repetitions: Sequence[PieceOf]) -> pd.DataFrame:
    """Compare the observed shares held with predictions of models that had not seen the table.

    An attempt that was held out more than once counts once, with the mean of its predictions.

    Parameters
    ----------
    repetitions
        Repetitions with rows (of `tried`), row_weight, and each model's predictions, learned from the largest log.
    """
    num = np.zeros(len(tried))
    sums = {name: np.zeros(len(tried)) for name in ("weight", *known.MODEL_NAMES)}
    for piece in repetitions:
        rows = np.array(piece["rows"], dtype=np.int64)
        num[rows] += 1.0
        sums["weight"][rows] += piece["row_weight"]
        for model in known.MODEL_NAMES:
            sums[model][rows] += piece["said"][model]
    kept = np.flatnonzero(num)
    mean = {name: values[kept] / num[kept] for name, values in sums.items()}
    met = tried.iloc[kept]
    held, tables = met["succeeded"].to_numpy(dtype=bool), met["trajectory"].to_numpy()
    lines = []
    for model in known.MODEL_NAMES:
        ways = {
            "occlusion": (occlusion_bins(met["occlusion"].to_numpy()), OCCLUSION_EDGES),
            "prediction": _alike(mean[model]),
        }
        for by, (groups, ends) in ways.items():
            for k, share in shares_by(groups, held, mean[model], mean["weight"], tables).items():
                line = {"model": model, "by": by, "bin_from": float(ends[k]), "bin_to": float(ends[k + 1])}
                line |= {"attempts": share.num_attempts, "share_of_attempts": share.num_attempts / len(kept)}
                line |= {"tables": share.num_tables, "mean_probability": share.predicted, "share_held": share.held}
                of = {"difference": share.difference, "low": share.low - share.predicted}
                lines.append(line | of | {"high": share.high - share.predicted})
    return pd.DataFrame(lines)


def _alike(said: Rows) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " edges"]]:
    """Group attempts by prediction into bins of about equal size; equal predictions stay together."""
    edges = np.unique(np.quantile(said, np.linspace(0.0, 1.0, NUM_PREDICTION_BINS + 1)))
    if len(edges) < 2:
        edges = np.repeat(edges, 2)
    return np.searchsorted(edges[1:-1], said, side="right").astype(np.int64), edges


def _counts(planner: str, source: Source) -> Row:
    tried, fit = frame_of(source), fit_of(source)
    counts = {"planner": planner, "tables": tried["trajectory"].nunique()}
    return counts | {"decided": fit.num_decided, "cut": fit.num_cut, "held": int(tried["succeeded"].sum())}


def held_by_occlusion(planner: str, source: Source) -> list[Row]:
    """Share held by occlusion, for standing and lying objects; attempts have weight 1/Ĝ."""
    tried = frame_of(source)
    decided = checked_attempts(tried)
    met = tried.iloc[decided.row]
    is_lying, lines = met["is_lying"].to_numpy(dtype=bool), []
    occlusion, tables = met["occlusion"].to_numpy(), met["trajectory"].to_numpy()
    for lies in (False, True):
        rows = is_lying == lies
        groups, nothing = occlusion_bins(occlusion[rows]), np.zeros(int(rows.sum()))
        found = shares_by(groups, decided.succeeded[rows], nothing, decided.weight[rows], tables[rows])
        for k, share in found.items():
            place = {"planner": planner, "is_lying": lies, "bin_from": OCCLUSION_EDGES[k]}
            place |= {"bin_to": OCCLUSION_EDGES[k + 1], "occlusion": float(occlusion[rows][groups == k].mean())}
            place |= {"attempts": share.num_attempts, "tables": share.num_tables}
            lines.append(place | {"share_held": share.held, "low": share.low, "high": share.high})
    return lines


def _law(planner: str, source: Source) -> pd.DataFrame:
    """Estimates of the regression, with normal 95 % confidence intervals clustered by table."""
    fit = fit_of(source)
    value, error = fit.estimate, fit.standard_error
    law = {"planner": planner, "parameter": NAMES, "estimate": value, "se": error}
    ends = {"low": value - _Z * error, "high": value + _Z * error}
    return pd.DataFrame(law | ends | {"p_value": 2.0 * stats.norm.sf(np.abs(value) / error)})


def _slopes(sources: Mapping[str, Source]) -> pd.DataFrame:
    """P(held) by occlusion at the first attempt at a usual object: by each regression, and under the assumed laws."""
    curves = [
        pd.DataFrame({"law": name, "is_lying": lies, "occlusion": SHOWN} | _curve(fit_of(source), lies))
        for name, source in sources.items()
        for lies in (False, True)
    ]
    assumed = {"law": ASSUMED, "is_lying": False, "occlusion": SHOWN, "share_held": assumed_share(SHOWN)}
    return pd.concat([*curves, pd.DataFrame(assumed)], ignore_index=True)


def assumed_share(occlusion: Float[np.ndarray, " shown"]) -> Float[np.ndarray, " shown"]:
    """P(held) under the assumed laws, with the offset of an object integrated out."""
    law: Any = WorldConfig().grasping
    log_failure = law.log_failure(occlusion[:, None], float(law.offset_std) * _NODES)
    return (1.0 - np.exp(np.asarray(log_failure, dtype=np.float64))) @ (_WEIGHTS / _WEIGHTS.sum())


def _curve(fit: GraspFit, lies: bool) -> dict[str, Float[np.ndarray, " shown"]]:
    """P(held) by occlusion, with bands by the delta method on the logit scale."""
    covariates = np.zeros((len(SHOWN), len(NAMES) - 1))
    covariates[:, 0], covariates[:, 1], covariates[:, NAMES.index("is_lying")] = 1.0, SHOWN, float(lies)

    def log_odds(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " shown"]:
        return logit(held_share(theta, covariates))

    steps = _STEP * np.eye(len(NAMES))
    gradient = [(log_odds(fit.estimate + step) - log_odds(fit.estimate - step)) / (2.0 * _STEP) for step in steps]
    reach = _Z * np.sqrt(np.einsum("ps,pq,qs->s", gradient, fit.covariance, gradient))
    middle = log_odds(fit.estimate)
    return {"share_held": expit(middle), "low": expit(middle - reach), "high": expit(middle + reach)}
