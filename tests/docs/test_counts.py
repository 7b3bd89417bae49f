"""Counts that prose tells are those of the logs that come with the repository."""

import re

import pytest

from halfseen.cell.calibration.law_folder import ATTEMPTS, read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.logs import read_logs
from pictures.intervals import INTERVALS
from pictures.picture import ROOT

TOLD = {
    "README.md": ("{logs} parts of a cell",),
    "examples/README.md": ("{logs} paths of which a third are cut",),
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
        "calibrated": 6000,
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


def test_no_page_tells_another_number_of_parts(counts):
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]:
        told = re.findall(r"(\d[\d,]*) parts\b", page.read_text(encoding="utf-8"))
        assert set(told) <= {counts["logs"], counts["later"]}, page
