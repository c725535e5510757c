"""`kreisel doctor`: what is installed, and whether it works here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import typer


@dataclass(frozen=True)
class _Extra:
    """Modules that come with an extra, and the commands that need them."""

    modules: tuple[str, ...]
    needed_by: str

    def missing(self) -> list[str]:
        """Return the modules that are not installed."""
        from importlib.util import find_spec

        return [name for name in self.modules if find_spec(name) is None]


_EXTRAS = {
    "live": _Extra(("serial",), "record, run and apply at serial lines"),
    "ros2": _Extra(("cyclonedds",), "record and virtual-cell at ros2:// addresses"),
    "serve": _Extra(
        ("starlette", "uvicorn", "websockets"), "station, and --dashboard of record, run, watch and static"
    ),
    "study": _Extra(("distributed",), "study, and batch with several --jobs"),
    "inverse": _Extra(("scipy",), "the estimator that predicts readings (--estimator inverse)"),
    "plot": _Extra(("matplotlib",), "figures in Python: kreisel.plot"),
    "tables": _Extra(("h5py", "pyarrow", "scipy"), "recordings in MATLAB and Parquet files"),
    "xlsx": _Extra(("xlsxwriter",), "batch --xlsx"),
    "certificate": _Extra(("weasyprint", "minisign"), "certificate as PDF or with --key, key and verify"),
}

_MOTION = _Extra(("ruckig",), "simulate, demo, virtual-cell, run and batch --simulate")
"""A part of kreisel itself, except on platforms for which there is no wheel of it."""

_SECONDS, _SEED, _WITHIN = 30.0, 3, 5.0
"""Of the recording of the self-check; standard deviations within which its errors must lie."""


def doctor(json: bool = typer.Option(False, "--json", help="Print one JSON object.")) -> None:
    """Check the installation: environment, compiled library, extras, and a calibration of a simulated recording.

    Exit status 1 if the self-check fails; extras that are missing are named, with the commands that need them.
    """
    import json as json_module

    facts = {"environment": _environment(), "extras": _extras(), "self-check": _self_check()}
    good = bool(facts["self-check"]["passed"])
    missing = _missing()
    if json:
        typer.echo(json_module.dumps({**facts, "missing": missing}))
    else:
        for title, table in facts.items():
            typer.echo(title)
            for name, value in table.items():
                typer.echo(f"  {name:<20}{value}")
        for line in _summary(missing, good=good):
            typer.echo(line)
    if not good:
        raise typer.Exit(1)


def _summary(missing: dict[str, str], *, good: bool) -> list[str]:
    """Return what works and what does not, in a few lines."""
    if not good:
        return ["the self-check failed: install kreisel again, and report this output"]
    if not missing:
        return ["everything works"]
    return [
        "calibration works; not installed is what these need:",
        *(f"  {use}: {get}" for use, get in missing.items()),
    ]


def _missing() -> dict[str, str]:
    """Return what does not work here, and what to install for it."""
    out = {one.needed_by: f"pip install 'kreisel[{name}]'" for name, one in _EXTRAS.items() if one.missing()}
    if _MOTION.missing():
        out[_MOTION.needed_by] = "pip install ruckig"
    if (pango := _without_pango()) is not None:
        out["certificate as PDF"] = (
            f"the system's Pango ({pango}); on Debian apt install libpango-1.0-0 libpangoft2-1.0-0"
        )
    return out


def _without_pango() -> str | None:
    """Return why certificates cannot be PDF although their extra is installed; None if they can, or if it is not."""
    if _EXTRAS["certificate"].missing():
        return None
    import warnings

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what later versions of weasyprint will need
            import weasyprint  # noqa: F401 - it loads the system's library
    except OSError as error:
        return str(error).splitlines()[0][:60]
    return None


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
    out = {}
    for extra, one in _EXTRAS.items():
        missing = one.missing()
        out[extra] = "installed" if not missing else f"missing: {', '.join(missing)}; pip install 'kreisel[{extra}]'"
    if (pango := _without_pango()) is not None:
        out["certificate"] = f"HTML only: the system's Pango is missing ({pango})"
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
