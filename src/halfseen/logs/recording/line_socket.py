"""The line protocol over a socket of this machine: one client at a time, and the next when it has gone."""

import io
import os
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from halfseen.errors import ArgumentError
from halfseen.logs.recording.line_protocol import MOST_BYTES, answered, record_lines
from halfseen.logs.recording.recorder import LogRecorder

HOST = "127.0.0.1"
"""No other machine reaches it."""


@contextmanager
def listening(address: int | Path) -> Iterator[socket.socket]:
    """Listen at a port of this machine, 0 for any, or at a Unix socket that only this user may open.

    Raises
    ------
    ArgumentError
        Somebody else listens there, or something else is there.
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
                f"{address}: nobody can listen there ({reason}); choose another port or file"
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
    """Record what clients say, one after the other, for ever; a trajectory that one leaves in progress is cut.

    Parameters
    ----------
    recorder
        Where to.
    listener
        Where they come.
    on_gone
        Called when one has gone.
    """
    while True:
        connection, _ = listener.accept()
        with connection, connection.makefile("rb") as lines:
            _record_client(recorder, connection, lines)
        on_gone()


def _record_client(recorder: LogRecorder, connection: socket.socket, lines: io.BufferedReader) -> None:
    def answer(text: str) -> None:
        # Who has gone without waiting for answers has said all the same what is to be recorded.
        with suppress(OSError):
            connection.sendall(text.encode() + b"\n")

    with suppress(ConnectionError):
        if lines.peek(1)[:1] not in (b"{", b""):
            # Such as a page in a browser, which speaks HTTP to any port: what else it says is not for us.
            answer(answered(recorder, lines.readline(MOST_BYTES)))
            return
    record_lines(recorder, lines, answer)
