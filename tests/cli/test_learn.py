import json
from dataclasses import replace
from operator import itemgetter

import numpy as np
import pytest
import shell

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import HeldOutVerdict, held_out
from halfseen.evaluation.exploring import Exploration, Region
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogStream, stream
from halfseen.logs.formats import write_csv
from halfseen.policies.exploration import read_exploration
from halfseen.policies.folder import read_policy
from halfseen.world.logs import states_of
from small_logs import flat_log, log_of, table_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learn")
    flat_log().write(folder / "flat")
    table_log().write(folder / "tables")
    return folder


def run(*arguments, has_verdict=False):
    return shell.run("learn", *arguments, *([] if has_verdict else ["--no-verdict"]))


def shares_by_hand(learner, logs, stage):
    rows = logs.stages[logs.stages["stage"] == stage]
    taken = learner.decide(rows, stage)
    return {name: float(np.mean(taken == name)) for name in ("A", "B", "C")}, float(np.mean(taken == rows["action"]))


def test_a_flat_log_is_learned_with_its_actions_by_stage_and_its_numeric_covariates(folder, tmp_path):
    result = run(folder / "flat", "--out", tmp_path / "policy", "--reg", 0.1, "--seed", 4, "--json")
    report = json.loads(result.stdout)
    policy = read_policy(tmp_path / "policy")
    assert policy.policy.covariates == ("x1", "x2")
    assert report["schema"]["possible"] == [["A", "B"], ["A", "C"]]
    assert (report["seed"], report["learner"]["reg"], report["learner"]["stages"]) == (4, 0.1, "pooled")
    assert report["notes"] == [
        "it does not look at colour, which is 'red' in every stage, so it carries no information; leave it out"
    ]
    logs = flat_log()
    by_hand = CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1, random_state=4).fit(logs)
    for stage in (1, 2):
        found = report["actions"][stage - 1]
        assert found["num_states"] == (logs.stages["stage"] == stage).sum()
        shares, as_logged = shares_by_hand(by_hand, logs, stage)
        assert found["shares"] == pytest.approx(shares)
        assert found["as_logged"] == pytest.approx(as_logged)


@pytest.mark.parametrize("message", ["Inconclusive: it earns", "Better: it earns"])
def test_ends_with_the_verdict_and_keeps_it(folder, tmp_path, monkeypatch, message):
    verdict, reason = message.lower().split(": ")
    judged = HeldOutVerdict(verdict, reason, 5)
    monkeypatch.setattr(held_out, "held_out_verdict", lambda learner, logs, **_: judged)
    arguments = (folder / "flat", "--out", tmp_path / "policy", "--reg", 0.1)
    lines = run(*arguments, has_verdict=True).stdout.splitlines()
    assert lines[-3] == judged.sentence
    assert lines[-3].startswith(message)
    assert lines[-1].startswith("Next: ")
    assert read_policy(tmp_path / "policy").verdict == judged.as_dict()
    report = json.loads(run(*arguments, "--overwrite", "--json", has_verdict=True).stdout)
    assert report["verdict"]["sentence"] == judged.sentence
    assert any(note.startswith("the log has no probabilities; the verdict estimates") for note in report["notes"])
    assert json.loads(run(*arguments, "--overwrite", "--json").stdout)["verdict"] is None


def test_a_verdict_that_cannot_be_had_does_not_keep_the_policy_back(tmp_path):
    flat_log(num_trajectories=12).write(tmp_path / "few")
    plain = ("--reg", 0.1, "--q-function", "linear", "--stages", "pooled", "--censoring", "kaplan-meier")
    result = run(tmp_path / "few", "--out", tmp_path / "policy", *plain, has_verdict=True)
    assert "\nInconclusive: the log has 12 trajectories, but 10 folds need 20; record more (said of" in result.stdout
    assert result.stderr == ""
    assert read_policy(tmp_path / "policy").verdict["verdict"] == "inconclusive"


def test_a_table_log_is_learned_as_tables(folder, tmp_path):
    result = run(folder / "tables", "--out", tmp_path / "policy", "--horizon", 3, "--reg", 0.1, "--json")
    report = json.loads(result.stdout)
    policy = read_policy(tmp_path / "policy")
    assert policy.is_table
    assert (policy.horizon, report["learner"]["stages"], report["notes"]) == (3, "pooled", [])
    assert set(policy.ranges(3)) == {"num_objects", "occlusion", "log_odds", "num_attempts"}
    assert policy.ranges(3)["num_objects"] == (1.0, 2.0)
    logs = table_log()
    states, decide = states_of(logs, 3), policy.policy.q_values
    for row in report["actions"]:
        stages = logs.stages[logs.stages["stage"] == row["stage"]]
        taken = []
        for trajectory in stages["trajectory"]:
            one = mapped(itemgetter((trajectory, row["stage"] - 1)), states)
            taken.append(int(np.asarray(decide(one)).argmax()))
        verbs = ["FINISH", "WASH", "WASH", "LIFT", "LIFT"]
        found = {verb: np.mean([verbs[action] == verb for action in taken]) for verb in ("FINISH", "WASH", "LIFT")}
        assert row["shares"] == pytest.approx(found)
        done = zip(stages["action"], stages["object"], strict=True)
        logged = [verbs.index(verb) + (0 if verb == "FINISH" else int(target)) for verb, target in done]
        assert row["as_logged"] == pytest.approx(np.mean(np.array(taken) == logged))


def test_one_seed_same_policy_and_what_is_there_stays(folder, tmp_path):
    plain = ("--covariates", "x1", "--reg", 0.1, "--stages", "pooled")
    arguments = [folder / "flat", "--out", tmp_path / "policy", *plain]
    run(*arguments)
    before = {file.name: file.read_bytes() for file in (tmp_path / "policy").iterdir()}
    run(*arguments, "--overwrite")
    assert {file.name: file.read_bytes() for file in (tmp_path / "policy").iterdir()} == before


@pytest.mark.slow
def test_what_to_try_is_written_for_serve_and_the_best_guess_on_request(tmp_path):
    _trial(300).write(tmp_path / "logs")
    arguments = (tmp_path / "logs", "--out", tmp_path / "policy", "--exploration", tmp_path / "try.csv")
    report = json.loads(run(*arguments, "--json", has_verdict=True).stdout)
    regions = report["verdict"]["exploration"]["regions"]
    table = read_exploration(tmp_path / "try.csv", ("A", "B", "C"), ("x",))
    assert regions
    assert [str(row.action) for row in table.rows] == [region["action"] for region in regions]
    assert report["verdict"]["claims"][0].startswith("Vouched for: ")
    best = json.loads(run(*arguments[:3], "--trust", "best", "--overwrite", "--json", has_verdict=True).stdout)
    assert best["verdict"]["caution"] == 1.0
    assert report["learner"]["pessimism"] == report["verdict"]["caution"] * best["learner"]["pessimism"]


@pytest.mark.slow
def test_a_table_that_names_nothing_to_try_is_noted(folder, tmp_path):
    arguments = (folder / "tables", "--out", tmp_path / "policy", "--horizon", 3, "--reg", 0.1)
    report = json.loads(run(*arguments, "--exploration", tmp_path / "try.csv", "--json", has_verdict=True).stdout)
    assert report["notes"][-1].startswith(f"{tmp_path / 'try.csv'} lists no actions to try;")
    assert read_exploration(tmp_path / "try.csv", ("A",), ()).shares({}, 1) == {}


def test_where_it_cannot_be_said_it_says_what_to_try():
    tried = Exploration((Region({"x": "<= 0.5"}, "B", now=0.1, wanted=0.4, part=0.6),), narrower=1.6)
    verdict = HeldOutVerdict("inconclusive", "few trajectories", num_folds=5, exploration=tried)
    lines = str(verdict).splitlines()
    assert "1.6 times narrower" in lines[1]
    assert lines[-1].split() == ["B", "x", "<=", "0.5", "10%", "40%", "60%"]
    better = replace(verdict, verdict="better")
    assert str(better) == better.sentence


def test_a_table_of_what_to_try_needs_a_verdict_and_a_place(folder, tmp_path):
    (tmp_path / "there.csv").write_text("kept")
    for file, has_verdict, said in (
        ("try.csv", False, "leave --no-verdict out"),
        ("try.txt", True, r"ends in \.csv"),
        ("there.csv", True, "it already exists"),
    ):
        arguments = (folder / "flat", "--out", tmp_path / "policy", "--exploration", tmp_path / file)
        with pytest.raises(ArgumentError, match=said):
            run(*arguments, has_verdict=has_verdict)
    assert (tmp_path / "there.csv").read_text() == "kept"
    assert not (tmp_path / "policy").exists()


# Part by part: what is said and decided is that of a log in memory.


@pytest.fixture
def by_sevens(monkeypatch):
    monkeypatch.setattr(LogStream.__init__, "__defaults__", (7,))


def assert_alike(one, other):
    """The same but for rounding."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        one, other = list(one.values()), list(other.values())
    if isinstance(one, list):
        assert len(one) == len(other)
        for first, second in zip(one, other, strict=True):
            assert_alike(first, second)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-6, nan_ok=True)
    else:
        assert one == other


@pytest.mark.slow
@pytest.mark.parametrize("log", ["flat", "tables"])
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_all_that_is_reported_is_the_same(folder, log, stages, tmp_path, by_sevens):
    result = {}
    for way in ("in-memory", "streaming"):
        shown = run(folder / log, "--out", tmp_path / way, "--stages", stages, f"--{way}", "--json", has_verdict=True)
        result[way] = json.loads(shown.stdout)
    for report in result.values():
        del report["policy"]
    assert_alike(result["streaming"], result["in-memory"])
    policies = [read_policy(tmp_path / way).policy for way in result]
    np.testing.assert_allclose(policies[0].coefficients, policies[1].coefficients, rtol=1e-5, atol=1e-6)


def test_many_stages_are_read_in_passes_and_few_are_not(folder, tmp_path, monkeypatch):
    assert not isinstance(stream.opened(folder / "flat"), LogStream)
    monkeypatch.setattr(stream, "MOST_STAGES_IN_MEMORY", 10)
    assert isinstance(stream.opened(folder / "flat"), LogStream)
    assert not isinstance(stream.opened(folder / "flat", streaming=False), LogStream)
    # Other forms are not.
    write_csv(flat_log(), tmp_path / "csv")
    with pytest.raises(LogError, match="only folders of Parquet files are read in passes; convert it"):
        stream.opened(tmp_path / "csv", streaming=True)


@pytest.mark.slow
def test_a_verdict_on_some_of_the_trajectories_says_so(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(held_out, "MOST_JUDGED", 30)
    arguments = (folder / "flat", "--out", tmp_path / "policy", "--reg", 0.1, "--streaming", "--json")
    report = json.loads(run(*arguments, has_verdict=True).stdout)
    assert "the verdict is about policies learned from 30 of the 40 trajectories, drawn at random" in report["notes"]


def _trial(num_trajectories):
    """Two stages in which B pays in state 1 and A in state 0, logged by a rule that mostly takes A, and seldom B."""
    rng = np.random.default_rng(0)
    trajectory, stage = np.repeat(np.arange(num_trajectories), 2), np.tile([1, 2], num_trajectories)
    x = rng.integers(0, 2, len(stage)).astype(float)
    action = rng.choice(3, len(stage), p=[0.6, 0.1, 0.3])
    reward = 1.0 * (action == x) + rng.normal(size=len(stage))
    done = {"trajectory": trajectory, "stage": stage, "elapsed_s": 1.0 * stage, "action": np.array([*"ABC"])[action]}
    return log_of(**done, reward=reward, probability=np.array([0.6, 0.1, 0.3])[action], x=x)
