"""Elements of plotly's plots: plain dictionaries, arrays in base64, colours by name.

A colour is written ``@name`` or ``@name/opacity``; the page replaces it by that of the light or the dark
palette. With dictionaries instead of plotly's own objects a report takes less than a second; a test checks
them with plotly's validation.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.report.thinning import Curve

Plot = dict[str, Any]

HEIGHT = 300
"""Pixels of a usual plot."""

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


def packed(values: NDArray[Any]) -> Plot:
    """Return an array the way plotly.js reads it without parsing numbers: single precision in base64."""
    single = np.ascontiguousarray(values, dtype="<f4")
    out: Plot = {"dtype": "f4", "bdata": base64.b64encode(single.tobytes()).decode("ascii")}
    if single.ndim > 1:
        out["shape"] = ", ".join(str(n) for n in single.shape)
    return out


def plot(data: list[Plot], layout: Plot) -> Plot:
    """Return a plot of traces in a layout."""
    return {"data": data, "layout": layout}


def axis(title: str, **more: Any) -> Plot:
    """Return an axis with its title."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": "@grid",
        "zerolinecolor": "@line/0.7",
        "linecolor": "@line",
        "tickcolor": "@line",
        "ticks": "outside",
        "ticklen": 4,
        "exponentformat": "power",
        "minexponent": 5,
        "tickmode": "auto",
        "automargin": True,
        **more,
    }


def layout_of(x: str, y: str, *, height: int = HEIGHT, **more: Any) -> Plot:
    """Return a layout with titled axes, the legend above it."""
    return {
        "height": height,
        "margin": {"l": 58, "r": 14, "t": 10, "b": 44},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "@ink"},
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1.02,
            "yanchor": "bottom",
            "bgcolor": "rgba(0,0,0,0)",
        },
        "hoverlabel": {"bgcolor": "@ground", "bordercolor": "@line", "font": {"color": "@ink"}},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "@muted/0.6", "activecolor": "@ink"},
        "dragmode": "zoom",
        "separators": ".\u202f",
        "xaxis": axis(x),
        "yaxis": axis(y),
        **more,
    }


def line(curve: Curve, name: str, colour: str, *, dash: str = "solid", width: float = 1.3, **more: Any) -> Plot:
    """Return a curve over time as a line; nan interrupts it."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": packed(curve.x),
        "y": packed(curve.y),
        "line": {"color": f"@{colour}", "width": width, "dash": dash},
        "hovertemplate": "%{y:.4g} at %{x:.2f} s",
        **more,
    }


def markers(x: NDArray[Any], y: NDArray[Any], name: str, colour: str, **marker: Any) -> Plot:
    """Return points over time as markers."""
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": packed(x),
        "y": packed(y),
        "marker": {"color": f"@{colour}", "size": 4, **marker},
        "hovertemplate": "%{y:.4g} at %{x:.2f} s",
    }


def area(x: Sequence[float], low: Sequence[float], high: Sequence[float], name: str, colour: str, **more: Any) -> Plot:
    """Return the filled area between two curves over the same x."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": packed(np.concatenate([np.asarray(x), np.asarray(x)[::-1]])),
        "y": packed(np.concatenate([np.asarray(high), np.asarray(low)[::-1]])),
        "fill": "toself",
        "fillcolor": f"@{colour}",
        "line": {"width": 0, "color": f"@{colour}"},
        "hoverinfo": "skip",
        **more,
    }


def logarithmic(low: float, high: float) -> Plot:
    """Return the settings of a logarithmic axis from 10^low to 10^high, with numbers as ticks."""
    low, high = low - 0.15, high + 0.15
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    digits = (1, 2, 5) if high - low < 1.6 else (1,)
    values = [digit * 10.0**k for k in decades for digit in digits]
    return {
        "type": "log",
        "range": [low, high],
        "tickmode": "array",
        "tickvals": values,
        "ticktext": [f"{value:g}" for value in values],
    }


def remark(text: str) -> Plot:
    """Return a remark in the middle of an empty plot."""
    return {
        "text": text,
        "showarrow": False,
        "xref": "paper",
        "yref": "paper",
        "x": 0.5,
        "y": 0.5,
        "font": {"color": "@muted"},
    }


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
        """Height in pixels."""
        return int(self.plot["layout"]["height"])
