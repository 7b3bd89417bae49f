"""``halfseen monitor``: its answer, its exit status, its page, and how it follows a log that grows."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
import shell

from chromium import PAGES, faults_of, in_browser
from halfseen.cli import monitor as module
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.policies.folder import write_policy
from holes import holed
from refusals import refused
from small_logs import log_of

told = partial(shell.run, "monitor")


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
    logs = read_logs(folder / "learned")
    learner = CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x", "y"], reg=1e-3).fit(logs)
    write_policy(learner, logs, folder / "policy")
    return folder


def test_no_alarm_is_told_with_what_is_not_watched_and_status_0(folders):
    result = told(folders / "policy", "--logs", folders / "next")
    lines = result.output.splitlines()
    assert result.exit_code == 0
    assert lines[0] == "No alarm: in 300 trajectories nothing has changed."
    assert any(line.startswith("note: nothing was promised") for line in lines)


def test_what_is_missing_is_filled_in_as_where_the_policy_was_learned(tmp_path):
    rule = {"x": "median+flag"}
    logs = holed(clinic(0), columns=("x",), missing=rule)
    learner = CensoredQLearner.of_paper(1, {1: ["A", "B"]}, ["x", "y", "x_missing"], reg=1e-3).fit(logs)
    write_policy(learner, logs, tmp_path / "policy")
    holed(clinic(1), seed=1, columns=("x",)).write(tmp_path / "next")
    assert told(tmp_path / "policy", "--logs", tmp_path / "next").output.startswith("No alarm: in 300 trajectories")
    holed(clinic(1), share=0.6, columns=("x",)).write(tmp_path / "lost")
    result = told(tmp_path / "policy", "--logs", tmp_path / "lost")
    assert result.exit_code == 3
    assert "x_missing" in result.output


def test_an_alarm_is_status_3_and_named_first(folders):
    result = told(folders / "policy", "--logs", folders / "moved")
    assert result.exit_code == 3
    assert result.output.startswith("Alarm at trajectory ")
    assert "x in stage 1 is larger than in the log, since about trajectory 1 (1 to " in result.output.splitlines()[0]
    assert "Where to look first:" in result.output


def test_after_mending_it_watches_anew(folders, tmp_path):
    broken, mended = read_logs(folders / "moved"), read_logs(folders / "next")
    later = [table.assign(trajectory=table["trajectory"] + 300) for table in (mended.stages, mended.trajectories)]
    both = zip((broken.stages, broken.trajectories), later, strict=True)
    Logs(*(pd.concat(each, ignore_index=True) for each in both)).write(tmp_path / "both")
    asked = (folders / "policy", "--logs", tmp_path / "both")
    assert told(*asked).exit_code == 3
    result = told(*asked, "--since", 300)
    assert (result.exit_code, result.output.startswith("No alarm: in 300 trajectories")) == (0, True)
    with refused("since is 900, and the log has no such trajectory"):
        told(*asked, "--since", 900)


def test_json_has_all_of_it(folders):
    report = json.loads(told(folders / "policy", "--logs", folders / "moved", "--json").output)
    assert report["is_alarm"]
    assert report["findings"][0]["name"] == "x in stage 1"
    assert report["findings"][0]["p_value"] < 1e-3
    assert json.loads(told(folders / "policy", "--logs", folders / "next", "--json").output)["findings"] == []


def test_the_page_tells_the_same_and_is_replaced_only_if_asked(folders, tmp_path):
    page = tmp_path / "service.html"
    result = told(folders / "policy", "--logs", folders / "moved", "--page", page)
    text = page.read_text(encoding="utf-8")
    assert result.output.splitlines()[0] in text
    assert text.count("<svg") == 1
    assert "<script" not in text
    told(folders / "policy", "--logs", folders / "next", "--page", page, "--overwrite")
    assert "no alarm" in page.read_text(encoding="utf-8")
    with refused("it is there already"):
        told(folders / "policy", "--logs", folders / "next", "--page", page)


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
            told(folders / "policy", "--logs", tmp_path / "journal")
        result = told(folders / "policy", "--logs", tmp_path / "journal", "--follow", "--every", 0.5)
    assert result.exit_code == 3
    assert calls
    assert set(calls) == {0.5}
    answers = [line for line in result.output.splitlines() if line.startswith(("No alarm", "Alarm"))]
    assert len(answers) == len(calls)
    assert answers[-1].startswith("Alarm")


@in_browser
@PAGES
def test_the_page_can_be_heard_and_read_on_a_phone(folders, tmp_path, width_px, scheme):
    told(folders / "policy", "--logs", folders / "moved", "--page", tmp_path / "service.html")
    assert faults_of([tmp_path / "service.html"], width_px, scheme) == []
