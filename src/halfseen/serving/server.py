"""The server: on one port, until somebody interrupts."""

import asyncio
import contextlib
import signal
import socket
from collections.abc import Callable, Iterator
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from halfseen.errors import ArgumentError
from halfseen.serving.bounds import App

HERE = "127.0.0.1"
MOST_CONNECTIONS = 128
SLOWEST_HEAD_S = 30.0
LARGEST_HEAD_BYTES = 1 << 14


class BoundedProtocol(H11Protocol):
    """HTTP/1.1 in which a connection that is silent, or sends the head of a request drop by drop, is closed."""

    _overdue: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._await_head()

    def data_received(self, data: bytes) -> None:
        """Take what came; with the whole head of a request, the waiting is over."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_waiting()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._await_head()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._stop_waiting()
        self._overdue = self.loop.call_later(SLOWEST_HEAD_S, self.transport.close)

    def _stop_waiting(self) -> None:
        if self._overdue is not None:
            self._overdue.cancel()


def bound_socket(host: str, port: int) -> socket.socket:
    """Take a port before anything else is done.

    Parameters
    ----------
    host
        Address or name of this machine.
    port
        0 for any that is free.

    Raises
    ------
    ArgumentError
        The address is none of this machine's, or the port is taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with contextlib.ExitStack() as closing:
            taken = closing.enter_context(socket.socket(family, kind, protocol))
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind(address)
            taken.listen(MOST_CONNECTIONS)
            closing.pop_all()
            return taken
    except OSError as error:
        raise ArgumentError(
            f"--host {host} --port {port}: nobody can serve there ({error.strerror}); choose another port, or 0 for any"
        ) from error


@contextlib.contextmanager
def _until_stopped() -> Iterator[None]:
    """Let a request to end, which uvicorn raises anew once all is answered, end no more than what is inside."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            yield
    finally:
        signal.signal(signal.SIGTERM, before)


def serve(app: App, at: socket.socket, on_start: Callable[[], Any] | None = None) -> None:
    """Answer until somebody interrupts; requests that have come are answered first.

    Parameters
    ----------
    app
        What answers.
    at
        As `bound_socket` gives it.
    on_start
        Called once, when requests are answered.
    """
    config = uvicorn.Config(
        app,  # type: ignore[arg-type]
        http=BoundedProtocol,
        ws="none",
        loop="asyncio",
        log_level="warning",
        access_log=False,
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_keep_alive=int(SLOWEST_HEAD_S),
        timeout_graceful_shutdown=10,
        h11_max_incomplete_event_size=LARGEST_HEAD_BYTES,
    )
    if on_start is not None:
        on_start()
    with _until_stopped():
        uvicorn.Server(config).run(sockets=[at])
