"""``halfseen evaluate``: through the door of the command line, with policies that were learned and stored."""

import json
from functools import partial

import numpy as np
import pytest
import shell

from halfseen.evaluation import evaluate as evaluated
from halfseen.evaluation.specification import specification_of
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs, read_logs
from halfseen.policies.folder import read_policy
from refusals import refused
from small_logs import kept, log_of

run_evaluate = partial(shell.run, "evaluate")


def clinic(seed, num_trajectories=300):
    """One stage on two actions; B is better where x is 1, and a fifth is cut."""
    rng = np.random.default_rng(seed)
    x, is_b = rng.integers(0, 2, num_trajectories), rng.integers(0, 2, num_trajectories)
    ends, cuts = rng.integers(1, 9, num_trajectories).astype(float), rng.geometric(0.06, num_trajectories).astype(float)
    is_cut = cuts < ends
    reward = 2.0 * (x == is_b) + 0.1 * ends + 0.5 * rng.normal(size=num_trajectories)
    done = {"elapsed_s": np.where(is_cut, np.nan, ends), "action": np.array(["A", "B"])[is_b], "reward": reward}
    seen = {"trajectory": range(num_trajectories), "probability": 0.5, "x": x.astype(float)}
    return log_of({"end_s": np.minimum(ends, cuts)}, **seen, **done)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluate")
    for name, seed in (("learned", 0), ("aside", 1)):
        clinic(seed).write(folder / name)
    learner = CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x"], reg=1e-3)
    kept(learner, read_logs(folder / "learned"), folder / "policy")
    return folder


def test_says_the_verdict_first_then_the_numbers(folders):
    lines = run_evaluate(folders / "policy", "--logs", folders / "aside").output.splitlines()
    assert lines[0].startswith("Better: it earns ")
    assert lines[1].startswith(
        "To overturn this, a cause of cuts that is not in the log would have to change the odds of "
    )
    assert [line.split("  ")[0] for line in lines[4:7]] == ["doubly robust", "importance sampling", "fitted Q"]
    assert " ".join(lines[8].split()) == "against value 95% interval difference 95% interval adjusted p verdict"
    assert lines[9].startswith("the logging policy ")
    assert lines[11].startswith("note: the logging policy without its exploration: the log shows no rule")
    assert len(lines) == 12


@pytest.mark.slow
def test_each_baseline_has_a_line_and_an_entry(folders):
    (folders / "thumb.csv").write_text("x,action\n1,A\n,B\n")
    given = ["logging", "sequence:A", folders / "thumb.csv", folders / "policy"]
    options = [word for baseline in given for word in ("--against", baseline)]
    lines = run_evaluate(folders / "policy", "--logs", folders / "aside", *options).output.splitlines()
    names = ["the logging policy", "the sequence A", "the rule thumb.csv", "the policy policy"]
    assert [line.split("  ")[0] for line in lines[8:]] == names
    assert [line.split()[-1] for line in lines[8:]] == ["better"] * 4
    assert lines[11].endswith("not better")
    assert lines[0].startswith("Not better: it earns as much a trajectory as the policy policy")
    report = shell.report("evaluate", folders / "policy", "--logs", folders / "aside", *options)
    assert [each["baseline"] for each in report["comparisons"]] == names
    assert report["comparisons"][3]["difference"]["value"] == 0.0
    assert {"value", "difference", "p", "adjusted_p", "verdict", "reason"} < set(report["comparisons"][0])


def test_json_carries_what_the_library_says(folders):
    report = shell.report("evaluate", folders / "policy", "--logs", folders / "aside", "--seed", 3)
    stored, logs = read_policy(folders / "policy"), read_logs(folders / "aside")
    spec = specification_of(stored, logs)
    answer = evaluated(stored.policy, logs, censoring=spec.censoring, q=spec.q, random_state=3)
    assert report["doubly_robust"] == answer.as_dict()["doubly_robust"]
    assert (report["verdict"], report["augmented"], report["censoring"]) == ("better", True, "cox")
    assert not report["is_learned_from_these_logs"]


def test_options_reach_the_model(folders):
    options = "--simple", "--censoring-by", "stage", "--propensity", "estimated", "--level", "0.9", "--json"
    report = json.loads(run_evaluate(folders / "policy", "--logs", folders / "aside", *options).output)
    assert (report["augmented"], report["censoring_by"], report["propensity"]) == (False, "stage", "estimated")
    assert report["level"] == 0.9


def test_the_logs_that_it_was_learned_from_are_distinguished(folders):
    assert (
        "note: the policy was learned from these logs"
        in run_evaluate(folders / "policy", "--logs", folders / "learned").output
    )


@pytest.mark.slow
def test_whole_numbers_are_no_text_in_evaluate_report_and_baselines(tmp_path):
    kinds = {"whole": {"A": 1, "B": 2}, "text": {"A": "1", "B": "2"}}
    for kind, names in kinds.items():
        logs = clinic(0, 60)
        logs = Logs(logs.stages.assign(action=logs.stages["action"].map(names)), logs.trajectories)
        logs.write(tmp_path / kind)
        kept(CensoredQLearner.of_paper(1, {1: list(names.values())}, ["x"], reg=0.1), logs, tmp_path / f"of_{kind}")
    of_whole, of_text, whole, text = (tmp_path / name for name in ("of_whole", "of_text", "whole", "text"))
    is_whole, is_text = "whole numbers, such as 1", "text, such as '1'"
    with refused(rf"of the policy are {is_whole}, but the log's are {is_text}; write .* as whole numbers$"):
        run_evaluate(of_whole, "--logs", text)
    with refused(rf"of the policy are {is_text}, but the log's are {is_whole}; write .* as text$"):
        run_evaluate(of_text, "--logs", whole)
    with refused(rf"of the policy of_text are {is_text}, but the log's are {is_whole}"):
        run_evaluate(of_whole, "--logs", whole, "--against", of_text)
    with refused(rf"of the policy are {is_whole}, but the log's are {is_text}"):
        shell.run("report", text, of_whole, "--out", tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()
    lines = run_evaluate(of_whole, "--logs", whole, "--against", "sequence:1").output
    assert "the sequence 1" in lines


def test_a_word_that_unicode_composes_otherwise_is_said_to_be_the_same(folders, tmp_path):
    logs = read_logs(folders / "learned")
    for kind, name in (("nfc", "caf\u00e9"), ("nfd", "cafe\u0301")):
        named = Logs(logs.stages.assign(action=logs.stages["action"].replace("A", name)), logs.trajectories)
        named.write(tmp_path / kind)
        kept(CensoredQLearner.of_paper(1, {1: [name, "B"]}, ["x"], reg=0.1), named, tmp_path / f"of_{kind}")
    with refused(r"the action 'caf\\xe9' of the policy is 'cafe\\u0301' in the log, the same word"):
        run_evaluate(tmp_path / "of_nfc", "--logs", tmp_path / "nfd")
    with refused(r"the action 'cafe\\u0301' of the policy of_nfd is 'caf\\xe9' in the log"):
        run_evaluate(tmp_path / "of_nfc", "--logs", tmp_path / "nfc", "--against", tmp_path / "of_nfd")
