"""Pages about a log, and about a policy: answers, names of users, bands, bytes."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from markupsafe import Markup

from chromium import PAGES, faults_of, in_browser
from halfseen.cli import halfseen
from halfseen.errors import ArgumentError
from halfseen.evaluation.evaluation import PerHour, Rate
from halfseen.evaluation.specification import task_of
from halfseen.figures import MOST_MARKERS, inline_svg
from halfseen.learning import CensoredQLearner
from halfseen.policies.named_decider import NamedObservation
from halfseen.policies.observations import decider_of
from halfseen.view import page as page_module
from halfseen.view.findings import find
from halfseen.view.log_figures import draw_follow_up
from halfseen.view.log_findings import follow_up
from halfseen.view.page import MARK, page_of, write_page
from halfseen.view.policy_findings import choices, q_curves
from halfseen.view.words import answer, answer_of, standing, why_no_hours
from small_logs import kept, log_of, table_log
from small_report import ACTIONS, CAUSE, COVARIATES, estimate, evaluation, found, hostile_log

EMPTY = {"meta", "br"}
UNIT = "<i>net</i> picks"


class Reader(HTMLParser):
    """Balance of tags, ids, and the words that are read."""

    def __init__(self, page):
        super().__init__()
        self.open, self.ids, self.links, self.tags, self.words = [], [], [], [], []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[name] for name in ("href", "src") if name in given]
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in EMPTY:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "svg"} & set(self.open) or "title" in self.open:
            self.words.append(data)


def words_of(page):
    return " ".join("".join(Reader(page).words).split())


@pytest.mark.slow
def test_it_tells_of_the_log_and_of_nothing_else():
    findings = find(None, hostile_log().in_unit(UNIT))
    page = page_of(findings, "halfseen report logs --seed 0")
    read, words = Reader(page), words_of(page)
    sections = [name for name in read.ids if name in ("value", "log", "weights", "policy", "unknown", "again")]
    assert sections == ["log", "weights", "unknown", "again"]
    assert all(link[1:] in read.ids for link in read.links if link.startswith("#"))
    assert read.tags.count("svg") == 5
    assert "<title>What these logs hold</title>" in page
    assert answer_of(findings) in words
    assert CAUSE in words
    assert f"Rewards are in {UNIT}." in words
    assert f"mean reward [{UNIT}]" in words
    for of_a_policy in ("learned policy", "Q:", "Bands", "doubly robust"):
        assert of_a_policy not in words


def one_stage(ends):
    """Trajectories of one stage: (end, whether it finished)."""
    end_s, is_done = (np.array(each) for each in zip(*ends, strict=True))
    return log_of({"end_s": end_s}, trajectory=range(len(ends)), elapsed_s=np.where(is_done, end_s, np.nan))


@pytest.mark.parametrize(
    ("ends", "says"),
    [
        ([(2.0, True)], "1 trajectory, which was not cut; every trajectory counts once"),
        ([(2.0, False)], "1 trajectory: it was cut, by unknown; what was seen cannot safely stand"),
        ([(2.0, True), (3.0, True)], "2 trajectories, none of them cut"),
        ([(2.0, False), (3.0, False)], "2 trajectories: all were cut, by unknown; what was seen cannot safely stand"),
    ],
)
def test_the_smallest_logs_have_a_page_without_empty_parts(ends, says):
    findings = find(None, one_stage(ends))
    page = page_of(findings, "x")
    words = words_of(page)
    assert says in words
    num_finished = sum(is_done for _, is_done in ends)
    assert ("Actions of completed stages" in words) == (num_finished > 0)
    assert Reader(page).tags.count("svg") == (5 if num_finished else 2)
    assert not re.search(r"\b(nan|None)\b", words)


def rated(value, reach):
    return Rate(estimate(3600.0 * value, 3600.0 * reach), estimate(13.0, 1.0))


def test_what_is_earned_is_reported_of_today_and_in_an_hour():
    per_hour = PerHour(rated(0.1, 0.02), rated(0.05, 0.01))
    known = evaluation(reward_unit="parts", share=estimate(1.5, 0.2), per_hour=per_hour)
    said = standing(known).replace("\u00a0", " ")
    assert said == (
        "The best estimate is 1.50 parts a trajectory: 150 % of today’s (130 to 170 %) and 360 parts an hour (288 to "
        "432), against 180 today."
    )
    assert why_no_hours(known) == ""
    assert standing(evaluation()) == ""
    # Where too few trajectories follow the policy, its value is not to be believed, in whatever unit.
    few = replace(known, doubly_robust=replace(known.doubly_robust, effective_sample_size=3.0))
    assert standing(few) == ""


EXAMPLE = Path(__file__).parents[2] / "examples" / "pick_cell"
SECTIONS = ("value", "log", "weights", "policy", "unknown", "again")


@pytest.fixture(scope="module")
def logs():
    return hostile_log()


@pytest.fixture(scope="module")
def stored(logs, tmp_path_factory):
    learner = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1, random_state=3)
    return kept(learner, logs, tmp_path_factory.mktemp("report") / "policy")


@pytest.fixture(scope="module")
def findings(stored, logs):
    return found(stored, logs, 4, 1)


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
        "The policy was learned from these logs, which biases its value upwards",
        "The cause of all cuts is".lower(),
        "What was recorded explains the cuts.",
        "The logged probabilities are right.",
        "halfseen report 'a <b>' policy --seed 1",
        "seed 3",
    ):
        assert words.lower() in text.lower()


@pytest.mark.parametrize("verdict", ["better", "not better", "inconclusive"])
def test_the_answer_names_the_baseline_once(verdict):
    reason = "it earns between -1 and 2 more a trajectory than the logging policy; if it is 1, twice as many would tell"
    said, remedy = answer(replace(evaluation(verdict), reason=reason))
    assert said.count("the logging policy") == 1
    assert said.endswith(": it earns between −1 and 2 more a trajectory.")
    assert remedy == "If it is 1, twice as many would tell."


def test_the_page_stands_alone_and_names_of_users_are_reported_as_they_are_and_never_run(page):
    read = Reader(page)
    inner = [link for link in read.links if not link.startswith("data:image/png;base64,")]
    assert all(link.startswith("#") for link in inner)
    assert {link[1:] for link in inner} <= set(read.ids)
    assert len(set(read.ids)) == len(read.ids)
    assert not {"script", "link", "iframe"} & set(read.tags)
    assert not re.search(r"http|@import|url\((?!#)|<script|<b>grip|x<1>", page)
    assert [name for name in (*ACTIONS, *COVARIATES, CAUSE) if name not in "".join(read.words)] == []


@pytest.mark.slow
def test_the_same_findings_are_the_same_bytes_and_what_is_no_number_is_a_dash(findings, page, stored, logs):
    assert page_of(found(stored, logs, 4, 1), "halfseen report 'a <b>' policy --seed 1") == page
    (other, *_), _ = q_curves(stored, logs, 4, 2)
    assert np.any(other.low[ACTIONS[0]] != findings.policy.curves[0].low[ACTIONS[0]])
    nothing = evaluation(importance_sampling=replace(estimate(1.0, 0.1), value=np.nan, low=-np.inf, high=np.inf))
    page = page_of(replace(findings, policy=replace(findings.policy, evaluation=nothing)), "x")
    words = " ".join(Reader(page).words)
    assert "–" in words
    assert not re.search(r"\b(nan|inf|None)\b", words, flags=re.IGNORECASE)
    assert "NaN" not in page


def test_watched_is_kaplan_meier_with_the_numbers_still_watched_and_a_long_log_becomes_a_small_drawing():
    result = follow_up(one_stage([(1.0, True), (2.0, False), (2.0, True), (6.0, True)]))
    assert result.time_s.tolist() == [0.0, 2.0, 6.0]
    assert result.survival.tolist() == [1.0, 0.5, 0.5]
    assert result.risk_time_s.tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert result.num_watched.tolist() == [4, 4, 3, 1, 1, 1, 1]
    ends_s = {name: each.tolist() for name, each in result.ends_s.items()}
    assert ends_s == {"finished": [1.0, 2.0, 6.0], "cut: unknown": [2.0]}
    long = replace(result, ends_s={"finished": np.linspace(0.0, 5.0, 50 * MOST_MARKERS)})
    drawn = inline_svg(lambda: draw_follow_up(long), "f", "t")
    assert "data:image/png;base64" in drawn
    assert len(drawn) < 300_000


def test_a_log_without_cuts_says_so_and_assumes_nothing_of_them(stored, monkeypatch):
    monkeypatch.setattr(page_module, "inline_svg", lambda *_: Markup("<svg></svg>"))
    result = found(stored, hostile_log(cut_after_s=1e6))
    page = page_of(result, "x")
    assert "No trajectory was cut: each was observed to its end." in page
    assert "explains the cuts" not in page
    assert "learned from other logs" in page
    assert result.policy.curves[0].low is None


def test_choices_are_shares_of_the_same_states(stored, logs):
    for row in choices(stored.policy, task_of(stored.policy, logs), logs):
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


@pytest.mark.slow
def test_a_policy_of_tables_is_reported_by_its_verbs(tmp_path):
    logs = table_log()
    result = found(kept(CensoredQLearner.for_table(3, reg=0.1), logs, tmp_path / "policy"), logs)
    assert (result.policy.curves, result.policy.maps) == ([], [])
    assert set(result.policy.choices[0]["logged"]) == {"FINISH", "WASH", "LIFT"}
    assert sum(result.policy.choices[0]["logged"].values()) == pytest.approx(1.0)
    read = Reader(page_of(result, "x"))
    assert read.tags.count("svg") == 7 + len(result.policy.table_map.share if result.policy.table_map else ())
    assert "who hides whom" in "".join(read.words)


def test_a_page_is_replaced_only_where_that_is_asked_for(tmp_path):
    file = tmp_path / "new" / "report.html"
    write_page(f"{MARK} first", file)
    with pytest.raises(ArgumentError, match="it already exists"):
        write_page(f"{MARK} second", file)
    write_page(f"{MARK} second", file, overwrite=True)
    assert file.read_text() == f"{MARK} second"
    assert [path.name for path in file.parent.iterdir()] == ["report.html"]


def test_a_policy_that_knows_its_errors_has_their_bands_on_other_logs(logs, tmp_path):
    learner = CensoredQLearner(2, ACTIONS, COVARIATES, reg=0.1, stages="pooled", pessimism=1.0)
    stored = kept(learner, logs, tmp_path / "policy")
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
