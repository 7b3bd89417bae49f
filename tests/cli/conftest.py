"""The command line as it is typed, without the start of a process."""

import sys
import threading
from typing import NamedTuple

import pytest

from halfseen import cli, progress


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
