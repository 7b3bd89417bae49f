"""Who asks a server, and what is said of a refusal."""

from contextlib import contextmanager, nullcontext

from starlette.testclient import TestClient

from halfseen.serving.answering import Answering
from halfseen.serving.app import Served, app_of
from halfseen.serving.recording import RecordedTrajectories


@contextmanager
def client_of(policy, folder=None, *, of_tables=False, token=None, largest_bytes=None, law=None, **answering):
    """Ask a server that records into a folder, if one is given."""
    recorded = nullcontext() if folder is None else RecordedTrajectories(folder, is_of_tables=of_tables)
    with recorded as trajectories:
        served = Served(policy, Answering(**answering, trajectories=trajectories), extrapolates=of_tables, law=law)
        app = app_of(served, token, largest_bytes=largest_bytes)
        with TestClient(app, base_url="http://127.0.0.1") as client:
            yield client


def refused(response, status):
    assert response.status_code == status, response.text
    (line,) = response.json().values()
    assert line
    assert "\n" not in line
    return line
