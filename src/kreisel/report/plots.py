"""Elements of the plots on a page: plain dictionaries, arrays in base64, colours by name.

A colour is written ``@name`` or ``@name/opacity``; the page replaces it by that of the light or the dark palette. The
page draws them with uPlot; `templates/report.js` says what each kind of trace looks like.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.report.thinning import Curve, Envelope

Plot = dict[str, Any]
"""Panels above each other, with a common horizontal axis."""

Trace = dict[str, Any]

TIME = "IMU time (s)"
"""Title of the axis of time."""

HEIGHT = 300
"""Pixels of a usual plot."""

LEVELS = 65_534
"""Steps to which an array is rounded over its range; far finer than a screen."""

PALETTES: dict[str, dict[str, str]] = {
    "light": {
        "x": "0,101,163",
        "y": "205,84,0",
        "z": "0,140,100",
        "alert": "170,51,119",
        "ink": "34,42,53",
        "muted": "96,106,118",
        "grid": "226,230,235",
        "line": "160,168,178",
        "ground": "255,255,255",
    },
    "dark": {
        "x": "98,181,235",
        "y": "245,151,79",
        "z": "64,199,153",
        "alert": "236,138,190",
        "ink": "222,227,233",
        "muted": "157,168,180",
        "grid": "47,54,63",
        "line": "92,102,114",
        "ground": "24,28,33",
    },
}
"""Red, green and blue of every named colour; x, y, z after Okabe and Ito: colour-blind people can distinguish them."""


def packed(values: NDArray[Any]) -> dict[str, Any]:
    """Return an array (n,) in 16 bits: what a screen can show; what is not finite becomes a gap."""
    own = np.asarray(values, dtype=float).ravel()
    good = np.isfinite(own)
    low = float(own[good].min()) if good.any() else 0.0
    step = (float(own[good].max()) - low) / LEVELS if good.any() else 0.0
    levels = np.full(own.size, LEVELS + 1, dtype="<u2")
    levels[good] = np.round((own[good] - low) / step) if step > 0.0 else 0
    return {"low": low, "step": step, "data": base64.b64encode(levels.tobytes()).decode("ascii")}


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis: its title, and `range` (low, high), `log`, `ticks` (values, texts), where it has them."""
    return {"title": title, **more}


def logarithmic(title: str, low: float, high: float) -> dict[str, Any]:
    """Return a logarithmic axis from 10^low to 10^high."""
    return axis(title, log=True, range=[10.0 ** (low - 0.15), 10.0 ** (high + 0.15)])


def panel(traces: Sequence[Trace], y: dict[str, Any], *, height: int = HEIGHT, **more: Any) -> dict[str, Any]:
    """Return one panel: `rules` are vertical lines, `equal` makes both axes of one scale, `remark` stands in it."""
    return {"traces": list(traces), "y": y, "height": height, **more}


def plot(x: dict[str, Any], *panels: dict[str, Any]) -> Plot:
    """Return panels over a common horizontal axis."""
    return {"x": x, "panels": list(panels)}


def simple(traces: Sequence[Trace], x: str, y: str, *, height: int = HEIGHT, **more: Any) -> Plot:
    """Return a plot of one panel with titled axes."""
    return plot(axis(x), panel(traces, axis(y), height=height, **more))


def line(
    curve: Curve, name: str, colour: str, *, dash: str = "", width: float = 1.3, legend: bool = True, **more: Any
) -> Trace:
    """Return a curve as a line; nan interrupts it. `dash` is empty, "dot" or "dash"; `steps` makes a staircase."""
    return {
        "kind": "line", "name": name, "colour": f"@{colour}", "x": packed(curve.x), "y": packed(curve.y), "dash": dash,
        "width": width, "legend": legend, **more,
    }  # fmt: skip


def markers(x: NDArray[Any], y: NDArray[Any], name: str, colour: str, **more: Any) -> Trace:
    """Return points: `symbol` disc, diamond or cross; `size`; `error` (n,) for bars; `texts` for the pointer."""
    if "error" in more:
        more["error"] = packed(more["error"])
    return {
        "kind": "markers", "name": name, "colour": f"@{colour}", "x": packed(x), "y": packed(y), "size": 4, **more
    }  # fmt: skip


def area(
    x: Sequence[float] | NDArray[Any], low: Sequence[float] | NDArray[Any], high: Sequence[float] | NDArray[Any],
    name: str, colour: str, **more: Any,
) -> Trace:  # fmt: skip
    """Return the filled area between two curves over the same x; `edge` is the width of its outline."""
    arrays = {key: packed(np.asarray(part)) for key, part in (("x", x), ("low", low), ("high", high))}
    return {"kind": "area", "name": name, "colour": f"@{colour}", "legend": bool(name), **arrays, **more}


def envelope(curve: Envelope, name: str, colour: str) -> Trace:
    """Return the range of a dense curve as an area with an outline."""
    return area(curve.x, curve.low, curve.high, name, f"{colour}/0.75", edge=1)


def shade(intervals: NDArray[Any], name: str, colour: str) -> Trace:
    """Return intervals (n, 2) of x, shaded from bottom to top."""
    return {
        "kind": "shade", "name": name, "colour": f"@{colour}", "from": packed(intervals[:, 0]),
        "to": packed(intervals[:, 1]),
    }  # fmt: skip


def trail(x: NDArray[Any], y: NDArray[Any], name: str, colour: str, **more: Any) -> Trace:
    """Return a line that may run in any direction, or, with `spots`, its points; `label` stands at its end."""
    return {"kind": "trail", "name": name, "colour": f"@{colour}", "x": packed(x), "y": packed(y), "width": 1, **more}


def matrix(values: NDArray[Any], names: Sequence[str]) -> Trace:
    """Return a square matrix of values from -1 to 1 as coloured cells, the first row at the top."""
    return {"kind": "matrix", "name": "", "colour": "@ink", "values": packed(values), "names": list(names)}


@dataclass(frozen=True)
class Figure:
    """A figure: its name, its title, its caption and its plot.

    `link` names figures whose time axes move together; `shape` is empty for half the width, "wide" for
    all of it, "square" for as much as a square takes.
    """

    name: str
    title: str
    caption: str
    plot: Plot
    link: str = ""
    shape: str = ""

    @property
    def height(self) -> int:
        """Height in pixels, without the legend."""
        return int(sum(one["height"] for one in self.plot["panels"]))
