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
from halfseen.policies.folder import read_policy, write_policy

told = partial(shell.run, "evaluate")


def clinic(seed, num_trajectories=300):
    """One stage on two actions; B is better where x is 1, and a fifth is cut."""
    rng = np.random.default_rng(seed)
    x, is_b = rng.integers(0, 2, num_trajectories), rng.integers(0, 2, num_trajectories)
    ends, cuts = rng.integers(1, 9, num_trajectories).astype(float), rng.geometric(0.06, num_trajectories).astype(float)
    is_cut = cuts < ends
    reward = 2.0 * (x == is_b) + 0.1 * ends + 0.5 * rng.normal(size=num_trajectories)
    stages = {
        "trajectory": np.arange(num_trajectories),
        "stage": np.ones(num_trajectories, dtype=int),
        "elapsed_s": np.where(is_cut, np.nan, ends),
        "action": np.array(["A", "B"])[is_b],
        "reward": np.where(is_cut, np.nan, reward),
        "probability": np.full(num_trajectories, 0.5),
        "x": x.astype(float),
    }
    trajectories = {
        "trajectory": np.arange(num_trajectories),
        "end_s": np.minimum(ends, cuts),
        "ending": np.where(is_cut, "cut", "finished"),
    }
    return Logs(stages, trajectories)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluate")
    for name, seed in (("learned", 0), ("aside", 1)):
        clinic(seed).write(folder / name)
    logs = read_logs(folder / "learned")
    learner = CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x"], reg=1e-3).fit(logs)
    write_policy(learner, logs, folder / "policy")
    return folder


def test_says_the_verdict_first_then_the_numbers(folders):
    lines = told(folders / "policy", "--logs", folders / "aside").output.splitlines()
    assert lines[0].startswith("Better: it earns ")
    assert lines[1].startswith("To undo this, a cause of cuts that is not in the log would have to change the odds of ")
    assert [line.split("  ")[0] for line in lines[4:7]] == ["doubly robust", "importance sampling", "fitted Q"]
    assert " ".join(lines[8].split()) == "against value 95% interval difference 95% interval adjusted p verdict"
    assert lines[9].startswith("the logging policy ")
    assert lines[11].startswith("note: the logging policy without its exploration: the log shows no rule")
    assert len(lines) == 12


def test_each_opponent_has_a_line_and_an_entry(folders):
    (folders / "thumb.csv").write_text("x,action\n1,A\n,B\n")
    given = ["logging", "sequence:A", folders / "thumb.csv", folders / "policy"]
    options = [word for opponent in given for word in ("--against", opponent)]
    lines = told(folders / "policy", "--logs", folders / "aside", *options).output.splitlines()
    names = ["the logging policy", "the sequence A", "the rule thumb.csv", "the policy policy"]
    assert [line.split("  ")[0] for line in lines[8:]] == names
    assert [line.split()[-1] for line in lines[8:]] == ["better"] * 4
    assert lines[11].endswith("not better")
    assert lines[0].startswith("Not better: it earns as much a trajectory as the policy policy")
    report = json.loads(told(folders / "policy", "--logs", folders / "aside", *options, "--json").output)
    assert [each["opponent"] for each in report["comparisons"]] == names
    assert report["comparisons"][3]["difference"]["value"] == 0.0
    assert {"value", "difference", "p", "adjusted_p", "verdict", "reason"} < set(report["comparisons"][0])


def test_json_carries_what_the_library_says(folders):
    report = json.loads(told(folders / "policy", "--logs", folders / "aside", "--json", "--seed", 3).output)
    stored, logs = read_policy(folders / "policy"), read_logs(folders / "aside")
    spec = specification_of(stored, logs)
    answer = evaluated(stored.policy, logs, censoring=spec.censoring, q=spec.q, random_state=3)
    assert report["doubly_robust"] == answer.as_dict()["doubly_robust"]
    assert (report["verdict"], report["augmented"], report["censoring"]) == ("better", True, "cox")
    assert not report["is_learned_from_these_logs"]


def test_options_reach_the_model(folders):
    options = "--simple", "--censoring-by", "stage", "--propensity", "estimated", "--level", "0.9", "--json"
    report = json.loads(told(folders / "policy", "--logs", folders / "aside", *options).output)
    assert (report["augmented"], report["censoring_by"], report["propensity"]) == (False, "stage", "estimated")
    assert report["level"] == 0.9


def test_the_logs_that_it_was_learned_from_are_told_apart(folders):
    assert "note: it was learned from these very logs" in told(folders / "policy", "--logs", folders / "learned").output
