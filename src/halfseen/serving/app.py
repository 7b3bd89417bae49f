"""The app: what is asked by which address, and in which form it is answered."""

import asyncio
import json
import signal
import sys
import threading
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from halfseen.errors import HalfseenError
from halfseen.reading import json_of
from halfseen.serving.answering import Answering, InService, Seen, seen_in_cloud, seen_in_state, taken_into_service
from halfseen.serving.limits import LARGEST_CLOUD_BYTES, LARGEST_STATE_BYTES, App, Bounded, Refusal, cloud_in
from halfseen.serving.openapi import described, page_of
from halfseen.serving.recording import RecordedTrajectories


@asynccontextmanager
async def reloading_at_hang_up(reload: Callable[[], Awaitable[Any]]) -> AsyncIterator[None]:
    """Reload at SIGHUP for a while, where there is such a signal; what cannot be read is told on stderr.

    Parameters
    ----------
    reload
        Reads the files again, or raises `HalfseenError` and leaves all as it was.
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
            print(f"halfseen: {error}; the policy before goes on", file=sys.stderr)

    def begin() -> None:
        task = loop.create_task(tell())
        running.add(task)
        task.add_done_callback(running.discard)

    loop.add_signal_handler(hang_up, begin)
    try:
        yield
    finally:
        loop.remove_signal_handler(hang_up)


if TYPE_CHECKING:
    from halfseen.policies.table_observation import SeenLaw

Answer = Callable[[Request], Awaitable[Any]]


@dataclass(eq=False)
class Served:
    """A policy that is served, and what it is served with.

    Parameters
    ----------
    folder
        Of the policy; it is read again where a reload is asked for.
    answering
        How decisions are taken and kept.
    extrapolates
        Whether to decide far outside what the logs showed, too.
    law
        Of tables, what a cell's law tells of labels; None for the assumed one.
    """

    folder: Path
    answering: Answering = field(default_factory=Answering)
    extrapolates: bool = False
    law: "SeenLaw | None" = None

    def __post_init__(self) -> None:
        self.service = self.read()
        self.lock = asyncio.Lock()

    def read(self) -> InService:
        """Read the policy as it is in its folder now; raises what `taken_into_service` does."""
        return taken_into_service(self.folder, extrapolates=self.extrapolates)

    async def reload(self) -> InService:
        """Put the policy of the folder in the place of the one that answers; requests go on meanwhile.

        Raises
        ------
        PolicyError
            The folder cannot be read; what answered goes on.
        """
        fresh = await run_in_threadpool(self.read)
        async with self.lock:
            self.service = fresh
        return fresh

    @property
    def trajectories(self) -> RecordedTrajectories:
        """What records.

        Raises
        ------
        Refusal
            Nothing is recorded.
        """
        if self.answering.trajectories is None:
            raise Refusal(409, "this server records nothing; start it with --record LOGS")
        return self.answering.trajectories

    async def answer(self, request: Request, look: Callable[[InService], Seen]) -> dict[str, Any]:
        """Look, decide and record, one at a time; tables decide beside the loop, so that others are answered.

        Raises
        ------
        Refusal
            It cannot be recorded, or nobody would learn what was decided; then nothing was.
        """
        async with self.lock:
            service = self.service

            def decide() -> tuple[Seen, dict[str, Any]]:
                seen = look(service)
                return seen, self.answering.answer(service, seen)

            if not service.stored.is_table:
                return self.answering.recorded(*decide())
            await _check_is_there(request)
            seen, told = await run_in_threadpool(decide)
            await _check_is_there(request)
            return await run_in_threadpool(self.answering.recorded, seen, told)


async def _check_is_there(request: Request) -> None:
    if await request.is_disconnected():
        raise Refusal(408, "the client has gone; nothing is decided")


def app_of(served: Served, token: str | None = None, *, largest_bytes: int | None = None) -> App:
    """Make an ASGI app of a policy that is served.

    Parameters
    ----------
    served
        The policy.
    token
        That each request must bring; None where none is asked for.
    largest_bytes
        Of a request; None for 1 MiB, and 64 MiB where clouds may come.
    """
    asked = {
        "/decide": ("POST", _decide),
        "/reward": ("POST", _reward),
        "/end": ("POST", _end),
        "/reload": ("POST", _reload),
        "/health": ("GET", _health),
        "/openapi.json": ("GET", _openapi),
    }
    routes = [
        Route(trajectory, _told(partial(answer, served)), methods=[how]) for trajectory, (how, answer) in asked.items()
    ]
    page = Route("/", _page(served), methods=["GET"])
    refused: Any = {HTTPException: _no_address}
    app = Starlette(
        routes=[*routes, page], exception_handlers=refused, lifespan=lambda _: reloading_at_hang_up(served.reload)
    )
    largest = largest_bytes or (LARGEST_CLOUD_BYTES if served.service.stored.is_table else LARGEST_STATE_BYTES)
    return Bounded(app, _refused, token, largest)  # type: ignore[arg-type]


def _told(answer: Answer) -> Callable[[Request], Awaitable[Response]]:
    """Answer in JSON; what is refused in one line."""

    async def respond(request: Request) -> Response:
        try:
            return _json(await answer(request))
        except Refusal as refusal:
            return _error(refusal)
        except HalfseenError as error:
            return _error(Refusal(422, str(error)))
        except Exception as error:
            # The next request is answered all the same.
            traceback.print_exc(file=sys.stderr)
            return _error(Refusal(500, f"this went wrong in halfseen itself ({type(error).__name__}); see its log"))

    return respond


async def _decide(served: Served, request: Request) -> dict[str, Any]:
    kind = _content_type(request)
    if kind == "multipart/form-data":
        return await _decide_cloud(served, request)
    state, trajectories = await _object(request), served.answering.trajectories

    def look(service: InService) -> Seen:
        return seen_in_state(service, state, None if trajectories is None else trajectories.next_stage())

    return await served.answer(request, look)


async def _decide_cloud(served: Served, request: Request) -> dict[str, Any]:
    async with cloud_in(request) as given:
        trajectories = served.answering.trajectories
        return await served.answer(request, lambda service: seen_in_cloud(service, *given, served.law, trajectories))


async def _reward(served: Served, request: Request) -> dict[str, Any]:
    told = await _object(request, required=("reward",), others=("elapsed_s", "held"))
    async with served.lock:
        return served.trajectories.rewarded(told["reward"], told.get("elapsed_s"), told.get("held"))


async def _end(served: Served, request: Request) -> dict[str, Any]:
    told = await _object(request, required=("ending",), others=("cause", "elapsed_s"))
    ending, cause = told["ending"], told.get("cause")
    if ending not in ("finished", "cut") or (ending == "cut") != isinstance(cause, str):
        raise Refusal(422, 'give {"ending": "finished"}, or {"ending": "cut", "cause": "operator"}, or what cut it')
    async with served.lock:
        return served.trajectories.ended(cause, told.get("elapsed_s"))


async def _reload(served: Served, request: Request) -> dict[str, Any]:
    return {"policy": (await served.reload()).digest}


async def _health(served: Served, request: Request) -> dict[str, Any]:
    service, trajectories = served.service, served.answering.trajectories
    told = {"status": "ok", "policy": service.digest, "kind": service.stored.record["kind"]}
    return told if trajectories is None else {**told, "recording": trajectories.facts}


async def _openapi(served: Served, request: Request) -> dict[str, Any]:
    return described(served.service, is_recording=served.answering.trajectories is not None)


def _page(served: Served) -> Callable[[Request], Awaitable[Response]]:
    async def page(request: Request) -> Response:
        is_recording = served.answering.trajectories is not None
        policy = "default-src 'none'; style-src 'unsafe-inline'"
        page = page_of(described(served.service, is_recording=is_recording))
        return HTMLResponse(page, headers={"Content-Security-Policy": policy})

    return page


async def _object(request: Request, required: tuple[str, ...] = (), others: tuple[str, ...] = ()) -> dict[str, Any]:
    """Read the JSON object of a request; with names, it holds the required ones, and nothing but these and others."""
    if _content_type(request) != "application/json":
        raise Refusal(415, f"content-type is {_content_type(request)!r}; send JSON, as application/json")
    try:
        told = json_of(await request.body())
    except ValueError as error:
        raise Refusal(400, f"the request is no JSON ({str(error)[:100]})") from error
    if not isinstance(told, dict):
        raise Refusal(422, f"the request is a JSON {type(told).__name__}; send one object")
    missing = [name for name in required if name not in told]
    unknown = [name for name in told if required and name not in (*required, *others)]
    if missing or unknown:
        wrong = f"there is no {missing[0]!r}" if missing else f"nothing is known of {unknown[0][:40]!r}"
        raise Refusal(422, f"the request: {wrong}; give {', '.join(required)} and, if wanted, {', '.join(others)}")
    return told


def _content_type(request: Request) -> str:
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def _json(told: Any, status: int = 200) -> Response:
    body = json.dumps(told, allow_nan=False).encode()
    return Response(body, status, media_type="application/json")


def _error(refusal: Refusal) -> Response:
    return _json({"error": refusal.message}, refusal.status)


async def _refused(refusal: Refusal, scope: Any, receive: Any, send: Any) -> None:
    response = _error(refusal)
    # What is left of the request is not read.
    response.headers["connection"] = "close"
    if refusal.status == 401:
        response.headers["www-authenticate"] = "Bearer"
    await response(scope, receive, send)


async def _no_address(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    trouble = "there is nothing at this address" if status == 404 else f"{request.method} is not answered here"
    return _error(Refusal(status, f"{request.url.path[:80]}: {trouble}; / lists what there is"))
