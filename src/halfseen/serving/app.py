"""The HTTP app: its addresses, and the form of its answers."""

import asyncio
import json
import signal
import sys
import threading
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any

from msgspec import to_builtins
from msgspec.structs import replace
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from halfseen.errors import HalfseenError
from halfseen.reading import json_of
from halfseen.serving import models
from halfseen.serving.limits import LARGEST_CLOUD_BYTES, LARGEST_STATE_BYTES, Bounded, cloud_in
from halfseen.serving.models import DecisionAnswer, Refusal, model_of
from halfseen.serving.pages import FORM, JSON, SECURITY, cell_of, described, description_of, page_of
from halfseen.serving.questions import seen_in_cloud, seen_in_state
from halfseen.serving.served import Served

if TYPE_CHECKING:
    from halfseen.serving.opcua.wire import Wire


@asynccontextmanager
async def reloading_at_hang_up(reload: Callable[[], Awaitable[Any]]) -> AsyncIterator[None]:
    """Reload on SIGHUP within this context, if the system has that signal; report read errors on stderr.

    Parameters
    ----------
    reload
        Reads the files again, or raises `HalfseenError` and changes nothing.
    """
    hang_up: Any = getattr(signal, "SIGHUP", None)
    if hang_up is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    loop, running = asyncio.get_running_loop(), set()

    async def tell() -> None:
        try:
            await reload()
        except HalfseenError as error:
            print(f"halfseen: {error}; the previous policy stays in use", file=sys.stderr)

    def begin() -> None:
        task = loop.create_task(tell())
        running.add(task)
        task.add_done_callback(running.discard)

    loop.add_signal_handler(hang_up, begin)
    try:
        yield
    finally:
        loop.remove_signal_handler(hang_up)


async def _check_is_there(request: Request) -> None:
    if await request.is_disconnected():
        raise Refusal(408, "the client has disconnected; nothing is decided")


def app_of(
    served: Served, token: str | None = None, *, largest_bytes: int | None = None, wire: "Wire | None" = None
) -> Bounded:
    """Create the ASGI app of a served policy.

    Parameters
    ----------
    served
        The policy.
    token
        Token required in each request; None for no token.
    largest_bytes
        Largest size of a request; None for 1 MiB, or 64 MiB if clouds are allowed.
    wire
        Connection by which a controller asks instead while the app runs; then HTTP takes no decisions.
    """
    asked = {
        "/decide": ("POST", _decide),
        "/reward": ("POST", _reward),
        "/end": ("POST", _end),
        "/reload": ("POST", _reload),
        "/health": ("GET", partial(_health, wire)),
        "/comparison": ("GET", _comparison),
        "/openapi.json": ("GET", _openapi),
        "/api": ("GET", _description),
        "/state": ("GET", _state),
        "/": ("GET", _page),
    }
    if wire is not None:
        asked |= dict.fromkeys(("/decide", "/reward", "/end"), ("POST", partial(_asked_elsewhere, wire)))
    routes = [Route(path, _answering(partial(answer, served)), methods=[how]) for path, (how, answer) in asked.items()]
    refused: Any = {HTTPException: _no_address}
    app = Starlette(routes=routes, exception_handlers=refused, lifespan=lambda _: _running(served, wire))
    largest = largest_bytes or (LARGEST_CLOUD_BYTES if served.service.stored.is_table else LARGEST_STATE_BYTES)
    app.router.redirect_slashes = False
    return Bounded(app, _refused, token, largest)  # type: ignore[arg-type]


@asynccontextmanager
async def _running(served: Served, wire: "Wire | None") -> AsyncIterator[None]:
    async with reloading_at_hang_up(served.reload), nullcontext() if wire is None else wire.running():
        yield


async def _asked_elsewhere(wire: "Wire", served: Served, request: Request) -> None:
    raise Refusal(409, f"the controller at {wire.url} asks for decisions; GET /health gives its state")


def _answering(answer: Callable[[Request], Awaitable[Any]]) -> Callable[[Request], Awaitable[Response]]:
    """Wrap an endpoint: answer in JSON, and refuse in one line."""

    async def respond(request: Request) -> Response:
        try:
            given = await answer(request)
            return given if isinstance(given, Response) else _json(given)
        except Refusal as refusal:
            return _error(refusal)
        except HalfseenError as error:
            return _error(Refusal(422, str(error)))
        except Exception as error:
            # The server still answers the next request.
            traceback.print_exc(file=sys.stderr)
            return _error(Refusal(500, f"unexpected error in halfseen ({type(error).__name__}); see its log"))

    return respond


async def _decide(served: Served, request: Request) -> DecisionAnswer:
    trajectories, check = served.answering.trajectories, partial(_check_is_there, request)
    if _content_type(request) == FORM:
        async with cloud_in(request) as cloud:
            return await served.decide(lambda service: seen_in_cloud(service, cloud, served.law, trajectories), check)
    state = await _object(request)
    return await served.decide(lambda service: seen_in_state(service, state, trajectories), check)


async def _reward(served: Served, request: Request) -> models.RecordingProgress:
    given = model_of(await _object(request), models.StageReward)
    return await served.rewarded(given.reward, given.elapsed_s, given.held, given.trajectory)


async def _end(served: Served, request: Request) -> models.EndAnswer:
    given = model_of(await _object(request), models.TrajectoryEnd)
    return await served.ended(given.cause, given.elapsed_s, given.trajectory)


async def _comparison(served: Served, request: Request) -> models.Compared:
    if served.answering.comparison is None:
        raise Refusal(409, "this server compares nothing; start it with --against RULE")
    return served.answering.comparison.facts


async def _reload(served: Served, request: Request) -> models.Reloaded:
    return models.Reloaded((await served.reload()).digest)


async def _health(wire: "Wire | None", served: Served, request: Request) -> models.Health:
    if wire is None:
        return served.health
    is_deciding = {} if wire.facts.is_deciding else {"status": "not deciding"}
    return replace(served.health, **is_deciding, wire=wire.facts)


async def _openapi(served: Served, request: Request) -> dict[str, Any]:
    answering = served.answering
    is_recording, is_comparing = answering.trajectories is not None, answering.comparison is not None
    return described(served.service, is_recording=is_recording, is_comparing=is_comparing)


async def _description(served: Served, request: Request) -> Response:
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    return HTMLResponse(description_of(await _openapi(served, request)), headers={"Content-Security-Policy": policy})


async def _state(served: Served, request: Request) -> models.Cell:
    return cell_of(served.service, served.answering)


async def _page(served: Served, request: Request) -> Response:
    page = page_of(await _state(served, request), served.answering)
    return HTMLResponse(page, headers={"Content-Security-Policy": SECURITY})


async def _object(request: Request) -> dict[str, Any]:
    if _content_type(request) != JSON:
        raise Refusal(415, f"content-type is {_content_type(request)!r}; send JSON, as application/json")
    if (coding := request.headers.get("content-encoding", "identity").lower()) != "identity":
        raise Refusal(415, f"content-encoding is {coding!r:.40}; send it unpacked")
    try:
        given = json_of(await request.body())
    except ValueError as error:
        raise Refusal(400, f"the request is not valid JSON ({str(error)[:100]})") from error
    if not isinstance(given, dict):
        raise Refusal(422, f"the request is a JSON {type(given).__name__}; send one object")
    return given


def _content_type(request: Request) -> str:
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def _json(given: Any, status: int = 200) -> Response:
    body = json.dumps(given, default=to_builtins, allow_nan=False).encode()
    return Response(body, status, media_type=JSON)


def _error(refusal: Refusal) -> Response:
    return _json(refusal.answer, refusal.status)


async def _refused(refusal: Refusal, scope: Any, receive: Any, send: Any) -> None:
    response = _error(refusal)
    # The rest of the request is not read.
    response.headers["connection"] = "close"
    if refusal.status == 401:
        response.headers["www-authenticate"] = 'Basic realm="halfseen"' if scope["method"] == "GET" else "Bearer"
    await response(scope, receive, send)


async def _no_address(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    trouble = "this address does not exist" if status == 404 else f"{request.method} is not answered here"
    refused = _error(Refusal(status, f"{request.url.path[:80]}: {trouble}; /api lists the addresses"))
    refused.headers.update(getattr(error, "headers", None) or {})
    return refused
