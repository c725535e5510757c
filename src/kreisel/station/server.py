"""The server of a station's page: what the page, or a program in its place, asks for."""

from __future__ import annotations

import json
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from kreisel.dashboard.app import POLICY, Answer, make_app
from kreisel.errors import KreiselError, SettingsError
from kreisel.station.station import Station

_LARGEST = 4096
"""Bytes of a request. Chosen: a serial number and a name take 400."""


def station_app(station: Station, host: str = "127.0.0.1") -> tuple[Starlette, str | None]:
    """Return the server of a station, and the token that it needs if it serves other machines.

    Notes
    -----
    `POST /start {"serial": …, "operator": …}`, `POST /stop {}`, `POST /printed {"attempt": …}` answer `{}`, or with
    status 409 `{"error": …}`; `GET /state` is the message of the page, `/certificate/N`, `/report/N`, `/unit/N` are
    files of attempt N.
    """

    async def start(request: Request) -> Response:
        asked = await _asked(request)
        attempt = station.start(str(asked.get("serial", "")), str(asked.get("operator", "")))
        return JSONResponse({"attempt": attempt.id})

    async def stop(request: Request) -> Response:
        await _asked(request)
        station.stop()
        return JSONResponse({})

    async def printed(request: Request) -> Response:
        station.printed(_number((await _asked(request)).get("attempt")))
        return JSONResponse({})

    async def state(_: Request) -> Response:
        return JSONResponse(station.so_far()[0])

    async def certificate(request: Request) -> Response:
        return _page(station.certificate(_number(request.path_params["number"])))

    async def report(request: Request) -> Response:
        return _page(station.report(_number(request.path_params["number"])))

    async def document(request: Request) -> Response:
        path = station.document(_number(request.path_params["number"]))
        return Response(path.read_bytes(), media_type="application/json") if path.is_file() else _missing(path)

    def checked(answer: Answer) -> Answer:
        async def answered(request: Request) -> Response:
            try:
                return await answer(request)
            except KreiselError as error:
                return JSONResponse({"error": str(error)}, 409)

        return answered

    asked: list[tuple[str, str, Answer]]
    asked = [("POST", "/start", start), ("POST", "/stop", stop), ("POST", "/printed", printed)]
    asked += [
        ("GET", "/state", state),
        ("GET", "/certificate/{number}", certificate),
        ("GET", "/report/{number}", report),
    ]
    asked += [("GET", "/unit/{number}", document)]
    more = [(method, path, checked(answer)) for method, path, answer in asked]
    return make_app(station, host, "station.html", more, station.at_work)


async def _asked(request: Request) -> dict[str, object]:
    """Return the object of a request.

    Raises
    ------
    SettingsError
        If it is none, or not said to be JSON: forms of other pages cannot say so.
    """
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise SettingsError("expected content-type application/json")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST:
            raise SettingsError(f"expected at most {_LARGEST} bytes")
    try:
        found = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"not JSON: {error}") from error
    if not isinstance(found, dict):
        raise SettingsError("expected one JSON object")
    return found


def _number(text: object) -> int:
    if (
        not (isinstance(text, int) or (isinstance(text, str) and text.isascii() and text.isdigit()))
        or len(f"{text}") > 9
    ):
        raise SettingsError(f"attempt {str(text)[:20]}: expected its number")
    return int(text)


def _page(path: Path) -> Response:
    if not path.is_file():
        return _missing(path)
    return HTMLResponse(path.read_bytes(), headers={"Content-Security-Policy": f"{POLICY}; img-src data:"})


def _missing(path: Path) -> Response:
    return JSONResponse({"error": f"{path.name}: there is none"}, 404)
