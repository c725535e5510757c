"""Connections of the page that ask for nothing are closed, so that they cannot use up what a process may open."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

PATIENCE = 10.0
"""Seconds within which a connection has to send a whole request. Chosen: a browser on a slow network needs one."""


class Impatient(H11Protocol):
    """HTTP for a server of uvicorn; a connection without a request in time is closed."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        asyncio.get_running_loop().call_later(PATIENCE, self._look, transport)

    def _look(self, transport: Any) -> None:
        if transport.get_protocol() is self and self.cycle is None:  # else it became a WebSocket, or was answered
            transport.close()
