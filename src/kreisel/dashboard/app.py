"""The server of the page: one reader of the recording, any number of browsers, none of which it waits for."""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib import resources
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from kreisel.acquisition.tail import Tail
from kreisel.dashboard.feed import Feed, Message
from kreisel.dashboard.online import Online
from kreisel.errors import KreiselError

PERIOD = 0.05
"""Seconds between two looks at the recording."""

_WAITING = 400  # messages that may wait for a browser before it is let go
_LOOPBACK = ("127.0.0.1", "localhost", "::1")


class Hub:
    """Browsers, and what is sent to them."""

    def __init__(self, path: Path) -> None:
        self.feed = Feed(path)
        self._online = Online(Tail(path))
        self._queues: set[asyncio.Queue[str]] = set()

    async def follow(self) -> None:
        """Tell all browsers what is new, for ever."""
        estimating = asyncio.ensure_future(self._estimate())
        try:
            while True:
                with suppress(KreiselError):
                    for message in await asyncio.to_thread(self.feed.news):
                        self._tell(message)
                await asyncio.sleep(PERIOD)
        finally:
            estimating.cancel()

    async def _estimate(self) -> None:
        """Calibrate what there is by now, beside all else."""

        def step() -> Message | None:
            with suppress(KreiselError):
                found = self._online.look()
                return None if found is None else self.feed.estimate(found)
            return None

        while True:
            message = await asyncio.to_thread(step)
            if message is not None:
                self._tell(message)
            await asyncio.sleep(0.2)

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[asyncio.Queue[str]]:
        """Yield the messages for one browser, beginning with all so far."""
        queue: asyncio.Queue[str] = asyncio.Queue(_WAITING)
        for message in self.feed.so_far()[-_WAITING:]:
            queue.put_nowait(json.dumps(message))
        self._queues.add(queue)
        try:
            yield queue
        finally:
            self._queues.discard(queue)

    def _tell(self, message: Message) -> None:
        text = json.dumps(message)
        for queue in list(self._queues):
            try:
                queue.put_nowait(text)
            except asyncio.QueueFull:
                self._queues.discard(queue)


def make_app(path: Path, host: str = "127.0.0.1") -> tuple[Starlette, str | None]:
    """Return the page's server for a recording, and the token browsers need if it is not for this machine alone.

    Parameters
    ----------
    host
        The address it will be served on.
    """
    hub = Hub(path)
    token = None if host in _LOOPBACK else secrets.token_urlsafe(16)

    def may(given: str | None) -> bool:
        return token is None or secrets.compare_digest(given or "", token)

    async def page(request: Request) -> Response:
        if not may(request.query_params.get("token")):
            return PlainTextResponse("the token is missing or wrong: use the address that was printed", 403)
        text = resources.files("kreisel.dashboard").joinpath("page.html").read_text(encoding="utf-8")
        policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'"
        return HTMLResponse(text, headers={"Content-Security-Policy": policy})

    async def live(socket: WebSocket) -> None:
        origin = socket.headers.get("origin", "").partition("//")[2]
        if not may(socket.query_params.get("token")) or origin not in ("", socket.headers.get("host")):
            await socket.close(1008)
            return
        await socket.accept()
        async with hub.listening() as queue:
            leaving = asyncio.ensure_future(socket.receive())
            with suppress(WebSocketDisconnect, RuntimeError):
                while not leaving.done():
                    with suppress(TimeoutError):
                        async with asyncio.timeout(1.0):
                            await socket.send_text(await queue.get())
            leaving.cancel()

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        following = asyncio.ensure_future(hub.follow())
        yield
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)

    guard = [Middleware(TrustedHostMiddleware, allowed_hosts=[*_LOOPBACK])] if token is None else []
    routes = [Route("/", page), WebSocketRoute("/live", live)]
    return Starlette(routes=routes, middleware=guard, lifespan=lifespan), token
