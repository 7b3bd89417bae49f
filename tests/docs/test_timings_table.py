"""What was measured is told once, by its newest entry; what was measured before stands below."""

import importlib
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def modules():
    folders = [str(ROOT / "benchmarks"), str(ROOT / "docs" / "extensions")]
    sys.path[:0] = folders
    yield importlib.import_module("timings"), importlib.import_module("timings_table")
    for folder in folders:
        sys.path.remove(folder)


def entry(timings, day, **row):
    return asdict(timings.Row(**row)) | {"date": f"2026-11-{day:02d}", "machine": "2 cores"}


def test_seconds_are_better_where_fewer_and_rates_where_more(modules):
    timings, _ = modules
    fit = timings.Row("a fit", 0.5, "s", "a peer", 2.0, bar=0.4)
    steps = timings.Row("steps", 3e6, "steps/s", "a peer", 1e6, bar=1e6)
    assert (fit.ratio, fit.holds) == (4.0, False)
    assert (steps.ratio, steps.holds) == (3.0, True)
    assert timings.Row("alone", 1.0, "s").ratio is None
    assert timings.Row("alone", 1.0, "s").holds is None


def test_the_newest_comes_first_and_what_was_before_stands_below(modules):
    timings, timings_table = modules
    history = [
        entry(timings, 1, what="a fit", ours=0.5, unit="s", peer="a peer", theirs=2.0),
        entry(timings, 2, what="steps", ours=3e6, unit="steps/s", bar=1e6),
        entry(timings, 3, what="a fit", ours=0.25, unit="s", peer="a peer", theirs=2.0, bar=0.4),
    ]
    assert [each["ours"] for each in timings.newest(history)] == [0.25, 3e6]
    now, before = timings_table.markdown(history).split("Before:")
    assert "| a fit | 0.25 s | 0.4 s holds | a peer | 2 s | 8 | 2026-11-03 |" in now
    assert "| steps | 3,000,000 steps/s | 1,000,000 steps/s holds |" in now
    assert "| a fit | 0.5 s |  | a peer | 2 s | 4 | 2026-11-01 |" in before
