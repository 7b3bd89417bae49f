"""Who asks a server, and what is said of a refusal; whatever is asked and answered is held against the description."""

import json
from contextlib import contextmanager, nullcontext

from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from halfseen.serving.app import app_of
from halfseen.serving.pages import described
from halfseen.serving.recording import RecordedTrajectories
from halfseen.serving.served import Answering, Served

OF_ACT = {"policy", "input", "learned_from"}
"""What `act` says of the folder and the file that it was given, and a server does not with each decision."""


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
            client.event_hooks = {"response": [lambda response: check_described(api, response)]}
            yield client


def check_described(api, response):
    """Check an answer, and the request if it was taken."""
    path, how = response.request.url.path, response.request.method.lower()
    if how not in api["paths"].get(path, {}):
        return
    response.read()
    operation, is_taken = api["paths"][path][how], response.status_code == 200
    (answered,) = operation["responses"]["200" if is_taken else "4XX"]["content"].values()
    check(api, answered, response.json())
    assert response.json().keys() <= resolved(api, answered)["properties"].keys()
    if is_taken and "requestBody" in operation:
        kind = response.request.headers["content-type"].partition(";")[0]
        asked = operation["requestBody"]["content"][kind]
        if kind == "application/json":
            check(api, asked, json.loads(response.request.read()))


def check(api, content, given):
    Draft202012Validator({**content["schema"], "components": api["components"]}).validate(given)


def resolved(api, content):
    """The schema that a content refers to."""
    return api["components"]["schemas"][content["schema"]["$ref"].rpartition("/")[2]]


def refused(response, status):
    assert response.status_code == status, response.text
    (line,) = response.json().values()
    assert line
    assert "\n" not in line
    return line
