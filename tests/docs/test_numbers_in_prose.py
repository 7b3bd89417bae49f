"""Numbers that prose tells are those of the logs, laws and measurements that come with the repository."""

import importlib
import json
import re
import runpy

import pandas as pd
import pytest

from halfseen.cell.calibration.law import ATTEMPTS, VISIBLE_ONLY, read_law, shipped_law
from halfseen.cli.cell import calibrate
from halfseen.logs import read_logs
from pictures.guide_pages import numbers_in, table_of
from pictures.intervals import INTERVALS
from pictures.picture import NUMBERS, ROOT

CELL = "docs/guide/physical-cell.md"
TOLD = {
    "README.md": (
        "{logs} parts to learn from, and {later} later ones",
        "| learned from 800 trajectories of which half were cut | {best_800} ({best_800_span}) |",
        "| learned from 25 | {best_25} ({best_25_span}) |",
        "| a planner of 512 simulations a decision, which knows the true laws | {planner-512} ({planner-512_span}) |",
        "| greedy | {greedy} ({greedy_span}) |",
    ),
    "docs/guide/the-study.md": (
        "by {best_800} points a table from 800 trajectories of which half were cut ({best_800_span})",
        "by {best_25} from 25 ({best_25_span})",
    ),
    "examples/README.md": (
        "{logs} trajectories of which a third are cut, and {later} later ones",
        "holds {cleared} tables that an arm cleared",
    ),
    "docs/guide/from-logs-to-a-policy.md": (
        "{logs} parts that differ in weight",
        "{logs} trajectories of up to",
        "{logs} parts are few",
        "is of {later} parts that came later",
    ),
    "docs/guide/where-does-it-go.md": ("stand for all {logs};",),
    CELL: (
        "`calibrate` makes {calibrated} by default",
        "of {attempts} attempts on {tables} tables, of which {attempts_cut} were cut and {last} were the last",
        "holds {visible_only} attempts with grasps planned from visible points alone",
        "A look shows {view} % of a cup at most",
        "found {found} % of the dirty ones and taken {taken} % of the clean ones for dirty",
        "turned, {found_turned} and {taken_turned} %",
    ),
    "docs/guide/can-i-believe-it.md": ("{missed} of the {intervals} miss it, in orange",),
    "docs/gallery.md": (
        "{logs} parts, three grippers and a person to hand a part over to; {logs_cut} trajectories were cut",
        "{later} parts that came later",
        "The operator cut {by_operator};",
        "a sensor was lost in {by_sensor}.",
        "{cleared} tables that the arm cleared",
        "{cleared_cut} were cut: {hard} by a contact that was too hard, {lost} by a lost camera, {long} by an attempt",
    ),
}
"""By page: what it says, with the names of its numbers."""
WORDS = {2: "Two", 40: "forty"}


def prose(page):
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def law():
    return read_law(shipped_law()).law


def counts(law):
    logs, later, cleared = (
        read_logs(ROOT / "examples" / name) for name in ("pick_cell/logs", "pick_cell/later_logs", "physical_cell/logs")
    )
    tried, by = read_logs(shipped_law() / ATTEMPTS), later.trajectories["cause"].value_counts()
    stopped = cleared.trajectories["cause"].value_counts()
    found = {
        "logs": logs.num_trajectories,
        "logs_cut": (~logs.is_finished).sum(),
        "later": later.num_trajectories,
        "by_operator": by["operator"],
        "by_sensor": by["sensor-lost"],
        "cleared": cleared.num_trajectories,
        "cleared_cut": (~cleared.is_finished).sum(),
        "hard": stopped["emergency-stop"],
        "lost": stopped["sensor-lost"],
        "long": stopped["time-out"],
        "attempts": tried.num_stages,
        "attempts_cut": law.grasp.num_cut,
        "last": tried.num_stages - law.grasp.num_decided - law.grasp.num_cut,
        "tables": tried.num_trajectories,
        "visible_only": read_logs(shipped_law() / VISIBLE_ONLY).num_stages,
        "calibrated": next(option.default for option in calibrate.params if option.name == "attempts"),
    }
    intervals, seeing = INTERVALS.numbers.read(), law.seeing
    missed = sum(not row["low"] <= row["truth"] <= row["high"] for row in intervals)
    shares = {"view": seeing.views[3], "found": seeing.sensitivity[3], "taken": seeing.false_alarms[3]}
    shares |= {"found_turned": seeing.sensitivity[4], "taken_turned": seeing.false_alarms[4]}
    return (
        {name: f"{count:,}" for name, count in found.items()}
        | {name: f"{100 * share:.0f}" for name, share in shares.items()}
        | {"missed": WORDS[missed], "intervals": WORDS[len(intervals)]}
    )


def gains():
    """What the learned policy earns over the best rule in the study [points a table]."""
    rows = pd.read_csv(NUMBERS / "study-figure1.csv")
    learned = rows[(rows["policy"] == "censored_q") & ((rows["cut_share"] - 0.5).abs() < 1e-6)].set_index(
        "num_trajectories"
    )
    each = {f"best_{size}": learned.loc[size] for size in (25, 800)}
    each |= {name: rows[rows["policy"] == name].iloc[0] for name in ("planner-512", "greedy")}
    found = {name: f"{row['gain']:.2f}" for name, row in each.items()}
    found |= {f"{name}_span": f"{row['gain_low']:.2f} to {row['gain_high']:.2f}" for name, row in each.items()}
    return {name: text.replace("-", "−") for name, text in found.items()}


def test_a_number_in_prose_is_that_of_the_log_the_law_or_the_measurement(law):
    result = counts(law) | gains()
    for page, sentences in TOLD.items():
        text = prose(page)
        assert [words for words in sentences if words.format(**result) not in text] == [], page
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]:
        others = set(re.findall(r"(\d[\d,]*) parts\b", page.read_text(encoding="utf-8")))
        assert others <= {result["logs"], result["later"]}, page


EFFECTS = {
    "occlusion": "wholly hidden, for in full view",
    "is_lying": "lying, for standing",
    "width_m": "each 2 cm of width",
    "room_m": "each 3 cm of room beside it",
}


def test_the_page_of_the_cell_tells_the_law_that_comes_with_the_package(law):
    page = (ROOT / CELL).read_text(encoding="utf-8")
    for (name, effect), error in zip(law.coefficients.items(), law.grasp.standard_error, strict=True):
        if name in EFFECTS:
            (cells,) = re.findall(rf"^\| {EFFECTS[name]} \| (\S+) \| (\S+) to (\S+) \|$", page, flags=re.MULTILINE)
            result = [float(cell.replace("−", "-")) for cell in cells]
            # Told to one digit behind the point.
            assert result == pytest.approx([effect, effect - 1.96 * error, effect + 1.96 * error], abs=0.051), name


def biases(situation):
    """Bias [s], its standard error [s] and coverage [%] in the guide, by model."""
    head, *rows = table_of("which-censoring-model", "<!-- benchmarks/dependent_cuts.py -->")
    return {row[0]: numbers_in(row[head.index(situation)]) for row in rows}


def test_kaplan_meier_is_biased_where_cuts_depend_on_covariates_and_cox_is_not():
    biased, biased_error, biased_covers = biases("linear")["kaplan-meier"]
    bias, error, covers = biases("linear")["cox"]
    assert abs(biased) > 10 * biased_error
    assert abs(bias) < 2 * error
    assert biased_covers < 80 < 95 <= covers


@pytest.mark.slow
@pytest.mark.parametrize("situation", ["linear", "curved"])
def test_the_table_of_biases_is_what_the_benchmark_prints(situation):
    measured = runpy.run_path(str(ROOT / "benchmarks/dependent_cuts.py"))["measured"]
    printed, models = biases(situation), ("drop", "kaplan-meier", "cox", "cox, z and z²")
    rows = [row for row in measured(situation, 200, models) if row["share"] == "1/2"]
    assert len(rows) == len(models)
    for row in rows:
        bias, error, covers = printed[row["model"]]
        assert [row["bias_s"], row["bias_error_s"]] == pytest.approx([bias, error], abs=1e-3)
        # One interval of 200 may end so near the truth that rounding decides.
        assert 100 * row["coverage"] == pytest.approx(covers, abs=0.51)


def test_the_guide_says_what_benchmarks_measured(monkeypatch):
    usage = (ROOT / "benchmarks/verdicts.py").read_text(encoding="utf-8")
    result = re.findall(r"(\d+) logs of (\d+) trajectories a row", prose("docs/guide/can-i-believe-it.md"))
    assert result == re.findall(r"\[--logs (\d+)\] \[--trajectories (\d+)\]", usage)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    fleet, text = importlib.import_module("fleet"), prose("docs/guide/any-multistage-problem.md")
    assert [each for each in fleet.sentences(json.loads(fleet.KEPT.read_text())) if each not in text] == []
