"""The report's figures, each with a caption that describes a good one."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kreisel.calibration.evidence import SplitHalves
from kreisel.model.groups import REGISTRY
from kreisel.report import plots
from kreisel.report.data import (
    Curves,
    Difference,
    Envelopes,
    Excitation,
    Residuals,
    Track,
    Uncertainty,
    Unseen,
)
from kreisel.report.plots import Figure, Plot, Trace
from kreisel.report.thinning import Curve

AXES = "xyz"
GROUP_LABELS = {group.name: group.symbol for group in REGISTRY}

_PANEL = 130
"""px; height of one of several panels. Chosen: less than half of `plots.HEIGHT`, because two or three stand
together."""

_SETTLED = 6.0
"""Deviation, over the last one, from which the axis shows an estimate. Chosen: with more of the beginning the end is a
line, with less the figure does not show how it settles. It was 10 at first."""


def excitation_figures(e: Excitation) -> list[Figure]:
    """Return the figures of section 1."""
    count = e.rejected.size
    note = f" Rejected updates: {count}, marked by crosses at the top." if count else " No update was rejected."
    figures = [
        Figure(
            "rates",
            "Angular rates",
            "Raw gyro readings; standstills are shaded. Good: all three axes turn strongly between any two standstills."
            + note,
            _over_time(e.rates, "Angular rate (deg/s)", e),
            link="excitation",
            shape="wide",
        ),
        Figure(
            "accelerations",
            "Accelerations",
            "Raw accelerometer readings. Good: over the standstills gravity acts along every axis in both directions, "
            "and there is motion in between." + note,
            _over_time(e.forces, "Acceleration (m/s²)", e),
            link="excitation",
            shape="wide",
        ),
    ]
    if e.reference_rate.x.size:
        figures.append(
            Figure(
                "synchronisation",
                "Time relation",
                "Above: norm of the angular rate by the gyros, over the excerpt with the most rotation; below: that of "
                "the reference less it, on one clock. Good: the difference is small, without the rate's shape.",
                _time_relation(e),
                shape="wide",
            )
        )
    return [*figures, *_geometry_figures(e)]


def _time_relation(e: Excitation) -> Plot:
    x, y = e.gyro_rate.x, e.gyro_rate.y
    good = np.isfinite(x) & np.isfinite(y)
    at = np.interp(e.reference_rate.x, x[good], y[good]).astype(np.float32)
    difference = Curve(e.reference_rate.x, e.reference_rate.y - at)
    return plots.plot(
        plots.axis(plots.TIME),
        plots.panel([plots.line(e.gyro_rate, "", "x", legend=False)], plots.axis("Rate (deg/s)"), height=_PANEL),
        plots.panel([plots.line(difference, "", "y", legend=False)], plots.axis("Δ (deg/s)"), height=_PANEL),
    )


def _geometry_figures(e: Excitation) -> list[Figure]:
    """Return the coverage of orientations, and the path in space."""
    figures = []
    if len(e.up):
        figures.append(
            Figure(
                "coverage",
                "Orientations",
                "Where up is in axes of b: left, towards +z; right, towards -z. Equal areas are equal angles. Good: "
                "points in all parts of both discs; along directions without any, gravity did not act.",
                _sphere(e.up),
            )
        )
    if len(e.path):
        figures.append(
            Figure(
                "path",
                "Path of b",
                "Positions of b in r, seen from above at an angle; the three axes of r begin at the least x, y and z "
                f"and are {_triad(e.path):g} m long. Good: a path that fills a volume.",
                _isometric(e.path),
            )
        )
    return figures


def _sphere(up: NDArray[np.float64]) -> Plot:
    """Return both halves of the sphere of directions, in Lambert's equal-area projection."""
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    data: list[Trace] = []
    for centre, sign, name in ((-1.15, 1.0, "+z"), (1.15, -1.0, "−z")):
        data.append(plots.trail(centre + np.cos(turn), np.sin(turn), "", "line"))
        ring = np.sqrt(1.0 - np.cos(np.pi / 4.0))
        data.append(plots.trail(centre + ring * np.cos(turn), ring * np.sin(turn), "", "grid"))
        own = up[sign * up[:, 2] >= 0.0]
        across = np.hypot(own[:, 0], own[:, 1])
        r = np.sqrt(np.maximum(1.0 - np.abs(own[:, 2]), 0.0)) / np.maximum(across, 1e-12)
        data.append(plots.trail(centre + sign * r * own[:, 0], r * own[:, 1], "", "x/0.5", spots=3))
        data.append(plots.trail(np.array([centre, centre + sign]), np.zeros(2), "", "grid", label="x"))
        data.append(plots.trail(np.full(2, centre), np.array([0.0, 1.0]), "", "grid", label="y"))
        data.append(plots.trail(np.full(1, centre - 0.98), np.full(1, 0.88), "", "muted", label=name))
    x, y = plots.axis("", range=[-2.3, 2.3], hidden=True), plots.axis("", range=[-1.15, 1.15], hidden=True)
    return plots.plot(x, plots.panel(data, y, height=260, equal=True))


def _triad(path: NDArray[np.float64]) -> float:
    """Return the length of axes that is a round one, a fifth to two fifths of the path's extent."""
    size = max(float(np.ptp(path, axis=0).max()), 1e-3)
    length = float(10.0 ** np.floor(np.log10(0.4 * size)))
    return length * (2.0 if 0.4 * size / length >= 2.0 else 1.0)


def _isometric(path: NDArray[np.float64]) -> Plot:
    """Return positions in isometric projection, with a triad."""
    across = np.array([[np.cos(np.pi / 6.0), -np.cos(np.pi / 6.0), 0.0], [-0.5, -0.5, 1.0]])
    low = path.min(axis=0)
    length = _triad(path)
    flat = path @ across.T
    data = [plots.trail(flat[:, 0], flat[:, 1], "", "x/0.8")]
    for i, name in enumerate(AXES):
        ends = np.array([low, low + length * np.eye(3)[i]]) @ across.T
        data.append(plots.trail(ends[:, 0], ends[:, 1], "", "ink", width=1.5, label=name))
    corner = low @ across.T
    every_x, every_y = np.append(flat[:, 0], corner[0]), np.append(flat[:, 1], corner[1])
    x = plots.axis("", range=[float(every_x.min()) - length, float(every_x.max()) + length], hidden=True)
    y = plots.axis("", range=[float(every_y.min()) - 0.6 * length, float(every_y.max()) + 0.3 * length], hidden=True)
    return plots.plot(x, plots.panel(data, y, height=260, equal=True))


def residual_figures(r: Residuals) -> list[Figure]:
    """Return the figures of section 2."""
    figures = [
        Figure(
            f"innovations-{name}",
            f"Innovations of {name}",
            f"Reference less predicted {name} at every update; diamonds: standstill. Good: a structureless band about "
            "zero, narrower at standstill than on the path; slow waves mean errors that are not modelled.",
            _innovations(r, values, f"Innovation of {name} ({unit})"),
            link="residuals",
        )
        for name, values, unit in (("position", r.position, "mm"), ("attitude", r.attitude, "mrad"))
        if np.isfinite(values).any()
    ]
    return [
        *figures,
        Figure(
            "nis",
            "Normalised innovation squared",
            "NIS of every update per degree of freedom. Good: nineteen of twenty points within the 95 % band, no "
            "trend; points mostly above it mean noise figures too small, mostly below too large.",
            _nis(r),
            link="residuals",
        ),
        Figure(
            "histogram",
            "Whitened innovations",
            "How often innovations of each size occur, each divided by its expected deviation. Good: the steps follow "
            "the unit normal's curve; values beyond five deviations are counted in the outermost bins.",
            _histogram(r),
        ),
        Figure(
            "autocorrelation",
            "Autocorrelation of whitened innovations",
            "Mean over the three axes, updates on the path. Good: within the 95 % band of white noise; "
            "a slow decay means errors that last over several updates; the standard deviations are inflated for them.",
            _autocorrelation(r),
            shape="wide",
        ),
    ]


def difference_figures(d: Difference) -> list[Figure]:
    """Return the figures of section 3."""
    where = f"From {d.start:.1f} s to {d.stop:.1f} s."
    return [
        Figure(
            "rates-difference",
            "Angular rate, corrected less raw",
            f"{where} Change by the calibration, against raw readings rotated by the nominal mount. Good: a constant "
            "(offset) with a share that follows the rates themselves (scale and misalignment), without jumps.",
            _axes_plot(d.rates.difference, "Change of angular rate (deg/s)"),
            link="difference",
        ),
        Figure(
            "forces-difference",
            "Specific force, corrected less raw",
            f"{where} Good: a constant (offset) with a share that follows the motion; noise here comes from the lever "
            "arms, which need the rates' derivative.",
            _axes_plot(d.forces.difference, "Change of specific force (mg)"),
            link="difference",
        ),
    ]


def track_figures(u: Uncertainty) -> list[Figure]:
    """Return the estimates over time of section 4."""
    figures = []
    for group, name, title, unit in (
        ("accel_offset", "accel-offsets", "Accelerometer biases", "mg"),
        ("gyro_offset", "gyro-offsets", "Gyro biases", "deg/h"),
        ("accel_cross_coupling", "accel-scales", "Accelerometer scale factor errors", "ppm"),
        ("gyro_cross_coupling", "gyro-scales", "Gyro scale factor errors", "ppm"),
    ):
        if group in u.tracks:
            panels = {track.axis: [track] for track in u.tracks[group]}
            figures.append(Figure(name, title, _track_caption(group), _stack(panels, unit), link="tracks"))
    if "lever_arms" in u.tracks:
        names = [name for name, group in zip(u.names, u.groups, strict=True) if group == "lever_arms"]
        arms: dict[str, list[Track]] = {}
        for name, track in zip(names, u.tracks["lever_arms"], strict=True):
            arms.setdefault(f"r of {AXES[int(name[-4])]}", []).append(track)  # lever_arms[j,i]
        plot = _stack(arms, "mm")
        figures.append(
            Figure(
                "lever-arms",
                "Lever arms, less the reported value",
                "Positions of the three accelerometers in b, components x, y and z. Good: bands narrow towards zero "
                "and the lines stay within them.",
                plot,
                link="tracks",
            )
        )
    if "time_offset" in u.tracks:
        figures.append(
            Figure(
                "time-offset",
                "Time offset, less the reported value",
                "Good: the band narrows to a small part of the IMU's sampling interval; a ramp means clocks of "
                "different rates.",
                _stack({"t": list(u.tracks["time_offset"])}, "ms"),
                link="tracks",
            )
        )
    return figures


def _track_caption(group: str) -> str:
    text = (
        "Line: estimate after each update; band: two standard deviations either way; dotted: the value reported. "
        "Good: the band narrows quickly and the line stays within the earlier, wider band."
    )
    if group == "accel_offset":
        return text + " This is figure 4 of Fox and Janocha (2005), with its uncertainty."
    return text


def matrix_figure(u: Uncertainty) -> Figure:
    """Return the correlation matrix of section 4."""
    return Figure(
        "correlations",
        "Correlations of the estimates",
        "Correlation coefficients of all estimated parameters. Good: faint off the diagonal; a strong colour "
        "there is a pair that this motion can hardly distinguish. φ is the tilt, n north in the level plane, t₀ and s "
        "the clocks' offset and skew.",
        _matrix(u),
        shape="square",
    )


def drift_figures(unseen: Unseen) -> list[Figure]:
    """Return the drift on unseen data of section 5."""
    return [
        Figure(
            f"drift-{name}",
            f"Drift of {name} on unseen data",
            f"Error of free navigation from one update to the next, after {unseen.trained_until:.0f} s; this "
            "calibration did not use these data. Good: calibrated lies well below nominal, near the reference's noise.",
            _drift(getattr(unseen.nominal, name), getattr(unseen.calibrated, name), f"Drift of {name} ({unit})"),
            link="drift",
        )
        for name, unit in (("position", "mm"), ("attitude", "mrad"))
        if np.isfinite(getattr(unseen.calibrated, name).y).any()
    ]


def halves_figure(halves: SplitHalves, groups: Mapping[str, str]) -> Figure:
    """Return the split-half scores of section 5."""
    return Figure(
        "halves",
        "Repeatability of the two halves",
        "Estimate of the second half less that of the first, over the standard deviation of this difference. Good: "
        "nineteen of twenty within ±2, about as many above as below.",
        _scores(halves, groups),
        shape="wide",
    )


def _axes_plot(curves: Curves, title: str) -> Plot:
    lines = [plots.line(curve, axis, axis) for axis, curve in zip(AXES, curves, strict=True)]
    return plots.simple(lines, plots.TIME, title)


def _over_time(curves: Envelopes, title: str, e: Excitation) -> Plot:
    """Return readings over time above the shaded standstills, rejected updates marked at the top."""
    data = []
    if e.standstills.size:
        data.append(plots.shade(e.standstills, "standstill", "muted/0.16"))
    data += [plots.envelope(curve, axis, axis) for axis, curve in zip(AXES, curves, strict=True)]
    if e.rejected.size:
        top = max(float(np.nanmax(curve.high, initial=0.0)) for curve in curves)
        data.append(
            plots.markers(e.rejected, np.full(e.rejected.size, top), "rejected", "alert", symbol="cross", size=6)
        )
    return plots.simple(data, plots.TIME, title, height=250)


def _innovations(r: Residuals, values: NDArray[np.float32], title: str) -> Plot:
    data = []
    for name, which, marker in (
        ("path", r.used & ~r.at_standstill, {"opacity": 0.75}),
        ("standstill", r.used & r.at_standstill, {"symbol": "diamond", "size": 6}),
    ):
        if which.any():
            data += [
                plots.markers(r.seconds[which], values[which, i], AXES[i] if name == "path" else "", AXES[i], **marker)
                for i in range(3)
            ]
    if (~r.used).any():
        seconds, rejected = np.repeat(r.seconds[~r.used], 3), values[~r.used].ravel()
        data.append(plots.markers(seconds, rejected, "rejected", "alert", symbol="cross", size=6))
    y = plots.axis(title)
    usual = np.abs(values[r.used])
    usual = usual[np.isfinite(usual)]
    if usual.size:
        # one very large innovation must not set the scale for all others
        limit = 1.15 * min(float(usual.max()), 3.0 * float(np.percentile(usual, 98)))
        y["range"] = [-limit, limit]
    return plots.plot(plots.axis(plots.TIME), plots.panel(data, y))


def _nis(r: Residuals) -> Plot:
    data: list[Trace] = []
    if r.seconds.size:
        ends = [float(r.seconds[0]), float(r.seconds[-1])]
        for kind, colour in zip(r.kinds, ("x", "y"), strict=False):
            low, high = kind.bounds
            name = f"95 % band, {kind.name}"
            data.append(plots.area(ends, [low] * 2, [high] * 2, name, f"{colour}/0.12"))
    for name, which, colour, symbol in (
        ("path", ~r.at_standstill & r.used, "x", "disc"),
        ("standstill", r.at_standstill & r.used, "y", "diamond"),
        ("rejected", ~r.used, "alert", "cross"),
    ):
        if which.any():
            data.append(plots.markers(r.seconds[which], r.nis[which], name, colour, symbol=symbol, size=5))
    shown = r.nis[np.isfinite(r.nis) & (r.nis > 0.0)]
    low, high = np.log10(np.percentile(shown, [1.0, 100.0])) if shown.size else (0.0, 0.0)
    y = plots.logarithmic("NIS per degree of freedom", min(float(low), -1.0), max(float(high), 0.6))
    return plots.plot(plots.axis(plots.TIME), plots.panel(data, y))


def _histogram(r: Residuals) -> Plot:
    data = [
        plots.area(r.steps.tolist(), np.zeros(r.steps.size).tolist(), r.normal.tolist(), "unit normal", "muted/0.22")
    ]
    styles = {
        "position, path": ("x", ""),
        "attitude, path": ("y", ""),
        "position, standstill": ("x", "dot"),
        "attitude, standstill": ("y", "dot"),
        "velocity, standstill": ("z", "dot"),
    }
    middle = 0.5 * (r.edges[:-1] + r.edges[1:])
    for name, density in r.densities.items():
        colour, dash = styles[name]
        curve = Curve(middle.astype(np.float32), density.astype(np.float32))
        data.append(plots.line(curve, name, colour, dash=dash, steps=True))
    return plots.simple(data, "Whitened innovation (standard deviations)", "Density (1)")


def _autocorrelation(r: Residuals) -> Plot:
    data = []
    if r.lags.size:
        ends = [float(r.lags[0]), float(r.lags[-1])]
        data.append(plots.area(ends, [-r.bound] * 2, [r.bound] * 2, "95 % band of white noise", "muted/0.22"))
    for (name, values), colour in zip(r.correlations.items(), ("x", "y"), strict=False):
        data.append(plots.line(Curve(r.lags.astype(np.float32), values.astype(np.float32)), name, colour))
    x = plots.axis("Lag (updates)", range=[0.5, max(float(r.lags.size), 1.0) + 0.5])
    more = {} if r.correlations else {"remark": "too few updates on the path"}
    return plots.plot(x, plots.panel(data, plots.axis("Autocorrelation (1)"), height=230, **more))


def _stack(panels: Mapping[str, Sequence[Track]], unit: str) -> Plot:
    """Return tracks in titled panels above each other over a common time axis."""
    made = []
    for row, (title, tracks) in enumerate(panels.items()):
        data: list[Trace] = []
        for track in tracks:
            data += _track(track, track.axis, legend=row == len(panels) - 1 and len(tracks) > 1)
        y = plots.axis(f"{title} ({unit})", range=list(_settled_range(tracks)))
        made.append(plots.panel(data, y, height=_PANEL if len(panels) > 1 else plots.HEIGHT))
    return plots.plot(plots.axis(plots.TIME), *made)


def _track(track: Track, colour: str, *, legend: bool) -> list[Trace]:
    value, deviation = track.value.astype(float), track.deviation.astype(float)
    ends, reported = track.seconds[[0, -1]], np.full(2, track.reported, dtype=np.float32)
    band = plots.area(track.seconds, value - 2.0 * deviation, value + 2.0 * deviation, "", f"{colour}/0.18")
    flat = plots.line(Curve(ends, reported), "", "muted", dash="dot", width=1.2, legend=False)
    return [band, flat, plots.line(Curve(track.seconds, track.value), track.axis, colour, legend=legend)]


def _settled_range(tracks: Sequence[Track]) -> tuple[float, float]:
    """Return a range that contains the bands, from where they are within a few times the last one's width."""
    low, high = np.inf, -np.inf
    for track in tracks:
        narrow = np.flatnonzero(track.deviation <= _SETTLED * track.deviation[-1])
        later = slice(int(narrow[0]) if narrow.size else 0, None)
        value, spread = track.value[later].astype(float), 2.0 * track.deviation[later].astype(float)
        low = min(low, float(np.min(value - spread)), track.reported - 2.0 * track.reported_sd)
        high = max(high, float(np.max(value + spread)), track.reported + 2.0 * track.reported_sd)
    room = 0.06 * (high - low) or 1.0
    return low - room, high + room


def _spans(groups: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return the runs of equal groups: name, first, one past the last."""
    edges = [0, *(i for i in range(1, len(groups)) if groups[i] != groups[i - 1]), len(groups)]
    return [(groups[a], a, b) for a, b in pairwise(edges)] if groups else []


def _plain(label: str) -> str:
    """Return a symbol in HTML as plain text."""
    return re.sub(r"<[^>]+>", "", label)


def _of_groups(spans: Sequence[tuple[str, int, int]]) -> list[list[float] | list[str]]:
    """Return the ticks in the middle of each run of parameters: places and symbols."""
    return [[0.5 * (a + b - 1) for _, a, b in spans], [_plain(GROUP_LABELS.get(g, g)) for g, _, _ in spans]]


def _matrix(u: Uncertainty) -> Plot:
    n = len(u.names)
    spans = _spans(u.groups)
    places, labels = _of_groups(spans)
    x = plots.axis("Parameter", range=[-0.5, n - 0.5], ticks=[places, labels], bare=True)
    y = plots.axis(
        "Parameter", range=[-0.5, n - 0.5], ticks=[[n - 1 - float(place) for place in places], labels], bare=True
    )
    lines = [a - 0.5 for _, a, _ in spans[1:]]
    return plots.plot(
        x, plots.panel([plots.matrix(u.correlation, u.names)], y, height=640, rules=lines, equal=True, size=n)
    )


def _drift(nominal: Curve, calibrated: Curve, title: str) -> Plot:
    data = [
        plots.markers(nominal.x, nominal.y, "nominal", "y", symbol="diamond", size=5),
        plots.markers(calibrated.x, calibrated.y, "calibrated", "x", size=5),
    ]
    y = plots.axis(title)
    sizes = np.concatenate([nominal.y, calibrated.y])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if sizes.size:
        low, high = np.log10(np.percentile(sizes, [0.5, 100.0]))
        y = plots.logarithmic(title, float(low), float(high))
    return plots.plot(plots.axis(plots.TIME), plots.panel(data, y))


def _scores(halves: SplitHalves, groups: Mapping[str, str]) -> Plot:
    score = np.asarray(halves.score)
    spans = _spans([groups[name] for name in halves.names])
    place = np.arange(score.size, dtype=float)
    data = [
        plots.area([-0.5, score.size - 0.5], [-2.0, -2.0], [2.0, 2.0], "±2 standard deviations", "muted/0.18"),
        plots.markers(place, score, "second half less first", "x", size=7, texts=list(halves.names)),
    ]
    x = plots.axis("Parameter", range=[-0.5, score.size - 0.5], ticks=_of_groups(spans), bare=True)
    limit = 1.1 * max(3.0, float(np.max(np.abs(score), initial=0.0)))
    y = plots.axis("Difference / sd (1)", range=[-limit, limit])
    return plots.plot(x, plots.panel(data, y, height=280, rules=[a - 0.5 for _, a, _ in spans[1:]], texts=True))
