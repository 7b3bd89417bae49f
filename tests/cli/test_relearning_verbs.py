"""Learning on a log in which the cell has changed: what is told, what is taken, and which logs a policy came from."""

import json
import shlex

import numpy as np
import pandas as pd
import pytest
import shell

from halfseen.logs import Logs, read_logs
from halfseen.policies.folder import read_policy
from refusals import refused

LEARN = ["--no-verdict", "--q-function", "linear", "--reg", "0.1"]


def cell(num, seed, gain, first=1):
    """One stage: A brings x and more, B nothing; a fifth is cut."""
    rng = np.random.default_rng(seed)
    x, is_a, took = rng.random(num), rng.random(num) < 0.5, rng.uniform(1.0, 3.0, num)
    is_cut = rng.random(num) < 0.2
    names = np.arange(first, first + num)
    stages = {"trajectory": names, "stage": 1, "action": np.where(is_a, "A", "B"), "x": x}
    reward = np.where(is_a, x + gain, 0.0) + 0.3 * rng.normal(size=num)
    stages |= {"elapsed_s": np.where(is_cut, np.nan, took), "reward": np.where(is_cut, np.nan, reward)}
    ends = {"trajectory": names, "end_s": took, "ending": np.where(is_cut, "cut", "finished")}
    return Logs(pd.DataFrame(stages), pd.DataFrame(ends))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("relearning")
    cell(150, 0, 0.5).write(folder / "old")
    cell(100, 1, -1.5).write(folder / "new")
    shell.run("convert", folder / "old", folder / "new", "--out", folder / "both")
    shell.run("learn", folder / "old", "--out", folder / "policy", *LEARN)
    return folder


def record_of(policy):
    return json.loads((policy / "policy.json").read_text())


def test_a_change_is_told_with_the_command_that_takes_only_what_still_holds(folder, tmp_path):
    result = shell.run("learn", folder / "both", "--out", tmp_path / "policy", *LEARN)
    lines = result.output.splitlines()
    at = next(k for k, line in enumerate(lines) if "the cell has changed within the log: A brings" in line)
    assert lines[at].startswith("warning ")
    assert "less than before in the same states, since about trajectory 15" in lines[at]
    command = shlex.split(lines[at + 1].partition("still holds: ")[2])
    since = command[-1]
    assert command == shlex.split(f"halfseen learn {folder}/both --out {tmp_path}/policy --overwrite --since {since}")
    assert shell.run(*command[1:], *LEARN).exit_code == 0
    assert read_policy(tmp_path / "policy").record["log"]["num_trajectories"] == 250 - int(since)


def test_all_is_used_until_one_says_so_and_the_doubt_is_kept(folder, tmp_path):
    report = json.loads(shell.run("learn", folder / "both", "--out", tmp_path / "policy", *LEARN, "--json").output)
    log = report["log"]
    assert log["num_trajectories"] == 250
    assert [(each["num_trajectories"], each["first"], each["last"]) for each in log["sources"]] == [
        (150, "1", "150"),
        (100, "1", "100"),
    ]
    assert [each["name"] for each in log["sources"]] == [str(folder / "old"), str(folder / "new")]
    assert log["changes"][0]["since"] == pytest.approx(150, abs=5)
    assert any("has changed within the log" in doubt for doubt in read_policy(tmp_path / "policy").doubts)


def test_since_is_the_log_cut_by_hand(folder, tmp_path):
    logs = read_logs(folder / "old")
    logs.select(logs.trajectory_ids[60:]).write(tmp_path / "old")
    shell.run("learn", folder / "old", "--out", tmp_path / "since", "--since", 61, *LEARN[1:])
    shell.run("learn", tmp_path / "old", "--out", tmp_path / "cut", *LEARN[1:])
    one, other = ((tmp_path / name / "policy.safetensors").read_bytes() for name in ("since", "cut"))
    assert one == other
    since, cut = record_of(tmp_path / "since"), record_of(tmp_path / "cut")
    assert (since["log"].pop("since"), cut["log"].pop("since")) == ("61", None)
    assert since == cut


def test_weights_by_recency_are_told_and_kept_and_leave_no_doubt(folder, tmp_path):
    for recency, half_life in (("40", 40.0), ("auto", 16.0)):
        options = ["--recency", recency, "--overwrite", "--json"]
        report = json.loads(shell.run("learn", folder / "both", "--out", tmp_path / "policy", *LEARN, *options).output)
        assert report["learner"]["half_life"] == pytest.approx(half_life, rel=1.0)
        assert report["log"]["changes"]
        assert not any("has changed" in each for each in report["warnings"])
    decided = read_policy(tmp_path / "policy").policy.decide(pd.DataFrame({"x": [0.5]}), 1)
    assert decided.tolist() == ["B"]


def test_act_says_which_logs_it_was_learned_from(folder, tmp_path):
    (tmp_path / "now.json").write_text('{"x": 0.5}')
    told = shell.run("act", folder / "policy", tmp_path / "now.json").output
    assert told.splitlines()[-1] == "learned from 150 trajectories of old (1 to 150)"
    assert json.loads(shell.run("act", folder / "policy", tmp_path / "now.json", "--json").output)["learned_from"] == [
        {"name": "old", "num_trajectories": 150, "first": 1, "last": 150}
    ]


def test_of_an_unchanged_log_nothing_is_told(folder):
    assert record_of(folder / "policy")["log"]["changes"] == []
    assert "half_life" not in record_of(folder / "policy")["learner"]


def test_an_alarm_says_whether_learning_again_may_pay(folder):
    result = shell.run("monitor", folder / "policy", "--logs", folder / "new")
    assert result.exit_code == 3
    assert "Learning again will not pay yet: there are 99 trajectories since the change, and about 200" in result.output
    assert "Learning again" not in shell.run("monitor", folder / "policy", "--logs", folder / "old").output


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (
            ["--since", "none-such"],
            "since is none-such, and the log has no such trajectory; give the name of one, 1 to",
        ),
        (["--since", "5", "--streaming"], "--since takes logs that are held in memory: add --in-memory"),
        (["--recency", "-3"], "half_life is -3.0; it is a number of trajectories above 0"),
    ],
)
def test_what_cannot_be_is_refused(folder, tmp_path, options, told):
    with refused(told):
        shell.run("learn", folder / "old", "--out", tmp_path / "policy", *LEARN, *options)
    assert not (tmp_path / "policy").exists()
