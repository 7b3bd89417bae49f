"""A policy over HTTP: it says what `halfseen act` says, records what it decided, and survives anyone who asks."""

import asyncio
import json
from collections import Counter

import httpx2
import numpy as np
import pytest
from asking import OF_ACT, acted, client_of, ended, flat_with, refused, resolved, written
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from halfseen.cli.act import act
from halfseen.logs import read_logs
from halfseen.policies.exploration import read_exploration
from halfseen.scene import table_paths
from halfseen.serving.app import app_of
from halfseen.serving.limits import Bounded
from halfseen.serving.served import Served

SEEN = {"x1": 0.4, "x2": 1, "colour": "red"}
NOT_OF_ACT = {"probability", "is_explored"}


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    return written(tmp_path_factory.mktemp("serving") / "flat", pessimism=1.0)


@pytest.fixture
def asked(flat):
    with client_of(flat) as client:
        yield client


def test_it_says_what_act_says(asked, flat, tmp_path):
    rng = np.random.default_rng(0)
    for stage in (1, 2, 1, 2):
        state = {"x1": float(rng.normal()), "x2": int(rng.integers(3)), "stage": stage}
        answer = asked.post("/decide", json=state).json()
        said = acted(flat, tmp_path, **state)
        assert said["intervals"]
        assert {name: answer[name] for name in said} == said
        assert set(answer) - set(said) == {*NOT_OF_ACT, "policy"}
        assert (answer["probability"], answer["is_explored"]) == (1.0, False)


@pytest.mark.parametrize(
    ("body", "status", "says"),
    [
        (b"{", 400, "not valid JSON"),
        (b"[" * 100_000, 400, "not valid JSON"),
        (b'{"x1": NaN, "x2": 1}', 400, "NaN is not a JSON number"),
        (b'{"x1": 0, "x2": 1, "x1": 2}', 400, "'x1' is given twice"),
        (b"\xff", 400, "not valid JSON"),
        (b"[1]", 422, "JSON list; send one object"),
        (b"{}", 422, "'x1' is missing (given: nothing)"),
        (b'{"x1": 1, "X2": 1}', 422, "'x2' is missing (given: x1, X2)"),
        (b'{"x1": null, "x2": 1}', 422, "covariate 'x1'"),
        (b'{"x1": "red", "x2": 1}', 422, "'x1' is not numeric"),
        (b'{"x1": [1], "x2": {"a": 2}}', 422, "'x1' is not numeric"),
        (b'{"x1": 1e999, "x2": 1}', 400, "1e999 is not a JSON number"),
        # Of a log that held it, nothing could be learned.
        (
            b'{"x1": 1.7976931348623157e308, "x2": 1}',
            422,
            "'x1' is 1.7976931348623157e+308; give a finite",
        ),
        (b'{"x1": 1' + b"0" * 400 + b', "x2": 1}', 400, "is not a 64-bit whole number"),
        (b'{"x1": 0, "x2": 1, "stage": 0}', 422, "stage is 0; give a whole number from 1"),
        (b'{"x1": 0, "x2": 1, "stage": 10001}', 422, "stage is 10001; give a whole number from 1 to 10,000"),
        (b'{"x1": 0, "x2": 1, "stage": true}', 422, "stage is True"),
        (b'{"x1": 0, "x2": 1, "stage": "1"}', 422, "stage is '1'; give a whole number"),
        (b'{"x1": 0, "x2": 1, " Stage": 2}', 422, "it says ' Stage', which is not read; write it as 'stage'"),
        (b'{"x1": 0, "x2": 1, "stage": null}', 422, "stage is None"),
    ],
)
def test_a_bad_request_gets_one_line_and_harms_no_other(asked, body, status, says):
    before = asked.post("/decide", json=SEEN).json()
    answer = asked.post("/decide", content=body, headers={"content-type": "application/json"})
    assert says in refused(answer, status)
    assert asked.post("/decide", json=SEEN).json() == before


def test_a_method_that_is_not_answered_is_reported_with_those_that_are(asked):
    assert asked.get("/decide").headers["allow"] == "POST"
    assert "does not exist" in refused(asked.post("/decide/", json=SEEN, follow_redirects=False), 404)


def test_other_addresses_and_forms_are_refused(asked):
    text = {"content": b"{}", "headers": {"content-type": "text/plain"}}
    packed = {"content": b"\x1f\x8b", "headers": {"content-type": "application/json", "content-encoding": "gzip"}}
    for answer, status, result in (
        (asked.get("/decisions"), 404, "this address does not exist"),
        (asked.get("/decide"), 405, "GET is not answered"),
        (asked.post("/decide", **text), 415, "content-type is 'text/plain'"),
        (asked.post("/decide", **packed), 415, "content-encoding is 'gzip'; send it unpacked"),
        (asked.post("/decide", files={"cloud": ("t.pcd", b"no")}), 415, "not at clouds"),
        (asked.post("/reward", json={"reward": 1}), 409, "records nothing"),
        # A page of another site.
        *(
            (asked.get("/health", headers={"host": name}), 403, "this server answers only as 127.0.0.1")
            for name in ("evil.example", "127.0.0.1.evil.example", "evil.example:8080", "")
        ),
    ):
        assert result in refused(answer, status)
    for name in ("localhost:8080", "127.0.0.1", "[::1]:8080", "[::1]"):
        assert asked.get("/health", headers={"host": name}).json()["status"] == "ok"


def test_with_a_token_only_who_has_it_is_answered_and_what_is_too_large_is_refused(flat):
    with client_of(flat, token="secret-of-16-let", largest_bytes=100) as client:
        for given in ({}, {"authorization": "Bearer other"}, {"authorization": "secret-of-16-let"}):
            assert "Authorization: Bearer" in refused(client.get("/health", headers=given), 401)
        client.headers |= {"authorization": "Bearer secret-of-16-let", "host": "cell-3"}
        assert client.get("/health").json()["kind"] == "flat"
        # A browser brings it as a password, for what changes nothing.
        for password, status in (("secret-of-16-let", 200), ("other", 401), ("", 401)):
            assert client.get("/", auth=("anyone", password)).status_code == status
        refused(client.post("/reload", auth=("anyone", "secret-of-16-let")), 401)
        refused(client.get("/", headers={"authorization": "Basic secret!"}), 401)
        # Whether it says how large it is or not.
        for large in (b" " * 101, (b" " * 60 for _ in range(2))):
            answer = client.post("/decide", content=large, headers={"content-type": "application/json"})
            assert "more than 100 bytes" in refused(answer, 413)
        assert client.post("/decide", json=SEEN).status_code == 200


@pytest.mark.slow
def test_what_is_decided_becomes_a_log_with_probabilities(flat, tmp_path):
    folder, rewards, taken = tmp_path / "logs", [], []
    with client_of(flat, folder, epsilon=0.4) as client:
        rng = np.random.default_rng(3)
        for trajectory in range(24):
            for stage in (1, 2):
                state = {"x1": float(rng.normal()), "x2": int(rng.integers(3)), "seen_by": "left", "objects": 3}
                answer = client.post("/decide", json=state).json()
                assert (answer["trajectory"], answer["stage"]) == (trajectory + 1, stage)
                taken.append((answer["action"], answer["probability"]))
                assert "has no reward yet" in refused(client.post("/decide", json=state), 409)
                assert "has no reward yet" in refused(client.post("/end", json={"ending": "finished"}), 409)
                rewards.append(float(rng.normal()))
                assert client.post("/reward", json={"reward": rewards[-1]}).json()["waits_for"] == "decision"
                assert "no stage waits" in refused(client.post("/reward", json={"reward": 1.0}), 409)
            cause = {"ending": "cut", "cause": "operator"} if trajectory % 4 == 0 else {"ending": "finished"}
            assert client.post("/end", json=cause).json()["stages"] == 2
    logs = read_logs(folder)
    # What the last stage of a trajectory that was cut between two stages led to was not seen.
    is_seen = (np.arange(24) % 4 > 0)[:, None] | [True, False]
    np.testing.assert_array_equal(logs.stages["reward"], np.where(is_seen.ravel(), rewards, np.nan))
    assert list(zip(logs.stages["action"], logs.stages["probability"], strict=True)) == taken
    assert set(logs.stages["seen_by"]) == {"left"}
    # Only a table has objects of its own.
    assert set(logs.stages["objects"]) == {3}
    assert (logs.num_trajectories, int(logs.is_finished.sum())) == (24, 18)
    assert set(logs.stages["probability"].round(9)) == {0.8, 0.2}
    assert 2 <= sum(p < 0.5 for _, p in taken) <= 20
    written(tmp_path / "next", logs)


def test_a_trajectory_in_progress_is_reported_and_cut_when_the_server_stops(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        assert client.get("/health").json()["recording"] == {"trajectory": None, "stage": 0, "waits_for": "decision"}
        answer = client.post("/decide", json=SEEN).json()
        where = {"trajectory": 1, "stage": 1, "waits_for": "reward", "action": answer["action"]}
        assert client.get("/health").json()["recording"] == where
        client.post("/reward", json={"reward": 1.0, "elapsed_s": 2.0})
        assert "leave it out" in refused(client.post("/decide", json=SEEN | {"stage": 1}), 409)
        assert "is before" in refused(client.post("/end", json={"ending": "finished", "elapsed_s": 1.0}), 422)
    with client_of(flat, tmp_path / "logs") as client:
        answer = refused(client.post("/decide", json=SEEN | {"stage": 2}), 409)
        assert answer == "stage is 2, but no trajectory is in progress, as a server that stops cuts it; begin a new one"
    assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == ["server stopped"]


def test_who_names_another_trajectory_than_that_in_progress_is_refused(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        begun = "trajectory is 1, but none is in progress; leave it out to begin one"
        assert begun in refused(client.post("/decide", json=SEEN | {"trajectory": 1}), 409)
        for number in (1, 2):
            client.post("/decide", json=SEEN).raise_for_status()
            client.post("/reward", json={"reward": 1.0, "trajectory": number}).raise_for_status()
            client.post("/decide", json=SEEN | {"trajectory": number}).raise_for_status()
            for path, asked in (("reward", {"reward": 1.0}), ("end", {"ending": "finished"}), ("decide", SEEN)):
                line = refused(client.post(f"/{path}", json=asked | {"trajectory": 3 - number}), 409)
                assert f"trajectory is {3 - number}, but {number} is in progress" in line
            client.post("/reward", json={"reward": 1.0}).raise_for_status()
            client.post("/end", json={"ending": "finished", "trajectory": number}).raise_for_status()
    assert read_logs(tmp_path / "logs").stages["trajectory"].tolist() == [1, 1, 2, 2]


def test_an_end_says_which(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        client.post("/decide", json=SEEN)
        unclear = ({}, {"ending": "done"}, {"ending": "cut"}, {"ending": "finished", "cause": "x"})
        # A trajectory that goes on is not counted.
        for end in (*unclear, {"ending": "cut", "why": 1}, {"ending": "cut", "cause": "still-running"}):
            refused(client.post("/end", json=end), 422)
            assert client.get("/health").json()["recording"]["trajectory"] == 1


def test_what_cannot_be_recorded_is_not_decided(flat, tmp_path):
    with client_of(flat, tmp_path / "logs") as client:
        assert "could not be recorded" in refused(client.post("/decide", json=SEEN | {"reward": 1.0}), 422)
        assert client.get("/health").json()["recording"]["trajectory"] is None
        assert client.post("/decide", json=SEEN).json()["trajectory"] == 1
        assert "reward" in refused(client.post("/reward", json={"reward": "much"}), 422)
        client.post("/reward", json={"reward": 1})
        assert "could not be recorded" in refused(client.post("/decide", json={"x1": 0.4, "x2": 1}), 422)
        client.post("/decide", json=SEEN)
    assert len(read_logs(tmp_path / "logs").stages) == 2


@pytest.mark.slow
def test_a_draw_is_as_likely_as_it_says(flat):
    with client_of(flat, epsilon=0.5) as client:
        answer = [client.post("/decide", json=SEEN).json() for _ in range(160)]
    by_action = Counter((one["action"], round(one["probability"], 9), one["is_explored"]) for one in answer)
    assert {key[1:] for key in by_action} == {(0.75, False), (0.25, True)}
    explored = [one for one in answer if one["is_explored"]]
    assert len(explored) == pytest.approx(40, abs=4 * np.sqrt(160 * 0.25 * 0.75))
    assert "drawn to explore" in explored[0]["reason"]


def test_actions_that_are_numbers_stay_numbers_where_they_are_drawn(tmp_path):
    logs, taken = flat_with(action=lambda rows: rows["action"].map({"A": 1, "B": 2, "C": 3})), []
    policy = written(tmp_path / "policy", logs, actions={1: [1, 2], 2: [1, 3]})
    with client_of(policy, tmp_path / "logs", epsilon=0.9) as client:
        for _ in range(12):
            taken.append(client.post("/decide", json=SEEN).json()["action"])
            ended(client)
    assert set(taken) == {1, 2}
    assert read_logs(tmp_path / "logs").stages["action"].tolist() == taken


def test_a_table_says_what_is_tried_where_and_the_log_holds_its_probability(flat, tmp_path):
    file = tmp_path / "try.csv"
    file.write_text("x1,action,probability\n> 0,A,0.3\n> 0,B,0.3\n")
    table = read_exploration(file, ("A", "B", "C"), ("x1", "x2"))
    with client_of(flat, table=table) as client:
        answer = [client.post("/decide", json={"x1": 0.4, "x2": 1.0}).json() for _ in range(120)]
        still = [client.post("/decide", json={"x1": -0.4, "x2": 1.0}).json() for _ in range(5)]
    found = {one["action"]: (round(one["probability"], 9), one["is_explored"]) for one in answer}
    assert sorted(found.values()) == [(0.3, True), (0.7, False)]
    assert sum(one["is_explored"] for one in answer) == pytest.approx(36, abs=4 * np.sqrt(120 * 0.21))
    assert {(one["probability"], one["is_explored"]) for one in still} == {(1.0, False)}


def test_a_reload_changes_the_policy_and_a_bad_one_changes_nothing(flat, tmp_path):
    folder = written(tmp_path / "policy")
    with client_of(folder) as client:
        before = client.post("/decide", json=SEEN).json()
        written(folder, reg=5.0)
        assert client.post("/decide", json=SEEN).json() == before
        digest = client.post("/reload").json()["policy"]
        after = client.post("/decide", json=SEEN).json()
        assert after["policy"] == digest != before["policy"]
        assert after["q_values"] != before["q_values"]
        (folder / "policy.json").write_bytes(b"{}")
        assert "policy.json" in refused(client.post("/reload"), 422)
        assert client.post("/decide", json=SEEN).json() == after


def test_no_request_is_lost_while_policies_are_reloaded(flat):
    async def ask():
        app = app_of(Served(flat))
        transport = httpx2.ASGITransport(app)
        async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
            decisions = [client.post("/decide", json=SEEN) for _ in range(40)]
            reloads = [client.post("/reload") for _ in range(5)]
            return await asyncio.gather(*decisions[:20], *reloads, *decisions[20:])

    assert {answer.status_code for answer in asyncio.run(ask())} == {200}


def references(schema):
    """Every reference within a description."""
    if isinstance(schema, list):
        return [found for each in schema for found in references(each)]
    if not isinstance(schema, dict):
        return []
    return [schema["$ref"]] if "$ref" in schema else [found for each in schema.values() for found in references(each)]


def test_the_description_tells_what_can_be_asked(asked):
    api = asked.get("/openapi.json").json()
    content = api["paths"]["/decide"]["post"]["requestBody"]["content"]["application/json"]
    taken = resolved(api, content)
    assert set(taken["required"]) == {"x1", "x2"}
    assert "maximum" not in taken["properties"]["stage"]
    assert api["components"]["schemas"]["DecisionAnswer"]["properties"]["action"]["enum"] == ["A", "B", "C"]
    (example,) = taken["examples"]
    assert asked.post("/decide", json=example).status_code == 200
    assert list(api["paths"]) == ["/decide", "/reload", "/health", "/state"]


@pytest.mark.parametrize("policy", ["flat", "tables"])
def test_the_description_is_openapi_of_json_schemas(policy, request, tmp_path):
    with client_of(request.getfixturevalue(policy), tmp_path / "logs", of_tables=policy == "tables") as client:
        api = client.get("/openapi.json").json()
    assert api["openapi"] == "3.1.0"
    schemas = api["components"]["schemas"]
    for schema in schemas.values():
        Draft202012Validator.check_schema(schema)
        assert set(schema.get("required", ())) <= set(schema["properties"])
    assert set(references(api)) == {f"#/components/schemas/{name}" for name in schemas}
    for operation in (each for hows in api["paths"].values() for each in hows.values()):
        assert set(operation["responses"]) == {"200", "default"}
        assert all(each["description"] for each in operation["responses"].values())


def test_a_field_that_a_model_does_not_take_is_named_with_its_value_and_the_remedy(tables, tmp_path):
    with client_of(tables, tmp_path / "logs", of_tables=True) as client:
        for address, given, says in (
            (
                "/decide",
                {"objects": []},
                "the request: objects is []; give a list with each object as a stage of a log",
            ),
            ("/decide", {"objects": [{}, 1]}, "the request: objects is [{}, 1]; give a list with each object as"),
            ("/reward", {}, "the request: missing field 'reward'; give a number, in the unit of the log."),
            (
                "/reward",
                {"reward": 1, "why": 1},
                "the request: unknown field 'why'; give reward, elapsed_s, held",
            ),
            ("/reward", {"reward": "much"}, "the request: reward is 'much'; give a number, in the unit of the log."),
            ("/reward", {"reward": None}, "the request: reward is None; give a number"),
            (
                "/reward",
                {"reward": 1, "held": "yes"},
                "the request: held is 'yes'; give true or false, with clouds only",
            ),
            ("/reward", {"reward": 1, "elapsed_s": "2"}, "the request: elapsed_s is '2'; give seconds since the"),
            ("/end", {"ending": "done"}, "the request: ending is 'done'; give the word \"finished\", or"),
            ("/end", {"ending": "cut"}, 'the request: give {"ending": "finished"}, or {"ending": "cut", "cause": '),
            ("/end", {"ending": "x` - at `$.y`"}, "the request: ending is 'x` - at `$.y`'; give the word"),
            ("/end", {"x` - at `$.y": 1}, "the request: unknown field 'x` - at `$.y'; give ending, cause, elap"),
        ):
            body = json.dumps(given)
            answer = client.post(address, content=body, headers={"content-type": "application/json"})
            assert refused(answer, 422).startswith(says)
        for given in ({"ending": "\ud800"}, {"ending": "cut", "\ud800": 1}):
            answer = client.post("/end", content=json.dumps(given), headers={"content-type": "application/json"})
            assert "'\\ud800' is half of a character" in refused(answer, 400)
        files = {"cloud": ("t.pcd", b"")}
        for stage in ("x", "1.5", "0", "-1", ""):
            line = refused(client.post("/decide", files=files, data={"stage": stage}), 422)
            assert line == f"the request: stage is {stage!r}; give the stage to decide, a whole number from 1."
        for more, says in (("label", "'label' is not one of its parts"), ("cloud", "'cloud' is given twice")):
            parts = [*files.items(), (more, ("l.csv", b""))]
            line = refused(client.post("/decide", files=parts), 422)
            assert line == f"the request: {says}; give cloud, labels, stage, trajectory"
        line = refused(client.post("/decide", files=files, data={"labels": "0,dirty"}), 422)
        assert line.startswith("the request: labels is '0,dirty'; give a .csv or .json of labels, as")


def test_description_and_page_tell_in_words_whatever_is_asked_for_in_the_order_of_a_trajectory(tables, tmp_path):
    with client_of(tables, tmp_path / "logs", of_tables=True) as client:
        api, page = client.get("/openapi.json").json(), client.get("/api")
    assert list(api["paths"]) == ["/decide", "/reward", "/end", "/reload", "/health", "/state"]
    places = [page.text.index(address) for address in api["paths"]]
    assert places == sorted(places)
    assert "A file of what the camera sees" in page.text
    assert "http" not in page.text.replace("HTTP", "").replace("<!doctype html>", "")
    assert "default-src 'none'" in page.headers["content-security-policy"]
    for each in api["paths"].values():
        for content in each.get("post", {}).get("requestBody", {}).get("content", {}).values():
            for name, field in resolved(api, content)["properties"].items():
                assert field["description"].endswith("."), name


def test_a_table_is_decided_from_a_cloud_as_act_does(tables):
    table = table_paths()[7]
    done = CliRunner().invoke(act, [str(tables), str(table), "--json", "--stage", "2", "--extrapolate"])
    said = {name: answer for name, answer in json.loads(done.output).items() if name not in OF_ACT}
    with client_of(tables, of_tables=True) as client:
        answer = client.post("/decide", files={"cloud": (table.name, table.read_bytes())}, data={"stage": "2"}).json()
        assert {name: answer[name] for name in said} == said
        broken = client.post("/decide", files={"cloud": ("../../x.pcd", b"VERSION .7\n")})
        assert refused(broken, 422).startswith("cloud.pcd: ")
        assert "missing field 'cloud'; give a file of what the camera sees" in refused(
            client.post("/decide", files={"other": ("t.pcd", b"")}), 422
        )
        assert "missing field 'objects'; give a list" in refused(client.post("/decide", json={"x": 1}), 422)
        openapi = client.get("/openapi.json").json()["paths"]["/decide"]["post"]["requestBody"]["content"]
        assert set(openapi) == {"application/json", "multipart/form-data"}


@pytest.mark.parametrize("location", [[], ["TABLE", "TABLE"], 1, None, "SINK"])
def test_a_place_that_is_none_is_refused_in_one_line(tables, objects, location):
    with client_of(tables, of_tables=True) as client:
        given = [{**one, "location": location} for one in objects]
        assert "location" in refused(client.post("/decide", json={"objects": given}), 422)


def test_a_table_as_a_log_has_it_is_decided_and_recorded(tables, objects, tmp_path):
    with client_of(tables, tmp_path / "logs") as client:
        answer = client.post("/decide", json={"objects": objects}).json()
        assert answer["action"] == " ".join(str(one) for one in (answer["verb"], answer["object"]) if one is not None)
        ended(client)
        assert "a policy without tables" in refused(client.post("/decide", files={"cloud": ("t.pcd", b"")}), 409)
        wrong = [{**one, "location": "NOWHERE"} for one in objects]
        assert "NOWHERE" in refused(client.post("/decide", json={"objects": wrong}), 422)
    stored = read_logs(tmp_path / "logs")
    assert stored.stages[["action", "probability"]].to_numpy().tolist() == [[answer["verb"], 1.0]]
    assert len(stored.objects) == 3


def test_what_comes_too_slowly_is_refused():
    sent = []

    async def never(*_):
        await asyncio.sleep(60)

    async def send(message):
        sent.append(message)

    async def refuse(refusal, scope, receive, send):
        sent.append(refusal)

    scope = {"type": "http", "method": "POST", "headers": [(b"host", b"localhost")]}
    asyncio.run(Bounded(never, refuse, None, 100, slowest_s=0.01)(scope, never, send))
    assert [one.status for one in sent] == [408]
