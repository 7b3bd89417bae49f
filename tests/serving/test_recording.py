"""What a request lacks is filled in as act does; what it holds is recorded as the policy saw it and the log began."""

from shutil import copytree

import numpy as np
import pandas as pd
import pytest
from asking import acted, client_of, decided, ended, flat_with, refused, rewarded, written
from click.testing import CliRunner
from starlette.testclient import TestClient

from halfseen.cli.serve import serve
from halfseen.errors import PolicyError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.missing import LAST, MEDIAN
from halfseen.policies.folder import read_policy
from halfseen.serving import app, limits
from halfseen.serving.app import app_of
from halfseen.serving.recording import RecordedTrajectories
from holes import holed_log
from text_logs import ACTIONS

RULES = {"x": LAST, "colour": LAST, "is_heavy": MEDIAN}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    log = holed_log(0.3, missing=RULES)
    return written(tmp_path_factory.mktemp("serving") / "policy", log, log.stage_covariates, ACTIONS)


@pytest.mark.parametrize("state", [{}, {"x": None, "colour": "red"}, {"x": 0.5, "colour": None, "is_heavy": 0}])
def test_without_a_history_it_says_what_act_says(state, folder, tmp_path):
    said = acted(folder, tmp_path, **state, stage=2)
    with client_of(folder) as client:
        answer = client.post("/decide", json={**state, "stage": 2}).json()
    assert {name: answer[name] for name in said} == said
    assert answer["filled"] == [name for name in ("x", "colour", "is_heavy") if state.get(name) is None]


def test_within_an_episode_the_last_value_stands_and_is_recorded_as_the_policy_saw_it(folder, tmp_path):
    raw = holed_log(0.3, seed=5, num_trajectories=12)
    names = raw.stage_covariates
    expected = read_policy(folder).policy.filling.of_log(raw.stages)
    with client_of(folder, tmp_path / "logs") as client:
        for _, stages in raw.stages.groupby("trajectory"):
            for row in stages.to_dict("records"):
                state = {name: None if pd.isna(row[name]) else row[name] for name in names}
                state["is_heavy"] = None if state["is_heavy"] is None else int(state["is_heavy"])
                answer = client.post("/decide", json=state).json()
                assert answer["filled"] == [name for name, value in state.items() if value is None]
                rewarded(client)
            client.post("/end", json={"ending": "finished"}).raise_for_status()
    found = read_logs(tmp_path / "logs").stages
    for name in (*names, "is_heavy_missing"):
        np.testing.assert_array_equal(found[name], expected[name])
    again = read_logs(tmp_path / "logs", missing=RULES).filling
    assert again is not None
    assert again.fills["is_heavy"].num_missing == expected["is_heavy_missing"].sum()


def test_what_has_no_rule_is_refused_in_one_line(tmp_path):
    log = holed_log(0.3, missing=RULES)
    plain = type(log)(log.stages, log.trajectories)
    with client_of(written(tmp_path / "policy", plain, ["x", "colour"], ACTIONS)) as client:
        for name in ("x", "colour"):
            line = refused(client.post("/decide", json={"x": 1.0, "colour": "red", name: None}), 422)
            assert f"covariate {name!r} is null" in line
            assert f"leave the state out, or learn the policy with --missing {name}=median+flag" in line
        assert "'x' is missing (given: colour)" in refused(client.post("/decide", json={"colour": "red"}), 422)


def test_a_policy_with_a_flag_records_on_after_one_without_and_the_other_way_round(folder, tmp_path):
    log, plain, serving, logs = holed_log(0.0), tmp_path / "plain", tmp_path / "policy", tmp_path / "logs"
    written(plain, log, ["x", "colour", "is_heavy"], ACTIONS)
    copytree(plain, serving)
    with client_of(serving, logs) as client:
        client.event_hooks = {}  # what may be asked changes
        for policy, seen in ((plain, {"is_heavy": 1}), (folder, {}), (plain, {"is_heavy": 0})):
            copytree(policy, serving, dirs_exist_ok=True)
            client.post("/reload").raise_for_status()
            client.post("/decide", json={"x": 0.5, "colour": "red", **seen}).raise_for_status()
            ended(client)
    assert read_logs(logs).stages["is_heavy_missing"].tolist() == [0, 1, 0]


CUT = {"ending": "cut", "cause": "operator"}


def cut(client):
    client.post("/end", json=CUT)


@pytest.mark.parametrize(
    ("given", "held"), [([0, True, 1.5], [0.0, 1.0, 1.5]), ([True, 0, False], [True, False, False])]
)
def test_truth_values_and_numbers_are_recorded_as_the_log_began(flat, tmp_path, given, held):
    with client_of(flat, tmp_path / "logs") as client:
        for x1 in given:
            decided(client, x1=x1, x2=1)
            cut(client)
    assert read_logs(tmp_path / "logs").stages["x1"].tolist() == held


def test_a_covariate_that_is_new_to_the_log_is_left_out_and_reported(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        assert "warning" not in " ".join(decided(client, x1=0.1, x2=1, batch=7)["warnings"])
        cut(client)
        answer = decided(client, x1=0.1, x2=1, batch=8, colour="red", reward=3)
        cut(client)
        assert answer["warnings"][-2:] == [
            f"'{name}' is not in the log so far, and is not recorded" for name in ("colour", "reward")
        ]
        line = refused(client.post("/decide", json={"x1": 0.1, "x2": 1}), 422)
        assert "covariate batch is missing, though it was given before" in line
        assert client.get("/health").json()["rule"]["decisions"] == 2
    assert read_logs(tmp_path / "logs").stages["batch"].tolist() == [7, 8]


def test_columns_of_objects_that_are_new_to_the_log_are_left_out_and_reported(tables, objects, tmp_path):
    more = [{**row, "hue": 3} for row in objects]
    with client_of(tables, tmp_path / "logs", of_tables=True) as client:
        decided(client, objects=objects)
        cut(client)
        answer = decided(client, objects=more, light=1)
        cut(client)
    words = "is not in the log so far, and is not recorded"
    assert answer["warnings"][-2:] == [f"'light' {words}", f"of objects, 'hue' {words}"]
    logs = read_logs(tmp_path / "logs")
    assert (len(logs.objects), "hue" in logs.objects, "light" in logs.stages) == (2 * len(objects), False, False)


@pytest.mark.parametrize(
    ("state", "trouble"),
    [
        ({"x1": 0.1}, "takes a number as 'x2', but .*logs lacks it; record into another folder"),
        ({"x1": "low", "x2": 1}, "takes a number as 'x1', but .*logs has a text there"),
    ],
)
def test_a_log_that_cannot_hold_the_states_of_a_policy_is_refused_before_anybody_asks(flat, tmp_path, state, trouble):
    with LogRecorder(tmp_path / "logs") as recorder:
        recorder.begin_trajectory().begin_stage(state, action="A", probability=1.0)
    with RecordedTrajectories(tmp_path / "logs") as recorded, pytest.raises(PolicyError, match=trouble):
        recorded.refuse_other_log(read_policy(flat))
    with RecordedTrajectories(tmp_path / "new") as recorded:
        recorded.refuse_other_log(read_policy(flat))


@pytest.mark.parametrize(
    ("stage", "trouble"),
    [
        ({"action": "A"}, "probability is given, unlike in stages before"),
        ({"action": 0, "probability": 1.0}, "action 'A' is a text, but earlier ones are number"),
        ({"action": "A", "probability": 1.0, "robot": 0}, "robot is missing"),
        ({"action": "A", "probability": 1.0, "objects": [{"object": 1}]}, "the policy takes no objects"),
    ],
)
def test_a_log_that_cannot_hold_decisions_is_refused_before_anybody_asks(flat, tmp_path, stage, trouble):
    with LogRecorder(tmp_path / "logs") as recorder:
        recorder.begin_trajectory().begin_stage({"x1": 0.1, "x2": 1}, **stage)
    with RecordedTrajectories(tmp_path / "logs") as recorded, pytest.raises(PolicyError, match=trouble) as refusal:
        recorded.refuse_other_log(read_policy(flat))
    assert "record into another folder" in str(refusal.value)


def test_a_policy_of_other_actions_or_of_tables_is_not_reloaded(flat, tables, tmp_path):
    folder = copytree(flat, tmp_path / "policy")
    with client_of(folder, tmp_path / "logs") as client:
        decided(client, x1=0.1, x2=1)
        cut(client)
        numbered = flat_with(action=lambda rows: rows["action"].map({"A": 0, "B": 1, "C": 2}))
        written(folder, numbered, actions={1: [0, 1], 2: [0, 2]})
        assert "action 0 is a number, but earlier ones are text" in refused(client.post("/reload"), 422)
        copytree(tables, folder, dirs_exist_ok=True)
        assert "the policy takes objects, unlike" in refused(client.post("/reload"), 422)
        decided(client, x1=0.1, x2=1)


def test_a_number_that_comes_as_a_truth_value_at_first_shuts_out_no_others(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        for x1 in (True, 0.5):
            decided(client, x1=x1, x2=1)
            cut(client)
    assert read_logs(tmp_path / "logs").stages["x1"].tolist() == [1.0, 0.5]


def test_a_policy_of_other_covariates_is_not_reloaded(flat, tmp_path):
    folder = copytree(flat, tmp_path / "policy")
    with client_of(folder, tmp_path / "logs") as client:
        before = decided(client, x1=0.1, x2=1)["policy"]
        cut(client)
        written(folder, flat_with(x3=lambda rows: rows["x1"]), ["x1", "x3"])
        assert "takes a number as 'x3'" in refused(client.post("/reload"), 422)
        assert decided(client, x1=0.1, x2=1)["policy"] == before
        cut(client)
        written(folder, reg=5.0)
        assert client.post("/reload").json()["policy"] != before


def test_a_trajectory_in_progress_is_finished_by_the_policy_that_began_it(flat, tmp_path):
    folder = copytree(flat, tmp_path / "policy")
    with client_of(folder, tmp_path / "logs") as client:
        before = decided(client, x1=0.1, x2=1)["policy"]
        written(folder, reg=5.0)
        fresh = client.post("/reload").json()["policy"]
        client.post("/reward", json={"reward": 1.0, "elapsed_s": 1.0})
        assert decided(client, x1=0.2, x2=1)["policy"] == before == client.get("/health").json()["policy"]
        cut(client)
        assert client.get("/health").json()["policy"] == fresh != before
        assert decided(client, x1=0.1, x2=1)["policy"] == fresh
        cut(client)
    assert read_logs(tmp_path / "logs").trajectories["policy_digest"].tolist() == [before, fresh]


def test_a_full_disk_is_reported_with_a_status_of_its_own_until_there_is_room(flat, tmp_path, monkeypatch):
    def status_of(client):
        return client.get("/health").json()["status"]

    def full(*_):
        raise OSError(28, "No space left on device")

    with client_of(flat, tmp_path / "logs") as client:
        decided(client, x1=0.1, x2=1)
        with monkeypatch.context() as disk:
            disk.setattr("halfseen.logs.journal_writer._write", full)
            for address, given in (("/reward", {"reward": 1.0, "elapsed_s": 1.0}), ("/end", CUT)):
                answer = client.post(address, json=given)
                assert answer.status_code == 507
                assert "make room and give it again" in answer.json()["error"]
                assert status_of(client) == "not recording"
        client.post("/reward", json={"reward": 1.0, "elapsed_s": 1.0}).raise_for_status()
        assert status_of(client) == "ok"
        with monkeypatch.context() as disk:
            disk.setattr("halfseen.logs.journal_writer._write", full)
            assert client.post("/decide", json={"x1": 0.1, "x2": 1}).status_code == 507
        assert decided(client, x1=0.1, x2=1)["stage"] == 2
        cut(client)
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["reward"].tolist()[:1] == [1.0]
    assert logs.trajectories["ending"].tolist() == ["cut"]


def test_a_server_that_begins_again_does_not_draw_the_same_again(flat, tmp_path, monkeypatch):
    result = []

    def asked(served, *_, **__):
        result.append(served.answering.rng.bit_generator.state["state"]["state"])
        with TestClient(app_of(served), base_url="http://127.0.0.1") as client:
            decided(client, x1=0.1, x2=1)

    monkeypatch.setattr(app, "app_of", asked)
    monkeypatch.setattr(limits, "serve", lambda *_: None)
    words = [str(flat), "--port", "0", "--monitor-every", "0", "--record", str(tmp_path / "logs"), "--explore", "0.9"]
    for _ in range(12):
        CliRunner().invoke(serve, words, catch_exceptions=False)
    assert len(set(result)) == 12
    assert set(read_logs(tmp_path / "logs").stages["probability"].round(6)) == {0.45, 0.55}
    # Nor is the first draw the one by which the first trajectory is dealt.
    assert result[0] != np.random.default_rng([0, 0]).bit_generator.state["state"]["state"]
