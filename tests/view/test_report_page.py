import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from markupsafe import Markup
from page_reader import Reader

from axe import PAGES, faults_of, in_browser
from halfseen.cli import halfseen
from halfseen.errors import ArgumentError
from halfseen.evaluation.targets import task_of
from halfseen.figures import MOST_MARKERS, inline_svg
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder import read_policy, write_policy
from halfseen.policies.named_decider import NamedObservation
from halfseen.policies.observations import decider_of
from halfseen.view import findings as found_in
from halfseen.view import page as page_module
from halfseen.view.findings import find
from halfseen.view.log_figures import draw_follow_up
from halfseen.view.log_findings import follow_up
from halfseen.view.page import MARK, page_of, write_page
from halfseen.view.policy_findings import choices, q_curves
from halfseen.view.words import answer
from small_logs import table_log
from small_report import ACTIONS, CAUSE, COVARIATES, estimate, evaluation, hostile_log

EXAMPLE = Path(__file__).parents[2] / "examples" / "pick_cell"
SECTIONS = ("value", "log", "weights", "policy", "unknown", "again")


@pytest.fixture(scope="module")
def logs():
    return hostile_log()


def learned(logs, folder):
    learner = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1, random_state=3).fit(logs)
    write_policy(learner, logs, folder)
    return read_policy(folder)


@pytest.fixture(scope="module")
def stored(logs, tmp_path_factory):
    return learned(logs, tmp_path_factory.mktemp("report") / "policy")


@pytest.fixture(scope="module")
def findings(stored, logs):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(found_in, "evaluate", lambda *_, **__: evaluation())
        return find(stored, logs, num_replicates=4, seed=1)


def judged_as(findings, **changed):
    return replace(findings, policy=replace(findings.policy, **changed))


@pytest.fixture
def is_undrawn(monkeypatch):
    monkeypatch.setattr(page_module, "inline_svg", lambda *_: Markup("<svg></svg>"))


@pytest.fixture(scope="module")
def page(findings):
    return page_of(findings, "halfseen report 'a <b>' policy --seed 1")


def test_every_section_and_figure_is_there_and_the_answer_comes_first(page, findings):
    read = Reader(page)
    assert [name for name in read.ids if name in SECTIONS] == list(SECTIONS)
    # Values, trajectories along time, Ĝ, three of the weights, choices, Q, and maps of the stages that have states
    # enough.
    assert read.tags.count("svg") == 8 + len(findings.policy.maps) > 8
    text = " ".join("".join(read.words).split())
    first = "The learned policy is better than the logging policy: it earns <this> much."
    assert text.index(first) < text.index("What it is worth")
    for words in (
        "The policy was learned from these very logs, which flatters it",
        "The cause of all cuts is".lower(),
        "What was recorded explains the cuts.",
        "The logged probabilities are right.",
        "halfseen report 'a <b>' policy --seed 1",
        "seed 3",
    ):
        assert words.lower() in text.lower()


@pytest.mark.parametrize("verdict", ["better", "not better", "cannot be said"])
def test_the_answer_names_the_opponent_once(verdict):
    reason = "it earns between -1 and 2 more a trajectory than the logging policy; if it is 1, twice as many would tell"
    said, remedy = answer(replace(evaluation(verdict), reason=reason))
    assert said.count("the logging policy") == 1
    assert said.endswith(": it earns between −1 and 2 more a trajectory.")
    assert remedy == "If it is 1, twice as many would tell."


def test_the_page_stands_alone(page):
    read = Reader(page)
    inner = [link for link in read.links if not link.startswith("data:image/png;base64,")]
    assert all(link.startswith("#") for link in inner)
    assert {link[1:] for link in inner} <= set(read.ids)
    assert len(set(read.ids)) == len(read.ids)
    assert not {"script", "link", "iframe"} & set(read.tags)
    assert "http" not in page
    assert "@import" not in page
    assert len(re.findall(r"url\((?!#)", page)) == 0


def test_names_of_users_are_told_as_they_are_and_never_run(page):
    text = "".join(Reader(page).words)
    for name in (*ACTIONS, *COVARIATES, CAUSE):
        assert name in text
    for raw in ("<script", "<b>grip", "x<1>"):
        assert raw not in page


def test_what_is_no_number_is_a_dash(findings):
    nothing = replace(estimate(1.0, 0.1), value=np.nan, low=-np.inf, high=np.inf)
    page = page_of(judged_as(findings, evaluation=evaluation(importance_sampling=nothing)), "x")
    words = " ".join(Reader(page).words)
    assert "–" in words
    assert not re.search(r"\b(nan|inf|None)\b", words, flags=re.IGNORECASE)
    assert "NaN" not in page


def test_the_same_findings_are_the_same_bytes(findings, page, stored, logs, monkeypatch):
    monkeypatch.setattr(found_in, "evaluate", lambda *_, **__: evaluation())
    again = find(stored, logs, num_replicates=4, seed=1)
    assert page_of(again, "halfseen report 'a <b>' policy --seed 1") == page
    other = find(stored, logs, num_replicates=4, seed=2)
    assert np.any(other.policy.curves[0].low[ACTIONS[0]] != again.policy.curves[0].low[ACTIONS[0]])


def test_watched_is_kaplan_meier_with_the_numbers_still_watched():
    stages = {"trajectory": range(4), "stage": 1, "elapsed_s": [1.0, None, 2.0, 6.0], "action": "A"}
    trajectories = {
        "trajectory": range(4),
        "end_s": [1.0, 2.0, 2.0, 6.0],
        "ending": ["finished", "cut", "finished", "finished"],
    }
    told = follow_up(Logs(pd.DataFrame(stages | {"reward": [0.0, None, 0.0, 0.0]}), pd.DataFrame(trajectories)))
    assert told.time_s.tolist() == [0.0, 2.0, 6.0]
    assert told.survival.tolist() == [1.0, 0.5, 0.5]
    assert told.risk_time_s.tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert told.num_watched.tolist() == [4, 4, 3, 1, 1, 1, 1]
    assert {name: ends_s.tolist() for name, ends_s in told.ends_s.items()} == {
        "finished": [1.0, 2.0, 6.0],
        "cut: unknown": [2.0],
    }


@pytest.mark.usefixtures("is_undrawn")
def test_a_log_without_cuts_says_so_and_assumes_nothing_of_them(stored, monkeypatch):
    logs = hostile_log(cut_after_s=1e6)
    monkeypatch.setattr(found_in, "evaluate", lambda *_, **__: evaluation())
    told = find(stored, logs, num_replicates=2)
    page = page_of(told, "x")
    assert "No trajectory was cut: each was watched to its own end." in page
    assert "explains the cuts" not in page
    assert "learned from other logs than these" in page
    assert told.policy.curves[0].low is None


def test_choices_are_shares_of_the_same_states(stored, logs):
    for row in choices(stored, task_of(stored.policy, logs), logs):
        states = logs.stages[logs.stages["stage"] == row["stage"]]
        taken = stored.policy.decide(states, row["stage"])
        assert row["num_states"] == len(states)
        for name in ACTIONS:
            assert row["policy"][name] == pytest.approx(np.mean(taken == name))
            assert row["logged"][name] == pytest.approx(np.mean(states["action"] == name))
        assert row["as_logged"] == pytest.approx(np.mean(taken == states["action"]))


def test_curves_follow_q_with_the_rest_at_its_median_and_within_bands(findings, stored, logs):
    curve = findings.policy.curves[0]
    states = logs.stages.loc[logs.stages["stage"] == 1, COVARIATES]
    assert (curve.stage, curve.covariate) == (1, COVARIATES[0])
    at = pd.DataFrame([states.median()] * 2).assign(**{COVARIATES[0]: curve.values[[0, -1]]})
    q = stored.policy.q_values(at, 1)
    for k, name in enumerate(ACTIONS):
        assert curve.q[name][[0, -1]] == pytest.approx(q[:, k])
        assert np.all(curve.low[name] <= curve.high[name])
    assert np.quantile(states[COVARIATES[0]], [0.05, 0.95]) == pytest.approx(curve.values[[0, -1]])


def test_a_policy_of_tables_is_told_by_its_verbs(tmp_path, monkeypatch):
    logs = table_log()
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, tmp_path / "policy")
    monkeypatch.setattr(found_in, "evaluate", lambda *_, **__: evaluation())
    told = find(read_policy(tmp_path / "policy"), logs, num_replicates=2)
    assert told.policy.curves == []
    assert set(told.policy.choices[0]["logged"]) == {"FINISH", "WASH", "LIFT"}
    assert sum(told.policy.choices[0]["logged"].values()) == pytest.approx(1.0)
    read = Reader(page_of(told, "x"))
    assert told.policy.maps == []
    assert read.tags.count("svg") == 7 + len(told.policy.table_map.share if told.policy.table_map else ())
    assert "who hides whom" in "".join(read.words)


def test_a_long_log_becomes_a_small_drawing(logs):
    told = follow_up(logs)
    long = replace(told, ends_s={"finished": np.linspace(0.0, 5.0, 50 * MOST_MARKERS)})
    drawn = inline_svg(lambda: draw_follow_up(long), "f", "t")
    assert "data:image/png;base64" in drawn
    assert len(drawn) < 300_000


def test_a_page_is_replaced_only_where_that_is_asked_for(tmp_path):
    file = tmp_path / "new" / "report.html"
    write_page(f"{MARK} first", file)
    with pytest.raises(ArgumentError, match="it is there already"):
        write_page(f"{MARK} second", file)
    write_page(f"{MARK} second", file, overwrite=True)
    assert file.read_text() == f"{MARK} second"
    assert [path.name for path in file.parent.iterdir()] == ["report.html"]


def test_a_policy_that_knows_its_errors_has_their_bands_on_other_logs(logs, tmp_path):
    learner = CensoredQLearner(2, ACTIONS, COVARIATES, reg=0.1, stages="pooled", pessimism=1.0).fit(logs)
    write_policy(learner, logs, tmp_path / "policy")
    stored = read_policy(tmp_path / "policy")
    other = hostile_log(seed=9)
    curves, band = q_curves(stored, other, 2, 0, is_own_log=False)
    assert band == "regression"
    curve = curves[0]
    at = pd.DataFrame([other.stages.loc[other.stages["stage"] == 1, COVARIATES].median()]).assign(
        **{COVARIATES[0]: curve.values[:1]}
    )
    decision = decider_of(stored, extrapolates=True).decide(NamedObservation(at, 1))
    for name in ACTIONS:
        assert (curve.low[name][0], curve.high[name][0]) == pytest.approx(decision.intervals[name])
        assert np.all(curve.low[name] < curve.q[name])


@pytest.fixture(scope="module")
def example_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readable")
    policy, out = str(folder / "policy"), folder / "report.html"
    for words in (
        ["learn", str(EXAMPLE / "logs"), "--out", policy],
        ["report", str(EXAMPLE / "later_logs"), policy, "--out", str(out)],
    ):
        CliRunner().invoke(halfseen, [*words, "--quiet"], catch_exceptions=False)
    return out


@in_browser
@pytest.mark.slow
@PAGES
def test_everybody_can_read_the_page_of_a_policy(example_page, width_px, scheme):
    assert faults_of([example_page], width_px, scheme) == []
