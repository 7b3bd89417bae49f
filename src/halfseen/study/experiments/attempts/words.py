"""The sentences: whether an SVM predicts better, and whether success falls with occlusion."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.cell.calibration.grasp_fit import SCALES
from halfseen.study.experiment import Row, Tables
from halfseen.study.experiments.attempts.design import (
    BETA,
    COMPLETED,
    LAW,
    PAIRS,
    PLANNERS,
    SCORE,
    SHARE_OF_A_BIN,
    SVM,
    SVM_FACTS,
    SVM_SET,
    VISIBLE_ONLY,
    WIDTH_WANTED,
)
from halfseen.study.experiments.attempts.occlusion import ASSUMED
from halfseen.study.experiments.attempts.tables import BETTER, UNDECIDED, WORSE
from halfseen.study.frames import records, row_of, where
from halfseen.wording import amount, as_sentence, counted, estimated, interval, listed, p_value, percent

NO_ATTEMPTS = (
    "There are no attempts of a cell to test an SVM, or the fall of success with occlusion, on; `--law` names a law "
    "that was estimated from some."
)
SCORE_DECIMALS = 4
NOUNS = {
    BETA: "the Beta mean",
    SVM: "the SVM",
    SVM_FACTS: "the SVM that also sees pose, width and room",
    SVM_SET: "the SVM with a set kernel over past attempts",
    LAW: "the logistic law",
}
ADVERBS = {BETTER: "better", WORSE: "worse", UNDECIDED: "neither clearly better nor worse"}


def by_size(tests: pd.DataFrame, model: str, rival: str) -> str:
    """Say from how many tables a model predicts better than another, worse, or neither."""
    rows = records(tests, model=model, rival=rival, measure=SCORE)
    sizes = {verdict: [str(row["num_tables"]) for row in rows if row["verdict"] == verdict] for verdict in ADVERBS}
    met = {verdict: of for verdict, of in sizes.items() if of}
    first, *rest = met
    if not rest:
        least, most = rows[0]["num_tables"], rows[-1]["num_tables"]
        which = "any" if first == UNDECIDED else "every"
        return f"{ADVERBS[first]} than {NOUNS[rival]} at {which} size, from {least} to {most} tables"
    told = [f"{ADVERBS[first]} than {NOUNS[rival]} from {listed(met[first])}"]
    return f"{listed([*told, *(f'{ADVERBS[verdict]} from {listed(met[verdict])}' for verdict in rest)])} tables"


def numbers_of(row: Row) -> str:
    """The difference of a test with its interval and adjusted p-value."""
    written = p_value(row["p_holm"])
    p = written if written[0] in "<>" else f"= {written}"
    low_high = interval(row["low"], row["high"], SCORE_DECIMALS)
    return f"{amount(row['effect'], SCORE_DECIMALS)}, 95 % interval {low_high}; adjusted p {p}"


def claim(tables: Tables) -> str:
    """The answer to the paper's claim, by size of what was learned from."""
    (model, rival), counts = PAIRS[0], row_of(tables["attempts"], planner=COMPLETED)
    last = records(tables["attempts_tests"], model=model, rival=rival, measure=SCORE)[-1]
    return (
        f"On physical attempts ({counts['decided']:,} decided at {counted(counts['tables'], 'table')}, "
        f"{percent(counts['held'] / counts['decided'])} of them held), the SVM predicts what will hold "
        f"{by_size(tables['attempts_tests'], model, rival)} (log-loss at tables kept apart, SVM − Beta mean, from "
        f"{last['num_tables']}: {numbers_of(last)})."
    )


def others(tables: Tables) -> str:
    """Say how the models that see more do."""
    tests = tables["attempts_tests"]
    told = []
    for model, rival in PAIRS[1:]:
        last = records(tests, model=model, rival=rival, measure=SCORE)[-1]
        size = last["num_tables"]
        told.append(f"{NOUNS[model]} predicts {by_size(tests, model, rival)} (from {size}: {numbers_of(last)})")
    return as_sentence("; ".join(told))


def fall(tables: Tables) -> str:
    """Say whether success falls with occlusion, for each planner of grasps, and what else moves it."""
    law = tables["attempts_law"]
    told = [_fall_of(law, name) for name in PLANNERS if (law["planner"] == name).any()]
    if len(told) == len(PLANNERS):
        told.append(_contrast(law))
    return as_sentence("; ".join(told))


def _fall_of(law: pd.DataFrame, planner: str) -> str:
    of = {row["parameter"]: row for row in records(law, planner=planner)}
    slope = of["occlusion"]
    verb = "falls" if slope["high"] < 0 else "rises" if slope["low"] > 0 else "does not change significantly"
    steps = f"each {100 * SCALES['width_m']:g} cm of width", f"each {100 * SCALES['room_m']:g} cm of room beside it"
    effects = [
        f"{_estimate(of[name])} for {words}"
        for name, words in zip(("is_lying", "width_m", "room_m"), ("what lies", *steps), strict=True)
    ]
    return (
        f"{PLANNERS[planner].words}, success {verb} with occlusion: the log-odds of holding change by "
        f"{_estimate(slope)} from nothing hidden to all hidden, by {listed(effects)} (95 % intervals)"
    )


def _contrast(law: pd.DataFrame) -> str:
    ours, other = (row_of(law, planner=name, parameter="occlusion") for name in (COMPLETED, VISIBLE_ONLY))
    change, reach = other["estimate"] - ours["estimate"], 1.96 * np.hypot(other["se"], ours["se"])
    return f"the second slope less the first is {estimated(change, change - reach, change + reach, 1)}"


def _estimate(row: Row) -> str:
    return estimated(row["estimate"], row["low"], row["high"], 1)


def assumption(tables: Tables) -> str:
    """Say what the assumed laws have beside what attempts tell."""
    slope = tables["attempts_slope"]
    standing, lying = (where(slope, law=COMPLETED, is_lying=lies) for lies in (False, True))
    none, half = (f"{percent(_at(where(slope, law=ASSUMED), place)['share_held'])}" for place in (0.0, 0.5))
    return (
        f"A first attempt at a standing object of usual width and room holds in {_share(_at(standing, 0.0))} with "
        f"nothing hidden and in {_share(_at(standing, 0.5))} with half hidden; at one that lies, in "
        f"{_share(_at(lying, 0.0))} and {_share(_at(lying, 0.5))}; the assumed laws have {none} and {half}: their "
        "slope comes from no attempt."
    )


def _at(rows: pd.DataFrame, occlusion: float) -> dict[str, Any]:
    return dict(rows.iloc[int(np.argmin(np.abs(rows["occlusion"].to_numpy() - occlusion)))])


def _share(row: Row) -> str:
    value, low, high = (100.0 * float(row[name]) for name in ("share_held", "low", "high"))
    return f"{amount(value, 1)}\u00a0% ({interval(low, high, 1)})"


def calibrated(tables: Tables) -> str:
    """Say how well the law is calibrated where a bin of occlusion holds a tenth of the attempts."""
    rows = records(tables["attempts_calibration"], model=LAW, by="occlusion")
    full = [row for row in rows if row["share_of_attempts"] >= SHARE_OF_A_BIN]
    if not full:
        return "No bin of occlusion holds a tenth of the attempts, so nothing is said of calibration there."
    widest = max((row["high"] - row["low"]) / 2.0 for row in full)
    off = max((row["difference"] for row in full), key=abs)
    away = [_bin(row) for row in full if row["low"] > 0 or row["high"] < 0]
    wanted = "as was wanted" if widest <= WIDTH_WANTED else f"and not to the ±{WIDTH_WANTED:g} that was wanted"
    where_to = f"at {listed(away)}" if away else "nowhere"
    return (
        f"Of the bins of occlusion, {len(full)} hold a tenth of the attempts or more each; there the share that held "
        f"less what the law predicted at unseen tables is {amount(abs(off), 3)} at most, known to ±{amount(widest, 3)} "
        f"or better, {wanted}; it is significantly away from 0 {where_to}."
    )


def _bin(row: Row) -> str:
    return f"{row['bin_from']:g} to {row['bin_to']:g}"


def title_of(tests: pd.DataFrame) -> str:
    """What the figure shows first."""
    return f"On physical attempts, the SVM predicts {by_size(tests, *PAIRS[0])}"
