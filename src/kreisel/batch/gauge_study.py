"""Gauge study: how much of the spread of results is due to the calibration, the appraiser, and the units themselves.

Every result is mean + unit + appraiser + both together + repetition, each with a variance of its own. The variances
have the largest restricted likelihood, none below zero: in a complete design they are those of the analysis of
variance with an interaction that is pooled where it is none, and runs may be missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.batch.job_result import Run
from kreisel.batch.lot import OF_DEVICE, figures_of, title_of
from kreisel.calibration.data_sheet import Quantity
from kreisel.calibration.limits import Limits, limits_of
from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array
from kreisel.recording.recording_settings import CertificateTable, DeviceTable
from kreisel.report.cells import Row, Table, number

APPRAISERS = (*CertificateTable.model_fields, *DeviceTable.model_fields)
"""Keys of recording.toml that may say who or what calibrated."""

_PASSES = 500
"""Steps of the iteration; a complete design needs two. Chosen: incomplete ones need some dozens."""

_FULL_STEPS = 20
"""Steps of full length; half ones then leave a cycle that full ones may enter. Chosen: most designs need fewer."""

_SETTLED = 1e-9
"""Relative change of the variances after which the iteration ends."""

GOOD, POOR = 0.1, 0.3
"""Shares of tolerance below which a gauge is good, and above which it is not acceptable (AIAG MSA, 4th edition)."""


@dataclass(frozen=True)
class Components:
    """Standard deviations of the parts of a result."""

    repeatability: float
    appraiser: float
    interaction: float
    unit: float

    @property
    def reproducibility(self) -> float:
        """Of the appraiser, alone and together with the unit."""
        return math.hypot(self.appraiser, self.interaction)

    @property
    def gauge(self) -> float:
        """Of repeatability and reproducibility, R&R."""
        return math.hypot(self.repeatability, self.reproducibility)

    @property
    def total(self) -> float:
        """Of all parts."""
        return math.hypot(self.gauge, self.unit)

    @property
    def categories(self) -> int:
        """How many classes of units can be distinguished (ndc of AIAG MSA)."""
        return math.floor(math.sqrt(2.0) * self.unit / self.gauge) if self.gauge > 0.0 else 0


@dataclass(frozen=True)
class Gauged:
    """One figure in a gauge study.

    Attributes
    ----------
    limit
        Largest absolute value; infinite where there is none.
    calibration_sd
        Root mean square of the standard deviations that the calibrations state: what repeatability should be.
    """

    quantity: Quantity
    axis: int
    components: Components
    limit: float
    calibration_sd: float

    @property
    def of_tolerance(self) -> float:
        """Six deviations of the gauge over the width of the limits; nan without limits."""
        return 3.0 * self.components.gauge / self.limit if math.isfinite(self.limit) else math.nan


def variance_components(values: Array, units: Sequence[str], appraisers: Sequence[str]) -> Components:
    """Return the components of values (n,), each of a unit by an appraiser.

    Raises
    ------
    SettingsError
        If nothing was repeated.

    Notes
    -----
    Restricted maximum likelihood by scoring (Harville 1977, J. Am. Stat. Assoc. 72, 320); a variance that would be
    negative is zero. A component that the design cannot show is zero.
    """
    cells = [f"{unit}\n{appraiser}" for unit, appraiser in zip(units, appraisers, strict=True)]
    designs = [np.eye(len(values))]
    names = ["repeatability"]
    several = len(set(appraisers)) > 1
    for name, levels in (("appraiser", appraisers), ("interaction", cells), ("unit", units)):
        count = len(set(levels))
        if count < 2 or count == len(values) or (name == "interaction" and (not several or count == len(set(units)))):
            continue
        found = sorted(set(levels))
        Z = np.array([[level == one for one in found] for level in levels], float)
        designs.append(Z @ Z.T)
        names.append(name)
    if len(set(units)) == len(values):
        raise SettingsError("no unit was calibrated twice: a gauge study needs repetitions")
    theta = _restricted(np.asarray(values, float), designs)
    own = dict(zip(names, np.sqrt(theta).tolist(), strict=True))
    return Components(*(own.get(name, 0.0) for name in ("repeatability", "appraiser", "interaction", "unit")))


def _restricted(y: Array, designs: Sequence[Array]) -> Array:
    """Return the variances of the largest restricted likelihood."""
    scale = float(np.var(y, ddof=1))
    if scale == 0.0:
        return np.zeros(len(designs))
    y = y / math.sqrt(scale)
    theta = np.full(len(designs), 1.0 / len(designs))
    one = np.ones(y.size)
    for step in range(_PASSES):
        inverse = np.linalg.inv(sum(t * V for t, V in zip(theta, designs, strict=True)))
        left = inverse @ one
        P = inverse - np.outer(left, left) / (one @ left)
        PV = [P @ V for V in designs]
        S = np.array([[np.sum(A * B.T) for B in PV] for A in PV])
        q = np.array([y @ A @ P @ y for A in PV])
        new = _not_negative(S, q)
        new[0] = max(new[0], 1e-12)
        if np.max(np.abs(new - theta)) < _SETTLED:
            return np.asarray(scale * new)
        theta = 0.5 * (theta + new) if step > _FULL_STEPS else new
    return np.asarray(scale * theta)


def _not_negative(S: Array, q: Array) -> Array:
    """Return the solution of S x = q without its negative entries, which are zero."""
    used = np.ones(q.size, bool)
    while used.any():
        x = np.zeros(q.size)
        x[used] = np.linalg.solve(S[np.ix_(used, used)], q[used])
        if (x >= 0.0).all():
            return x
        used &= x > 0.0
    return np.zeros(q.size)


def gauge_study(runs: Sequence[Run], limits: Limits | None, by: str = "operator") -> list[Gauged]:
    """Return the components of every figure over accepted runs, of which each recording counts once.

    Parameters
    ----------
    by
        Key of `[certificate]` or `[device]` in recording.toml that says who calibrated.

    Raises
    ------
    SettingsError
        If nothing was repeated, or each unit has an appraiser of its own.
    """
    used = counted_once(runs)
    pairs = {(run.device, appraiser_of(run, by)) for run in used}
    if len(pairs) > 1 and len(pairs) == len({unit for unit, _ in pairs}) == len({one for _, one in pairs}):
        raise SettingsError(
            f"every unit has a {by} of its own, which does not say who calibrated; choose another key by --by"
        )
    out = []
    for quantity in OF_DEVICE:
        values, deviations = figures_of(used, quantity)
        for axis in range(3):
            known = np.flatnonzero(np.isfinite(values[:, axis]) & (np.nan_to_num(deviations[:, axis]) > 0.0))
            if known.size < 3:
                continue
            own = [used[i] for i in known]
            appraisers = [appraiser_of(run, by) for run in own]
            found = variance_components(values[known, axis], ["\n".join(run.device) for run in own], appraisers)
            usual = math.sqrt(float(np.mean(deviations[known, axis] ** 2)))
            out.append(Gauged(quantity, axis, found, float(limits_of(limits, quantity)[axis]), usual))
    if not out:
        raise SettingsError(f"{len(used)} accepted calibrations: a gauge study needs units with several")
    return out


def counted_once(runs: Sequence[Run]) -> list[Run]:
    """Return accepted runs, of one recording the last one.

    Raises
    ------
    SettingsError
        If the same data stand under two units.
    """
    found: dict[str, Run] = {}
    for run in runs:
        other = found.get(run.data)
        if other is not None and other.unit != run.unit and run.data != run.name:
            raise SettingsError(
                f"{other.name} of unit {other.unit} and {run.name} of unit {run.unit} are calibrations of the same "
                "data: correct the serial number in one of the recordings, or delete it"
            )
        found[run.data] = run
    return [run for run in found.values() if run.accepted]


def appraiser_of(run: Run, by: str) -> str:
    """Return who or what calibrated, as the recording states it; empty where it does not."""
    facts = None if run.parts is None else run.parts.recording
    return "" if facts is None else {**facts.device, **facts.certificate}.get(by, "")


def gauge_table(found: Sequence[Gauged]) -> Table:
    """Return the study as a table, the largest share of the tolerance first."""
    rows = []
    for one in sorted(found, key=lambda one: -(one.of_tolerance if math.isfinite(one.of_tolerance) else -1.0)):
        own = one.components
        share = f"{100.0 * one.of_tolerance:.1f} %" if math.isfinite(one.of_tolerance) else ""
        parts = (own.repeatability, own.reproducibility, own.unit)
        ratio = own.repeatability / one.calibration_sd
        rows.append(Row(
            (title_of(one.quantity, one.axis), one.quantity.unit,
             *(number(part, 3) for part in parts), share, f"{own.categories}", f"{ratio:.2f}"),
            weak=one.of_tolerance > POOR,
        ))  # fmt: skip
    columns = ("Figure", "Unit", "Repeatability", "Reproducibility", "Units", "R&R of tolerance", "Classes",
               "Repeatability over stated deviation")  # fmt: skip
    return Table("Gauge study, standard deviations", columns, tuple(rows), 2)


def gauge_facts(found: Sequence[Gauged]) -> list[str]:
    """Return what the study says, in sentences."""
    limited = [one for one in found if math.isfinite(one.of_tolerance)]
    facts = []
    for text, low, high in (
        ("not acceptable, above 30 % of the tolerance", POOR, math.inf),
        ("acceptable with care, 10 to 30 % of the tolerance", GOOD, POOR),
        ("good, below 10 % of the tolerance", -1.0, GOOD),
    ):
        if count := sum(low < one.of_tolerance <= high for one in limited):
            facts.append(f"{text}: {count} of {len(limited)} figures")
    ratios = np.array([one.components.repeatability / one.calibration_sd for one in found])
    facts.append(
        f"Repeatability is {np.median(ratios):.2f} times the deviation that calibrations state (median of {len(found)} "
        "figures): 1 if nothing but what they account for changes from run to run. Offsets change when a "
        "device is switched off and on."
    )
    return facts
