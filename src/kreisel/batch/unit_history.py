"""The history of a unit: its errors over the years, how they age, and when it is due again.

An error is a line in time, with a scatter from one calibration to the next beyond what their deviations explain: the
device is not the same after it was switched off and on. The scatter is estimated from the residuals, the line by
weighted least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np

from kreisel.batch.job_result import Run
from kreisel.batch.lot import OF_DEVICE, figures_of, title_of
from kreisel.calibration.data_sheet import Quantity
from kreisel.calibration.limits import COVERAGE, Limits, limits_of
from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array

YEAR = 365.25
"""Days."""

SHOWN = 3.0
"""Standard deviations beyond which a change is called ageing, where many values tell the scatter."""

_STUDENT = (np.inf, 235.8, 19.21, 9.219, 6.620, 5.507, 4.904, 4.530, 4.277, 4.094, 3.957)
"""The same probability by Student's distribution, where 0, 1, 2, ... degrees of freedom tell the scatter."""

_MIN = 2
"""Calibrations with a date: of one there is no history."""

_LONGEST = 20.0
"""Years ahead in which a due date is looked for."""

_STEPS = 60
"""Halvings of the interval in which the scatter lies: 2^-60 of it is below the resolution of float64, 2^-53."""


@dataclass(frozen=True)
class Ageing:
    """How one figure changes with time.

    Attributes
    ----------
    level, level_sd
        At the last calibration.
    rate, rate_sd
        Change a year; nan with one date only.
    scatter
        Standard deviation from one calibration to the next beyond their own.
    covariance : (2, 2)
        Of level and rate.
    free
        Degrees of freedom of the scatter: values of the quantity less parameters.
    """

    level: float
    level_sd: float
    rate: float
    rate_sd: float
    scatter: float
    covariance: Array
    free: int = 0

    def at(self, years: Array) -> tuple[Array, Array]:
        """Return value and standard deviation so many years after the last calibration."""
        rate = self.rate if np.isfinite(self.rate) else 0.0
        P = np.nan_to_num(self.covariance)
        variance = P[0, 0] + 2.0 * years * P[0, 1] + years**2 * P[1, 1] + self.scatter**2
        return self.level + rate * years, np.sqrt(variance)

    @property
    def significant(self) -> bool:
        """Whether the change a year is larger than three of its standard deviations: a unit has 24 figures.

        More are asked for where few calibrations tell the scatter, also where they show none. Two never show ageing:
        their difference may be the scatter from one calibration to the next.
        """
        return bool(np.isfinite(self.rate) and abs(self.rate) > self._needed * self.rate_sd)

    @property
    def _needed(self) -> float:
        return _STUDENT[self.free] if self.free < len(_STUDENT) else SHOWN * (1.0 + 3.3 / self.free)


@dataclass(frozen=True)
class Trend:
    """One quantity of a unit over time.

    Attributes
    ----------
    quantity
        Of three figures.
    years : (n,)
        Before the last calibration, not positive.
    values, deviations : (n, 3)
        In the quantity's unit.
    ageing
        Of each of the three figures.
    limits : (3,)
        Largest absolute values; infinite where there is none.
    """

    quantity: Quantity
    years: Array
    values: Array
    deviations: Array
    ageing: tuple[Ageing, ...]
    limits: Array


@dataclass(frozen=True)
class Due:
    """When a unit is to be calibrated again, and for which figure.

    `day` is None where it is more than 20 years ahead; `reason` says what is reached then.
    """

    day: date | None
    reason: str


@dataclass(frozen=True)
class History:
    """The history of a unit: its accepted runs by date, its trends, those left out, and when it is due."""

    unit: str
    runs: tuple[Run, ...]
    days: tuple[date, ...]
    trends: tuple[Trend, ...]
    left_out: tuple[tuple[str, str], ...]
    due: Due


def of_one_type(unit: str, runs: Sequence[Run], wanted: str | None) -> list[Run]:
    """Return the runs of one device: a serial number may belong to several, of different makers or types.

    Raises
    ------
    SettingsError
        If there are several and none is chosen, or the chosen one is not among them.
    """
    types = list(dict.fromkeys((run.maker, run.type) for run in runs))
    chosen = [one for one in types if wanted is None or wanted in (one[1], " ".join(one).strip())]
    if len(chosen) == 1:
        return [run for run in runs if (run.maker, run.type) == chosen[0]]
    listed = ", ".join(f"'{' '.join(one).strip() or 'not stated'}'" for one in types)
    if wanted is not None and not chosen:
        raise SettingsError(f"--type {wanted}: unit '{unit}' is of {listed}")
    raise SettingsError(f"devices of several types have the serial number '{unit}': {listed}; choose by --type")


def history_of(unit: str, runs: Sequence[Run], limits: Limits | None, most_months: float | None = None) -> History:
    """Return the history of a unit from its runs, in the order they were made; of one recording the last one counts.

    Parameters
    ----------
    most_months
        The longest interval between two calibrations, whatever the trends say.

    Raises
    ------
    SettingsError
        If fewer than two runs can be used.
    """
    runs = list({run.data: run for run in runs}.values())
    left_out = [(run.name, run.error or "rejected") for run in runs if not run.accepted]
    left_out += [(run.name, "no date") for run in runs if run.accepted and _day(run) is None]
    used = sorted((run for run in runs if run.accepted and _day(run) is not None), key=lambda run: str(run.date))
    if len(used) < _MIN:
        why = "".join(f"; {name}: {reason}" for name, reason in left_out)
        raise SettingsError(
            f"unit '{unit}' has {len(used)} accepted calibrations with a date, expected {_MIN} or more; dates are "
            f"those of stamps since 2000, or [certificate] date in recording.toml{why}"
        )
    days = tuple(date.fromisoformat(str(run.date)) for run in used)
    years = np.array([(day - days[-1]).days / YEAR for day in days])
    trends = []
    for quantity in OF_DEVICE:
        values, deviations = figures_of(used, quantity)
        values = np.where(deviations > 0.0, values, np.nan)  # others were held
        ageing = aged(years, values, deviations)
        trends.append(Trend(quantity, years, values, deviations, ageing, limits_of(limits, quantity)))
    return History(
        unit, tuple(used), days, tuple(trends), tuple(left_out), _at_most(_due(trends, days[-1]), days[-1], most_months)
    )


def _day(run: Run) -> date | None:
    try:
        return None if run.date is None else date.fromisoformat(run.date)
    except (TypeError, ValueError):
        return None


def aged(years: Array, values: Array, deviations: Array) -> tuple[Ageing, ...]:
    """Return level and change a year of each figure of a quantity, (n, k), at times before the last one, in years.

    Notes
    -----
    Values without a deviation were held, not estimated, and do not count. The figures of a quantity have one scatter:
    it makes the weighted sum of squared residuals what is expected of it, the number of values less that of parameters
    (Paule and Mandel 1982); it is found by bisection. Without several dates there is no rate, without more values than
    parameters no scatter.
    """
    good = np.isfinite(values) & np.isfinite(deviations) & (deviations > 0.0)
    lines = [_Line.of(years[own], y[own], sd[own]) for own, y, sd in zip(good.T, values.T, deviations.T, strict=True)]
    free = sum(line.free for line in lines)
    scatter = _scatter(lines, free)
    return tuple(line.ageing(scatter, free) for line in lines)


@dataclass(frozen=True)
class _Line:
    """Columns A (n, 1) or (n, 2) of a line in time, its values and their deviations (n,)."""

    A: Array
    y: Array
    sd: Array

    @classmethod
    def of(cls, t: Array, y: Array, sd: Array) -> _Line:
        several = np.unique(t).size > 1
        return cls(np.column_stack([np.ones_like(t), t]) if several else np.ones((t.size, 1)), y, sd)

    @property
    def free(self) -> int:
        """Values less parameters; of none there are none."""
        return max(self.y.size - self.A.shape[1], 0)

    def fitted(self, scatter: float) -> tuple[Array, Array]:
        """Return level and rate, with their covariance."""
        weight = 1.0 / np.hypot(self.sd, scatter)
        A = self.A * weight[:, None]
        P = np.linalg.pinv(A.T @ A)
        return np.asarray(P @ (A.T @ (self.y * weight))), np.asarray(P)

    def square(self, scatter: float) -> float:
        """Return the weighted sum of squared residuals."""
        x, _ = self.fitted(scatter)
        return float(np.sum((self.y - self.A @ x) ** 2 / (self.sd**2 + scatter**2)))

    def ageing(self, scatter: float, free: int) -> Ageing:
        """Return the line as a change with time; free: values less parameters by which the scatter is known."""
        full = np.full((2, 2), np.nan)
        if not self.y.size:
            return Ageing(np.nan, np.nan, np.nan, np.nan, 0.0, full)
        x, P = self.fitted(scatter)
        full[: x.size, : x.size] = P
        rate, rate_sd = (float(x[1]), float(np.sqrt(P[1, 1]))) if x.size > 1 else (np.nan, np.nan)
        return Ageing(float(x[0]), float(np.sqrt(P[0, 0])), rate, rate_sd, scatter, full, free)


def _scatter(lines: Sequence[_Line], free: int) -> float:
    used = [line for line in lines if line.free]

    def excess(scatter: float) -> float:
        return sum(line.square(scatter) for line in used) - free

    if not used or excess(0.0) <= 0.0:
        return 0.0
    low, high = 0.0, max(float(np.ptp(line.y)) + float(line.sd.max()) for line in used)
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


def _not_known(ageing: Ageing) -> str:
    """Return that a change is not known yet, where it is uncertain and not shown: a due date is then early."""
    if not np.isfinite(ageing.rate) or ageing.significant:
        return ""
    return f"; its change a year is not known better than ± {COVERAGE * ageing.rate_sd:.2g}: calibrate again before"


def _at_most(due: Due, last: date, months: float | None) -> Due:
    """Return the due date, not later than the longest interval allows."""
    if months is None:
        return due
    latest = last + timedelta(days=round(min(months, 12.0 * _LONGEST) * YEAR / 12.0))
    if due.day is not None and due.day <= latest:
        return due
    return Due(latest, f"the longest interval, {months:g} months, ends")


def _due(trends: Sequence[Trend], last: date) -> Due:
    """Return when the first figure may have left its limit; without limits, when an uncertainty has doubled.

    A figure may have left its limit when its value and expanded uncertainty reach it. The uncertainty of what was found
    at the last calibration has doubled when the expected change since, with its expanded uncertainty, is as large as
    sqrt(3) times the expanded uncertainty of the calibration.
    """
    ahead = np.linspace(0.0, _LONGEST, 4001)
    best, reason = np.inf, ""
    limited = any(np.isfinite(trend.limits).any() for trend in trends)
    for trend in trends:
        for axis, ageing in enumerate(trend.ageing):
            value, sd = ageing.at(ahead)
            label = title_of(trend.quantity, axis)
            if np.isfinite(limit := trend.limits[axis]):
                over = np.abs(value) + COVERAGE * sd > limit
                text = f"{label} may reach its limit of {limit:.3g} {trend.quantity.unit}{_not_known(ageing)}"
            elif limited or not np.isfinite(ageing.rate) or ageing.free < 1:
                continue
            else:
                own = COVERAGE * float(trend.deviations[-1, axis])
                change = np.abs(ageing.rate) * ahead + COVERAGE * np.sqrt(ageing.rate_sd**2 * ahead**2)
                over = change > np.sqrt(3.0) * np.hypot(own, COVERAGE * ageing.scatter)
                has = "has" if ageing.significant else "may have"
                text = f"the uncertainty of {label} {has} doubled by ageing{_not_known(ageing)}"
            if over.any() and ahead[int(np.argmax(over))] < best:
                best, reason = float(ahead[int(np.argmax(over))]), text
    if not np.isfinite(best):
        if not limited and all(ageing.free < 1 for trend in trends for ageing in trend.ageing):
            return Due(None, "two dates do not tell ageing from scatter: calibrate a third time")
        return Due(None, "no figure reaches its limit within 20 years" if limited else "nothing ages within 20 years")
    try:
        return Due(last + timedelta(days=round(best * YEAR)), reason)
    except OverflowError:  # dates end with the year 9999
        return Due(None, reason)
