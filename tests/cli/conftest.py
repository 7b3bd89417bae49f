"""The command line as it is typed, without the start of a process."""

import sys
from typing import NamedTuple

import pytest

from halfseen import cli


class Typed(NamedTuple):
    """What a command line ended with."""

    status: int
    out: str
    err: str


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
