"""Counts that prose tells are those of the logs that come with the repository."""

import re

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
CALIBRATED = 6000


@pytest.fixture(scope="module")
def counts():
    logs, later, cleared = (
        read_logs(ROOT / "examples" / name) for name in ("pick_cell/logs", "pick_cell/later_logs", "physical_cell/logs")
    )
    law, tried = read_law(shipped_law()).law.grasp, read_logs(shipped_law() / ATTEMPTS)
    by, stopped = later.paths["cause"].value_counts(), cleared.paths["cause"].value_counts()
    intervals = INTERVALS.numbers.read()
    missed = sum(not row["low"] <= row["truth"] <= row["high"] for row in intervals)
    found = {
        "logs": len(logs.paths),
        "logs_cut": (~logs.is_finished).sum(),
        "later": len(later.paths),
        "by_operator": by["operator"],
        "by_sensor": by["sensor-lost"],
        "cleared": len(cleared.paths),
        "cleared_cut": (~cleared.is_finished).sum(),
        "hard": stopped["emergency-stop"],
        "lost": stopped["sensor-lost"],
        "long": stopped["time-out"],
        "attempts": len(tried.stages),
        "attempts_cut": law.num_cut,
        "last": len(tried.stages) - law.num_decided - law.num_cut,
        "tables": len(tried.paths),
        "visible_only": len(read_logs(shipped_law() / VISIBLE_ONLY).stages),
        "calibrated": CALIBRATED,
    }
    return {name: f"{count:,}" for name, count in found.items()} | {
        "missed": WORDS[missed],
        "intervals": WORDS[len(intervals)],
    }


@pytest.mark.parametrize("page", TOLD)
def test_a_count_in_prose_is_that_of_the_log(page, counts):
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    for words in TOLD[page]:
        assert words.format(**counts) in text, page


EFFECTS = {
    "occlusion": "wholly hidden, for in full view",
    "is_lying": "lying, for standing",
    "width_m": "each 2 cm of width",
    "room_m": "each 3 cm of room beside it",
}


def test_the_effects_on_the_page_are_those_of_the_law_that_comes_with_the_package():
    law = read_law(shipped_law()).law
    page = (ROOT / "docs/guide/physical-cell.md").read_text(encoding="utf-8")
    for (name, effect), error in zip(law.coefficients.items(), law.grasp.standard_error, strict=True):
        if name in EFFECTS:
            (cells,) = re.findall(rf"^\| {EFFECTS[name]} \| (\S+) \| (\S+) to (\S+) \|$", page, flags=re.MULTILINE)
            told = [float(cell.replace("−", "-")) for cell in cells]
            # Told to one digit behind the point.
            assert told == pytest.approx([effect, effect - 1.96 * error, effect + 1.96 * error], abs=0.051), name


def test_what_a_look_shows_and_tells_is_that_of_the_law_that_comes_with_the_package():
    seeing = read_law(shipped_law()).law.seeing
    page = " ".join((ROOT / "docs/guide/physical-cell.md").read_text(encoding="utf-8").split())
    view, found, taken = (100 * each[3] for each in (seeing.views, seeing.sensitivity, seeing.false_alarms))
    assert f"A look shows {view:.0f} % of a cup at most" in page
    assert f"found {found:.0f} % of the dirty ones and taken {taken:.0f} % of the clean ones for dirty" in page
    assert f"turned, {100 * seeing.sensitivity[4]:.0f} and {100 * seeing.false_alarms[4]:.0f} %" in page


def test_the_attempts_of_a_calibration_are_those_that_the_command_makes():
    (attempts,) = (option for option in calibrate.params if option.name == "attempts")
    assert attempts.default == CALIBRATED


def test_the_logs_that_verdicts_are_counted_over_are_those_of_the_benchmark():
    page = (ROOT / "docs/guide/how-good-is-it.md").read_text(encoding="utf-8")
    usage = (ROOT / "benchmarks/verdicts.py").read_text(encoding="utf-8")
    told = re.findall(r"records (\d+) logs of (\d+) paths", page)
    assert told == re.findall(r"\[--logs (\d+)\] \[--paths (\d+)\]", usage)


def test_no_page_tells_another_number_of_parts(counts):
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]:
        told = re.findall(r"(\d[\d,]*) parts\b", page.read_text(encoding="utf-8"))
        assert set(told) <= {counts["logs"], counts["later"]}, page


def test_what_ten_thousand_repetitions_tell_is_what_is_kept_of_them():
    rows = TEN_THOUSAND_NUMBERS.read()
    text = " ".join((ROOT / "docs/guide/ten-thousand-repetitions.md").read_text(encoding="utf-8").split())
    for question in ("cuts", "more", "rule"):
        some = [row for row in rows if row["question"] == question]
        told = [sum(row[f"{begin}low"] > 0 or row[f"{begin}high"] < 0 for row in some) for begin in ("few_", "")]
        assert f"| {len(some)} | {told[0]} | {told[1]} |" in text

    def of(question, against, size, share):
        (row,) = (
            row
            for row in rows
            if (row["question"], str(row["against"]), row["num_paths"]) == (question, against, size)
            and row["cut_share"] == pytest.approx(share)
        )
        return row

    def between(low, high):
        return f"{low:.2f} to {high:.2f}"

    few, many = of("cuts", "no cuts", 25, 0.5), of("cuts", "no cuts", 800, 0.5)
    assert f"{-few['mean']:.2f} points a table are lost with 25 paths ({between(-few['high'], -few['low'])})" in text
    assert f"{-many['mean']:.2f} with 800 ({between(-many['high'], -many['low'])})" in text
    assert f"{of('cuts', 'no cuts', 200, 0.5)['few_mean']:.2f} gained" in text
    doubled = [of("more", "400.0", 800, share)["mean"] for share in (0, 1 / 6, 1 / 3, 0.5)]
    assert f"still {between(min(doubled), max(doubled))} points a table" in text
    uncut, half = (of("rule", "history-penalty", 800, share) for share in (0, 0.5))
    assert f"{uncut['mean']:.2f} points more where nothing was cut ({between(uncut['low'], uncut['high'])})" in text
    assert f"{half['mean']:.2f} where half was ({between(half['low'], half['high'])})" in text
    assert f"between {-half['few_low']:.2f} less and {half['few_high']:.2f} more" in text
    tie = of("rule", "history-penalty", 400, 1 / 6)
    assert f"({tie['mean']:.2f}; −{-tie['low']:.2f} to {tie['high']:.2f})" in text
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"{half['mean']:.2f} points ({between(half['low'], half['high'])}), and by {uncut['mean']:.2f}" in readme
