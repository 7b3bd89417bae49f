"""Trajectories are dealt to the policy or the rule of today, with honest probabilities, and the log is the state."""

import sys
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from asking import RULE, client_of, decided, refused, run
from click.testing import CliRunner

from halfseen.cli.serve import serve
from halfseen.errors import ArgumentError, LogError
from halfseen.logs import read_logs
from halfseen.logs.journal import JOURNAL, JournalEvents
from halfseen.logs.recorder import torn_by
from halfseen.monitoring.dealing import Terms, standing
from halfseen.policies import read_policy
from halfseen.serving import comparing, limits
from halfseen.serving.comparing import LiveComparison, courses_of
from halfseen.serving.in_service import taken_into_service


@pytest.fixture
def cell(flat, tmp_path):
    """A comparison that records, as the command makes it: whom to ask, how it stands, and what was said."""
    (tmp_path / "rule.csv").write_text(RULE)

    def begin(terms=None, seed=3, **answering):
        said, terms = [], terms or Terms(0.5)
        service = taken_into_service(flat, rule=tmp_path / "rule.csv")
        compared = LiveComparison(service, tmp_path / "rule.csv", tmp_path / "logs", terms, seed, said.append)
        return compared, said, client_of(flat, tmp_path / "logs", comparison=compared, **answering)

    return begin


def test_a_log_that_cannot_be_read_is_no_beginning(cell, tmp_path, monkeypatch):
    (tmp_path / "logs").mkdir()

    def broken(folder):
        raise LogError(f"{folder}: trajectory 3 is broken")

    monkeypatch.setattr(comparing, "read_logs", broken)
    with pytest.raises(LogError, match="trajectory 3 is broken"):
        cell()


@pytest.mark.slow
@pytest.mark.parametrize("is_clocked", [True, False])
def test_the_log_says_which_arm_with_which_chance_and_a_server_that_begins_again_goes_on(cell, tmp_path, is_clocked):
    rng = np.random.default_rng(0)
    compared, _, client = cell()
    with client as asked:
        run(asked, rng, 30, cut=0.3, is_clocked=is_clocked)
        answer, live = asked.get("/comparison").json(), compared.standing
        assert asked.get("/health").json()["comparison"] == answer
        decided(asked, x1=0.1, x2=1)
        torn = compared.deal
    trajectories = read_logs(tmp_path / "logs").trajectories
    assert (answer["num"], answer["num_policy"]) == (30, int((trajectories["arm"][:30] == "policy").sum()))
    assert set(trajectories["policy_chance"]) == {0.5}
    again, _, client = cell()
    assert (again.courses.num, again.courses.is_policy[-1]) == (31, torn.is_policys)
    first = again.courses.part(0, 30)
    for name, each in first._asdict().items():
        np.testing.assert_array_equal(each, getattr(compared.courses, name), name)
    with client as asked:
        deals = [again.dealt().is_policys for _ in range(3)]
        assert deals == [np.random.default_rng([3, 31]).random() < again.standing.share] * 3
    assert live == compared.standing == standing(first, compared.terms)


@pytest.mark.slow
def test_probabilities_are_those_of_both_arms_together(cell, tmp_path, flat):
    rng = np.random.default_rng(1)
    _, _, client = cell(epsilon=0.2)
    with client as asked:
        run(asked, rng, 40)
    logs, policy = read_logs(tmp_path / "logs"), read_policy(flat).policy
    for _, rows in logs.stages.groupby("trajectory"):
        # By the chance of all actions so far under either arm.
        joint, before = np.array([0.5, 0.5]), 1.0
        for row in rows.itertuples():
            frame = rows[rows["stage"] == row.stage]
            best = policy.decide(frame, row.stage)[0]
            by_policy = 0.9 if row.action == best else 0.1
            of_rule = "A" if row.stage == 2 or row.x1 > 0 else "B"
            joint = joint * [by_policy, float(row.action == of_rule)]
            assert row.probability == pytest.approx(joint.sum() / before)
            before = joint.sum()


def test_a_better_policy_is_promoted_and_a_sentence_says_so_once(cell, tmp_path):
    rng = np.random.default_rng(2)
    compared, said, client = cell()
    with client as asked:
        run(asked, rng, 40, gain=3.0)
        assert compared.standing.verdict == "promoted"
        answer = asked.get("/comparison").json()
        assert (answer["verdict"], answer["share"]) == ("promoted", 1.0)
        assert 0.0 < answer["low"] < answer["gain"] < answer["high"]
    assert len(said) == 1
    assert said[0].startswith("the policy is promoted after ")
    chances = read_logs(tmp_path / "logs").trajectories["policy_chance"]
    assert set(chances) == {0.5, 1.0}
    assert (np.diff(chances) >= 0).all()
    # What comes after the verdict adds nothing, and is not kept.
    assert compared.courses.num == answer["num"] + 1 < len(chances)
    again, said, _ = cell()
    assert (again.standing, again.courses.num, said) == (compared.standing, compared.courses.num, [])


@pytest.mark.slow
def test_a_worse_policy_is_stopped_within_the_loss_that_was_allowed(cell, tmp_path):
    rng = np.random.default_rng(2)
    compared, said, client = cell(Terms(0.5, most_loss=20.0))
    with client as asked:
        run(asked, rng, 40, gain=-2.0)
        assert compared.standing.verdict == "stopped"
        assert decided(asked, x1=0.1, x2=1)["arm"] == "rule"
    assert said[0].startswith("the policy is stopped after ")
    trajectories = read_logs(tmp_path / "logs").trajectories
    assert (trajectories["arm"] == "policy").sum() * 2.0 <= 20.0
    assert trajectories["policy_chance"].iloc[-1] == 0.0


def test_another_policy_begins_a_comparison_of_its_own(cell, tmp_path):
    compared, _, client = cell()
    with client as asked:
        run(asked, np.random.default_rng(0), 5)
    other = replace(compared.service, digest="another")
    assert compared.of(compared.service) is compared
    assert compared.of(other).courses.num == 0
    # The rule of the comparison is the one that it began with, until it is read again.
    (tmp_path / "rule.csv").write_text("action\nC\n")
    assert compared.rule.action({"x1": 1.0}, 1)[0] == "A"
    of_rule = compared.of(compared.service)
    assert (of_rule.courses.num, of_rule.rule.action({"x1": 1.0}, 1)[0]) == (0, "C")
    (tmp_path / "rule.csv").unlink()
    with pytest.raises(ArgumentError, match=r"rule\.csv: it cannot be read"):
        compared.of(compared.service)
    logs = read_logs(tmp_path / "logs")
    assert courses_of(logs, compared.policy, compared.name).num == 5


def test_a_verdict_that_the_log_already_shows_is_reported_when_a_server_begins(cell, flat, tmp_path, monkeypatch):
    _, said, client = cell()
    with client as asked:
        run(asked, np.random.default_rng(2), 8)
    assert said == []
    monkeypatch.setattr(limits, "serve", lambda _app, _at, begun: begun())
    words = ["--port", "0", "--monitor-every", "0", "--record", tmp_path / "logs", "--against", tmp_path / "rule.csv"]
    for more, found in (([], []), (["--most-loss", "0.01"], ["the policy is stopped after 8 trajectories, 6 by"])):
        result = CliRunner().invoke(serve, [str(word) for word in (flat, *words, *more)], catch_exceptions=False)
        _, *lines = result.stdout.splitlines()
        assert [line[: len(at)] for line, at in zip(lines, found, strict=True)] == found


def test_without_a_comparison_there_is_nothing_to_say(flat):
    with client_of(flat) as asked:
        assert "--against RULE" in refused(asked.get("/comparison"), 409)
        assert "/comparison" not in asked.get("/openapi.json").json()["paths"]


def test_the_command_asks_for_a_log(flat, tmp_path):
    (tmp_path / "rule.csv").write_text(RULE)
    with pytest.raises(ArgumentError, match=r"--against is .*rule\.csv, .*; give --record LOGS"):
        CliRunner().invoke(serve, [str(flat), "--against", str(tmp_path / "rule.csv")], catch_exceptions=False)


@pytest.mark.parametrize("seed", range(4))
def test_a_deal_goes_on_where_the_log_of_a_trajectory_in_progress_ends(cell, tmp_path, seed):
    compared, _, client = cell(seed=seed, epsilon=0.2)
    with client as asked:
        decided(asked, x1=0.1 + seed, x2=1)
        asked.post("/reward", json={"reward": 1.0, "elapsed_s": 1.0})
        decided(asked, x1=-0.3, x2=0)
        events = reduce(torn_by, JournalEvents(tmp_path / "logs" / JOURNAL), [])
        again, _, _ = cell(seed=seed)
        assert again.courses.num == compared.courses.num == 0
        assert again.resumed(events)
        deal, live = again.deal, compared.deal
        assert (deal.is_policys, deal.chance, deal.belief) == (live.is_policys, live.chance, pytest.approx(live.belief))
        assert not replace(again, seed=seed).resumed([{**events[0], "columns": {}}])


@pytest.mark.slow
def test_kills_lose_no_decision_but_the_one_in_progress_and_deal_as_one_server_would(tmp_path, monkeypatch):
    """A server is killed with −9 again and again, and what it said stands."""
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[2] / "benchmarks"), *sys.path])
    from running_cell import killed, learned

    found = killed(tmp_path, learned(tmp_path / "policy"), num_kills=12)
    assert found["torn"] > 3
    assert found["trajectories"] > 12
