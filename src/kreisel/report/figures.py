"""The report's figures, each with a caption that describes a good one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kreisel.calibration.evidence import SplitHalves
from kreisel.model.groups import REGISTRY
from kreisel.report import plots
from kreisel.report.data import Change, Curves, Difference, Excitation, Residuals, Track, Uncertainty, Unseen
from kreisel.report.plots import Figure, Plot
from kreisel.report.thinning import Curve

AXES = "xyz"
GROUP_LABELS = {group.name: group.symbol for group in REGISTRY}

_TIME = "IMU time (s)"
_PANEL = 130
_SETTLED = 6.0


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
                "Norm of the angular rate by the gyros and by the reference, on one clock, over the excerpt with the "
                "most rotation. Good: the two curves coincide, with peaks at the same times.",
                plots.plot(
                    [plots.line(e.gyro_rate, "gyros", "x"), plots.line(e.reference_rate, "reference", "y", dash="dot")],
                    plots.layout_of(_TIME, "Norm of angular rate (deg/s)"),
                ),
                shape="wide",
            )
        )
    return figures


def residual_figures(r: Residuals) -> list[Figure]:
    """Return the figures of section 2."""
    figures = [
        Figure(
            f"innovations-{name}",
            f"Innovations of {name}",
            f"Reference less predicted {name} at every update. Good: a structureless band about zero, narrower at "
            "standstill than on the path; slow waves mean errors that are not modelled.",
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
    where = f"{d.start:.1f} s to {d.stop:.1f} s"
    return [
        Figure(
            "rates-corrected",
            "Angular rate, raw and corrected",
            f"From {where}, raw readings rotated by the nominal mount. Good: the two curves look nearly the same.",
            _raw_and_corrected(d.rates, "Angular rate (deg/s)"),
            link="difference",
        ),
        Figure(
            "rates-difference",
            "Angular rate, corrected less raw",
            "Change by the calibration. Good: a constant (offset) with a share that follows the rates themselves "
            "(scale and misalignment), without jumps.",
            _axes_plot(d.rates.difference, "Change of angular rate (deg/s)"),
            link="difference",
        ),
        Figure(
            "forces-corrected",
            "Specific force, raw and corrected",
            f"From {where}, raw readings rotated by the nominal mount. Good: the two curves look nearly the same, "
            "unless the accelerometers are far from the origin of b.",
            _raw_and_corrected(d.forces, "Specific force (m/s²)"),
            link="difference",
        ),
        Figure(
            "forces-difference",
            "Specific force, corrected less raw",
            "Change by the calibration. Good: a constant (offset) with a share that follows the motion; noise here "
            "comes from the lever arms, which need the rates' derivative.",
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
            panels = [[track] for track in u.tracks[group]]
            figures.append(Figure(name, title, _track_caption(group), _stack(panels, unit, AXES), link="tracks"))
    if "lever_arms" in u.tracks:
        arms = u.tracks["lever_arms"]
        plot = _stack(
            [list(arms[3 * j : 3 * j + 3]) for j in range(3)],
            "mm",
            ["r<sub>x</sub>", "r<sub>y</sub>", "r<sub>z</sub>"],
        )
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
                _stack([list(u.tracks["time_offset"])], "ms", ["t"]),
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
    return plots.plot(lines, plots.layout_of(_TIME, title))


def _over_time(curves: Curves, title: str, e: Excitation) -> Plot:
    """Return readings over time above the shaded standstills, rejected updates marked at the top."""
    data = []
    if e.standstills.size:
        a, b = e.standstills[:, 0], e.standstills[:, 1]
        gap = np.full_like(a, np.nan)
        x = np.column_stack([a, a, b, b, gap]).ravel()
        y = np.tile([0.0, 1.0, 1.0, 0.0, np.nan], a.size)
        shade = plots.line(
            Curve(x.astype(np.float32), y.astype(np.float32)),
            "standstill",
            "muted",
            width=0,
            fill="toself",
            fillcolor="@muted/0.16",
            yaxis="y2",
        )
        data.append({**shade, "hoverinfo": "skip", "hovertemplate": None})
    data += [plots.line(curve, axis, axis, width=1.0) for axis, curve in zip(AXES, curves, strict=True)]
    if e.rejected.size:
        marks = plots.markers(e.rejected, np.full(e.rejected.size, 0.97), "rejected", "alert", symbol="x", size=6)
        data.append({**marks, "yaxis": "y2", "hovertemplate": "rejected at %{x:.2f} s"})
    layout = plots.layout_of(_TIME, title, height=280)
    layout["yaxis"]["overlaying"] = "y2"
    layout["yaxis"]["side"] = "left"
    layout["yaxis2"] = {"range": [0, 1], "visible": False, "fixedrange": True, "side": "right"}
    return plots.plot(data, layout)


def _innovations(r: Residuals, values: NDArray[np.float32], title: str) -> Plot:
    data = []
    for name, which, marker in (
        ("path", r.used & ~r.at_standstill, {"opacity": 0.75}),
        ("standstill", r.used & r.at_standstill, {"symbol": "diamond-open", "size": 6}),
    ):
        if which.any():
            data += [
                plots.markers(r.seconds[which], values[which, i], f"{AXES[i]}, {name}", AXES[i], **marker)
                for i in range(3)
            ]
    if (~r.used).any():
        seconds, rejected = np.repeat(r.seconds[~r.used], 3), values[~r.used].ravel()
        data.append({**plots.markers(seconds, rejected, "rejected", "alert", symbol="x", size=6)})
    layout = plots.layout_of(_TIME, title)
    usual = np.abs(values[r.used])
    usual = usual[np.isfinite(usual)]
    if usual.size:
        # one very large innovation must not set the scale for all others; a double click shows it
        limit = 1.15 * min(float(usual.max()), 3.0 * float(np.percentile(usual, 98)))
        layout["yaxis"]["range"] = [-limit, limit]
    return plots.plot(data, layout)


def _nis(r: Residuals) -> Plot:
    data: list[Plot] = []
    if r.seconds.size:
        ends = [float(r.seconds[0]), float(r.seconds[-1])]
        for kind, colour in zip(r.kinds, ("x", "y"), strict=False):
            low, high = kind.bounds
            name = f"95 % band, {kind.name}"
            data.append(plots.area(ends, [low] * 2, [high] * 2, name, f"{colour}/0.12"))
    for name, which, colour, symbol in (
        ("path", ~r.at_standstill & r.used, "x", "circle"),
        ("standstill", r.at_standstill & r.used, "y", "diamond-open"),
        ("rejected", ~r.used, "alert", "x"),
    ):
        if which.any():
            data.append(plots.markers(r.seconds[which], r.nis[which], name, colour, symbol=symbol, size=5))
    layout = plots.layout_of(_TIME, "NIS per degree of freedom")
    shown = r.nis[np.isfinite(r.nis) & (r.nis > 0.0)]
    low, high = np.log10(np.percentile(shown, [1.0, 100.0])) if shown.size else (0.0, 0.0)
    layout["yaxis"] |= plots.logarithmic(min(float(low), -1.0), max(float(high), 0.6))
    return plots.plot(data, layout)


def _histogram(r: Residuals) -> Plot:
    data = [
        plots.area(r.steps.tolist(), np.zeros(r.steps.size).tolist(), r.normal.tolist(), "unit normal", "muted/0.22")
    ]
    styles = {
        "position, path": ("x", "solid"),
        "attitude, path": ("y", "solid"),
        "position, standstill": ("x", "dot"),
        "attitude, standstill": ("y", "dot"),
        "velocity, standstill": ("z", "dot"),
    }
    middle = 0.5 * (r.edges[:-1] + r.edges[1:])
    for name, density in r.densities.items():
        colour, dash = styles[name]
        line = plots.line(Curve(middle.astype(np.float32), density.astype(np.float32)), name, colour, dash=dash)
        line["line"]["shape"] = "hvh"
        data.append({**line, "hovertemplate": "%{y:.3f} at %{x:.2f}"})
    return plots.plot(data, plots.layout_of("Whitened innovation (standard deviations)", "Density (1)"))


def _autocorrelation(r: Residuals) -> Plot:
    data = []
    if r.lags.size:
        ends = [float(r.lags[0]), float(r.lags[-1])]
        data.append(plots.area(ends, [-r.bound] * 2, [r.bound] * 2, "95 % band of white noise", "muted/0.22"))
    for (name, values), colour in zip(r.correlations.items(), ("x", "y"), strict=False):
        line = plots.line(Curve(r.lags.astype(np.float32), values.astype(np.float32)), name, colour)
        data.append({**line, "mode": "lines+markers", "marker": {"size": 5}, "hovertemplate": "%{y:.3f} at lag %{x}"})
    layout = plots.layout_of("Lag (updates)", "Autocorrelation (1)", height=260)
    layout["xaxis"]["range"] = [0.5, max(float(r.lags.size), 1.0) + 0.5]
    if not r.correlations:
        layout["annotations"] = [plots.remark("too few updates on the path")]
    return plots.plot(data, layout)


def _raw_and_corrected(change: Change, title: str) -> Plot:
    data = []
    for i, axis in enumerate(AXES):
        data.append(plots.line(change.raw[i], f"{axis} raw", axis, dash="dot", width=1.6))
        data.append(plots.line(change.corrected[i], f"{axis} corrected", axis))
    return plots.plot(data, plots.layout_of(_TIME, title))


def _stack(panels: Sequence[Sequence[Track]], unit: str, titles: Sequence[str]) -> Plot:
    """Return tracks in panels above each other over a common time axis."""
    n = len(panels)
    data: list[Plot] = []
    layout = plots.layout_of(_TIME, "", height=plots.HEIGHT if n == 1 else _PANEL * n + 60)
    gap = 0.07 if n > 1 else 0.0
    for row, (tracks, title) in enumerate(zip(panels, titles, strict=True)):
        key = "" if row == 0 else str(row + 1)
        top = 1.0 - row * (1.0 + gap) / n
        low, high = _settled_range(tracks)
        layout[f"yaxis{key}"] = plots.axis(
            f"{title} ({unit})",
            domain=[max(0.0, top - (1.0 + gap) / n + gap), top],
            range=[low, high],
            nticks=6,
        )
        for i, track in enumerate(tracks):
            colour = AXES[row % 3] if len(tracks) == 1 else AXES[i]
            data += _track(track, colour, f"y{key}", legend=row == 0 and len(tracks) > 1)
    layout["xaxis"]["anchor"] = "y" if n == 1 else f"y{n}"
    return plots.plot(data, layout)


def _track(track: Track, colour: str, axis: str, *, legend: bool) -> list[Plot]:
    name = track.axis
    value, deviation = track.value.astype(float), track.deviation.astype(float)
    ends = track.seconds[[0, -1]]
    reported = np.full(2, track.reported)
    more: Plot = {"yaxis": axis, "legendgroup": f"{name}{colour}", "showlegend": False}
    band = plots.area(
        track.seconds.tolist(),
        (value - 2.0 * deviation).tolist(),
        (value + 2.0 * deviation).tolist(),
        name,
        f"{colour}/0.18",
        **more,
    )
    flat = plots.line(Curve(ends, reported.astype(np.float32)), name, "muted", dash="dot", width=1.2, **more)
    line = plots.line(Curve(track.seconds, track.value), name, colour, **{**more, "showlegend": legend})
    return [band, {**flat, "hoverinfo": "skip", "hovertemplate": None}, line]


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


def _matrix(u: Uncertainty) -> Plot:
    n = len(u.names)
    spans = _spans(u.groups)
    ticks = {
        "tickmode": "array",
        "tickvals": [0.5 * (a + b - 1) for _, a, b in spans],
        "ticktext": [GROUP_LABELS.get(g, g) for g, _, _ in spans],
        "tickangle": 0,
        "tickfont": {"size": 11},
        "showgrid": False,
        "zeroline": False,
        "ticks": "",
        "range": [-0.5, n - 0.5],
    }
    heat = {
        "type": "heatmap",
        "z": plots.packed(u.correlation),
        "text": [[f"{a}<br>{b}" for a in u.names] for b in u.names],
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "@y"], [0.5, "@ground"], [1, "@x"]],
        "colorbar": {
            "title": {"text": "Correlation (1)", "side": "top"},
            "orientation": "h",
            "y": 1.0,
            "yanchor": "bottom",
            "thickness": 10,
            "len": 0.6,
            "outlinewidth": 0,
            "tickvals": [-1, -0.5, 0, 0.5, 1],
        },
        "hovertemplate": "%{text}<br>%{z:.3f}<extra></extra>",
        "xgap": 0.5,
        "ygap": 0.5,
    }
    layout = plots.layout_of("Parameter", "Parameter", height=640)
    layout["xaxis"] |= ticks | {"constrain": "domain"}
    layout["yaxis"] |= ticks | {"range": [n - 0.5, -0.5], "scaleanchor": "x", "constrain": "domain"}
    layout["shapes"] = [
        {"type": "line", "line": {"color": "@line", "width": 1}, **ends}
        for _, a, _ in spans[1:]
        for ends in (
            {"x0": a - 0.5, "x1": a - 0.5, "y0": -0.5, "y1": n - 0.5},
            {"y0": a - 0.5, "y1": a - 0.5, "x0": -0.5, "x1": n - 0.5},
        )
    ]
    return plots.plot([heat], layout)


def _drift(nominal: Curve, calibrated: Curve, title: str) -> Plot:
    data = [
        plots.markers(nominal.x, nominal.y, "nominal", "y", symbol="diamond-open", size=5),
        plots.markers(calibrated.x, calibrated.y, "calibrated", "x", size=5),
    ]
    layout = plots.layout_of(_TIME, title)
    sizes = np.concatenate([nominal.y, calibrated.y])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if sizes.size:
        low, high = np.log10(np.percentile(sizes, [0.5, 100.0]))
        layout["yaxis"] |= plots.logarithmic(float(low), float(high))
    return plots.plot(data, layout)


def _scores(halves: SplitHalves, groups: Mapping[str, str]) -> Plot:
    score = np.asarray(halves.score)
    own = [groups[name] for name in halves.names]
    spans = _spans(own)
    place = np.arange(score.size, dtype=float)
    marks = plots.markers(place, score, "second half less first", "x", size=7)
    marks |= {"text": list(halves.names), "hovertemplate": "%{text}<br>%{y:.2f}<extra></extra>"}
    band = plots.area([-0.5, score.size - 0.5], [-2.0, -2.0], [2.0, 2.0], "±2 standard deviations", "muted/0.18")
    layout = plots.layout_of("Parameter", "Difference / sd (1)", height=280)
    layout["xaxis"] |= {
        "tickmode": "array",
        "tickvals": [0.5 * (a + b - 1) for _, a, b in spans],
        "ticktext": [GROUP_LABELS.get(g, g) for g, _, _ in spans],
        "tickangle": 0,
        "showgrid": False,
        "zeroline": False,
        "range": [-0.5, score.size - 0.5],
    }
    layout["shapes"] = [
        {
            "type": "line",
            "x0": a - 0.5,
            "x1": a - 0.5,
            "yref": "paper",
            "y0": 0,
            "y1": 1,
            "line": {"color": "@grid", "width": 1},
        }
        for _, a, _ in spans[1:]
    ]
    layout["yaxis"]["zeroline"] = True
    limit = 1.1 * max(3.0, float(np.max(np.abs(score), initial=0.0)))
    layout["yaxis"]["range"] = [-limit, limit]
    return plots.plot([band, marks], layout)
