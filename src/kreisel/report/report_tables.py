"""Tables of the report: numbers as text, rounded by their standard deviations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from kreisel.calibration.evidence import Injection, SplitHalves
from kreisel.calibration.outcome import Outcome
from kreisel.geometry.rotation import Array
from kreisel.model.considered_terms import Considered
from kreisel.model.groups import REGISTRY, group_named
from kreisel.model.parameters import GROUPS, ROBOT_GROUPS
from kreisel.recording.recording import DataWarning
from kreisel.refinement.noise_adaptation import imu_density
from kreisel.report.cells import NOTHING, Row, Table, number, pair, with_minus
from kreisel.report.data import Change, Difference, Excitation, ReportData, Residuals, Unseen
from kreisel.report.reader_names import in_words
from kreisel.report.result_tables import Support
from kreisel.robot.pose_accuracy import PoseAccuracy
from kreisel.synchronization.clock import Clock
from kreisel.units import MG, MM, MRAD, MS, PPM

UNITS: dict[str, tuple[str, float]] = {group.name: (group.unit, group.size) for group in REGISTRY}
"""Unit a group of parameters is shown in, and its size in SI."""


def rejected_table(outcome: Outcome) -> Table | None:
    """Return the updates that were rejected, the largest first, each with what is large in it; None without any."""
    history = outcome.estimate.run.history
    lost = np.flatnonzero(~history.used)
    if not lost.size:
        return None
    words = [f"{what} {axis}" for what in ("position", "attitude", "velocity") for axis in "xyz"]
    size = np.nan_to_num(np.abs(history.whitened[lost]))
    rows = []
    for i in np.argsort(-size.max(axis=1))[:_REJECTED]:
        j = int(np.argmax(size[i]))
        where = "standstill" if history.at_standstill[lost[i]] else "path"
        rows.append(Row((f"{history.seconds[lost[i]]:.2f}", where, words[j], number(float(size[i, j]), 3))))
    title = f"Rejected updates, {len(rows)} of {lost.size}"
    return Table(title, ("IMU time (s)", "Kind", "Largest in", "Standard deviations"), tuple(rows), 3)


_REJECTED = 8
"""Rejected updates that are listed."""

_RANKS = (
    ("masked", "lost", "gaps", "accumulated", "intervals", "while recording", "stamps", "repeats", "clocks"),
    ("imu", "noise", "outliers", "quaternions", "whiteness", "differences", "offsets", "standstill"),
    ("effects", "robot", "joints", "reference", "overlap", "motion"),
)
"""Subjects of warnings: of data that are not there, of data that do not fit, of what limits the rest."""


def ranked(warnings: Sequence[DataWarning]) -> list[DataWarning]:
    """Return warnings, those about missing data first, then those about data that do not fit, then the others."""

    def rank(warning: DataWarning) -> int:
        return next((i for i, subjects in enumerate(_RANKS) if warning.subject in subjects), len(_RANKS))

    return sorted(warnings, key=rank)


def excitation_table(excitation: Excitation) -> Table:
    """Return least, greatest and rms reading of every axis."""
    rows = []
    for title, unit, spread in (
        ("Angular rate", "deg/s", excitation.rate_spread),
        ("Acceleration", "m/s²", excitation.force_spread),
    ):
        for i, axis in enumerate("xyz"):
            peak = max(abs(spread.least[i]), abs(spread.greatest[i]))
            values = spread.rms[i], peak, spread.least[i], spread.greatest[i]
            rows.append(Row((f"{title} {axis}", unit, *(number(float(v), 4) for v in values))))
    return Table(
        "Raw readings over the whole recording",
        ("Axis", "Unit", "rms", "peak", "minimum", "maximum"),
        tuple(rows),
        2,
    )


def clock_table(outcome: Outcome, excitation: Excitation) -> Table:
    """Return the time relation step by step."""
    final = excitation.clock[-1]
    first = int(outcome.recording.imu.stamps_ns[0]), int(outcome.problem.reference.stamps_ns[0])
    rows = [
        Row(
            (
                step.name,
                with_minus(f"{Clock(step.start).offset(*first):.6f}"),
                with_minus(f"{(step.start - final.start) / MS:+.3f}"),
                with_minus(f"{step.skew / PPM:.1f}"),
            )
        )
        for step in excitation.clock
    ]
    return Table("Time relation", ("Found by", "Offset (s)", "Less the final one (ms)", "Skew (ppm)"), tuple(rows))


def nis_table(residuals: Residuals) -> Table:
    """Return the mean NIS of each kind of update with the band in which it should lie."""
    rows = []
    for kind in residuals.kinds:
        low, high = kind.mean_bounds
        fits = low <= kind.mean <= high
        word = "as assumed" if fits else "larger" if kind.mean > high else "smaller"
        rows.append(
            Row(
                (
                    kind.name,
                    str(kind.count),
                    str(kind.rejected),
                    str(kind.degrees),
                    number(kind.mean),
                    f"{number(low)} to {number(high)}",
                    word if math.isfinite(kind.mean) else NOTHING,
                ),
                weak=kind.mean > high,
            )
        )
    columns = ("Kind", "Updates", "Rejected", "Degrees", "Mean", "95 % band", "Innovations")
    return Table("NIS per degree of freedom", columns, tuple(rows), broad=True)


def noise_table(outcome: Outcome) -> Table:
    """Return the noise figures finally assumed."""
    noise, reference = outcome.problem.noise.reference, outcome.problem.reference
    gyro, accel = imu_density(outcome.problem)
    absent = {"mm": reference.positions is None, "mrad": reference.quaternions is None}
    rows = []
    for title, value, unit, size in (
        ("Reference position, path", noise.position, "mm", MM),
        ("Reference attitude, path", noise.orientation, "mrad", MRAD),
        ("Reference position, standstill", noise.standstill_position, "mm", MM),
        ("Reference attitude, standstill", noise.standstill_orientation, "mrad", MRAD),
        ("Gyro noise density", gyro, "mrad/s/√Hz", MRAD),
        ("Accelerometer noise density", accel, "mg/√Hz", MG),
    ):
        if not absent.get(unit):
            rows.append(Row((title, unit, number(value / size))))
    return Table("Noise finally assumed", ("Source", "Unit", "Standard deviation or density"), tuple(rows), 2)


def cause_table(difference: Difference) -> Table:
    """Return the rms of the change by cause."""
    rows: list[Row] = []
    for title, unit, change in (
        ("rate", "deg/s", difference.rates),
        ("specific force", "mg", difference.forces),
    ):
        rows.extend(_cause_rows(title, unit, change))
    return Table("Change by cause, rms over the excerpt", ("Cause", "Unit", "x", "y", "z"), tuple(rows), 2)


def _cause_rows(title: str, unit: str, change: Change) -> Iterable[Row]:
    for cause, rms in change.causes.items():
        yield Row((f"{title}: {cause}", unit, *(number(float(v)) for v in rms)))


def considered_table(outcome: Outcome) -> Table | None:
    """Return every effect that was considered: its largest value, what it gains, and what it changes."""
    rows = [considered_row(effect) for effect in outcome.estimate.considered]
    for walking, gain in outcome.estimate.walks.items():
        name = f"random walk during the recording: {group_named(walking).meaning.split(',')[0]}"
        density = number(outcome.problem.noise.offset_walk[walking])
        rows.insert(0, Row((name, "SI/√s", density, f"{gain:.1f}", "yes", "")))
    if not rows:
        return None
    return Table("Error terms beyond the usual model", CONSIDERED, tuple(rows), 2, broad=True)


CONSIDERED = ("Error term", "Unit", "Estimate", "Gain", "Estimated", "Largest shift")
"""Columns of `considered_row`."""


def considered_row(effect: Considered) -> Row:
    """Return an effect that was considered: its clearest value, what it gains, and what it changes."""
    group = group_named(effect.group)
    values, sd = effect.value / group.size, effect.deviation / group.size
    worst = int(np.argmax(np.abs(values) / np.maximum(sd, 1e-300)))
    shift = f"{effect.shift:.1f} ({in_words(effect.shifted)})" if effect.shifted else ""
    name = group.meaning if values.size == 1 else f"{group.meaning} (of {values.size}, the clearest)"
    cells = (name, group.unit, pair(float(values[worst]), float(sd[worst])), f"{effect.gain:.1f}")
    return Row((*cells, "yes" if effect.included else "no", shift), weak=not effect.included)


def parameter_table(data: ReportData) -> Table:
    """Return every estimated parameter with its standard deviation before and after."""
    outcome, u = data.outcome, data.uncertainty
    support, parameters = Support.of(outcome), outcome.estimate.run.parameters
    values: list[float | None] = []
    for group in outcome.problem.groups:
        stored = [None] * 3 if group == "alignment" else list(outcome.problem.stored(parameters, group))
        if group == "time_offset":
            stored = [outcome.calibration.timing.offset]
        part = outcome.problem.layout[group]
        values.extend(stored[: part.stop - part.start])
    rows: list[Row] = []
    for name, group, value, before, after in zip(u.names, u.groups, values, u.prior, u.posterior, strict=True):
        if group in ROBOT_GROUPS:
            continue  # they have a table of their own
        unit, size = UNITS.get(group, ("SI", 1.0))
        gain = float(before / after) if after > 0.0 else math.inf
        word = support.of_name(name)
        rows.append(
            Row(
                (
                    name,
                    unit,
                    pair(None if value is None else value / size, after / size),
                    number(float(before / size)),
                    number(float(after / size)),
                    word,
                    number(gain, 3),
                ),
                weak=word != "yes",
                bar=float(np.clip(np.log10(max(gain, 1.0)) / 5.0, 0.0, 1.0)),
            )
        )
    columns = ("Parameter", "Unit", "Estimate", "Usual sd", "Posterior sd", "Observable", "Usual / posterior")
    return Table("Every estimated parameter of IMU and cell", columns, tuple(rows), 2, broad=True)


def robot_tables(outcome: Outcome) -> tuple[Table, Table] | None:
    """Return the robot's errors joint by joint, and their effect on its poses; None where none were estimated."""
    robot = outcome.calibration.robot
    if robot is None:
        return None
    names = [*robot.joints, f"{robot.tcp} (tool)"]
    lost = set(robot.not_separable)
    rows = []
    for j, (name, values, sds) in enumerate(
        zip(names, robot.placement.value.tolist(), robot.placement.deviation.tolist(), strict=True)
    ):
        own = [f"robot.placement[{j},{i}]" in lost for i in range(6)]
        cells = tuple(
            NOTHING if gone else pair(1e3 * value, 1e3 * sd) for value, sd, gone in zip(values, sds, own, strict=True)
        )
        rows.append(Row((name, *cells), weak=all(own)))
    placements = Table(
        f"Errors of {robot.name}: how far each placement lies from the model's",
        ("Joint", "x (mm)", "y (mm)", "z (mm)", "about x (mrad)", "about y (mrad)", "about z (mrad)"),
        tuple(rows),
        broad=True,
    )

    def row(title: str, error: PoseAccuracy) -> Row:
        return Row((title, number(1e3 * error.position), number(1e3 * error.orientation)))

    poses = Table(
        "Pose error, rms over the motion's poses, without errors of the base and tool frames",
        ("", "Position (mm)", "Orientation (mrad)"),
        (
            row("Expected before", robot.before),
            row("Removed by the estimated errors", robot.found),
            row("Expected to remain", robot.after),
        ),
    )
    return poses, placements


def not_estimated(outcome: Outcome) -> list[tuple[str, str]]:
    """Return the groups that were not estimated, each with why."""
    settings = outcome.problem.settings
    at = dict(settings.fixed_values)
    return [(g, f"fixed by the user{', at the value given' if g in at else ''}") for g in GROUPS if g in settings.fixed]


def drift_table(unseen: Unseen) -> Table:
    """Return the drift between updates, nominal against calibrated."""
    rows: list[Row] = []
    for i, (title, unit) in enumerate((("Position", "mm"), ("Attitude", "mrad"))):
        a, b = unseen.nominal, unseen.calibrated
        gain = a.rms[i] / b.rms[i] if b.rms[i] > 0.0 else math.inf
        values = a.rms[i], b.rms[i], gain, a.greatest[i], b.greatest[i]
        rows.append(Row((title, unit, *(number(v) for v in values)), weak=gain < 1.0))
    columns = (
        "Drift",
        "Unit",
        "rms nominal",
        "rms calibrated",
        "Ratio of rms",
        "Maximum nominal",
        "Maximum calibrated",
    )
    return Table("Drift between updates on unseen data", columns, tuple(rows), 2, broad=True)


def free_navigation_table(unseen: Unseen) -> Table:
    """Return the rms error of free navigation on data that were not used, before and after calibration."""
    rows = [
        Row((title, unit, number(before), number(after), number(before / after) if after > 0.0 else NOTHING))
        for title, unit, before, after in zip(
            ("Position", "Attitude"), ("mm", "mrad"), unseen.nominal.rms, unseen.calibrated.rms, strict=True
        )
        if math.isfinite(after)
    ]
    columns = ("Error", "Unit", "Before calibration", "After", "Times smaller")
    return Table("Error of free navigation from one update to the next, rms", columns, tuple(rows), 2)


def score_summary(halves: SplitHalves) -> tuple[str, str, str]:
    """Return rms of the scores, share within two, and the parameter that repeats worst."""
    score: Array = halves.score
    worst = int(np.argmax(np.abs(score)))
    return (
        number(float(np.sqrt(np.mean(score**2)))),
        f"{100.0 * float(np.mean(np.abs(score) <= 2.0)):.0f} %",
        f"{in_words(halves.names[worst])} ({with_minus(f'{score[worst]:.1f}')})",
    )


def injection_table(injection: Injection, groups: dict[str, str]) -> Table:
    """Return injected errors against those found.

    Parameters
    ----------
    groups
        Group of every parameter.
    """
    rows = []
    for name, put, got, sd in zip(
        injection.names, injection.injected, injection.found, injection.deviation, strict=True
    ):
        unit, size = UNITS.get(groups[name], ("SI", 1.0))
        if abs(put) < 1e-12 or groups[name] in ("alignment", "north", "earth_down"):
            continue
        score = (got - put) / max(sd, 1e-300)
        rows.append(
            Row(
                (name, unit, *(number(float(v / size), 4) for v in (put, got, sd)), with_minus(f"{score:.2f}")),
                weak=abs(score) > 2.0,
            )
        )
    columns = (
        "Parameter",
        "Unit",
        "Expected change",
        "Found change",
        "Standard deviation",
        "Difference / sd",
    )
    return Table("Known errors added to the raw readings", columns, tuple(rows), 2, broad=True)
