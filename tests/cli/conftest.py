"""The command line as it is typed, without the start of a process, and a folder of what its verbs take."""

import sys
import threading
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shell
from shell import BEHIND, LEFT, RIGHT, TABLE

from halfseen import cli, perception, progress
from halfseen.learning import CensoredQLearner
from halfseen.perception import perceive, read_cloud
from halfseen.policies import table_observation
from small_logs import HIDES, flat_learner, flat_log, kept, table_log


class Typed(NamedTuple):
    """What a command line ended with."""

    status: int
    out: str
    err: str


@pytest.fixture(scope="module", autouse=True)
def _no_lines_of_progress():
    """What is said does not depend on how long a machine takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "LINE_S", threading.TIMEOUT_MAX)
        yield


of_content, seen_once = cache(lambda content, file: read_cloud(file)), cache(perceive)


def read_once(file):
    small = Path(file).is_file() and Path(file).stat().st_size < 10**7
    return of_content(Path(file).read_bytes(), file) if small else read_cloud(file)


@pytest.fixture(scope="module", autouse=True)
def _each_cloud_is_looked_at_once():
    with pytest.MonkeyPatch.context() as patch:
        for module in (perception, table_observation):
            patch.setattr(module, "read_cloud", read_once)
            patch.setattr(module, "perceive", seen_once)
        yield


@pytest.fixture
def typed(monkeypatch, capsys):
    """Run ``halfseen`` with arguments, as a shell would."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["halfseen", *map(str, arguments)])
        status = 0
        try:
            cli.main()
        except SystemExit as stop:
            status = stop.code
        return Typed(status, *capsys.readouterr())

    return run


@pytest.fixture
def refused(typed):
    """Run ``halfseen`` with arguments that it refuses: status 2 and one line, which is returned."""

    def run(*arguments):
        status, out, err = typed(*arguments)
        assert (status, out, err.count("\n")) == (2, "", 1), err
        return err

    return run


@pytest.fixture(scope="session")
def house(tmp_path_factory):
    """Logs and policies of named actions, of tables and of a team of two."""
    folder, flat = tmp_path_factory.mktemp("house"), flat_log()
    tables = table_log(num_objects=3, hides=np.pad(HIDES, (0, 1)))
    flat.write(folder / "logs")
    tables.write(folder / "table-logs")
    kept(flat_learner(), flat, folder / "policy")
    kept(CensoredQLearner.for_table(3, reg=0.1), tables, folder / "table-policy")
    (folder / "two.toml").write_text("reward_per_s = -0.05\n" + LEFT + RIGHT)
    (folder / "three.toml").write_text(LEFT + RIGHT + BEHIND)
    few = ["--episodes", 40, "--horizon", 3, "--cut-share", 0.4, "--seed", 3]
    shell.run("simulate", TABLE, "--team", folder / "two.toml", "--out", folder / "team-logs", *few)
    return folder


@pytest.fixture(scope="session")
def learned(house):
    """What `learn` says of the logs of the team; its policy is in the house."""
    return shell.run("learn", house / "team-logs", "--out", house / "team-policy", "--reg", "0.1", "--no-verdict")
