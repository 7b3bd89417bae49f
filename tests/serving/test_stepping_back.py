"""Never without a decision: where the policy does not decide, the rule does, and answer, log and /health say so."""

import json
import re
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from asking import client_of, decided, flat_with, refused, rewarded, written
from click.testing import CliRunner

from halfseen.cli.evaluate import evaluate
from halfseen.cli.serve import serve
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs, read_logs
from halfseen.policies.folder import read_policy
from halfseen.policies.folder.log_facts import actions_taken
from halfseen.policies.rule_files import fall_back_of, usual_actions
from halfseen.serving.in_service import MOST_UNANSWERED
from halfseen.serving.served import Served
from small_logs import flat_log

WITHIN = {"x1": 0.0, "x2": 1}


@pytest.fixture(scope="module")
def logs():
    return flat_log()


def coloured():
    return flat_with(colour=lambda rows: np.where(rows["x1"] > 0, "red", "blue"))


def usual(logs, stage):
    """By a loop: the action that the log took most often in a stage."""
    counts = {}
    for of, action in zip(logs.stages["stage"], logs.stages["action"], strict=True):
        if of == stage and action is not None:
            counts[action] = counts.get(action, 0) + 1
    return max(counts, key=lambda name: (counts[name], name))


def test_far_outside_and_beyond_the_horizon_the_usual_action_of_the_log_is_taken(flat, logs):
    with client_of(flat, epsilon=0.5) as client:
        far, later = decided(client, **{**WITHIN, "x1": 800}), decided(client, **WITHIN, stage=7)
        assert (far["action"], far["stepped_back"]) == (usual(logs, 1), "out-of-range")
        assert far["reason"].startswith(f"{far['action']}: the usual action of its log in this stage, in the policy's")
        assert "x1 is 800, outside the logs (" in far["reason"]
        assert (later["action"], later["stepped_back"]) == (usual(logs, 2), "beyond-horizon")
        for one in (far, later):
            assert (one["probability"], one["is_explored"], one["q_values"]) == (1.0, False, {})
        assert "stepped_back" not in decided(client, **WITHIN)
        answer = client.get("/health").json()["rule"]
    counts = {"decisions": 3, "stepped_back": 2, "by": {"out-of-range": 1, "beyond-horizon": 1}}
    assert answer == {**counts, "last": "stage 7 is beyond the policy's horizon, 2"}


@pytest.mark.parametrize(("stays_within", "why"), [(True, "out-of-range"), (False, None)])
def test_a_hair_outside_the_rule_decides_where_that_is_wanted_and_the_ends_are_within(flat, stays_within, why):
    stored = read_policy(flat)
    (low, high), (below, above) = stored.ranges(1)["x1"], stored.margins(1)["x1"]
    low, high = low - below, high + above
    with client_of(flat, served={"stays_within": stays_within}) as client:
        for end, way in ((low, -np.inf), (high, np.inf)):
            assert "stepped_back" not in decided(client, **{**WITHIN, "x1": end})
            beyond = float(np.nextafter(end, way))
            answer = decided(client, **{**WITHIN, "x1": beyond})
            assert answer.get("stepped_back") == why
            # As many digits as tell the two apart.
            ((value, least, most),) = re.findall(
                r"x1 is (\S+), [^(]*outside the logs[^(]* \((\S+) to (\S+)\)", json.dumps(answer)
            )
            assert not float(least) <= float(value) <= float(most)


def test_the_ends_of_what_was_logged_in_single_precision_are_within_however_they_are_written(tmp_path):
    rng, single = np.random.default_rng(0), np.array([0.1, 0.2, 0.3], dtype=np.float32)
    policy = written(tmp_path / "policy", flat_with(x1=lambda rows: rng.choice(single, len(rows))))
    with client_of(policy, served={"stays_within": True}) as client:
        for value in (0.1, 0.3, *map(float, np.float32([0.1, 0.3]))):
            assert "stepped_back" not in decided(client, x1=value, x2=1)
        for value in (0.0999999, 0.3000001):
            assert decided(client, x1=value, x2=1)["stepped_back"] == "out-of-range"


def test_a_rule_file_decides_and_where_it_cannot_the_usual_action_does(flat, tmp_path, logs):
    rule = tmp_path / "rule.csv"
    rule.write_text("x2,seen_by,action\n> 1,= left,C\n,,A\n")
    with client_of(flat, served={"rule": rule}) as client:
        answer = [decided(client, x1=800, x2=x2, seen_by="left")["action"] for x2 in (0, 2)]
        lacking = decided(client, x1=800, x2=2)
    assert answer == ["A", "C"]
    assert lacking["action"] == usual(logs, 1)
    assert "as the rule rule.csv fails: the rule asks for seen_by = left, but seen_by is None" in lacking["reason"]
    rule.write_text("action\nD\n")
    with pytest.raises(ValueError, match=r"rule\.csv: unknown action D; give one of A, B, C"):
        Served(flat, rule=rule)
    # Otherwise that row would fail in each state, and the usual action be taken.
    rule.write_text("x1,action\nhigh,B\n,A\n")
    with pytest.raises(ValueError, match=r"rule\.csv: row 1: x1 is 'high'; give numbers"):
        Served(flat, rule=rule)


def test_a_rule_that_asks_for_what_the_policy_does_not_is_reported_of(flat, tmp_path):
    (tmp_path / "rule.csv").write_text("x_1,action\n> 1,B\n,A\n")
    # It is reported before the address is found not to be of this machine.
    words = [str(flat), "--fall-back", str(tmp_path / "rule.csv"), "--host", "192.0.2.1", "--token", "a" * 16]
    result = CliRunner().invoke(serve, words)
    assert "rule.csv: the rule asks for x_1, which the policy does not use; if a request lacks it" in result.output
    assert "did you mean 'x1'?" in result.output
    assert isinstance(result.exception, ArgumentError)
    policy = written(tmp_path / "policy", coloured(), ["x1", "colour"])
    (tmp_path / "rule.csv").write_text("colour,action\nred or blue,B\n!= Red,C\nblue,A\n,A\n")
    result = CliRunner().invoke(serve, [str(policy), *words[1:]]).output
    assert "rule.csv: a row asks for colour = red or blue, which no log showed" in result
    assert "rule.csv: a row asks for colour != Red, which no log showed; did you mean 'red'?" in result
    assert result.count("asks for") == 2


@pytest.mark.parametrize("failing", ["raises", "is no number"])
def test_a_policy_that_fails_is_replaced_by_the_rule(flat, monkeypatch, capsys, failing):
    with client_of(flat) as client:
        kind = type(read_policy(flat).policy)
        known = kind.valued

        def broken(self, encoded, stage):
            if failing == "raises":
                raise ZeroDivisionError("by zero")
            found = known(self, encoded, stage)
            return found._replace(scores=np.full_like(found.scores, np.nan))

        monkeypatch.setattr(kind, "valued", broken)
        answer = decided(client, **WITHIN)
        assert answer["stepped_back"] == "failed"
        assert client.get("/health").json()["rule"]["by"] == {"failed": 1}
    assert ("ZeroDivisionError" in capsys.readouterr().err) == (failing == "raises")


def test_a_decision_that_comes_too_late_is_dropped_for_the_rules(flat, monkeypatch):
    with client_of(flat, served={"limit_s": 0.05}) as client:
        kind = type(read_policy(flat).policy)
        known = kind.valued

        def slow(self, encoded, stage):
            time.sleep(0.5)
            return known(self, encoded, stage)

        monkeypatch.setattr(kind, "valued", slow)
        answer = decided(client, **WITHIN)
        assert (answer["stepped_back"], answer["probability"]) == ("late", 1.0)
        assert "did not answer within 0.05 s" in answer["reason"]


def test_a_policy_that_hangs_is_asked_no_more_until_it_answers_or_another_is_read(flat, monkeypatch):
    answers, asked = threading.Event(), []

    def hanging(self, encoded, stage):
        asked.append(threading.current_thread())
        answers.wait()

    with client_of(flat, served={"limit_s": 0.01}) as client:
        with monkeypatch.context() as patched:
            patched.setattr(type(read_policy(flat).policy), "valued", hanging)
            answer = [decided(client, **WITHIN) for _ in range(MOST_UNANSWERED + 5)]
        assert {one["stepped_back"] for one in answer} == {"late"}
        assert "has not yet answered 8 earlier questions" in answer[-1]["reason"]
        assert all(thread.daemon for thread in asked)
        client.post("/reload").raise_for_status()
        assert "earlier questions" not in decided(client, **WITHIN)["reason"]
    answers.set()


def test_a_new_category_is_outside_the_logs(tmp_path):
    logs = coloured()
    with client_of(written(tmp_path / "policy", logs, ["x1", "colour"])) as client:
        answer = decided(client, x1=0.1, colour="mauve")
        assert (answer["action"], answer["stepped_back"]) == (usual(logs, 1), "out-of-range")
        assert "colour is 'mauve', which does not occur in the logs." in answer["reason"]
        answer = decided(client, x1=0.1, colour="Red")
        assert "colour is 'Red', which does not occur in the logs; they have 'red'." in answer["reason"]
        assert "'x1'" in refused(client.post("/decide", json={"colour": "mauve"}), 422)


def test_a_category_that_comes_as_a_number_is_text_in_the_log(tmp_path):
    logs = flat_with(part=lambda rows: np.where(rows["x1"] > 0, "4711", "12a"))
    with client_of(written(tmp_path / "policy", logs, ["x1", "part"]), tmp_path / "logs") as client:
        client.event_hooks = {}  # it is taken, but not described
        for part in (4711, "12a", "4711", "new"):
            decided(client, x1=0.1, part=part)
            rewarded(client)
    assert read_logs(tmp_path / "logs").stages["part"].tolist() == ["4711", "12a", "4711", "new"]


def test_the_log_says_where_the_rule_decided_and_is_learned_from(flat, tmp_path):
    with client_of(flat, tmp_path / "logs", epsilon=0.3, served={"stays_within": True}) as client:
        rng = np.random.default_rng(0)
        for _ in range(40):
            for _ in range(3):
                decided(client, x1=float(3.0 * rng.normal()), x2=int(rng.integers(3)))
                client.post("/reward", json={"reward": float(rng.normal())})
            client.post("/end", json={"ending": "finished"})
        answer = client.get("/health").json()["rule"]
    logs = read_logs(tmp_path / "logs")
    stages = logs.stages
    counts = stages["stepped_back"].value_counts().to_dict()
    assert counts == answer["by"]
    assert counts["beyond-horizon"] == 40
    assert (stages.loc[stages["stepped_back"].notna(), "probability"] == 1.0).all()
    assert (stages.loc[stages["stepped_back"].isna(), "probability"] < 1.0).all()
    assert logs.stage_covariates == ["x1", "x2"]
    logs.write(tmp_path / "written")
    assert read_logs(tmp_path / "written").stages["stepped_back"].value_counts().to_dict() == counts
    CensoredQLearner(logs.horizon, ["A", "B", "C"], ["x1", "x2"], reg=0.1).fit(logs)


@pytest.mark.slow
def test_what_was_served_is_evaluated_with_the_rules_decisions(flat, tmp_path):
    (tmp_path / "rule.csv").write_text("stage,action\n1,B\n,C\n")
    rng, served = np.random.default_rng(1), {"rule": tmp_path / "rule.csv", "stays_within": True}
    with client_of(flat, tmp_path / "logs", served=served) as client:
        for trajectory in range(60):
            # Some go on beyond the horizon.
            for stage in range(1, 3 + trajectory % 2):
                is_far = rng.random() < 0.3
                answer = decided(client, x1=float(rng.uniform(-1.0, 1.0)) + 9.0 * is_far, x2=int(rng.integers(3)))
                assert ("stepped_back" in answer) == (is_far or stage == 3)
                client.post("/reward", json={"reward": float(rng.random()) + is_far * (answer["action"] != "A")})
            client.post("/end", json={"ending": "finished"})
    stages = read_logs(tmp_path / "logs").stages
    answer = CliRunner().invoke(
        evaluate, [str(flat), "--logs", str(tmp_path / "logs"), "--json"], catch_exceptions=False
    )
    report = json.loads(answer.stdout)
    # The policy and its rule made this log, so what they earned is what they are worth.
    value = report["doubly_robust"]["value"]
    assert value == pytest.approx(stages["reward"].sum() / 60)
    num = int(stages["stepped_back"].notna().sum())
    assert report["notes"][0].startswith(f"in {num} stages the state lies outside the policy's logs")


def test_a_folder_of_before_refuses_what_it_did(flat, monkeypatch):
    stored = read_policy(flat)
    record = {name: each for name, each in stored.record.items() if name != "actions_taken"}
    assert fall_back_of(replace(stored, record=record)) is None
    monkeypatch.setattr("halfseen.serving.in_service.fall_back_of", lambda *_: None)
    with client_of(flat) as client:
        line = refused(client.post("/decide", json={**WITHIN, "x1": 800}), 422)
    assert line.startswith("x1 is 800, outside the logs (")
    assert line.endswith("learn it again, or serve it with --fall-back RULE")


def test_of_tables_the_trajectory_ends(tables, objects):
    with client_of(tables, of_tables=True) as client:
        answer = decided(client, objects=objects, stage=9)
    wanted = {"action": "FINISH", "verb": "FINISH", "object": None, "stepped_back": "beyond-horizon"}
    assert {name: answer[name] for name in wanted} == wanted


def test_a_policy_keeps_how_often_its_log_took_each_action_in_each_stage_also_of_a_log_in_parts(flat, logs):
    kept = read_policy(flat).record["actions_taken"]
    naive = [{}, {}]
    for stage, action in zip(logs.stages["stage"], logs.stages["action"], strict=True):
        naive[stage - 1][action] = naive[stage - 1].get(action, 0) + 1
    assert kept == naive
    ids = logs.trajectories["trajectory"]
    halves = [
        Logs(logs.stages[logs.stages["trajectory"].isin(part)], logs.trajectories[ids.isin(part)])
        for part in (ids[:30], ids[30:])
    ]
    added = [one + other for one, other in zip(*map(actions_taken, halves), strict=True)]
    assert [dict(each) for each in added] == naive
    assert list(usual_actions(read_policy(flat))) == [usual(logs, 1), usual(logs, 2)]
