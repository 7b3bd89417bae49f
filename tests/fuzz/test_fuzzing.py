"""The campaign itself: what failed once, a short run of fresh cases, and that faults are found."""

import json

import pytest

from fuzz.campaign import KEPT, numbered, run
from fuzz.cases import Case, drawn, kept, remade
from fuzz.oracle import Outcome, judged

KEPT_FILES = sorted(KEPT.glob("*.json"))
SHORT, LONG = 25, 150
"""Cases of the run that every test run makes, and of the one beside the slow tests; `make fuzz` is the campaign."""
RIGHT = Case("npz", ("look", "in/table.npz", "--json"), ())


def faults(results):
    return {result.name: f"{result.case}: {result.label}: {result.why}" for result in results if result.is_fault}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def results(place):
    """What came of the kept cases, and of a few fresh ones without what compiles: one process runs them all."""
    orders = [*({"file": str(file)} for file in KEPT_FILES), *numbered(0, range(SHORT), has_heavy=False)]
    return {result.name: result for result in run(orders, place, limit_s=60.0)}


@pytest.mark.slow
@pytest.mark.parametrize("file", KEPT_FILES, ids=lambda file: file.stem)
def test_what_failed_once_is_refused_or_right(results, file):
    assert faults([results[file.name]]) == {}


@pytest.mark.slow
def test_fresh_cases_are_refused_or_right(results):
    fresh = [results[str(number)] for number in range(SHORT)]
    assert faults(fresh) == {}
    assert {result.label for result in fresh} == {"refused", "right"}


@pytest.mark.slow
def test_many_fresh_cases_are_refused_or_right(place):
    assert faults(run(numbered(1, range(LONG)), place, limit_s=120.0)) == {}


def test_the_same_seed_draws_the_same_case_and_a_kept_one_is_made_again(place, tmp_path):
    corpus = place / "corpus"
    corpus.mkdir(exist_ok=True)
    for number in range(12):
        files = []
        for copy in ("one", "other"):
            folder = tmp_path / f"{number}-{copy}"
            folder.mkdir()
            case = drawn(5, number, corpus, folder, has_heavy=False)
            files.append(kept(case, folder, corpus))
        assert files[0] == files[1]
        (tmp_path / "case.json").write_text(files[0])
        folder = tmp_path / f"{number}-again"
        folder.mkdir()
        assert remade(tmp_path / "case.json", corpus, folder) == case
        assert kept(case, folder, corpus) == files[0]


@pytest.mark.slow
def test_a_hang_is_found_and_the_next_case_runs(place, tmp_path):
    waits = Case("calls", ("record", "--listen", "sock", "--out", "out"), ())
    # It takes a hundredth of the limit.
    short = Case("flat", ("inspect", "in/logs", "--json"), ())
    files = []
    for name, case in (("waits", waits), ("right", short)):
        saved = {
            "seed": case.seed,
            "words": case.words,
            "mutations": [],
            "line": None,
            "is_whole": False,
            "changed": {},
        }
        (tmp_path / f"{name}.json").write_text(json.dumps(saved))
        files.append({"file": str(tmp_path / f"{name}.json")})
    labels = {result.name: result.label for result in run(files, place, limit_s=15.0)}
    assert labels == {"waits.json": "fault: hang", "right.json": "right"}


REFUSAL = "halfseen: no; give another\n"


@pytest.mark.parametrize(
    ("outcome", "label"),
    [
        (Outcome(0, "{}"), "right"),
        (Outcome(2, "", REFUSAL), "refused"),
        (Outcome(0, '{"a": NaN}'), "fault: no JSON"),
        (Outcome(1, "", "Traceback (most recent call last):\n"), "fault: traceback"),
        (Outcome(3, "", REFUSAL), "fault: status"),
        (Outcome(2, "", REFUSAL * 2, left=("out",)), "fault: left behind"),
        (Outcome(2, "", REFUSAL, changed=("in/a",)), "fault: input changed"),
        (Outcome(2, "", f"warning: x\n{REFUSAL}"), "fault: another's line"),
        (Outcome(2, "", "halfseen: \x1b[31m\n"), "fault: escape code"),
        (Outcome(2, "", "halfseen: 'NoneType' object is not subscriptable\n"), "fault: from inside"),
        (Outcome(2, "", "halfseen: memory does not suffice; give less at once, or more memory\n"), "fault: net"),
        (Outcome(2, "", f"halfseen: {'a' * 2000}\n"), "fault: long line"),
        (Outcome(2, "half of it", REFUSAL), "fault: no one line"),
        (Outcome(2), "fault: no one line"),
        (Outcome(0, "{}", grown_mb=3000.0), "fault: memory"),
        (Outcome(None, death="crash"), "fault: crash"),
    ],
)
def test_faults_are_distinguished(outcome, label):
    assert judged(Case("flat", ("inspect", "in/logs", "--json"), ()), outcome, None)[0] == label


def test_another_answer_to_the_same_input_is_a_fault():
    assert judged(RIGHT, Outcome(0, "{}"), "{}")[0] == "right"
    assert judged(RIGHT, Outcome(0, "[]"), "{}")[0] == "fault: another answer"
