"""No verb uses a network, not even this machine's, but those that serve; these answer this machine alone.

Workers of a Dask cluster that is asked for talk over ports of this machine. What a cluster of Ray does is Ray's own
affair: its programs listen at the machine's address, and ask whether they run in a cloud.
"""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from halfseen.cli import VERBS
from release.every_verb import CLONE, LINES, SERVERS, Ended, prepare

HERE = Path(__file__).parent
TINY_STUDY = """
import json
import halfseen.study.runner as run
from release.every_verb import LINES, run as run_line
from examples import TINY
run.chosen = lambda only: TINY[-1:]
print(json.dumps([run_line(line) for line in LINES]))
"""


def environment(folder, **more):
    """Environment of a Python to which the network is forbidden."""
    path = os.pathsep.join(map(str, (HERE / "no_sockets", CLONE, HERE.parent / "study", *filter(None, sys.path))))
    message = {"PYTHONPATH": path, "FORBIDDEN_SOCKETS": str(folder / "forbidden"), "MINARI_DATASETS_PATH": str(folder)}
    return os.environ | message | more


def asked_for(folder):
    file = folder / "forbidden"
    return file.read_text(encoding="utf-8") if file.exists() else ""


def run(folder, *words, **more):
    """Run a Python to which the network is forbidden."""
    command, message = [sys.executable, *words], environment(folder, **more)
    return subprocess.run(command, env=message, cwd=folder, capture_output=True, text=True, check=False)


def test_no_verb_is_left_out():
    assert {line.split()[0] for line in LINES} | set(SERVERS) == set(VERBS)


ASKING = {
    "socket.create_connection(('240.0.0.1', 80), timeout=0.1)": "",
    "socket.create_connection(('127.0.0.1', PORT), timeout=0.1)": "1",
    "socket.socket().bind(('127.0.0.1', 0))": "1",
    "socket.socket().bind(('0.0.0.0', 0))": "",
    "socket.socket().bind(('', 0))": "",
    "socket.socket(type=socket.SOCK_DGRAM).sendto(b'x', ('240.0.0.1', 80))": "",
    "socket.getaddrinfo('example.invalid', 80)": "",
    "socket.gethostbyname('example.invalid')": "",
    "__import__('urllib.request').request.urlopen('http://240.0.0.1')": "",
    "socket.socketpair()": "01",
    "socket.socket(socket.AF_UNIX).bind('talk')": "01",
}
"""What asks for a network, and whether it is allowed where none is ("0") and where this machine's is ("1")."""
TRYING = """
import os, socket, sys
for line in sys.argv[1:]:
    try:
        eval(line)
    except OSError as error:
        print("no network is used here" in str(error))
    else:
        print(False)
    print(os.path.exists(os.environ["FORBIDDEN_SOCKETS"]))
    if os.path.exists(os.environ["FORBIDDEN_SOCKETS"]):
        os.unlink(os.environ["FORBIDDEN_SOCKETS"])
"""


@pytest.mark.parametrize("this_machine", ["0", "1"])
def test_what_forbids_the_network_does(tmp_path, this_machine):
    with socket.create_server(("127.0.0.1", 0)) as server:
        lines = [line.replace("PORT", str(server.getsockname()[1])) for line in ASKING]
        # A process that is started by one that is watched.
        started = "import subprocess, sys; subprocess.run([sys.executable, *sys.argv[1:]])"
        done = run(tmp_path, "-c", started, "-c", TRYING, *lines, THIS_MACHINE=this_machine)
    is_forbidden = [this_machine not in allowed for allowed in ASKING.values()]
    assert done.stdout.split() == [str(each) for each in is_forbidden for _ in range(2)], done.stderr


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A folder in which each verb that ends by itself has run, without a network, and what each ended with."""
    folder = tmp_path_factory.mktemp("no_network")
    prepare(folder)
    done = run(folder, "-c", TINY_STUDY)
    assert done.returncode == 0, done.stderr
    return folder, [Ended(*result) for result in json.loads(done.stdout)]


@pytest.mark.slow
def test_every_verb_works_without_a_network(walked):
    folder, ended = walked
    assert [result for result in ended if result.status != 0] == []
    assert asked_for(folder) == ""


@contextmanager
def serving(folder, *words):
    """Run a verb that serves this machine, and give the port that it tells."""
    command = [sys.executable, "-m", "halfseen.cli", *words]
    with subprocess.Popen(
        command, env=environment(folder, THIS_MACHINE="1"), cwd=folder, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield next(int(found[1]) for line in process.stdout if (found := re.search(r"127\.0\.0\.1:(\d+)", line)))
        finally:
            # Where the tests run in the background of a shell, what they start is deaf to Ctrl-C.
            process.terminate()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "asking", "answer"),
    [
        (["serve", "policy", "--port", "0"], b"GET /health HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n", b" 200 "),
        (["watch", "table.pcd", "--port", "0"], b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b" 200 "),
        (["record", "--listen", "0", "--out", "heard"], None, b'"ok": true'),
    ],
    ids=["serve", "watch", "record"],
)
def test_what_is_served_is_served_to_this_machine_alone(walked, words, asking, answer):
    folder, _ = walked
    with serving(folder, *words) as port, socket.create_connection(("127.0.0.1", port), timeout=60) as client:
        client.sendall(asking or (folder / "lines.jsonl").read_bytes())
        assert answer in client.makefile("rb").readline()
    assert asked_for(folder) == ""


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_workers_talk_on_this_machine_alone(walked, engine):
    folder, _ = walked
    shutil.copy(folder / "table.pcd", folder / f"{engine}.pcd")
    words = ("-m", "halfseen.cli", "look", "table.pcd", f"{engine}.pcd", "--workers", "2", "--engine", engine)
    done = run(folder, *words, THIS_MACHINE="0" if engine == "processes" else "1")
    assert done.returncode == 0, done.stderr
    assert asked_for(folder) == ""
