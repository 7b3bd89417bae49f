"""The page of the running cell says what the log and the monitor say, stands alone, and waits for nobody."""

import base64
import hashlib
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
from asking import RULE, client_of, decided, ended, run, written

from chromium import PAGES, faults_of, in_browser
from halfseen.logs import read_logs
from halfseen.monitoring import monitored
from halfseen.monitoring.dealing import Terms
from halfseen.policies.folder import read_policy
from halfseen.serving import watching
from halfseen.serving.comparing import LiveComparison
from halfseen.serving.in_service import taken_into_service
from halfseen.serving.watching import MOST_TRAJECTORIES, Recent, Watch, found_of

VOID = {"meta", "br", "link", "path", "use", "rect", "image"}


class Outline(HTMLParser):
    """The elements of a page, and whether each was closed where it should be."""

    def __init__(self, page):
        super().__init__()
        self.open, self.elements = [], []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def all(self, *tags):
        return [given for tag, given in self.elements if tag in tags]


def check_page(answer):
    """Check that a page stands alone, and what axe would say first of it."""
    outline, text = Outline(answer.text), answer.text
    ids = [given["id"] for _, given in outline.elements if "id" in given]
    assert len(ids) == len(set(ids))
    assert outline.all("html")[0]["lang"] == "en"
    assert (
        len(outline.all("h1")) == len(outline.all("main")) == len(outline.all("title")) - len(outline.all("svg")) == 1
    )
    assert all("scope" in each for each in outline.all("th"))
    assert all(each.get("aria-label") for _, each in outline.elements if each.get("role") == "group")
    assert not [
        value for _, each in outline.elements for value in each.values() if re.match("(https?:)?//", value or "")
    ]
    (script,) = re.findall("<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in answer.headers["content-security-policy"]
    for part in re.findall(r'getElementById\("(\w+)"\)', script):
        assert part == "age" or part in ids
    return text


def test_before_the_first_decision_it_says_so(flat):
    with client_of(flat) as asked:
        text = check_page(asked.get("/"))
        assert asked.get("/state").json()["decision"] is None
    assert "<h1>No decision yet.</h1>" in text
    assert "halfseen serve --record LOGS" in text


def test_a_decision_is_reported_with_its_reason_its_values_and_what_was_seen(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as asked:
        answer = decided(asked, x1=0.25, x2=1)
        state, text = asked.get("/state").json(), check_page(asked.get("/"))
        assert (state["decision"], state["seen"]) == (answer, {"x1": 0.25, "x2": 1})
        assert f"<h1>Trajectory 1, stage 1 of 2: {answer['action']}, by the policy.</h1>" in text
        assert answer["reason"] in text
        assert f"{answer['action']}, taken</th>" in text
        assert asked.get("/state").json()["revision"] == state["revision"]
        asked.post("/reward", json={"reward": 1.0})
        after = asked.get("/state").json()
        assert after["sentence"] == "Trajectory 1: stage 1 is done; waiting for the next decision."
        assert after["revision"] != state["revision"]
        asked.post("/end", json={"ending": "finished"})
        assert asked.get("/state").json()["sentence"] == "No trajectory is in progress."


def test_where_the_rule_decides_it_says_why(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as asked:
        decided(asked, x1=1e6, x2=1)
        text, why = check_page(asked.get("/")), asked.get("/state").json()["rule"]["last"]
    assert "by the rule in the policy&#39;s place (out-of-range).</h1>" in text
    assert "stepped back</p>" in text
    assert text.count(why) == 2


def test_the_last_trajectories_are_those_of_the_log_and_the_comparison_is_that_of_its_address(flat, tmp_path):
    (tmp_path / "rule.csv").write_text(RULE)
    service = taken_into_service(flat, rule=tmp_path / "rule.csv")
    compared = LiveComparison(service, tmp_path / "rule.csv", tmp_path / "logs", Terms(0.5), 3, print)
    with client_of(flat, tmp_path / "logs", comparison=compared) as asked:
        assert "<dd>not known yet</dd>" in check_page(asked.get("/"))
        run(asked, np.random.default_rng(0), MOST_TRAJECTORIES + 3, cut=0.4)
        state, text = asked.get("/state").json(), check_page(asked.get("/"))
        assert state["comparison"] == asked.get("/comparison").json()
    assert state["comparison"]["sentence"][1:] in text.replace("&#39;", "'")
    logs = read_logs(tmp_path / "logs")
    totals = logs.stages.groupby("trajectory")["reward"].agg(["sum", "size"])
    rows = logs.trajectories.set_index("trajectory").iloc[: -MOST_TRAJECTORIES - 1 : -1]
    assert [each["trajectory"] for each in state["trajectories"]] == rows.index.tolist()
    for result, (name, row) in zip(state["trajectories"], rows.iterrows(), strict=True):
        assert result["reward"] == pytest.approx(totals["sum"][name])
        assert (result["stages"], result["arm"], result["ending"]) == (totals["size"][name], row["arm"], row["ending"])


@pytest.fixture(scope="module")
def alarm(flat, tmp_path_factory):
    """The page of a cell in which everything earns more than the log, once that was found, and its log."""
    logs = tmp_path_factory.mktemp("alarm") / "logs"
    watch = Watch(flat, logs, say=lambda sentence: None)
    with watch, client_of(flat, logs, recent=Recent(watch)) as asked:
        watch.found = {"error": "its folder promises nothing"}
        assert "Not watched: its folder promises nothing" in check_page(asked.get("/"))
        watch.every_s = watch._next_s = float("inf")
        run(asked, np.random.default_rng(0), 120, gain=9.0)
        watch.found = found_of(flat, logs)
        return watch.found, asked.get("/"), asked.get("/state").json(), logs


@pytest.mark.slow
def test_what_the_monitor_found_is_reported_first(alarm, flat):
    found, page, state, logs = alarm
    text = check_page(page).replace("&#39;", "'")
    expected = monitored(read_policy(flat), read_logs(logs))
    assert {**state["monitor"], "age_s": 0} == {**expected.as_dict(), "age_s": 0}
    assert found["is_alarm"]
    assert f"<h1>{expected.sentence}</h1>" in text
    assert text.count("<svg") == len(found["figures"]) > 0
    assert "figures" not in state["monitor"]


def test_a_log_is_looked_at_where_there_is_news_and_not_too_often(flat, tmp_path, monkeypatch):
    looks, said = [], []

    def asked(watch):
        looks.append(len(looks))
        return {"is_alarm": len(looks) > 1, "sentence": f"Look {len(looks)}."}

    monkeypatch.setattr(Watch, "_asked", asked)
    with Watch(flat, tmp_path, every_s=0.0, say=said.append) as watch:
        watch.look()
        assert watch._thread is None
        for num in (1, 2, 3):
            watch._next_s = 0.0
            watch.ended()
            watch._thread.join()
            assert len(looks) == num
        watch._next_s = float("inf")
        watch.ended()
        watch._thread.join()
    assert len(looks) == 3
    assert said == ["Look 2."]


@pytest.mark.slow
def test_a_policy_is_watched_by_what_it_decided_itself(flat, tmp_path, monkeypatch):
    folder, logs = shutil.copytree(flat, tmp_path / "policy"), tmp_path / "logs"
    monkeypatch.setattr(Watch, "_asked", lambda watch: found_of(folder, logs, watch.digest))
    digest = read_policy(flat).digest
    with (
        Watch(folder, logs, every_s=0.0, digest=digest) as watch,
        client_of(folder, logs, recent=Recent(watch)) as asked,
    ):

        def watched():
            watch._next_s = 0.0
            ended(asked)
            watch._thread.join()
            found = asked.get("/state").json()["monitor"]
            return found and (found["num_trajectories"], found["notes"][0].partition(":")[0])

        decided(asked, x1=0.1, x2=1)
        watched()
        asked.post("/reload")
        decided(asked, x1=0.1, x2=1)
        assert watched()[0] == 2
        decided(asked, x1=0.1, x2=1)
        written(folder, reg=5.0)
        other = asked.post("/reload").json()["policy"]
        assert "holds a different policy than the one in use" in found_of(folder, logs, digest)["error"]
        # The first policy finishes the third.
        assert watch.digest == digest != other
        assert watched() is None
        assert watch.digest == other == read_policy(folder).digest
        decided(asked, x1=0.1, x2=1)
        assert watched() == (1, "not counted")
    assert read_logs(logs).trajectories["policy_digest"].tolist() == [digest] * 3 + [other]
    assert found_of(flat, logs)["num_trajectories"] == 3
    for one in (flat, folder):
        assert monitored(read_policy(one), read_logs(logs)).num_trajectories == (3 if one == flat else 1)


@pytest.mark.slow
def test_a_log_that_cannot_be_watched_is_reported_once(flat, tmp_path):
    said = []
    with Watch(flat, tmp_path / "nowhere", every_s=0.0, say=said.append) as watch:
        for _ in range(2):
            watch._next_s = 0.0
            watch.ended()
            watch._thread.join()
    assert len(said) == 1
    assert said[0].startswith("The log is not monitored: ")


def test_ctrl_c_before_the_log_is_watched_is_no_error(flat, tmp_path, monkeypatch):
    def interrupted(thread):
        raise KeyboardInterrupt

    monkeypatch.setattr(watching.threading.Thread, "start", interrupted)
    with pytest.raises(KeyboardInterrupt), Watch(flat, tmp_path / "logs") as watch:
        watch.ended()


@pytest.mark.slow
def test_the_log_is_watched_in_a_process_of_its_own(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as asked:
        run(asked, np.random.default_rng(0), 3)
    with Watch(flat, tmp_path / "logs") as watch:
        watch.ended()
        watch._thread.join()
        assert watch.found == found_of(flat, tmp_path / "logs")
        assert watch._process.returncode == 0
    assert "nowhere" in found_of(flat, tmp_path / "nowhere")["error"]


@pytest.mark.slow
@in_browser
@PAGES
def test_the_page_can_be_heard_and_read_on_a_phone(alarm, tmp_path, width_px, scheme):
    (tmp_path / "cell.html").write_text(alarm[1].text, encoding="utf-8")
    assert faults_of([tmp_path / "cell.html"], width_px, scheme) == []
