"""Figures for scripts and notebooks, made by matplotlib: `kreisel.plot`.

Each function returns a `matplotlib.figure.Figure`. A notebook shows it if it is the last value of a cell; a script
writes it by `savefig`. Each takes a figure, too, or a subfigure, that it draws in: with
`figure=matplotlib.pyplot.figure()`, pyplot shows it in a window. matplotlib is the extra `plot`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kreisel.calibration.by_method import Comparison
from kreisel.calibration.data_sheet import QUANTITIES, Quantity
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured
from kreisel.calibration.result_views import group_of
from kreisel.errors import RecordingError, SettingsError, unknown_name
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import REGISTRY, ParameterGroup, group_named
from kreisel.units import MM, MRAD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["budget", "correlations", "estimates", "methods", "parameters", "residuals"]

COLOURS = ("#0b62a4", "#d1510a", "#2a8a3e")
"""Of x, y and z, as in reports."""

SOURCE_COLOURS = ("#0b62a4", "#d1510a", "#2a8a3e", "#8a6d00", "#7a3b9a", "#5b6b7a", "#b0307a", "#111111")
"""Of the sources of uncertainty, in their order."""

_WIDTH = 6.4
"""Inches; chosen: a page of the documentation, and readable on a telephone."""

_SETTLED = 6.0
"""Deviation, over the last one, from which on an axis shows an estimate; as in reports."""

_LABELS = {"axes": ("x", "y", "z"), "pairs": ("xy", "xz", "yz")}


class HasSensors(Protocol):
    """What knows the parameters of a sensor: the truth of a simulation, or another calibration."""

    @property
    def sensors(self) -> SensorParameters:
        """The parameters of the sensor model."""
        ...


def parameters(
    calibration: Calibration,
    truth: HasSensors | None = None,
    quantities: Collection[str] | None = None,
    *,
    figure: Figure | None = None,
) -> Figure:
    """Return the sensors' errors in terms of data sheets, with bars of one standard deviation either way.

    Parameters
    ----------
    calibration
        A result.
    truth
        The truth of a simulation, or another calibration in the same axes: values are shown less its values.
    quantities
        Names of `calibration.derived`, such as ``accel_bias_mg``; all that are determined by default.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If a quantity does not exist or none is determined, or if matplotlib is not installed.
    """
    shown = _quantities(calibration, quantities)
    rows = -(-len(shown) // 3)
    drawn = _drawn_in(figure, 0.4 + 1.9 * rows)
    axes = drawn.subplots(rows, min(3, len(shown)), squeeze=False).ravel()
    for one, quantity in zip(axes, shown, strict=False):
        found = calibration.derived[quantity.name]
        value = found.value if truth is None else found.value - quantity.value(truth.sensors)
        _bars(one, Measured(value, found.deviation), _LABELS[quantity.of])
        title = re.sub("[Aa]ccelerometer", lambda word: word[0][:5] + ".", quantity.title).replace(".s", ".")
        one.set_title(title, fontsize="small")
        one.set_ylabel(quantity.unit, fontsize="small")
        one.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    for one in axes[len(shown) :]:
        one.set_axis_off()
    less = "" if truth is None else " less true value"
    drawn.suptitle(f"Estimate{less}; bars: one standard deviation", fontsize="medium")
    return drawn


def _quantities(calibration: Calibration, names: Collection[str] | None) -> list[Quantity]:
    known = {quantity.name: quantity for quantity in QUANTITIES if quantity.name in calibration.derived}
    for name in names or ():
        if name not in known:
            raise SettingsError(unknown_name("quantity", name, known))
    chosen = [one for name, one in known.items() if names is None or name in names]
    shown = [one for one in chosen if np.isfinite(calibration.derived[one.name].value).all()]
    if not shown:
        raise SettingsError("no quantity of this calibration is determined; nothing can be shown")
    return shown


def _bars(axes: Axes, found: Measured, labels: Sequence[str]) -> None:
    for i, colour in enumerate(COLOURS):
        axes.errorbar(i, found.value[i], found.deviation[i], fmt="o", color=colour, markersize=4, capsize=3)
    axes.set_xticks(range(len(labels)), labels)
    axes.set_xlim(-0.6, len(labels) - 0.4)


def estimates(
    source: Calibration | str | Path,
    group: str = "accel_offset",
    truth: HasSensors | None = None,
    *,
    deviations: float = 2.0,
    figure: Figure | None = None,
) -> Figure:
    """Return the estimates of a group of parameters after every update, each in a band of standard deviations.

    They are corrections, as in the result file: an offset is the negative of a bias.

    Parameters
    ----------
    source
        A calibration that was made here, or a result folder with `estimates.csv`.
    group
        As in `--fix`: ``accel_offset``, ``gyro_offset``, ``accel_cross_coupling``, ``lever_arms``, ``time_offset``, …
    truth
        The truth of a simulation, or another calibration: dotted lines. Of offsets, matrices and lever arms only.
    deviations
        Half the width of the band, in standard deviations.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If the group was not estimated, if there are no estimates over time, or if matplotlib is not installed.
    RecordingError
        If the folder has no `estimates.csv`.
    """
    names, table = _over_time(source)
    groups = [group_of(name) for name in names]
    own = [i for i, one in enumerate(groups) if one is not None and one.name == group]
    if not own:
        raise SettingsError(unknown_name("group", group, {one.name for one in groups if one is not None}))
    known, true = group_named(group), {} if truth is None else _true_values(truth.sensors)
    columns = 3 if len(own) > 3 else 1
    rows = -(-len(own) // columns)
    drawn = _drawn_in(figure, 0.6 + 1.45 * rows)
    axes = drawn.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for one, i in zip(axes, own, strict=False):
        value, sd = table[:, 1 + i] / known.size, table[:, 1 + len(names) + i] / known.size
        colour = COLOURS[own.index(i) % 3]
        _track(one, table[:, 0], value, deviations * sd, colour)
        if names[i] in true:
            one.axhline(true[names[i]] / known.size, color="black", linestyle=":", linewidth=1.2)
        one.ticklabel_format(axis="y", useOffset=False)
        one.set_title(names[i].rpartition(".")[2] if columns > 1 else names[i], fontsize="small", loc="left")
        one.set_ylabel(_unit(known), fontsize="small")
    for one in axes[-columns:]:
        one.set_xlabel("Time (s)")
    band = f"Line: estimate; band: {deviations:g} standard deviations either way"
    drawn.suptitle(band + ("; dotted: true" if true else ""), fontsize="medium")
    return drawn


def _over_time(source: Calibration | str | Path) -> tuple[tuple[str, ...], Array]:
    """Return names and table of estimates: seconds, estimates, standard deviations."""
    if isinstance(source, Calibration):
        if not len(source.estimates):
            raise SettingsError(
                "this calibration has no estimates over time: give one that `kreisel.calibrate` returned, in axes of "
                "the tool, or the folder it was saved in"
            )
        return source.names, source.estimates
    file = Path(source) / "estimates.csv" if Path(source).is_dir() else Path(source)
    try:
        with file.open(encoding="utf-8") as stream:
            header = re.findall(r'"([^"]*)"', stream.readline())
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"no table of estimates ({error}); give a result folder of `kreisel calibrate`", file=file
        ) from error
    n = (len(header) - 1) // 2
    if n < 1 or not len(table) or table.shape[1] != 1 + 2 * n:
        raise RecordingError(
            f"a table of {table.shape[1]} columns under {len(header)} names, expected the seconds, and estimate and "
            "deviation of each parameter; save the result again",
            file=file,
        )
    return tuple(header[1 : 1 + n]), table


def _track(axes: Axes, seconds: Array, value: Array, half: Array, colour: str) -> None:
    axes.fill_between(seconds, value - half, value + half, color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(seconds, value, color=colour, linewidth=1.4)
    narrow = np.flatnonzero(half <= _SETTLED * half[-1])
    later = slice(int(narrow[0]) if narrow.size else 0, None)
    low, high = float(np.min((value - half)[later])), float(np.max((value + half)[later]))
    room = 0.08 * (high - low) or 1.0
    axes.set_ylim(low - room, high + room)


def _true_values(sensors: SensorParameters) -> dict[str, float]:
    """Return parameters of a sensor by their names in the result file, SI."""
    values = {
        "gyroscope.cross_coupling": sensors.K_omega, "gyroscope.offset": sensors.k_w[0],
        "accelerometer.cross_coupling": sensors.K_a, "accelerometer.offset": sensors.k_a[0],
        "accelerometer.lever_arms": sensors.lever_arms,
    }  # fmt: skip
    return {
        f"{path}[{','.join(map(str, index))}]": float(value)
        for path, array in values.items()
        for index, value in np.ndenumerate(array)
    }


def residuals(calibration: Calibration, *, figure: Figure | None = None) -> Figure:
    """Return the innovations of position and orientation at every update, and their normalised squares (NIS).

    Innovations are the reference's poses less what was predicted of them before they were used. The NIS is divided by
    its degrees of freedom: 1 is expected.

    Parameters
    ----------
    calibration
        That `kreisel.calibrate` returned, in axes of the tool.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If the calibration was read from files (updates are not stored), or if matplotlib is not installed.
    """
    history = calibration.updates
    if history is None:
        raise SettingsError("this calibration has no updates: give one that `kreisel.calibrate` returned, as it is")
    kinds = [
        (title, part, size)
        for title, part, size in (
            ("Position (mm)", slice(0, 3), MM),
            ("Orientation (mrad)", slice(3, 6), MRAD),
        )
        if np.isfinite(history.innovation[:, part]).any()
    ]
    drawn = _drawn_in(figure, 0.6 + 1.9 * (len(kinds) + 1))
    axes = drawn.subplots(len(kinds) + 1, 1, sharex=True, squeeze=False).ravel()
    for one, (title, part, size) in zip(axes, kinds, strict=False):
        _innovations(one, history, history.innovation[:, part] / size)
        one.set_ylabel(title, fontsize="small")
    axes[0].legend(fontsize="small", ncols=4, loc="upper right", markerscale=2.0)
    _nis(axes[-1], history)
    drawn.suptitle("Innovations at every update", fontsize="medium")
    return drawn


def _innovations(axes: Axes, history: History, values: Array) -> None:
    for i, label in enumerate("xyz"):
        for which, symbol, size, text in (
            (~history.at_standstill, "o", 5.0, label),
            (history.at_standstill, "D", 9.0, "_nolegend_"),
        ):
            own = which & history.used
            axes.scatter(history.seconds[own], values[own, i], size, color=COLOURS[i], marker=symbol, linewidths=0.0,
                         label=text)  # fmt: skip
    rejected = ~history.used
    usual = np.abs(values[history.used])
    usual = usual[np.isfinite(usual)]
    if usual.size:
        # one very large innovation must not set the scale of all others
        limit = 1.15 * min(float(usual.max()), 3.0 * float(np.percentile(usual, 98)))
        axes.set_ylim(-limit, limit)
        if rejected.any():
            inside = np.clip(values[rejected], -0.97 * limit, 0.97 * limit)
            times = np.repeat(history.seconds[rejected], 3)
            axes.scatter(times, inside.ravel(), 14.0, color="black", marker="x", label="rejected")


def _nis(axes: Axes, history: History) -> None:
    nis = history.nis / history.degrees
    used, still = history.used, history.at_standstill
    shown: list[tuple[Mask, str, str, str]] = [
        (used & ~still, "o", COLOURS[0], "path"), (used & still, "D", COLOURS[1], "standstill"),
        (~used, "x", "black", "rejected"),
    ]  # fmt: skip
    for which, symbol, colour, label in shown:
        if which.any():
            axes.scatter(history.seconds[which], nis[which], 8.0, color=colour, marker=symbol, linewidths=0.7,
                         label=label)  # fmt: skip
    axes.axhline(1.0, color="0.4", linewidth=0.8)
    axes.set_yscale("log")
    positive = nis[np.isfinite(nis) & (nis > 0.0)]
    if positive.size:
        axes.set_ylim(min(0.1, float(np.percentile(positive, 1.0))), max(4.0, 2.0 * float(positive.max())))
    axes.set_ylabel("NIS (expected 1)", fontsize="small")
    axes.set_xlabel("Time (s)")
    axes.legend(fontsize="small", ncols=3, loc="lower right")


def correlations(
    calibration: Calibration, groups: Collection[str] | None = None, *, figure: Figure | None = None
) -> Figure:
    """Return the correlation coefficients of estimated parameters as a coloured matrix.

    Parameters
    ----------
    calibration
        A result with its `covariance.npz`.
    groups
        As in `--fix`; all but those of the robot by default.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If a group was not estimated, if the calibration has no covariance, or if matplotlib is not installed.
    """
    known = [group_of(name) for name in calibration.names]
    if not known:
        raise SettingsError("this calibration has no covariance: covariance.npz does not stand beside calibration.yaml")
    present = {one.name for one in known if one is not None}
    for name in groups or ():
        if name not in present:
            raise SettingsError(unknown_name("group", name, present))
    chosen = np.array([i for i, one in enumerate(known) if one is not None and _wanted(one, groups)], dtype=np.int64)
    P = calibration.covariance[np.ix_(chosen, chosen)]
    deviation = np.sqrt(np.maximum(np.diag(P), 0.0))
    deviation[deviation == 0.0] = 1.0
    drawn = _drawn_in(figure, 5.6)
    axes = drawn.subplots()
    shown = axes.imshow(P / np.outer(deviation, deviation), cmap="RdBu_r", vmin=-1.0, vmax=1.0, interpolation="nearest")
    drawn.colorbar(shown, ax=axes, shrink=0.8, label="Correlation coefficient")
    places, labels, edges = _spans([known[i] for i in chosen])
    axes.set_xticks(places, labels)
    axes.set_yticks(places, labels)
    for edge in edges:
        axes.axhline(edge, color="0.5", linewidth=0.6)
        axes.axvline(edge, color="0.5", linewidth=0.6)
    axes.set_title("Correlations of the estimates", fontsize="medium")
    return drawn


def _wanted(group: ParameterGroup, names: Collection[str] | None) -> bool:
    return group.owner != "robot" if names is None else group.name in names


def _spans(groups: Sequence[ParameterGroup | None]) -> tuple[list[float], list[str], list[float]]:
    """Return the middles of runs of one group, their symbols, and the edges between them."""
    edges = [i for i in range(1, len(groups)) if groups[i] is not groups[i - 1]]
    bounds = [0, *edges, len(groups)]
    middles = [0.5 * (a + b - 1) for a, b in pairwise(bounds)]
    labels = [symbol_of(one) if (one := groups[a]) is not None else "" for a in bounds[:-1]]
    return middles, labels, [edge - 0.5 for edge in edges]


def symbol_of(group: ParameterGroup) -> str:
    """Return the symbol of a group in matplotlib's mathematical text."""
    return "$" + re.sub(r"<sub>(.*?)</sub>", r"_{\1}", group.symbol).replace(" ", r"\ ") + "$"


def budget(calibration: Calibration, *, figure: Figure | None = None) -> Figure:
    """Return where the uncertainty comes from: the sources' mean shares in the variances of each group of parameters.

    Parameters
    ----------
    calibration
        Of one recording, in axes of the tool.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If the calibration has no budget, or if matplotlib is not installed.
    """
    made = calibration.budget
    if made is None:
        raise SettingsError("this calibration has no budget: joint ones, and those in other axes, have none")
    bars = _bars_of(made)
    drawn = _drawn_in(figure, 1.3 + 0.34 * len(bars))
    axes = drawn.subplots()
    left = np.zeros(len(bars))
    rows = np.arange(len(bars))
    for source, shares in made.by_source.items():
        width = np.array([100.0 * float(np.mean(shares[own])) for _, own in bars])
        colour = SOURCE_COLOURS[list(Source).index(source) % len(SOURCE_COLOURS)]
        axes.barh(rows, width, 0.7, left=left, color=colour, label=str(source))
        left += width
    axes.set_yticks(rows, [label for label, _ in bars])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("Share of the variance (%)")
    drawn.legend(loc="outside lower center", ncols=3, fontsize="small")
    return drawn


def _bars_of(made: Budget) -> list[tuple[str, Indices]]:
    """Return the label of each group, with the rms of its deviations, and the places of its parameters."""
    groups = [group_of(name) for name in made.names]
    bars = []
    for group in REGISTRY:
        own = np.array([i for i, one in enumerate(groups) if one is group], dtype=np.int64)
        if group.owner != "robot" and own.size and made.deviation[own].any():
            rms = float(np.sqrt(np.mean(made.deviation[own] ** 2))) / group.size
            bars.append((f"{group.name.replace('_', ' ')}: {rms:.2g} {_unit(group)}".rstrip(), own))
    return bars


def methods(
    compared: Comparison, quantities: Collection[str] = ("gyro_scale_error_ppm", "gyro_bias_deg_h"), *,
    figure: Figure | None = None,
) -> Figure:  # fmt: skip
    """Return what several estimators found, less what the first found, with bars of one standard deviation.

    Parameters
    ----------
    compared
        By `kreisel.compare_methods`.
    quantities
        Names of derived quantities, such as ``accel_bias_mg``; one panel each.
    figure
        To draw in; a new one by default.

    Raises
    ------
    SettingsError
        If a quantity does not exist, if no estimator succeeded, or if matplotlib is not installed.
    """
    known = {quantity.name: quantity for quantity in QUANTITIES}
    for name in quantities:
        if name not in known:
            raise SettingsError(unknown_name("quantity", name, known))
    if not compared.done:
        raise SettingsError("; ".join(f"{one.name}: {one.error}" for one in compared.found))
    drawn = _drawn_in(figure, 0.5 + 2.1 * len(quantities))
    axes = drawn.subplots(len(quantities), 1, sharex=True, squeeze=False).ravel()
    for one, name in zip(axes, quantities, strict=True):
        about = compared.first.derived[name].value
        for k, method in enumerate(compared.done):
            found = method.derived[name]
            for i, label in enumerate(_LABELS[known[name].of]):
                one.errorbar(k + 0.15 * (i - 1), found.value[i] - about[i], found.deviation[i], fmt="o",
                             color=COLOURS[i], markersize=4, capsize=3,
                             label=label if k == 0 else "_nolegend_")  # fmt: skip
        one.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
        one.set_ylabel(f"{known[name].title} ({known[name].unit})", fontsize="small")
    axes[0].legend(fontsize="small", ncols=3)
    axes[-1].set_xticks(range(len(compared.done)), [method.name for method in compared.done])
    drawn.suptitle(f"Estimate less that of {compared.first.name}; bars: one standard deviation", fontsize="medium")
    return drawn


def _unit(group: ParameterGroup) -> str:
    return "" if group.unit == "1" else group.unit


def _drawn_in(figure: Figure | None, height: float) -> Figure:
    """Return the figure that was given, or a new one of some height in inches.

    Raises
    ------
    SettingsError
        If matplotlib is not installed.
    """
    try:
        from kreisel.report.shown_figure import ShownFigure
    except ImportError as error:
        raise SettingsError("figures need matplotlib: pip install 'kreisel[plot]'") from error
    return ShownFigure(figsize=(_WIDTH, height), layout="constrained") if figure is None else figure
