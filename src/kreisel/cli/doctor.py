"""`kreisel doctor`: what is installed, and whether it works here."""

from __future__ import annotations

from typing import Any

import typer

_EXTRAS = {
    "robot": ("pinocchio", "ruckig", "scipy"),
    "live": ("serial",),
    "serve": ("starlette", "uvicorn", "websockets"),
    "study": ("distributed",),
    "tables": ("h5py", "pyarrow", "scipy"),
    "certificate": ("weasyprint", "minisign"),
}
"""Modules of each extra."""

_SECONDS, _SEED, _WITHIN = 30.0, 3, 5.0
"""Of the recording of the self-check; standard deviations within which its errors must lie."""


def doctor(json: bool = typer.Option(False, "--json", help="Print one JSON object.")) -> None:
    """Check the installation: environment, compiled library, extras, and a calibration of a simulated recording.

    Exit status 1 if the self-check fails.
    """
    import json as json_module

    facts = {"environment": _environment(), "extras": _extras(), "self-check": _self_check()}
    good = bool(facts["self-check"]["passed"])
    if json:
        typer.echo(json_module.dumps(facts))
    else:
        for title, table in facts.items():
            typer.echo(title)
            for name, value in table.items():
                typer.echo(f"  {name:<20}{value}")
        typer.echo(
            "everything works" if good else "the self-check failed: install kreisel again, and report this output"
        )
    if not good:
        raise typer.Exit(1)


def _environment() -> dict[str, Any]:
    import os
    import platform
    import shutil
    import sys
    import tempfile
    from pathlib import Path

    import numpy as np

    import kreisel
    from kreisel._kernels import compiled

    library = Path(compiled.__file__).parent
    files = [path.name for path in library.iterdir() if path.suffix in (".so", ".dylib", ".dll")]
    free = shutil.disk_usage(tempfile.gettempdir()).free
    return {
        "kreisel": kreisel.__version__,
        "python": f"{platform.python_version()}, {sys.executable}",
        "numpy": np.__version__,
        "system": platform.platform(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "compiled library": ", ".join(files) or "missing",
        "instructions": os.environ.get("KREISEL_INSTRUCTIONS", "the best this processor has"),
        "temporary files": f"{tempfile.gettempdir()}, {free / 1e9:.1f} GB free",
        "cache": "none is used",
    }


def _extras() -> dict[str, str]:
    """Return for each extra whether it is installed; of certificates whether the system's Pango is there, too."""
    from importlib.util import find_spec

    out = {}
    for extra, modules in _EXTRAS.items():
        missing = [name for name in modules if find_spec(name) is None]
        out[extra] = "installed" if not missing else f"missing: {', '.join(missing)}; pip install 'kreisel[{extra}]'"
    if out["certificate"] == "installed":
        try:
            import weasyprint  # noqa: F401 - it loads the system's library
        except OSError as error:
            out["certificate"] = f"HTML only: the system's Pango is missing ({str(error).splitlines()[0][:60]})"
    return out


def _self_check() -> dict[str, Any]:
    """Simulate a recording, calibrate it, and compare the result with the truth."""
    import time

    import numpy as np

    from kreisel.calibration.calibrate import calibrate
    from kreisel.calibration.data_sheet import QUANTITIES
    from kreisel.errors import KreiselError
    from kreisel.simulation.free_motion import free_recording

    began = time.perf_counter()
    try:
        truth, recording = free_recording(_SECONDS, np.random.default_rng(_SEED))
        found = calibrate(recording)
    except KreiselError as error:
        return {"passed": False, "error": str(error)}
    scores = []
    for quantity in QUANTITIES:
        own = found.derived[quantity.name]
        if quantity.name != "mounting_rotation_deg":
            scores.append(np.abs(own.value - quantity.value(truth)) / own.deviation)
    worst = float(np.max(scores))
    return {
        "passed": bool(found.accepted and worst < _WITHIN),
        "verdict": found.verdict.headline,
        "largest error": f"{worst:.1f} standard deviations, of {np.size(scores)} figures",
        "time": f"{time.perf_counter() - began:.1f} s",
    }
