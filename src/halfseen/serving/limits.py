"""Limits on requests: access, size and time are checked before a request is read. Also the server itself.

The server listens on one port until it is interrupted.
"""

import asyncio
import base64
import contextlib
import hmac
import signal
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, MutableMapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import uvicorn
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from uvicorn.protocols.http.h11_impl import H11Protocol

from halfseen.errors import ArgumentError
from halfseen.serving.models import CloudRequest, Refusal, model_of

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Refuse = Callable[[Refusal, MutableMapping[str, Any], Receive, Send], Awaitable[None]]
App = Callable[[MutableMapping[str, Any], Receive, Send], Awaitable[None]]

LARGEST_STATE_BYTES = 1 << 20
LARGEST_CLOUD_BYTES = 64 << 20
SLOWEST_BODY_S = 10.0
OF_THIS_MACHINE = ("127.0.0.1", "localhost", "[::1]")
"""Host names of a local server; a request from a page of another site has a different one."""


@dataclass(eq=False)
class Bounded:
    """Applies the limits in front of an ASGI app; the body is complete before the app sees it.

    Parameters
    ----------
    app
        The app.
    refuse
        Answers a refusal.
    token
        Token required in a request; None for no token, which restricts requests to local host names.
    largest_bytes
        Largest size of a body.
    slowest_s
        Time limit for a complete body [s].
    """

    app: App
    refuse: Refuse
    token: str | None
    largest_bytes: int
    slowest_s: float = SLOWEST_BODY_S

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """Answer one request, or run the app's startup and shutdown."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope, receive)
        try:
            self._check_asker(request)
            async with asyncio.timeout(self.slowest_s):
                body = await self._whole(request)
        except ClientDisconnect:
            return
        except TimeoutError:
            late = f"the request was not complete within {self.slowest_s:g} s; send it at once"
            await self.refuse(Refusal(408, late), scope, receive, send)
        except Refusal as refusal:
            await self.refuse(refusal, scope, receive, send)
        else:
            await self.app(scope, _given_once(body, receive), send)

    def _check_asker(self, request: Request) -> None:
        if self.token is None:
            name = request.headers.get("host", "")
            if (name if name.endswith("]") else name.rpartition(":")[0] or name) not in OF_THIS_MACHINE:
                raise Refusal(403, f"host is {name!r}; this server answers only as {' or '.join(OF_THIS_MACHINE)}")
        elif not hmac.compare_digest(_token_in(request), self.token.encode()):
            raise Refusal(401, "the token is missing or wrong; send the header Authorization: Bearer TOKEN")

    async def _whole(self, request: Request) -> bytes:
        """Read the body, unless it is too large or says so."""
        body, stated = bytearray(), request.headers.get("content-length", "0")
        too_large = Refusal(413, f"the request has more than {self.largest_bytes:,} bytes; send less")
        if stated.isdecimal() and int(stated) > self.largest_bytes:
            raise too_large
        async for part in request.stream():
            body += part
            if len(body) > self.largest_bytes:
                raise too_large
        return bytes(body)


def _token_in(request: Request) -> bytes:
    """The token of a header. For pages, a browser may send it as a password; never for decisions."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme == "Basic" and request.method == "GET":
        with contextlib.suppress(ValueError):
            return base64.b64decode(token, validate=True).partition(b":")[2]
    return token.encode("latin-1") if scheme == "Bearer" else b""


def _given_once(body: bytes, receive: Receive) -> Receive:
    """Replay a body that was read, then pass on later messages."""
    is_given = False

    async def again() -> Message:
        nonlocal is_given
        if is_given:
            return await receive()
        is_given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


@asynccontextmanager
async def cloud_in(request: Request) -> AsyncIterator[CloudRequest]:
    """Store the files of a form temporarily.

    Raises
    ------
    Refusal
        The request is not a form, or does not fit `CloudRequest`.
    """
    names = CloudRequest.__struct_fields__
    async with contextlib.AsyncExitStack() as kept:
        try:
            form = await kept.enter_async_context(request.form(max_files=2, max_fields=2, max_part_size=1 << 10))
        except HTTPException as error:
            trouble = f"the request is not a multipart form ({error.detail}); give {', '.join(names)}"
            raise Refusal(400, trouble) from error
        folder = Path(kept.enter_context(TemporaryDirectory()))
        given = {name: await _kept(name, form[name], folder) for name in names if name in form}
        found = model_of(given, CloudRequest, is_text=True)
        parts = [name for name, _ in form.multi_items()]
        for name in parts:
            if name not in names or parts.count(name) > 1:
                trouble = "is given twice" if name in names else "is not one of its parts"
                raise Refusal(422, f"the request: {name!r:.40} {trouble}; give {', '.join(names)}")
        yield found


async def _kept(name: str, given: UploadFile | str, folder: Path) -> Path | str:
    """Write a file of a form to a folder; text is returned unchanged."""
    if isinstance(given, str):
        return given
    ending = PurePosixPath(given.filename or "").suffix
    file = folder / f"{name}{ending if ending[1:].isalnum() and len(ending) < 10 else ''}"
    file.write_bytes(await given.read())
    return file


MOST_CONNECTIONS = 128
SLOWEST_HEAD_S = 30.0
LARGEST_HEAD_BYTES = 1 << 14


class BoundedProtocol(H11Protocol):
    """HTTP/1.1 of bounded connections; idle ones are closed, and those that send the head of a request too slowly."""

    _overdue: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for a request; refuse those of one connection too many."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            too_many = f"the server has {MOST_CONNECTIONS} open connections, its limit; keep one open for all requests"
            self.app = partial(self.app.refuse, Refusal(503, too_many))  # type: ignore[union-attr]
        self._await_head()

    def data_received(self, data: bytes) -> None:
        """Process data; stop the timer once the head of a request is complete."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_waiting()

    def on_response_complete(self) -> None:
        """Start the timer for the next request."""
        self._await_head()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._stop_waiting()
        self._overdue = self.loop.call_later(SLOWEST_HEAD_S, self.transport.close)

    def _stop_waiting(self) -> None:
        if self._overdue is not None:
            self._overdue.cancel()


def bound_socket(host: str, port: int) -> socket.socket:
    """Bind a port before anything else is done.

    Parameters
    ----------
    host
        Address or name of this machine.
    port
        Port number; 0 for any free port.

    Raises
    ------
    ArgumentError
        The address does not belong to this machine, or the port is taken.
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
            f"--host {host} --port {port}: the server cannot listen there ({error.strerror}); choose another port, "
            "or 0 for any"
        ) from error


class _Server(uvicorn.Server):
    """Ends in order, however often it is interrupted; uvicorn would leave the app and print a traceback."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Ignore all but the first signal."""
        if not self.should_exit:
            super().handle_exit(sig, frame)


def serve(app: Bounded, at: socket.socket, on_start: Callable[[], Any] | None = None) -> None:
    """Serve an app until it is interrupted; pending requests are answered first.

    Parameters
    ----------
    app
        The app.
    at
        Result of `bound_socket`.
    on_start
        Called once, before requests are answered.
    """
    config = uvicorn.Config(
        app,  # type: ignore[arg-type]
        http=BoundedProtocol,
        ws="none",
        loop="asyncio",
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=int(SLOWEST_HEAD_S),
        timeout_graceful_shutdown=10,
        h11_max_incomplete_event_size=LARGEST_HEAD_BYTES,
    )
    if on_start is not None:
        on_start()
    # uvicorn raises SIGTERM again once all requests are answered; it must end the server only.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            _Server(config).run(sockets=[at])
    finally:
        signal.signal(signal.SIGTERM, before)
