"""The signal at which servers read their files again."""

import asyncio
import signal
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from halfseen.errors import HalfseenError


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
