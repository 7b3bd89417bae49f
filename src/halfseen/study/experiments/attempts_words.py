"""The experiment's findings: whether an SVM predicts better, and success falls with occlusion; Figure 8, Table 4."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen import figures as pages
from halfseen.cell.calibration.fits import SCALES
from halfseen.figures import BLUE, FAINT, INK, ORANGE, PINK, RED, SKY, SOFT
from halfseen.study import figures
from halfseen.study.compare import estimated_in, records, row_of, three, where
from halfseen.study.experiment import Drawing, Listing, Row, Section, Tables, words
from halfseen.study.experiments import attempts_repetition as names
from halfseen.study.experiments.attempts_repetition import COMPLETED, LAW, MEASURES, MODEL_NAMES, PAIRS
from halfseen.study.setting import Setting
from halfseen.wording import amount, as_sentence, capitalised, estimated, interval, listed, p_value, percent

ASSUMED = "assumed"
BETTER, WORSE, UNDECIDED = "better", "worse", "no significant difference"
ADVERBS = {BETTER: "better", WORSE: "worse", UNDECIDED: "neither clearly better nor worse"}
SCORE_DECIMALS = 4
MODEL_COLOURS = {"rate": ORANGE, "beta": BLUE, "svm": RED, "svm-facts": SKY, "svm-set": PINK, LAW: INK}
LOOKS = figures.looks(MODEL_COLOURS, MODEL_NAMES)
NOUNS = {
    "beta": "the Beta mean",
    "svm": "the SVM",
    "svm-facts": "the SVM that also sees pose, width and room",
    "svm-set": "the SVM with a set kernel over past attempts",
    LAW: "the logistic law",
}
PLANNED = {COMPLETED: "where hidden shape is completed", names.VISIBLE_ONLY: "where only visible points count"}
WIDTH_WANTED, SHARE_OF_A_BIN = 0.03, 0.1
"""Half-width wanted for the interval of a calibration, in a bin with this share of the attempts."""
POSES = {False: ("standing", SKY, "o"), True: ("lying", ORANGE, "s")}
INTERVAL = ["share_held", "low", "high"]
DODGE, STEP, APART = 1.08, 0.16, 0.006
PARAMETER_NAMES = {
    "log_odds": "log-odds, standing, usual width and room",
    "occlusion": "occlusion, from none to all",
    "is_lying": "lying",
    "width_m": "each 2 cm of width",
    "room_m": "each 3 cm of room",
    "log_offset_std": "log of the spread of objects’ offsets",
}


def section_of(design: names.AttemptsRepetition, setting: Setting, tables: Tables) -> Section:
    """Report the findings from attempts, or that there are none."""
    heading = "Physical attempts: a Beta mean or an SVM, and the effect of occlusion"
    if not tables:
        return Section(heading, (words("attempts", "nothing"),), (), (), num_leading=0)
    scores = tables["attempts_scores"]
    sentences = (claim(tables), fall(tables), assumption(tables), others(tables), calibrated(tables))
    drawing = Drawing(
        "figure8",
        "Figure 8",
        f"On physical attempts, the SVM predicts {by_size(tables['attempts_tests'], *PAIRS[0])}",
        words("attempts", "caption", design=design, svms=scores[scores["model"].isin(names.SVMS)]),
        partial(_draw, tables),
    )
    listings = (*_tests(setting, tables["attempts_tests"]), _numbers(scores), _law(tables["attempts_law"]))
    return Section(heading, sentences, (drawing,), listings, num_leading=3)


def _tests(setting: Setting, tests: pd.DataFrame) -> list[Listing]:
    caption = words("attempts", "tests", setting=setting)
    cells: dict[str, Callable[[Row], str]] = {
        "learned from": lambda row: f"{row['num_tables']} tables",
        "difference": lambda row: estimated_in(row, ("effect", "low", "high"), SCORE_DECIMALS),
        "p": lambda row: p_value(row["p_value"]),
        "p, adjusted": lambda row: p_value(row["p_holm"]),
        "the first is": lambda row: row["verdict"],
    }
    first, *others = (records(tests, model=model, rival=rival) for model, rival in PAIRS)
    rest = [row for rows in others for row in rows]

    def heading(row: Row) -> str:
        return f"{capitalised(NOUNS[row['model']])} against {NOUNS[row['rival']]}: {MEASURES[row['measure']]}"

    return [
        Listing.of("Table 4", caption, first, cells, lambda row: capitalised(MEASURES[row["measure"]]), False),
        Listing.of("The other pairs of models, tested alike", "", rest, cells, heading),
    ]


def _numbers(scores: pd.DataFrame) -> Listing:
    cells: dict[str, Callable[[Row], str]] = {"model": lambda row: MODEL_NAMES[row["model"]]}
    cells["tables"] = lambda row: str(row["num_tables"])
    for measure, name in MEASURES.items():
        cells[name] = partial(estimated_in, names=three(measure), decimals=SCORE_DECIMALS)
    return Listing.of("The numbers of Figure 8", "", records(scores), cells)


def _law(law: pd.DataFrame) -> Listing:
    caption = words("attempts", "law")
    cells = {
        "log-odds": lambda row: PARAMETER_NAMES[row["parameter"]],
        "estimate": lambda row: estimated_in(row, ("estimate", "low", "high")),
        "standard error": lambda row: amount(row["se"]),
        "p": lambda row: p_value(row["p_value"]),
    }
    return Listing.of(
        "What affects success", caption, records(law), cells, lambda row: capitalised(PLANNED[row["planner"]])
    )


def by_size(tests: pd.DataFrame, model: str, rival: str) -> str:
    """Say from which number of tables a model predicts better than another, worse, or neither."""
    rows = records(tests, model=model, rival=rival, measure=names.SCORE)
    sizes = {verdict: [str(row["num_tables"]) for row in rows if row["verdict"] == verdict] for verdict in ADVERBS}
    met = {verdict: of for verdict, of in sizes.items() if of}
    first, *rest = met
    if not rest:
        least, most = rows[0]["num_tables"], rows[-1]["num_tables"]
        which = "any" if first == UNDECIDED else "every"
        return f"{ADVERBS[first]} than {NOUNS[rival]} at {which} size, from {least} to {most} tables"
    clauses = [f"{ADVERBS[first]} than {NOUNS[rival]} from {listed(met[first])}"]
    return f"{listed([*clauses, *(f'{ADVERBS[verdict]} from {listed(met[verdict])}' for verdict in rest)])} tables"


def numbers_of(row: Row) -> str:
    """The difference of a test with its interval and adjusted p-value."""
    written = p_value(row["p_holm"])
    p = written if written[0] in "<>" else f"= {written}"
    low_high = interval(row["low"], row["high"], SCORE_DECIMALS)
    return f"{amount(row['effect'], SCORE_DECIMALS)}, 95 % interval {low_high}; adjusted p {p}"


def claim(tables: Tables) -> str:
    """The answer to the paper's claim, by size of the log."""
    tests, counts = tables["attempts_tests"], row_of(tables["attempts"], planner=COMPLETED)
    last = records(tests, model=PAIRS[0][0], rival=PAIRS[0][1], measure=names.SCORE)[-1]
    facts_of = {"by_size": by_size(tests, *PAIRS[0]), "numbers": numbers_of(last)}
    return words("attempts", "claim", counts=counts, last=last, **facts_of)


def others(tables: Tables) -> str:
    """Say how the models with more covariates perform."""
    tests = tables["attempts_tests"]
    clauses = []
    for model, rival in PAIRS[1:]:
        last = records(tests, model=model, rival=rival, measure=names.SCORE)[-1]
        size = last["num_tables"]
        clauses.append(f"{NOUNS[model]} predicts {by_size(tests, model, rival)} (from {size}: {numbers_of(last)})")
    return as_sentence("; ".join(clauses))


def fall(tables: Tables) -> str:
    """Say whether success falls with occlusion, for each planner of grasps, and what else affects it."""
    law = tables["attempts_law"]
    steps = f"each {100 * SCALES['width_m']:g} cm of width", f"each {100 * SCALES['room_m']:g} cm of room beside it"
    others = {"is_lying": "what lies", "width_m": steps[0], "room_m": steps[1]}
    clauses, slopes = [], []
    for name, planned in PLANNED.items():
        of = {row["parameter"]: row for row in records(law, planner=name)}
        if of:
            effects = [f"{_estimate(of[each])} for {what}" for each, what in others.items()]
            slopes.append(of["occlusion"])
            facts = {"planned": planned, "slope": slopes[-1], "effects": effects, "estimate": _estimate}
            clauses.append(words("attempts", "fall", **facts))
    if len(slopes) == len(PLANNED):
        ours, other = slopes
        change, reach = other["estimate"] - ours["estimate"], 1.96 * np.hypot(other["se"], ours["se"])
        clauses.append(f"the second slope less the first is {estimated(change, change - reach, change + reach, 1)}")
    return as_sentence("; ".join(clauses))


def _estimate(row: Row) -> str:
    return estimated(row["estimate"], row["low"], row["high"], 1)


def assumption(tables: Tables) -> str:
    """Compare the assumed laws with the attempts."""
    slope, places = tables["attempts_slope"], (0.0, 0.5)
    standing, lying = (
        [_share(_at(where(slope, law=COMPLETED, is_lying=lies), place)) for place in places] for lies in (False, True)
    )
    assumed = [percent(_at(where(slope, law=ASSUMED), place)["share_held"]) for place in places]
    return words("attempts", "assumption", standing=standing, lying=lying, assumed=assumed)


def _at(rows: pd.DataFrame, occlusion: float) -> Row:
    return dict(rows.iloc[int(np.argmin(np.abs(rows["occlusion"].to_numpy() - occlusion)))])


def _share(row: Row) -> str:
    value, low, high = (100.0 * float(row[name]) for name in ("share_held", "low", "high"))
    return f"{amount(value, 1)}\u00a0% ({interval(low, high, 1)})"


def calibrated(tables: Tables) -> str:
    """Say how well the law is calibrated in a bin of occlusion that holds a tenth of the attempts."""
    rows = records(tables["attempts_calibration"], model=LAW, by="occlusion")
    full = [row for row in rows if row["share_of_attempts"] >= SHARE_OF_A_BIN]
    if not full:
        return "No bin of occlusion holds a tenth of the attempts, so calibration is not assessed."
    widest = max((row["high"] - row["low"]) / 2.0 for row in full)
    off = max((row["difference"] for row in full), key=abs)
    away = [f"{row['bin_from']:g} to {row['bin_to']:g}" for row in full if row["low"] > 0 or row["high"] < 0]
    facts = {"num": len(full), "off": abs(off), "widest": widest, "wanted": WIDTH_WANTED, "away": away}
    return words("attempts", "calibrated", **facts)


def _draw(tables: Tables, title: str) -> Figure:
    """Draw scores above, calibration and success below."""
    size, place = (pages.WIDTH_INCHES, 7.6), {"left": 0.075, "right": 0.985, "bottom": 0.085}
    grid = place | {"hspace": 0.38, "wspace": 0.17}
    figure, top, panels = figures.panels(title, size, (2, 2), 0.11, (False, False), **grid)
    scores, series = tables["attempts_scores"], {name: look for name, look in LOOKS.items() if name != "beta"}
    for axes, (measure, name), unit in zip(panels[0], MEASURES.items(), (" [nats]", ""), strict=True):
        pages.draw_zero(axes, MODEL_COLOURS["beta"])
        figures.draw_series(axes, scores, ("model", "num_tables"), series, three(f"{measure}_over_beta"), DODGE)
        pages.mark_sizes(axes, sorted(set(scores["num_tables"])))
        across = "tables that the model was learned from (log scale)"
        figures.name_panel(axes, f"{name} at unseen tables, above the Beta mean’s{unit}", across)
    _draw_calibration(panels[1, 0], tables["attempts_calibration"], ("beta", "svm", LAW))
    _draw_success(panels[1, 1], tables)
    shown = (*panels[0], panels[1, 0])
    figures.write_names(figure, top - 0.012, MODEL_NAMES, *shown, columnspacing=1.2, handletextpad=0.4)
    return figure


def _draw_calibration(axes: Axes, calibration: pd.DataFrame, models: Sequence[str]) -> None:
    """Share that held less the predicted share, by bin of occlusion."""
    axes.axhspan(-WIDTH_WANTED, WIDTH_WANTED, color=FAINT, alpha=0.5, linewidth=0, zorder=0.5)
    pages.draw_zero(axes)
    places = sorted(set(calibration.loc[calibration["by"] == "occlusion", "bin_from"]))
    for k, model in enumerate(models):
        rows = where(calibration, model=model, by="occlusion")
        across = np.searchsorted(places, rows["bin_from"]) + STEP * (k - (len(models) - 1) / 2)
        pages.draw_bars(axes, across, rows[["difference", "low", "high"]], linestyle="none", **LOOKS[model])
    bins = where(calibration, model=models[0], by="occlusion")
    ends = zip(bins["bin_from"], bins["bin_to"], bins["share_of_attempts"], strict=True)
    axes.set_xticks(range(len(places)), [f"{low:g}–{high:g}\n{percent(share)}" for low, high, share in ends])
    pages.draw_grid(axes)
    across = "hidden share of the object, and share of the attempts"
    figures.name_panel(axes, f"share that held − predicted, at unseen tables; grey: ±{WIDTH_WANTED:g}", across)


def _draw_success(axes: Axes, tables: Tables) -> None:
    """Share that held by occlusion: counted, by the law, and by the assumed laws."""
    slope, held = tables["attempts_slope"], tables["attempts_held"]
    for side, (lies, (name, colour, marker)) in zip((-1, 1), POSES.items(), strict=True):
        curve = where(slope, law=COMPLETED, is_lying=lies)
        pages.draw_curve(axes, curve["occlusion"], curve[INTERVAL], color=colour, linewidth=1.2)
        rows = where(held, planner=COMPLETED, is_lying=lies)
        look: Any = {"color": colour, "marker": marker, "linestyle": "none", "label": name}
        pages.draw_bars(axes, rows["occlusion"] + side * APART, rows[INTERVAL], **look)
    assumed = where(slope, law=ASSUMED)
    look = {"color": SOFT, "dashes": (4, 2), "linewidth": 1.4, "label": "assumed laws"}
    axes.plot(assumed["occlusion"], assumed["share_held"], **look)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    pages.draw_grid(axes)
    axes.legend(loc="lower left", frameon=False, fontsize=8.5)
    axes.set_xlim(-0.02, 0.84)
    words = "share of attempts that held; lines: by the law"
    figures.name_panel(axes, words, "hidden share of the object")
