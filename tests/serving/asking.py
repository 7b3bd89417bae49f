"""Who asks a server, and what is said of a refusal; whatever is asked and answered is held against the description."""

import json
from contextlib import contextmanager, nullcontext
from functools import cache, partial

from click.testing import CliRunner
from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from halfseen.cli.act import act
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder import write_policy
from halfseen.serving.app import app_of
from halfseen.serving.pages import described
from halfseen.serving.recording import RecordedTrajectories
from halfseen.serving.served import Answering, Served
from small_logs import flat_log

OF_ACT = {"policy", "input", "learned_from"}
"""What `act` says of the folder and the file that it was given, and a server does not with each decision."""
RULE = "stage,x1,action\n1,> 0,A\n1,,B\n,,A\n"


STAGES = {1: ["A", "B"], 2: ["A", "C"]}


def flat_with(**columns):
    """The small log of named actions, with other columns of its stages."""
    logs = flat_log()
    return Logs(logs.stages.assign(**columns), logs.trajectories)


def written(folder, logs=None, covariates=("x1", "x2"), actions=STAGES, reg=0.1, **options):
    """Learn a policy of two stages from a log, and write it in place of what is there."""
    logs = flat_log() if logs is None else logs
    learner = CensoredQLearner.of_paper(2, actions, covariates, reg=reg, **options).fit(logs)
    write_policy(learner, logs, folder, overwrite=True)
    return folder


@contextmanager
def client_of(
    policy, folder=None, *, of_tables=False, token=None, largest_bytes=None, law=None, served=None, **answering
):
    """Ask a server that records into a folder, if one is given."""
    recorded = nullcontext() if folder is None else RecordedTrajectories(folder, is_of_tables=of_tables)
    with recorded as trajectories:
        options = {"extrapolates": of_tables, "law": law, **(served or {})}
        served = Served(policy, Answering(**answering, trajectories=trajectories), **options)
        app = app_of(served, token, largest_bytes=largest_bytes)
        with TestClient(app, base_url="http://127.0.0.1") as client:
            api = described(served.service, is_recording=folder is not None, is_comparing="comparison" in answering)
            client.event_hooks = {"response": [partial(check_described, api, cache(partial(validator, api)))]}
            yield client


def validator(api, reference):
    return Draft202012Validator({"$ref": reference, "components": api["components"]})


def check_described(api, validator_of, response):
    """Check an answer, and the request if it was taken."""
    path, how = response.request.url.path, response.request.method.lower()
    if how not in api["paths"].get(path, {}):
        return
    response.read()
    operation, is_taken = api["paths"][path][how], response.status_code == 200
    (answered,) = operation["responses"]["200" if is_taken else "default"]["content"].values()
    validator_of(answered["schema"]["$ref"]).validate(response.json())
    assert response.json().keys() <= resolved(api, answered)["properties"].keys()
    if is_taken and "requestBody" in operation:
        kind = response.request.headers["content-type"].partition(";")[0]
        if kind == "application/json":
            asked = operation["requestBody"]["content"][kind]
            validator_of(asked["schema"]["$ref"]).validate(json.loads(response.request.read()))


def resolved(api, content):
    """The schema that a content refers to."""
    return api["components"]["schemas"][content["schema"]["$ref"].rpartition("/")[2]]


def refused(response, status):
    assert response.status_code == status, response.text
    (line,) = response.json().values()
    assert line
    assert "\n" not in line
    return line


def acted(folder, tmp_path, *words, **state):
    """What ``halfseen act --json`` says of a state."""
    file = tmp_path / "state.json"
    file.write_text(json.dumps(state))
    done = CliRunner().invoke(act, [str(folder), str(file), "--json", *words], catch_exceptions=False)
    return {name: result for name, result in json.loads(done.output).items() if name not in OF_ACT}


def decided(client, **state):
    answer = client.post("/decide", json=state)
    assert answer.status_code == 200, answer.text
    return answer.json()


def rewarded(client, reward=1.0):
    client.post("/reward", json={"reward": reward}).raise_for_status()


def ended(client, reward=1.0):
    """The stage in progress brings a reward, and is the last."""
    rewarded(client, reward)
    client.post("/end", json={"ending": "finished"}).raise_for_status()


def run(client, rng, num, gain=0.0, cut=0.0, *, is_clocked=True):
    """Trajectories of two stages; the policy's earn more by so much."""

    def clock(elapsed_s):
        return {"elapsed_s": elapsed_s} if is_clocked else {}

    for _ in range(num):
        for stage in (1, 2):
            answer = decided(client, x1=float(rng.normal()), x2=int(rng.integers(3)))
            reward = float(rng.random()) + (gain if answer.get("arm") != "rule" and stage == 2 else 0.0)
            client.post("/reward", json={"reward": reward, **clock(float(stage))})
        is_cut = rng.random() < cut
        end = {"ending": "cut", "cause": "operator"} if is_cut else {"ending": "finished"}
        client.post("/end", json={**end, **clock(2.5)})
