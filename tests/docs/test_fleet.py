"""What the guide says of the logs of a fleet is what was measured."""

import importlib
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "guide" / "any-multistage-problem.md"


@pytest.fixture(scope="module")
def fleet():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    yield importlib.import_module("fleet")
    sys.path.remove(str(ROOT / "benchmarks"))


def told(recipe, num_stages, cpu_s, peak_gb, is_kept=True):
    return {
        "recipe": recipe,
        "num_stages": num_stages,
        "cpu_s": cpu_s,
        "peak_gb": peak_gb,
        "is_kept": is_kept,
    }


def test_a_fleet_takes_what_a_stage_takes_times_its_stages(fleet):
    results = [told(recipe, 10**6 * k, 5.0 + 7.2 * k, 0.5 + 0.002 * k) for recipe in fleet.NAMES for k in (1, 5, 2)]
    results += [told(recipe, 10**6 * k, 9.0 + 72.0 * k, 0.5, is_kept=False) for recipe in fleet.NAMES for k in (1, 2)]
    # 10 billion stages of 7.2 µs are 72,000 s of a core, which 200 cores have in 360 s.
    assert fleet.sentences(results)[:2] == [
        "A stage more takes 2 bytes of the machine that asks: 20 GB.",
        "By eq. 3 of the paper it takes 7.2 µs of a core: 0.1 hours. "
        "Where nothing is kept between passes it is 72.0 µs, and 1.0 hours.",
    ]


def test_the_guide_says_what_was_measured(fleet):
    text = " ".join(GUIDE.read_text(encoding="utf-8").split())
    for sentence in fleet.sentences(json.loads(fleet.KEPT.read_text())):
        assert sentence in text
