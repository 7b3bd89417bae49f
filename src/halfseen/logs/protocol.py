r"""Recording without Python: each line in is one call of the recorder as a JSON object, each line out its answer.

::

    {"call": "begin_trajectory", "name": "left-1", "columns": {"cell": "left"}}
    {"call": "begin_stage", "covariates": {"clutter": 0.3}, "action": "PICK", "probability": 0.5}
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5}
    {"call": "finish"}

Calls and argument names are those of `LogRecorder` and `TrajectoryRecorder`; null counts as left out. The answer is
``{"ok": true, "trajectory": …}``, or ``{"ok": false, "error": "…"}`` with one line that names the fault and the remedy.
A refused call records nothing, and the next call is handled as if it had not been made. Lines are UTF-8 and end with
``\n``. At the end of the input, a trajectory in progress is cut.

A local socket serves one client at a time; the next is served once the first has disconnected.
"""

import io
import json
import os
import socket
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from halfseen.errors import ArgumentError, HalfseenError, LogError, did_you_mean
from halfseen.logs.recorder import LogRecorder
from halfseen.logs.trajectory_recorder import TrajectoryRecorder
from halfseen.reading import named_once

MOST_BYTES = 1_000_000
"""A longer line is refused and discarded."""

INPUT_ENDED = "input-ended"
"""Cause of the cut of a trajectory that was in progress when the input ended."""


@runtime_checkable
class Lines(Protocol):
    """A file, pipe or socket that is read line by line."""

    def readline(self, size: int, /) -> bytes:
        """Read the next line, at most `size` bytes of it; empty at the end of the input."""
        ...


def _takes(name: str) -> dict[str, bool]:
    """Arguments of a call, and whether each is required."""
    _, *takes = signature(getattr(TrajectoryRecorder, name)).parameters.values()
    return {each.name: each.default is each.empty for each in takes}


_NAMES = ("begin_stage", "complete_stage", "drop_out", "still_running", "finish", "cut")
CALLS = {"begin_trajectory": {"name": False, "columns": False}} | {name: _takes(name) for name in _NAMES}
"""Arguments of each call, and whether each is required."""


def record_lines(recorder: LogRecorder, lines: Lines, answer: Callable[[str], object]) -> None:
    """Make the calls of all lines, then cut the trajectory in progress.

    Raises
    ------
    LogError
        The cut cannot be written.
    """
    for line in _bounded(lines):
        if line.strip():
            answer(answered(recorder, line))
    if recorder.trajectory is not None and not recorder.trajectory.is_ended:
        recorder.trajectory.cut(INPUT_ENDED)


def answered(recorder: LogRecorder, line: bytes) -> str:
    """Make the call of one line and return the answer."""
    try:
        name, given = call_of(line)
        _make(recorder, name, given)
    except HalfseenError as error:
        return json.dumps({"ok": False, "error": " ".join(str(error).split())})
    return json.dumps({"ok": True, "trajectory": None if recorder.trajectory is None else recorder.trajectory.name})


def call_of(line: bytes) -> tuple[str, dict[str, Any]]:
    """Parse a line into the name of a call and its arguments.

    Raises
    ------
    LogError
        The line is too long or not a JSON object, or there is no such call.
    """
    if len(line) > MOST_BYTES:
        raise LogError(
            f"the line is longer than {MOST_BYTES} bytes; record less in a stage, such as a file's name "
            "instead of its contents"
        )
    try:
        given = json.loads(line, parse_constant=_no_number, object_pairs_hook=named_once)
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else error
        raise LogError(f"the line is not valid JSON ({reason}); give one JSON object a line") from error
    name = given.pop("call", None) if isinstance(given, dict) else None
    if not isinstance(name, str):
        raise LogError(f'the line has no call; give a JSON object with "call", one of {", ".join(CALLS)}')
    if name not in CALLS:
        raise LogError(f"unknown call {name[:40]!r}{did_you_mean(name[:40], CALLS) or '; give ' + ', '.join(CALLS)}")
    takes = CALLS[name]
    for key in given:
        if key not in takes:
            raise LogError(f"{name} takes no {key[:40]!r}; it takes {', '.join(takes)}")
    given = {key: value for key, value in given.items() if value is not None}
    for key, is_needed in takes.items():
        if is_needed and key not in given:
            raise LogError(f"{name} needs {key}; give it")
    return name, given


def _make(recorder: LogRecorder, name: str, given: dict[str, Any]) -> None:
    if name == "begin_trajectory":
        columns = given.get("columns", {})
        if not isinstance(columns, Mapping):
            raise LogError("columns are not a JSON object; give names and values")
        recorder.begin_trajectory(given.get("name"), **columns)
    elif recorder.trajectory is None:
        raise LogError(f"{name}: no trajectory has begun; begin_trajectory first")
    else:
        getattr(recorder.trajectory, name)(**given)


def _bounded(lines: Lines) -> Iterator[bytes]:
    """Lines, truncated if too long; a broken connection ends them."""
    with suppress(ConnectionError):
        while line := lines.readline(MOST_BYTES + 1):
            yield line
            while len(line) > MOST_BYTES and not line.endswith(b"\n"):
                line = lines.readline(MOST_BYTES + 1)


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is not a number")


HOST = "127.0.0.1"
"""Loopback address: other machines cannot reach it."""


@contextmanager
def listening(address: int | Path) -> Iterator[socket.socket]:
    """Listen on a local port, 0 for any, or on a Unix socket that only this user may open.

    Raises
    ------
    ArgumentError
        The address is in use, or the file exists and is not a stale socket.
    """
    is_port = isinstance(address, int)
    if not is_port and not hasattr(socket, "AF_UNIX"):
        raise ArgumentError(f"{address}: Python has no Unix sockets on this system; give a port, such as 0 for any")
    with socket.socket(socket.AF_INET if is_port else socket.AF_UNIX) as listener:
        try:
            if is_port:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind((HOST, address))
            else:
                _remove_left(address)
                before = os.umask(0o177)
                try:
                    listener.bind(str(address))
                finally:
                    os.umask(before)
            listener.listen()
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ArgumentError(
                f"{address}: it cannot be listened on ({reason}); choose another port or file"
            ) from error
        try:
            yield listener
        finally:
            if not is_port:
                with suppress(OSError):
                    address.unlink()


def _remove_left(file: Path) -> None:
    """Remove a socket that a killed process left behind."""
    if file.exists() and stat.S_ISSOCK(file.stat().st_mode):
        with socket.socket(socket.AF_UNIX) as asking:
            try:
                asking.connect(str(file))
            except ConnectionRefusedError:
                file.unlink()


def record_clients(
    recorder: LogRecorder, listener: socket.socket, on_gone: Callable[[], object] = lambda: None
) -> None:
    """Serve clients one after the other, forever; a trajectory that a client leaves in progress is cut."""
    while True:
        connection, _ = listener.accept()
        with connection, connection.makefile("rb") as lines:
            _record_client(recorder, connection, lines)
        on_gone()


def _record_client(recorder: LogRecorder, connection: socket.socket, lines: io.BufferedReader) -> None:
    def answer(text: str) -> None:
        # A client may disconnect without waiting for answers; its calls are recorded all the same.
        with suppress(OSError):
            connection.sendall(text.encode() + b"\n")

    with suppress(ConnectionError):
        if lines.peek(1)[:1] not in (b"{", b""):
            # Not our protocol, such as HTTP from a web page in a browser: answer once and ignore the rest.
            answer(answered(recorder, lines.readline(MOST_BYTES)))
            return
    record_lines(recorder, lines, answer)
