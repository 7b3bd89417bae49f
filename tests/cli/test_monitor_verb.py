"""``halfseen monitor``, and ``halfseen learn`` on a log in which the cell has changed."""

import json
import shlex
from functools import partial

import numpy as np
import pandas as pd
import pytest
import shell

from chromium import PAGES, faults_of, in_browser
from halfseen.cli import act as module
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.policies.folder import read_policy
from halfseen.view import page as page_module
from holes import holed
from refusals import refused
from small_logs import kept, log_of

run_monitor = partial(shell.run, "monitor")


def clinic(seed, num=300, moved=0.0):
    """One stage on two actions; B is better where x is 1, and a fifth is cut."""
    rng = np.random.default_rng(seed)
    x, is_b = rng.random(num) + moved, rng.integers(0, 2, num)
    ends, cuts = rng.integers(1, 9, num).astype(float), rng.geometric(0.06, num).astype(float)
    is_cut = cuts < ends
    reward = 2.0 * ((x > 0.5) == is_b) + rng.normal(size=num)
    done = {"elapsed_s": np.where(is_cut, np.nan, ends), "action": np.array(["A", "B"])[is_b], "reward": reward}
    return log_of({"end_s": np.minimum(ends, cuts)}, trajectory=range(num), x=x, y=rng.random(num), **done)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("monitor")
    for name, seed, moved in (("learned", 0, 0.0), ("next", 1, 0.0), ("moved", 1, 0.7)):
        clinic(seed, moved=moved).write(folder / name)
    learner = CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x", "y"], reg=1e-3)
    kept(learner, read_logs(folder / "learned"), folder / "policy")
    return folder


def test_no_alarm_is_reported_with_what_is_not_watched_and_status_0(folders):
    result = run_monitor(folders / "policy", "--logs", folders / "next")
    lines = result.output.splitlines()
    assert result.exit_code == 0
    assert lines[0] == "No alarm: in 300 trajectories nothing has changed."
    assert any(line.startswith("note: nothing was promised") for line in lines)


@pytest.mark.slow
def test_what_is_missing_is_filled_in_as_where_the_policy_was_learned(tmp_path):
    rule = {"x": "median+flag"}
    logs = holed(clinic(0), columns=("x",), missing=rule)
    kept(CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x", "y", "x_missing"], reg=1e-3), logs, tmp_path / "policy")
    holed(clinic(1), seed=1, columns=("x",)).write(tmp_path / "next")
    assert run_monitor(tmp_path / "policy", "--logs", tmp_path / "next").output.startswith(
        "No alarm: in 300 trajectories"
    )
    holed(clinic(1), share=0.6, columns=("x",)).write(tmp_path / "lost")
    result = run_monitor(tmp_path / "policy", "--logs", tmp_path / "lost")
    assert result.exit_code == 3
    assert "x_missing" in result.output


def test_an_alarm_is_status_3_and_named_first(folders):
    result = run_monitor(folders / "policy", "--logs", folders / "moved")
    assert result.exit_code == 3
    assert result.output.startswith("Alarm at trajectory ")
    assert "x in stage 1 is larger than in the log, since about trajectory 1 (1 to " in result.output.splitlines()[0]
    assert "Where to look first:" in result.output


@pytest.mark.parametrize("how", [(), ("--follow",)])
def test_a_log_that_another_policy_made_is_status_2_as_nothing_watches_this_one(folders, tmp_path, how):
    logs, policy = clinic(1), read_policy(folders / "policy").policy
    is_b = policy.decide(logs.stages, 1) == "A"
    reward = 2.0 * ((logs.stages["x"] > 0.5) == is_b) + np.random.default_rng(0).normal(size=len(is_b))
    done = {"action": np.where(is_b, "B", "A"), "reward": reward.where(logs.stages["reward"].notna())}
    Logs(logs.stages.assign(**done), logs.trajectories).write(tmp_path / "other")
    result = run_monitor(folders / "policy", "--logs", tmp_path / "other", *how)
    assert result.exit_code == 2
    assert result.output.startswith("Only 0% of the actions are the policy's: this log is not from its service")


def test_after_mending_it_watches_again(folders, tmp_path):
    broken, mended = read_logs(folders / "moved"), read_logs(folders / "next")
    later = [table.assign(trajectory=table["trajectory"] + 300) for table in (mended.stages, mended.trajectories)]
    both = zip((broken.stages, broken.trajectories), later, strict=True)
    Logs(*(pd.concat(each, ignore_index=True) for each in both)).write(tmp_path / "both")
    asked = (folders / "policy", "--logs", tmp_path / "both")
    assert run_monitor(*asked).exit_code == 3
    result = run_monitor(*asked, "--since", 300)
    assert (result.exit_code, result.output.startswith("No alarm: in 300 trajectories")) == (0, True)
    with refused("since is 900, and the log has no such trajectory"):
        run_monitor(*asked, "--since", 900)


def test_json_has_all_of_it(folders):
    report = shell.report("monitor", folders / "policy", "--logs", folders / "moved")
    assert report["is_alarm"]
    assert report["findings"][0]["name"] == "x in stage 1"
    assert report["findings"][0]["p_value"] < 1e-3
    assert shell.report("monitor", folders / "policy", "--logs", folders / "next")["findings"] == []


def test_the_page_tells_the_same_and_is_replaced_only_if_asked(folders, tmp_path):
    page = tmp_path / "service.html"
    result = run_monitor(folders / "policy", "--logs", folders / "moved", "--page", page)
    text = page.read_text(encoding="utf-8")
    assert result.output.splitlines()[0] in text
    assert text.count("<svg") == 1
    assert "<script" not in text
    run_monitor(folders / "policy", "--logs", folders / "next", "--page", page, "--overwrite")
    assert "no alarm" in page.read_text(encoding="utf-8")
    with refused("it already exists"):
        run_monitor(folders / "policy", "--logs", folders / "next", "--page", page)


def test_an_alarm_is_reported_even_if_its_page_cannot_be_written(folders, tmp_path, monkeypatch):
    def full(*_, **__):
        raise ArgumentError("the disk is full")

    said = []
    monkeypatch.setattr(module, "say", said.append)
    monkeypatch.setattr(page_module, "write_page", full)
    with refused("the disk is full"):
        run_monitor(folders / "policy", "--logs", folders / "moved", "--page", tmp_path / "service.html")
    assert said[0].startswith("Alarm at trajectory ")


def test_a_log_that_grows_is_followed_until_the_alarm(folders, tmp_path, monkeypatch):
    calls, logs = [], Logs(*(clinic(1, moved=0.7).tables[name] for name in ("stages", "trajectories")))
    with LogRecorder(tmp_path / "journal") as recorder:

        def record(num):
            for row in logs.stages.dropna(subset=["reward"]).iloc[num : num + 8].itertuples():
                trajectory = recorder.begin_trajectory()
                trajectory.begin_stage(covariates={"x": row.x, "y": row.y}, action=row.action)
                trajectory.complete_stage(row.reward, elapsed_s=row.elapsed_s)
                trajectory.finish()

        def wait(seconds):
            calls.append(seconds)
            record(8 * (len(calls) - 1))

        monkeypatch.setattr(module.time, "sleep", wait)
        with refused("no stage is recorded yet"):
            run_monitor(folders / "policy", "--logs", tmp_path / "journal")
        result = run_monitor(folders / "policy", "--logs", tmp_path / "journal", "--follow", "--every", 0.5)
    assert result.exit_code == 3
    assert calls
    assert set(calls) == {0.5}
    answers = [line for line in result.output.splitlines() if line.startswith(("No alarm", "Alarm"))]
    assert len(answers) == len(calls)
    assert answers[-1].startswith("Alarm")


@pytest.mark.slow
@in_browser
@PAGES
def test_the_page_can_be_heard_and_read_on_a_phone(folders, tmp_path, width_px, scheme):
    run_monitor(folders / "policy", "--logs", folders / "moved", "--page", tmp_path / "service.html")
    assert faults_of([tmp_path / "service.html"], width_px, scheme) == []


LEARN = ["--no-verdict", "--q-function", "linear", "--reg", "0.1"]


def cell(num, seed, gain, first=1):
    """One stage: A brings x and more, B nothing; a fifth is cut."""
    rng = np.random.default_rng(seed)
    x, is_a, took = rng.random(num), rng.random(num) < 0.5, rng.uniform(1.0, 3.0, num)
    is_cut = rng.random(num) < 0.2
    reward = np.where(is_a, x + gain, 0.0) + 0.3 * rng.normal(size=num)
    done = {"elapsed_s": np.where(is_cut, np.nan, took), "action": np.where(is_a, "A", "B"), "reward": reward}
    return log_of({"end_s": took}, trajectory=np.arange(first, first + num), x=x, **done)


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


@pytest.mark.slow
def test_a_change_is_reported_with_the_command_that_takes_only_what_still_holds(folder, tmp_path):
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


@pytest.mark.slow
def test_all_is_used_until_one_says_so_and_the_doubt_is_kept(folder, tmp_path):
    report = shell.report("learn", folder / "both", "--out", tmp_path / "policy", *LEARN)
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


def test_weights_by_recency_are_reported_and_kept_and_leave_no_doubt(folder, tmp_path):
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
    output = shell.run("act", folder / "policy", tmp_path / "now.json").output
    assert output.splitlines()[-1] == "learned from 150 trajectories of old (1 to 150)"
    assert shell.report("act", folder / "policy", tmp_path / "now.json")["learned_from"] == [
        {"name": "old", "num_trajectories": 150, "first": 1, "last": 150}
    ]


def test_of_an_unchanged_log_nothing_is_reported(folder):
    assert record_of(folder / "policy")["log"]["changes"] == []
    assert "half_life" not in record_of(folder / "policy")["learner"]


def test_an_alarm_says_whether_learning_again_may_pay(folder):
    result = shell.run("monitor", folder / "policy", "--logs", folder / "new")
    assert result.exit_code == 3
    assert "Learning again will not pay yet: there are 99 trajectories since the change, and about 200" in result.output
    assert "Learning again" not in shell.run("monitor", folder / "policy", "--logs", folder / "old").output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--since", "none-such"],
            "since is none-such, and the log has no such trajectory; give the name of one, 1 to",
        ),
        (["--since", "5", "--streaming"], "--since takes logs that are held in memory: add --in-memory"),
        (["--recency", "-3"], "half_life is -3.0; give a number of trajectories above 0"),
    ],
)
def test_what_cannot_be_is_refused(folder, tmp_path, options, message):
    with refused(message):
        shell.run("learn", folder / "old", "--out", tmp_path / "policy", *LEARN, *options)
    assert not (tmp_path / "policy").exists()


def test_a_log_that_names_another_policy_is_refused_and_followed_until_this_one_decides(folders, tmp_path, monkeypatch):
    policy, logs, naps = folders / "policy", clinic(1, num=30), []
    Logs(logs.stages, logs.trajectories.assign(policy_digest="f00")).write(tmp_path / "next")
    digest = read_policy(policy).digest
    with refused(rf"none of its 30 trajectories was decided by this policy \({digest}\), but by f00; give the log"):
        run_monitor(policy, "--logs", tmp_path / "next")

    def nap(every_s):
        naps.append(every_s)
        if len(naps) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(module.time, "sleep", nap)
    assert run_monitor(policy, "--logs", tmp_path / "next", "--follow").output.count("waiting: ") == 1


def test_a_log_that_is_replaced_while_it_is_followed_is_waited_for(folders, tmp_path, monkeypatch):
    policy, logs = folders / "policy", clinic(1, num=30)
    logs.write(tmp_path / "next")

    def copies():
        (tmp_path / "next").rename(tmp_path / "away")
        yield
        yield
        (tmp_path / "away").rename(tmp_path / "next")
        yield
        raise KeyboardInterrupt

    copying = copies()
    monkeypatch.setattr(module.time, "sleep", lambda _: next(copying))
    output = run_monitor(policy, "--logs", tmp_path / "next", "--follow").output
    assert output.count("waiting: ") == 1
    assert output.count("No alarm") == 2
    with refused("no such folder"):
        run_monitor(policy, "--logs", tmp_path / "none", "--follow")
