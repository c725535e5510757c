"""`kreisel watch`: estimates of a recording while it is made, in the terminal or on a page."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.units import DEG_PER_HOUR, MG, MS

if TYPE_CHECKING:
    from collections.abc import Iterator

DASHBOARD: Any = typer.Option(False, "--dashboard", help="Serve a page that shows the recording.")
PORT: Any = typer.Option(8321, "--port", min=0, max=65535, help="The page's port; 0 for any.")
"""Options of several commands. 8321 is chosen: a port above those that need privileges, up to 1023."""


def watch(
    recording: Path = typer.Argument(..., help="A recording that is being made: an .mcap file, or its folder."),
    dashboard: bool = DASHBOARD,
    guide: bool = typer.Option(False, hidden=True, help="Serve the page of `kreisel static --live` instead."),
    host: str = typer.Option(
        "127.0.0.1", help="Address to serve the page on; any other than this machine's own needs a token."
    ),
    port: int = PORT,
    as_json: bool = typer.Option(False, "--json", help="Print every estimate as one line of JSON."),
) -> None:
    """Calibrate a recording again and again while it grows; end when it ends. The recorder is not disturbed."""
    if as_json and (guide or dashboard):
        from kreisel.errors import SettingsError

        raise SettingsError("--json prints estimates, --dashboard serves a page; give one of them")
    if guide or dashboard:
        _serve(recording, host, port, guide=guide)
    else:
        _print(recording, as_json=as_json)


def check_page_installed() -> None:
    """Check that what serves pages is there, before a recording or a motion begins.

    Raises
    ------
    SettingsError
        If it is not.
    """
    from importlib.util import find_spec

    from kreisel.errors import SettingsError

    missing = next((name for name in ("starlette", "uvicorn", "websockets") if find_spec(name) is None), None)
    if missing is not None:
        raise SettingsError(f"the page needs an extra ({missing}): pip install 'kreisel[serve]'")


@contextmanager
def page_of(
    output: Path, port: int, *, wanted: bool, guide: bool = False, host: str = "127.0.0.1", beside_json: bool = False
) -> Iterator[None]:
    """Serve the page of a recording that is being made, from a separate process, which cannot delay the recorder.

    Parameters
    ----------
    wanted
        Whether to serve it at all.
    guide
        Whether it is that of `kreisel static --live`.
    beside_json
        Whether its address goes to standard error, because standard output is for an object.

    Raises
    ------
    SettingsError, DeviceError
        If what serves pages is not installed, or the port is used already.
    """
    import os
    import subprocess
    import sys

    if not wanted:
        yield
        return
    check_page_installed()
    from kreisel.dashboard.serving import listening

    listening(host, port).close()
    program = [sys.executable, "-P", "-m", "kreisel.cli.main"]  # -P: no modules from the working folder
    page = "--guide" if guide else "--dashboard"
    environment = {**os.environ, _PARENT: str(os.getpid())}
    watching = [*program, "watch", str(output), page, "--port", str(port), "--host", host]
    server = subprocess.Popen(watching, env=environment, stdout=sys.stderr if beside_json else None)
    try:
        yield
    finally:
        server.terminate()
        server.wait()


def _print(recording: Path, *, as_json: bool) -> None:
    import json
    import time

    from kreisel.acquisition.tail import Tail
    from kreisel.dashboard.online import Online

    tail = Tail(recording, bounded=True)
    online = Online(tail)
    while True:
        found = online.look()
        if found is not None and as_json:
            typer.echo(json.dumps({
                "seconds": found.seconds, "accepted": found.accepted, "summary": found.summary,
                "estimates": dict(zip(found.names, found.values.tolist(), strict=True)),
                "standard_deviations": dict(zip(found.names, found.deviations.tolist(), strict=True)),
            }))  # fmt: skip
        elif found is not None:
            deviations = dict(zip(found.names, found.deviations, strict=True))
            typer.echo(f"{found.seconds:7.1f} s  {_summary(deviations)}{found.summary}")
        if tail.ended and found is not None:
            return
        time.sleep(0.2)


def _summary(deviations: dict[str, float]) -> str:
    """Return the text of the most important standard deviations; empty where there are none."""
    parts = []
    for group, unit, factor in (
        ("accelerometer.offset", "mg", 1.0 / MG), ("gyroscope.offset", "deg/h", 1.0 / DEG_PER_HOUR),
        ("timing.offset", "ms", 1.0 / MS),
    ):  # fmt: skip
        found = [value for name, value in deviations.items() if name.startswith(group)]
        if found:
            parts.append(f"{group} ±{max(found) * factor:.3g} {unit}")
    return "; ".join(parts) + ("; " if parts else "")


def _serve(recording: Path, host: str, port: int, *, guide: bool) -> None:
    import os
    import threading

    from kreisel.errors import SettingsError

    try:
        from kreisel.acquisition.tail import Tail
        from kreisel.dashboard.app import make_app
        from kreisel.dashboard.feed import Feed
        from kreisel.dashboard.guide_feed import GuideFeed
        from kreisel.dashboard.online import Online
        from kreisel.dashboard.serving import address_of, listening, server_of
    except ImportError as error:
        raise SettingsError(f"the page needs an extra ({error.name}): pip install 'kreisel[serve]'") from error
    if guide:
        app, token = make_app(GuideFeed(recording), host, "guide.html")
    else:
        app, token = make_app(Feed(recording, Online(Tail(recording, bounded=True)).look), host)
    listener = listening(host, port)
    typer.echo(address_of(listener, host, token))
    server = server_of(app)
    if os.environ.get(_PARENT):
        parent = int(os.environ[_PARENT])
        threading.Thread(target=_end_with, args=(parent, server), daemon=True).start()
    server.run(sockets=[listener])


_PARENT = "KREISEL_PAGE_OF"
"""Environment variable with the process whose recording the page shows."""


def _end_with(parent: int, server: Any) -> None:
    """End a page whose recorder has ended, however that happened."""
    import os
    import time

    while os.getppid() == parent:
        time.sleep(0.5)
    server.should_exit = True
