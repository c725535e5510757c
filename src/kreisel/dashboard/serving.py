"""A page's server: where it listens, and how it runs."""

from __future__ import annotations

import socket

import uvicorn
from starlette.applications import Starlette

from kreisel.dashboard.patience import Impatient
from kreisel.errors import DeviceError


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 is any that is free.

    Raises
    ------
    DeviceError
        If the address cannot be used.
    """
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise DeviceError(
            f"http://{host}:{port}: cannot be served ({error.strerror}); choose another --port"
        ) from error
    return listener


def address_of(listener: socket.socket, host: str, token: str | None) -> str:
    """Return the address to open, with the token where one is needed."""
    secret = "" if token is None else f"/?token={token}"
    return f"http://{f'[{host}]' if ':' in host else host}:{listener.getsockname()[1]}{secret}"


def server_of(app: Starlette) -> uvicorn.Server:
    """Return the server of a page; `run(sockets=[listener])` serves until it is interrupted."""
    return uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="websockets-sansio", http=Impatient))
