"""A request is fitted to the log that it continues; a log that cannot hold a policy's states is refused at once."""

import shutil

import pytest
from asking import client_of, decided, flat_with, refused, written

from halfseen.errors import PolicyError
from halfseen.logs import LogRecorder, read_logs
from halfseen.policies import read_policy
from halfseen.serving.recording import RecordedTrajectories


def cut(client):
    client.post("/end", json={"ending": "cut", "cause": "operator"})


@pytest.mark.parametrize(
    ("given", "held"), [([0, True, 1.5], [0.0, 1.0, 1.5]), ([True, 0, False], [True, False, False])]
)
def test_truth_values_and_numbers_are_recorded_as_the_log_began(flat, tmp_path, given, held):
    with client_of(flat, tmp_path / "logs") as client:
        for x1 in given:
            decided(client, x1=x1, x2=1)
            cut(client)
    assert read_logs(tmp_path / "logs").stages["x1"].tolist() == held


def test_a_covariate_that_is_new_to_the_log_is_left_out_and_told(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        assert "warning" not in " ".join(decided(client, x1=0.1, x2=1, batch=7)["warnings"])
        cut(client)
        told = decided(client, x1=0.1, x2=1, batch=8, colour="red", reward=3)
        cut(client)
        assert told["warnings"][-2:] == [
            f"'{name}' is not in the log so far, and is not recorded" for name in ("colour", "reward")
        ]
        line = refused(client.post("/decide", json={"x1": 0.1, "x2": 1}), 422)
        assert "covariate batch is missing, though it was given before" in line
        assert client.get("/health").json()["rule"]["decisions"] == 2
    assert read_logs(tmp_path / "logs").stages["batch"].tolist() == [7, 8]


def test_columns_of_objects_that_are_new_to_the_log_are_left_out_and_told(tables, objects, tmp_path):
    more = [{**row, "hue": 3} for row in objects]
    with client_of(tables, tmp_path / "logs", of_tables=True) as client:
        decided(client, objects=objects)
        cut(client)
        told = decided(client, objects=more, light=1)
        cut(client)
    words = "is not in the log so far, and is not recorded"
    assert told["warnings"][-2:] == [f"'light' {words}", f"of objects, 'hue' {words}"]
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
        recorded.refuse_other_columns(read_policy(flat).policy)
    with RecordedTrajectories(tmp_path / "new") as recorded:
        recorded.refuse_other_columns(read_policy(flat).policy)


def test_a_policy_of_other_covariates_is_not_reloaded(flat, tmp_path):
    folder = shutil.copytree(flat, tmp_path / "policy")
    with client_of(folder, tmp_path / "logs") as client:
        before = decided(client, x1=0.1, x2=1)["policy"]
        cut(client)
        written(folder, flat_with(x3=lambda rows: rows["x1"]), ["x1", "x3"])
        assert "takes a number as 'x3'" in refused(client.post("/reload"), 422)
        assert decided(client, x1=0.1, x2=1)["policy"] == before
        cut(client)
        written(folder, reg=5.0)
        assert client.post("/reload").json()["policy"] != before
