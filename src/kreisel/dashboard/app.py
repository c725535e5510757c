"""The server of the page: one reader of the recording, any number of browsers; it waits for none of them."""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext, suppress
from importlib import resources
from typing import Protocol

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from kreisel.dashboard.message import Message
from kreisel.errors import KreiselError

PERIOD = 0.05
"""Seconds between two reads of the recording."""

_WAITING = 400  # messages that may wait for a browser before it is disconnected
_TRY_AGAIN = 1013  # close code of WebSockets: try again later
_LOOPBACK = ("127.0.0.1", "localhost", "::1")


class Source(Protocol):
    """Where the page's messages come from."""

    def news(self) -> list[Message]:
        """Return new messages, soon."""

    def look(self) -> Message | None:
        """Return a message that takes its time, such as an estimate, if one is due."""

    def so_far(self) -> list[Message]:
        """Return what a newly connected browser is sent first."""


class Browser:
    """The messages that are still to be sent to one browser.

    Parameters
    ----------
    backlog
        Messages that are sent first; any number.

    Attributes
    ----------
    behind
        Set when too many messages wait: the browser is disconnected, and has to connect again.
    """

    def __init__(self, backlog: Iterable[str]) -> None:
        self.behind = asyncio.Event()
        self._backlog = list(backlog)
        self._queue: asyncio.Queue[str] = asyncio.Queue(_WAITING)

    def tell(self, text: str) -> None:
        """Queue a message, without waiting for the browser."""
        try:
            self._queue.put_nowait(text)
        except asyncio.QueueFull:
            self.behind.set()

    async def messages(self) -> AsyncIterator[str]:
        """Yield the messages to be sent, without end."""
        while self._backlog:
            yield self._backlog.pop(0)
        while True:
            yield await self._queue.get()


class Hub:
    """The connected browsers, and the messages that are sent to them."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self._browsers: set[Browser] = set()
        self._sending = asyncio.Lock()  # a browser is added between two messages: none is sent to it twice

    async def follow(self) -> None:
        """Send new messages to all browsers, without end."""
        estimating = asyncio.ensure_future(self._estimate())
        try:
            while True:
                with suppress(KreiselError):
                    async with self._sending:
                        for message in await asyncio.to_thread(self.source.news):
                            self.tell(message)
                await asyncio.sleep(PERIOD)
        finally:
            estimating.cancel()

    async def _estimate(self) -> None:
        """Look for what takes its time, in parallel to all other tasks."""

        def look() -> Message | None:
            with suppress(KreiselError):
                return self.source.look()
            return None

        while True:
            found = await asyncio.to_thread(look)
            if found is not None:
                self.tell(found)
            await asyncio.sleep(0.2)

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[Browser]:
        """Yield a new browser, which is sent the messages so far and then the new ones."""
        async with self._sending:
            browser = Browser(map(json.dumps, self.source.so_far()))
            self._browsers.add(browser)
        try:
            yield browser
        finally:
            self._browsers.discard(browser)

    def tell(self, message: Message) -> None:
        """Send a message to all browsers."""
        text = json.dumps(message)
        for browser in self._browsers:
            browser.tell(text)


Answer = Callable[[Request], Awaitable[Response]]
"""What answers a request."""

POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"
"""What pages may load: nothing. Those here add what they need."""


def make_app(
    source: Source,
    host: str = "127.0.0.1",
    page_file: str = "page.html",
    more: Sequence[tuple[str, str, Answer]] = (),
    life: Callable[[], AbstractAsyncContextManager[None]] = nullcontext,
) -> tuple[Starlette, str | None]:
    """Return the page's server, and the token that browsers need if it serves other machines, too.

    Parameters
    ----------
    page_file
        The page, of this package.
    host
        The address that the page is served on.
    more
        Method, path and answer of what else is served, only to the page itself and to whoever has the token.
    life
        Entered when the server starts, and left when it ends.
    """
    hub = Hub(source)
    token = None if host in _LOOPBACK else secrets.token_urlsafe(16)

    def may(given: str | None) -> bool:
        return token is None or secrets.compare_digest((given or "").encode(), token.encode())

    def guarded(answer: Answer) -> Answer:
        async def answered(request: Request) -> Response:
            if not _is_own(request):
                return PlainTextResponse("the request comes from another page: open the address that was printed", 403)
            if not may(request.query_params.get("token")):
                return PlainTextResponse("the token is missing or wrong: use the address that was printed", 403)
            return await answer(request)

        return answered

    async def page(_: Request) -> Response:
        text = resources.files("kreisel.dashboard").joinpath(page_file).read_text(encoding="utf-8")
        frames = "; frame-src 'self'" if more else ""
        policy = f"{POLICY}; connect-src 'self'{frames}"
        return HTMLResponse(text, headers={"Content-Security-Policy": policy})

    async def live(socket: WebSocket) -> None:
        if not _is_own(socket) or not may(socket.query_params.get("token")):
            await socket.close(1008)
            return
        await socket.accept()
        async with hub.listening() as browser:
            ends = [
                asyncio.ensure_future(end) for end in (_send(socket, browser), socket.receive(), browser.behind.wait())
            ]
            try:
                await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for end in ends:
                    end.cancel()
                await asyncio.gather(*ends, return_exceptions=True)
        if browser.behind.is_set():
            with suppress(TimeoutError, RuntimeError):  # the connection ends with this handler in any case
                async with asyncio.timeout(1.0):
                    await socket.close(_TRY_AGAIN, "too far behind: connect again")

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        async with life():
            following = asyncio.ensure_future(hub.follow())
            yield
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)

    guard = [Middleware(TrustedHostMiddleware, allowed_hosts=[*_LOOPBACK])] if token is None else []
    pages = [("GET", "/", page), *more]
    routes = [Route(path, guarded(answer), methods=[method]) for method, path, answer in pages]
    return Starlette(routes=[*routes, WebSocketRoute("/live", live)], middleware=guard, lifespan=lifespan), token


def _is_own(connection: HTTPConnection) -> bool:
    """Return whether a request has no `Origin`, or exactly the scheme, host and port of the address it is sent to.

    Sandboxed pages and files send `Origin: null`, which is refused.
    """
    scheme = {"ws": "http", "wss": "https"}.get(connection.url.scheme, connection.url.scheme)
    own = f"{scheme}://{connection.headers.get('host', '')}"
    return all(origin == own for origin in connection.headers.getlist("origin"))


async def _send(socket: WebSocket, browser: Browser) -> None:
    async for message in browser.messages():
        await socket.send_text(message)
