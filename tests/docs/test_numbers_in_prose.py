"""Numbers that prose tells are those of the logs, laws and measurements that come with the repository."""

import importlib
import json
import re
import runpy

import pandas as pd
import pytest

from halfseen.cell.calibration.law_folder import ATTEMPTS, VISIBLE_ONLY, read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cli.cell_calibrate import calibrate
from halfseen.logs import read_logs
from pictures.intervals import INTERVALS
from pictures.picture import ROOT
from pictures.ten_thousand import TEN_THOUSAND_NUMBERS

TOLD = {
    "README.md": ("{logs} parts and {later} later ones",),
    "examples/README.md": (
        "{logs} paths of which a third are cut, and {later} later ones",
        "holds {cleared} tables that an arm cleared",
    ),
    "docs/guide/from-logs-to-a-policy.md": (
        "{logs} parts that differ in weight",
        "{logs} paths of up to",
        "{logs} parts are few",
        "is of {later} parts that came later",
    ),
    "docs/guide/where-does-it-go.md": ("stand for all {logs};",),
    "docs/guide/physical-cell.md": (
        "the {calibrated} that `calibrate` makes",
        "of {attempts} attempts on {tables} tables, of which {attempts_cut} were cut and {last} were the last",
        "holds {visible_only} attempts with grasps that were planned from visible points alone",
    ),
    "docs/guide/what-the-intervals-mean.md": ("{missed} of the {intervals} miss it, in orange",),
    "docs/gallery.md": (
        "{logs} parts, three grippers and a person to hand a part over to; {logs_cut} paths were cut",
        "{later} parts that came later",
        "The operator cut {by_operator};",
        "a sensor was lost in {by_sensor}.",
        "{cleared} tables that the arm cleared",
        "{cleared_cut} were cut: {hard} by a contact that was too hard, {lost} by a lost camera, {long} by an attempt",
        "{tables} tables at which the arm tried",
    ),
}
WORDS = {2: "Two", 40: "forty"}


def prose(page):
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def law():
    return read_law(shipped_law()).law


@pytest.fixture(scope="module")
def counts(law):
    logs, later, cleared = (
        read_logs(ROOT / "examples" / name) for name in ("pick_cell/logs", "pick_cell/later_logs", "physical_cell/logs")
    )
    tried, intervals = read_logs(shipped_law() / ATTEMPTS), INTERVALS.numbers.read()
    by, stopped = later.paths["cause"].value_counts(), cleared.paths["cause"].value_counts()
    found = {
        "logs": logs.num_paths,
        "logs_cut": (~logs.is_finished).sum(),
        "later": later.num_paths,
        "by_operator": by["operator"],
        "by_sensor": by["sensor-lost"],
        "cleared": cleared.num_paths,
        "cleared_cut": (~cleared.is_finished).sum(),
        "hard": stopped["emergency-stop"],
        "lost": stopped["sensor-lost"],
        "long": stopped["time-out"],
        "attempts": tried.num_stages,
        "attempts_cut": law.grasp.num_cut,
        "last": tried.num_stages - law.grasp.num_decided - law.grasp.num_cut,
        "tables": tried.num_paths,
        "visible_only": read_logs(shipped_law() / VISIBLE_ONLY).num_stages,
        "calibrated": next(option.default for option in calibrate.params if option.name == "attempts"),
    }
    missed = sum(not row["low"] <= row["truth"] <= row["high"] for row in intervals)
    words = {"missed": WORDS[missed], "intervals": WORDS[len(intervals)]}
    return {name: f"{count:,}" for name, count in found.items()} | words


@pytest.mark.parametrize("page", TOLD)
def test_a_count_in_prose_is_that_of_the_log(page, counts):
    text = prose(page)
    assert [words for words in TOLD[page] if words.format(**counts) not in text] == []


def test_no_page_tells_another_number_of_parts(counts):
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]:
        told = re.findall(r"(\d[\d,]*) parts\b", page.read_text(encoding="utf-8"))
        assert set(told) <= {counts["logs"], counts["later"]}, page


EFFECTS = {
    "occlusion": "wholly hidden, for in full view",
    "is_lying": "lying, for standing",
    "width_m": "each 2 cm of width",
    "room_m": "each 3 cm of room beside it",
}


def test_the_page_of_the_cell_tells_the_law_that_comes_with_the_package(law):
    page = (ROOT / "docs/guide/physical-cell.md").read_text(encoding="utf-8")
    for (name, effect), error in zip(law.coefficients.items(), law.grasp.standard_error, strict=True):
        if name in EFFECTS:
            (cells,) = re.findall(rf"^\| {EFFECTS[name]} \| (\S+) \| (\S+) to (\S+) \|$", page, flags=re.MULTILINE)
            told = [float(cell.replace("−", "-")) for cell in cells]
            # Told to one digit behind the point.
            assert told == pytest.approx([effect, effect - 1.96 * error, effect + 1.96 * error], abs=0.051), name
    seeing, text = law.seeing, prose("docs/guide/physical-cell.md")
    view, found, taken = (100 * each[3] for each in (seeing.views, seeing.sensitivity, seeing.false_alarms))
    assert f"A look shows {view:.0f} % of a cup at most" in text
    assert f"found {found:.0f} % of the dirty ones and taken {taken:.0f} % of the clean ones for dirty" in text
    assert f"turned, {100 * seeing.sensitivity[4]:.0f} and {100 * seeing.false_alarms[4]:.0f} %" in text


def test_the_logs_that_verdicts_are_counted_over_are_those_of_the_benchmark():
    usage = (ROOT / "benchmarks/verdicts.py").read_text(encoding="utf-8")
    told = re.findall(r"records (\d+) logs of (\d+) paths", prose("docs/guide/how-good-is-it.md"))
    assert told == re.findall(r"\[--logs (\d+)\] \[--paths (\d+)\]", usage)


def between(low, high):
    return f"{low:.2f} to {high:.2f}"


def test_what_ten_thousand_repetitions_tell_is_what_is_kept_of_them():
    rows, text = pd.DataFrame(TEN_THOUSAND_NUMBERS.read()), prose("docs/guide/ten-thousand-repetitions.md")
    for question, some in rows.groupby("question"):
        told = [((some[f"{begin}low"] > 0) | (some[f"{begin}high"] < 0)).sum() for begin in ("few_", "")]
        assert f"| {len(some)} | {told[0]} | {told[1]} |" in text, question

    def of(question, against, size, share):
        asked = (rows["question"] == question) & (rows["against"].astype(str) == against) & (rows["num_paths"] == size)
        return rows[asked & ((rows["cut_share"] - share).abs() < 1e-6)].squeeze()

    few, many = of("cuts", "no cuts", 25, 0.5), of("cuts", "no cuts", 800, 0.5)
    doubled = [of("more", "400.0", 800, share)["mean"] for share in (0, 1 / 6, 1 / 3, 0.5)]
    uncut, half = (of("rule", "history-penalty", 800, share) for share in (0, 0.5))
    tie = of("rule", "history-penalty", 400, 1 / 6)
    for sentence in (
        f"{-few['mean']:.2f} points a table are lost with 25 paths ({between(-few['high'], -few['low'])})",
        f"{-many['mean']:.2f} with 800 ({between(-many['high'], -many['low'])})",
        f"{of('cuts', 'no cuts', 200, 0.5)['few_mean']:.2f} gained",
        f"still {between(min(doubled), max(doubled))} points a table",
        f"{uncut['mean']:.2f} points more where nothing was cut ({between(uncut['low'], uncut['high'])})",
        f"{half['mean']:.2f} where half was ({between(half['low'], half['high'])})",
        f"between {-half['few_low']:.2f} less and {half['few_high']:.2f} more",
        f"({tie['mean']:.2f}; −{-tie['low']:.2f} to {tie['high']:.2f})",
    ):
        assert sentence in text
    told = f"{half['mean']:.2f} points ({between(half['low'], half['high'])}), and by {uncut['mean']:.2f}"
    assert told in prose("README.md")


def biases(situation):
    """Bias [s], its standard error [s] and coverage [%] in the guide, by share of cuts and model."""
    page = (ROOT / "docs/guide/which-censoring-model.md").read_text(encoding="utf-8")
    table = page.split(f"<!-- benchmarks/dependent_cuts.py: {situation} -->\n")[1].split("\n\n")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    return {
        (cut, model): [float(each.replace("−", "-")) for each in re.findall(r"[+−]?\d+\.\d+", f"{bias} {covers}")]
        for cut, model, _, bias, covers in cells
    }


@pytest.mark.parametrize("cut", ["1/3", "1/2"])
def test_kaplan_meier_is_biased_where_cuts_depend_on_covariates_and_cox_is_not(cut):
    biased, biased_error, biased_covers = biases("linear")[cut, "kaplan-meier"]
    bias, error, covers = biases("linear")[cut, "cox"]
    assert abs(biased) > 10 * biased_error
    assert biased_covers < 80
    assert abs(bias) < 2 * error
    assert covers >= 95


@pytest.mark.slow
@pytest.mark.parametrize("situation", ["linear", "curved"])
def test_the_table_of_biases_is_what_the_benchmark_prints(situation):
    measured = runpy.run_path(str(ROOT / "benchmarks/dependent_cuts.py"))["measured"]
    for row in measured(situation, 200, ("drop", "kaplan-meier", "cox", "cox, z and z²")):
        bias, error, covers = biases(situation)[row["share"], row["model"]]
        assert [row["bias_s"], row["bias_error_s"]] == pytest.approx([bias, error], abs=1e-3)
        # One interval of 200 may end so near the truth that rounding decides.
        assert 100 * row["coverage"] == pytest.approx(covers, abs=0.51)


def test_the_guide_says_what_was_measured_of_a_fleet(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    fleet, text = importlib.import_module("fleet"), prose("docs/guide/any-multistage-problem.md")
    assert [each for each in fleet.sentences(json.loads(fleet.KEPT.read_text())) if each not in text] == []
