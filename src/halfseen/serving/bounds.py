"""Who may ask, how much, and how slowly: whatever comes in is bounded before anybody looks at it."""

import asyncio
import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from halfseen.serving.refusal import Refusal

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Refuse = Callable[[Refusal, MutableMapping[str, Any], Receive, Send], Awaitable[None]]
App = Callable[[MutableMapping[str, Any], Receive, Send], Awaitable[None]]

LARGEST_STATE_BYTES = 1 << 20
LARGEST_CLOUD_BYTES = 64 << 20
SLOWEST_BODY_S = 10.0
OF_THIS_MACHINE = ("127.0.0.1", "localhost", "[::1]")
"""Names by which a server of this machine is asked; a page of another site that finds it has another."""


class Bounded:
    """Asks an ASGI app what is bounded: its body is whole before the app sees it.

    Parameters
    ----------
    app
        The app.
    refuse
        Answers a refusal.
    token
        That a request must bring; None where none is asked for, and then only by a name of this machine.
    largest_bytes
        Of a body.
    slowest_s
        Until a body is whole [s].
    """

    def __init__(
        self,
        app: App,
        refuse: Refuse,
        token: str | None,
        largest_bytes: int,
        slowest_s: float = SLOWEST_BODY_S,
    ) -> None:
        self._app, self._refuse, self._token = app, refuse, token
        self._largest_bytes, self._slowest_s = largest_bytes, slowest_s

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """Answer one request, or run the app's own beginning and end."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            headers = dict(scope["headers"])
            self._check_asker(headers)
            self._check_stated_size(headers)
            try:
                async with asyncio.timeout(self._slowest_s):
                    body = await self._whole(receive)
            except TimeoutError as error:
                late = f"the request did not come whole within {self._slowest_s:g} s; send it at once"
                raise Refusal(408, late) from error
        except Refusal as refusal:
            await self._refuse(refusal, scope, receive, send)
            return
        if body is not None:
            await self._app(scope, _given_once(body, receive), send)

    def _check_asker(self, headers: dict[bytes, bytes]) -> None:
        if self._token is None:
            name = headers.get(b"host", b"").decode("latin-1")
            if (name if name.endswith("]") else name.rpartition(":")[0] or name) not in OF_THIS_MACHINE:
                raise Refusal(403, f"host is {name!r}; this server is asked as {' or '.join(OF_THIS_MACHINE)}")
        elif not hmac.compare_digest(headers.get(b"authorization", b""), b"Bearer " + self._token.encode()):
            raise Refusal(401, "the token is missing or another; send the header Authorization: Bearer TOKEN")

    def _check_stated_size(self, headers: dict[bytes, bytes]) -> None:
        stated = headers.get(b"content-length", b"0")
        if stated.isdigit() and int(stated) > self._largest_bytes:
            raise self._too_large()

    async def _whole(self, receive: Receive) -> bytes | None:
        """Read the body; None where the client has gone."""
        parts, num_bytes = [], 0
        while True:
            message = await receive()
            if message["type"] != "http.request":
                return None
            parts.append(message.get("body", b""))
            num_bytes += len(parts[-1])
            if num_bytes > self._largest_bytes:
                raise self._too_large()
            if not message.get("more_body"):
                return b"".join(parts)

    def _too_large(self) -> Refusal:
        return Refusal(413, f"the request has more than {self._largest_bytes:,} bytes; send less")


def _given_once(body: bytes, receive: Receive) -> Receive:
    """Give a body that was read, and after it what comes."""
    is_given = False

    async def again() -> Message:
        nonlocal is_given
        if is_given:
            return await receive()
        is_given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again
