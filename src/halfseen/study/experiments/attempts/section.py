"""What the experiment says: Figure 8, Table 4, whether the paper's claim holds, and what occlusion does."""

from collections.abc import Callable
from functools import partial

import pandas as pd

from halfseen.study.experiment import Drawing, Listing, Row, Section, Setting, Tables
from halfseen.study.experiments.attempts.design import MEASURES, MODEL_NAMES, PAIRS, PLANNERS, SVMS, AttemptsDesign
from halfseen.study.experiments.attempts.figure import draw
from halfseen.study.experiments.attempts.words import (
    NO_ATTEMPTS,
    NOUNS,
    SCORE_DECIMALS,
    assumption,
    calibrated,
    claim,
    fall,
    others,
    title_of,
)
from halfseen.study.frames import records
from halfseen.study.wording import estimated_in
from halfseen.wording import amount, capitalised, p_value

HEADING = "Physical attempts: a Beta mean or an SVM, and what occlusion does"
NUM_LEADING = 3
PARAMETER_NAMES = {
    "log_odds": "log-odds, standing, usual width and room",
    "occlusion": "occlusion, from none to all",
    "is_lying": "lying",
    "width_m": "each 2 cm of width",
    "room_m": "each 3 cm of room",
    "log_offset_std": "log of the spread of objects’ offsets",
}


def section_of(design: AttemptsDesign, setting: Setting, tables: Tables) -> Section:
    """Say what attempts tell; where there are none, say that."""
    if not tables:
        return Section(HEADING, (NO_ATTEMPTS,), (), (), num_leading=0)
    sentences = (claim(tables), fall(tables), assumption(tables), others(tables), calibrated(tables))
    drawing = Drawing(
        "figure8", "Figure 8", title_of(tables["attempts_tests"]), _caption(design, tables), partial(draw, tables)
    )
    listings = (
        _tests(setting, tables["attempts_tests"]),
        _other_tests(tables["attempts_tests"]),
        _numbers(tables["attempts_scores"]),
        _law(tables["attempts_law"]),
    )
    return Section(HEADING, sentences, (drawing,), listings, NUM_LEADING)


def _caption(design: AttemptsDesign, tables: Tables) -> str:
    repetitions = int(tables["attempts_scores"]["repetitions"].iloc[0])
    return (
        "Models of the probability that an attempt of the physical cell holds, learned from the attempts at some "
        f"tables and scored on those at others: one {design.num_folds}th of the tables is held out in each of "
        f"{repetitions} repetitions, and no table is both. Cut attempts weigh nothing, decided ones 1/Ĝ, in learning "
        "and in scoring. Bars: 95 % intervals by Student’s t, with errors clustered by table and by repetition, which "
        "share what was learned from. The logistic law has a random offset of each object and goes by what is seen "
        "(occlusion, pose, width, room) and by what came of past attempts at it; so does the SVM with a "
        "set kernel. Lower left: learned from the largest "
        f"log; bars clustered by table.{_stood_in(tables)} Lower right: markers, counted; lines and bands, the "
        "regression at the first attempt at an object of usual width and room; dashed, the assumed laws."
    )


def _stood_in(tables: Tables) -> str:
    scores = tables["attempts_scores"]
    num = int(scores["stood_in"].sum())
    if not num:
        return ""
    return (
        f" Where fewer than two objects missed no SVM can be fitted, and one rate for all stands in for it: "
        f"{num} of {int(scores.loc[scores['model'].isin(SVMS), 'repetitions'].sum())} fits."
    )


def _cells() -> dict[str, Callable[[Row], str]]:
    return {
        "learned from": lambda row: f"{row['num_tables']} tables",
        "difference": lambda row: estimated_in(row, ("effect", "low", "high"), SCORE_DECIMALS),
        "p": lambda row: p_value(row["p_value"]),
        "p, adjusted": lambda row: p_value(row["p_holm"]),
        "the first is": lambda row: row["verdict"],
    }


def _tests(setting: Setting, tests: pd.DataFrame) -> Listing:
    caption = (
        "The SVM against the Beta mean on physical attempts: two-sided tests. Difference: SVM − Beta mean, below 0 is "
        "better, with its 95 % interval (not adjusted). Holm’s procedure adjusted the p-values of each pair of models "
        f"together, over sizes and scores; α = {setting.alpha:g}."
    )
    model, rival = PAIRS[0]
    rows = records(tests, model=model, rival=rival)
    return Listing.of("Table 4", caption, rows, _cells(), lambda row: capitalised(MEASURES[row["measure"]]), False)


def _other_tests(tests: pd.DataFrame) -> Listing:
    rows = [row for model, rival in PAIRS[1:] for row in records(tests, model=model, rival=rival)]
    return Listing.of("The other pairs of models, tested alike", "", rows, _cells(), _heading)


def _heading(row: Row) -> str:
    return f"{capitalised(NOUNS[row['model']])} against {NOUNS[row['rival']]}: {MEASURES[row['measure']]}"


def _numbers(scores: pd.DataFrame) -> Listing:
    def cell(measure: str) -> Callable[[Row], str]:
        columns = [f"{measure}{end}" for end in ("", "_low", "_high")]
        return lambda row: estimated_in(row, columns, SCORE_DECIMALS)

    cells = {"model": lambda row: MODEL_NAMES[row["model"]], "tables": lambda row: str(row["num_tables"])}
    cells |= {words: cell(measure) for measure, words in MEASURES.items()}
    return Listing.of("The numbers of Figure 8", "", records(scores), cells)


def _law(law: pd.DataFrame) -> Listing:
    caption = (
        "Logistic regression of what holds, with a random offset of each object; errors are robust to attempts of one "
        "table being alike."
    )
    cells = {
        "log-odds": lambda row: PARAMETER_NAMES[row["parameter"]],
        "estimate": lambda row: estimated_in(row, ("estimate", "low", "high")),
        "standard error": lambda row: amount(row["se"]),
        "p": lambda row: p_value(row["p_value"]),
    }
    return Listing.of(
        "What moves success", caption, records(law), cells, lambda row: capitalised(PLANNERS[row["planner"]].words)
    )
