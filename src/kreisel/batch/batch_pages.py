"""The summary page of a batch, and the page of a unit's history."""

from __future__ import annotations

import posixpath
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.batch.capability import capabilities, capability_table
from kreisel.batch.lot import OF_DEVICE, Unit, counts, devices, figures_of, good, label_of, pages_of, title_of
from kreisel.batch.outcomes import OUTCOMES
from kreisel.batch.unit_history import YEAR, History, Trend
from kreisel.calibration.data_sheet import Quantity
from kreisel.calibration.limits import COVERAGE, Limits, limits_of
from kreisel.estimation.robust import normal_scale
from kreisel.report import plots
from kreisel.report.cells import Row, Table, number, pair
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill
from kreisel.report.thinning import Curve

AXES = "xyz"

_AHEAD = 0.35
"""Share of the time observed that the band of a history goes on for."""


def write_batch(units: Sequence[Unit], limits: Limits | None, lead: str, reports: bool, path: Path) -> None:
    """Write the summary page of a batch as one HTML file that works offline.

    Parameters
    ----------
    reports
        Whether each result has a report, to be linked. Trays always have one.
    """
    pages = pages_of([unit.run for unit in units], reports=reports)
    ordered = sorted(units, key=lambda unit: -OUTCOMES.index(unit.outcome))
    figures = [_spread(quantity, units, limits) for quantity in OF_DEVICE if _has(quantity, units)]
    once = devices(units)
    page = fill(
        "batch.html",
        figures,
        lead=lead,
        total=len(once),
        good=good(once),
        share=100.0 * good(once) / max(len(once), 1),
        counts=counts(once),
        calibrations=len(units),
        with_limits=limits is not None,
        source="" if limits is None else f"grade {limits.grade}" if limits.grade else limits.file,
        spread=_spread_table(units, limits),
        capability=capability_table(capabilities(units, limits)),
        trays=_tray_rows(units, pages),
        rows=[_unit_row(unit, pages.get(unit.run.key)) for unit in ordered],
        outliers=[(unit.run.name, one.text) for unit in units for one in unit.outliers],
        figures=figures,
    )
    path.write_text(page, encoding="utf-8")


def _has(quantity: Quantity, units: Sequence[Unit]) -> bool:
    return bool(np.isfinite(figures_of([u.run for u in units if u.run.accepted], quantity)[0]).any())


def _tray_rows(units: Sequence[Unit], pages: Mapping[str, str]) -> list[dict[str, str]]:
    """Return a row for each tray: its page, that of the mean of its units, and what became of them."""
    trays: dict[str, list[Unit]] = {}
    for unit in units:
        if unit.run.tray:
            trays.setdefault(unit.run.tray, []).append(unit)
    return [
        {
            "name": tray,
            "units": f"{len(own)}",
            "good": f"{good(own)}",
            "page": f"results/{tray}/report.html" if own[0].run.key in pages else "",
            "mean": f"results/{tray}/mean/report.html" if own[0].run.key in pages else "",
        }
        for tray, own in trays.items()
    ]


def _unit_row(unit: Unit, page: str | None) -> dict[str, str]:
    """Return a row of the table of units: what limits it most is the figure nearest to its limit."""
    shares = [(one.share, one.quantity.title) for one in unit.judged if np.isfinite(one.share)]
    worst = max(shares, default=(np.nan, ""))
    return {
        "name": unit.run.name,
        "unit": unit.run.unit,
        "outcome": unit.outcome,
        "verdict": unit.run.headline,
        "worst": f"{worst[1]}, {100.0 * worst[0]:.0f} %" if shares else "",
        "note": unit.run.error or "; ".join(one.text for one in unit.outliers) or _reason(unit),
        "report": "" if page is None else posixpath.normpath(f"results/{unit.run.name}/{page}"),
    }


def _reason(unit: Unit) -> str:
    parts = unit.run.parts
    return "" if parts is None or parts.verdict.accepted or not parts.verdict.reasons else parts.verdict.reasons[0]


def _spread_table(units: Sequence[Unit], limits: Limits | None) -> Table:
    """Return median and spread of every figure over the accepted units, and the usual deviation of one calibration."""
    runs = [unit.run for unit in units if unit.run.accepted]
    rows = []
    for quantity in OF_DEVICE:
        values, deviations = figures_of(runs, quantity)
        if not np.isfinite(values).any():
            continue
        most = limits_of(limits, quantity)
        for axis in range(3):
            own = values[:, axis][np.isfinite(values[:, axis])]
            middle = float(np.median(own))
            spread = normal_scale(own - middle)
            usual = float(np.nanmedian(deviations[:, axis]))
            cells = (number(middle), number(spread), number(float(own.min())), number(float(own.max())), number(usual))
            title = title_of(quantity, axis)
            rows.append(
                Row((title, quantity.unit, *cells, f"± {number(most[axis])}" if np.isfinite(most[axis]) else ""))
            )
    columns = ("Quantity", "Unit", "Median", "Spread", "Minimum", "Maximum", "Deviation of one", "Limit")
    return Table("All accepted units", columns, tuple(rows), 2)


def _spread(quantity: Quantity, units: Sequence[Unit], limits: Limits | None) -> Figure:
    """Return a quantity of all accepted units, in their order."""
    runs = [unit.run for unit in units if unit.run.accepted]
    outlying = {unit.run.key: {one.axis for one in unit.outliers if one.quantity is quantity} for unit in units}
    values, deviations = figures_of(runs, quantity)
    place = np.arange(1, len(runs) + 1, dtype=float)
    data: list[Trace] = []
    for axis in range(3):
        label = label_of(quantity, axis)
        more = {"error": COVERAGE * deviations[:, axis]} if len(runs) <= 60 else {}
        shift = 0.2 * (axis - 1) if len(runs) <= 60 else 0.0
        data.append(
            plots.markers(
                place + shift, values[:, axis], label, AXES[axis], size=3, texts=[run.name for run in runs], **more
            )
        )
        marked = [i for i, run in enumerate(runs) if axis in outlying.get(run.key, ())]
        if marked:
            data.append(plots.markers(place[marked] + shift, values[marked, axis], "", "alert", symbol="cross", size=9))
    extreme = float(np.nanmax(np.abs(values)))
    most = [limit for limit in limits_of(limits, quantity).tolist() if _drawn(limit, extreme)]
    data += _limit_lines(most, (0.5, len(runs) + 0.5), "limit")
    x = plots.axis("unit, in the order of the table", range=[0.5, len(runs) + 0.5])
    caption = "Each accepted unit; crosses are outliers of the lot." + (
        " Bars: expanded uncertainty." if len(runs) <= 60 else ""
    )
    return Figure(
        quantity.name, quantity.title, caption,
        plots.plot(x, plots.panel(data, plots.axis(f"{quantity.title} ({quantity.unit})"), height=220, texts=True)),
    )  # fmt: skip


_FAR = 5.0
"""Distance of a limit from zero, over that of the values, from which on it is not drawn. Chosen: values stay seen."""


def _drawn(limit: float, *values: float) -> bool:
    """Return whether a limit is drawn beside values."""
    return bool(limit < _FAR * max(map(abs, values)))


def _limit_lines(limits: Sequence[float], ends: tuple[float, float], name: str) -> list[Trace]:
    """Return a line for every limit of either sign, the first with a name in the legend if there is one."""
    x = np.array(ends, dtype=np.float32)
    return [
        plots.line(Curve(x, np.full(2, limit, dtype=np.float32)), name if i == 0 else "", "alert", dash="dash",
                   legend=bool(name) and i == 0)
        for i, limit in enumerate(sorted({sign * limit for limit in limits for sign in (1.0, -1.0)}))
    ]  # fmt: skip


def write_history(history: History, limits: Limits | None, path: Path) -> None:
    """Write the page of a unit's history as one HTML file that works offline."""
    figures = [_trend(history, trend) for trend in history.trends if np.isfinite(trend.values).any()]
    page = fill(
        "history.html",
        figures,
        unit=history.unit,
        device=" ".join(dict.fromkeys(text for run in history.runs for text in (run.maker, run.type) if text)),
        first=history.days[0].isoformat(),
        last=history.days[-1].isoformat(),
        count=len(history.runs),
        due=history.due,
        with_limits=limits is not None,
        ageing=ageing_table(history),
        runs=_runs_table(history),
        left_out=history.left_out,
        figures=figures,
    )
    path.write_text(page, encoding="utf-8")


def ageing_table(history: History) -> Table:
    """Return level, change a year and scatter of every figure."""
    rows = []
    for trend in history.trends:
        for axis, ageing in enumerate(trend.ageing):
            if not np.isfinite(ageing.level):
                continue
            change = pair(ageing.rate, ageing.rate_sd) if np.isfinite(ageing.rate) else "one date only"
            word = "yes" if ageing.significant else "not shown" if ageing.free > 0 else "too few dates"
            rows.append(
                Row(
                    (
                        title_of(trend.quantity, axis),
                        trend.quantity.unit,
                        pair(ageing.level, ageing.level_sd),
                        change,
                        number(ageing.scatter, 2) if ageing.scatter > 0.0 else "none shown",
                        word,
                    ),
                    weak=not ageing.significant,
                )
            )
    columns = ("Figure", "Unit", "At the last date", "Change a year", "Scatter", "Ageing")
    return Table("Ageing", columns, tuple(rows), 2)


def _runs_table(history: History) -> Table:
    rows = tuple(
        Row((day.isoformat(), run.name, run.headline)) for day, run in zip(history.days, history.runs, strict=True)
    )
    return Table("Calibrations", ("Date", "Recording", "Verdict"), rows, 3)


def _trend(history: History, trend: Trend) -> Figure:
    """Return a quantity over the years, with the fitted lines and their bands."""
    decimal = history.days[-1].year + (history.days[-1].timetuple().tm_yday - 1) / YEAR
    span = max(-float(trend.years.min()), 0.05)
    t = np.linspace(-1.04 * span, _AHEAD * span, 81)
    panels = []
    for axis in range(3):
        ageing = trend.ageing[axis]
        value, sd = ageing.at(t)
        colour = AXES[axis]
        data: list[Trace] = [
            plots.area(decimal + t, value - COVERAGE * sd, value + COVERAGE * sd, "", f"{colour}/0.18"),
            plots.line(Curve((decimal + t).astype(np.float32), value.astype(np.float32)), "", colour, legend=False),
            plots.markers(
                decimal + trend.years, trend.values[:, axis], "", colour, size=6,
                error=COVERAGE * trend.deviations[:, axis], texts=[run.name for run in history.runs],
            ),
        ]  # fmt: skip
        shown = np.concatenate([value - COVERAGE * sd, value + COVERAGE * sd,
                                trend.values[:, axis] - COVERAGE * trend.deviations[:, axis],
                                trend.values[:, axis] + COVERAGE * trend.deviations[:, axis]])  # fmt: skip
        shown = shown[np.isfinite(shown)]
        low, high = (float(shown.min()), float(shown.max())) if shown.size else (-1.0, 1.0)
        limit = float(trend.limits[axis])
        if _drawn(limit, low, high):
            low, high = min(low, -1.05 * limit), max(high, 1.05 * limit)
            data += _limit_lines([limit], (decimal + t[0], decimal + t[-1]), "")
        room = 0.05 * (high - low) or 1.0
        y = plots.axis(f"{label_of(trend.quantity, axis)} ({trend.quantity.unit})", range=[low - room, high + room])
        panels.append(plots.panel(data, y, height=130, texts=True))
    return Figure(
        trend.quantity.name,
        trend.quantity.title,
        "Points: calibrations with their expanded uncertainties; line and band: the fit and its expanded uncertainty, "
        "with the scatter from one calibration to the next.",
        plots.plot(_date_axis(float(decimal + t[0]), float(decimal + t[-1])), *panels),
        link="years",
    )


_FEW_YEARS, _TICKS = 4.0, 6
"""An axis of fewer years shows months, so many at most."""


def _date_axis(first: float, last: float) -> dict[str, Any]:
    """Return an axis of decimal years; of few years with months."""
    if last - first > _FEW_YEARS:
        return plots.axis("year", range=[first, last])
    step = next(months for months in (1, 2, 3, 6, 12) if 12.0 * (last - first) / months <= _TICKS or months == 12)
    months = np.arange(np.ceil(12.0 * first / step) * step, 12.0 * last, step).astype(int)
    return plots.axis(
        "month", range=[first, last],
        ticks=[[float(month) / 12.0 for month in months], [f"{month // 12}-{month % 12 + 1:02d}" for month in months]],
    )  # fmt: skip
