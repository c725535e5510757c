"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from kreisel.calibration.evidence import Injection
    from kreisel.calibration.outcome import Outcome
    from kreisel.report.devices import Device

_ROWS = (
    ("gyro scale error", "gyro_scale_ppm", "ppm", ("x", "y", "z")),
    ("gyro non-orthogonality", "gyro_non_orthogonality_mrad", "mrad", ("xy", "xz", "yz")),
    ("gyro offset", "offset_deg_h", "deg/h", ("x", "y", "z")),
    ("accelerometer scale error", "accel_scale_ppm", "ppm", ("x", "y", "z")),
    ("accelerometer non-orthogonality", "non_orthogonality_mrad", "mrad", ("xy", "xz", "yz")),
    ("accelerometer offset", "offset_mg", "mg", ("x", "y", "z")),
    ("mounting", "mounting_rotation_deg", "deg", ("x", "y", "z")),
    ("gyros to accelerometers", "gyro_to_accel_rotation_mrad", "mrad", ("x", "y", "z")),
)


def _console() -> Console:
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=120)


def _pair(value: float, deviation: float) -> str:
    """Return a value with its standard deviation, rounded to two digits of the latter; without one it was held."""
    from math import floor, log10

    if not deviation > 0.0:
        return f"held at {value:.6g}"
    digits = max(0, min(6, 1 - floor(log10(deviation))))
    return f"{value:.{digits}f} ± {deviation:.{digits}f}"


def print_result(outcome: Outcome) -> None:
    """Print what was found, with uncertainties, and the verdict."""
    document = outcome.calibration.document
    console = _console()
    for finding in outcome.findings:
        console.print(f"· {finding}", markup=False)
    table = Table(title=f"{outcome.recording.name}: {document['recording']['reference']}", title_justify="left")
    for name in ("quantity", "unit", "x / xy", "y / xz", "z / yz"):
        table.add_column(name, justify="left" if name in ("quantity", "unit") else "right")
    derived, deviations = document["derived"], document["standard_deviation"]["derived"]
    for title, key, unit, _ in _ROWS:
        table.add_row(title, unit, *(_pair(v, s) for v, s in zip(derived[key], deviations[key], strict=True)))
    held = {*document["estimator"]["fixed"], *document["estimator"]["held"]}
    for j, axis in enumerate("xyz"):
        arms = document["accelerometer"]["lever_arms"][j]
        sd = document["standard_deviation"]["accelerometer"]["lever_arms"][j]
        sd = [0.0] * 3 if "lever_arms" in held else sd
        table.add_row(
            f"lever arm of accelerometer {axis}",
            "mm",
            *(_pair(1e3 * a, 1e3 * s) for a, s in zip(arms, sd, strict=True)),
        )
    timing, timing_sd = document["timing"], document["standard_deviation"]["timing"]
    offset_sd = 0.0 if "time_offset" in held else timing_sd["offset"]
    table.add_row("time offset", "ms", _pair(1e3 * timing["offset"], 1e3 * offset_sd), "", "")
    if timing_sd["skew"] is None and timing["skew"]:
        table.add_row("clock ratio less one", "ppm", _pair(1e6 * timing["skew"], 0.0), "", "")
    elif timing_sd["skew"]:
        table.add_row("clock ratio less one", "ppm", _pair(1e6 * timing["skew"], 1e6 * timing_sd["skew"]), "", "")
    console.print(table)
    _print_robot(console, document)
    _print_verdict(console, document)


def _print_robot(console: Console, document: dict[str, Any]) -> None:
    robot = document.get("robot")
    if robot is None:
        return
    before, after = (robot["pose_error"][key] for key in ("believed_before", "believed_after"))
    console.print(
        f"robot {robot['name']}: pose error {1e3 * before['position_rms']:.2g} mm, "
        f"{1e3 * before['orientation_rms']:.2g} mrad before, {1e3 * after['position_rms']:.2g} mm, "
        f"{1e3 * after['orientation_rms']:.2g} mrad once its errors are known (base and tool frames apart)",
        markup=False,
    )


def _print_verdict(console: Console, document: dict[str, Any]) -> None:
    facts, verdict = document["consistency"], document["verdict"]
    still = facts["nis_standstill"]
    console.print(
        f"normalised innovation squared (expected 1): path {facts['nis_path']:.2f}"
        + ("" if still is None else f", standstill {still:.2f}")
        + f"; rejected {facts['rejected_updates']} of {facts['updates']} updates",
        markup=False,
    )
    if verdict["unobservable"]:
        names = verdict["unobservable"]
        console.print(f"not shown by this motion, or too weakly: {', '.join(names)}", markup=False)
    reasons = f" Reasons: {'; '.join(verdict['reasons'])}" if verdict["reasons"] else ""
    console.print(f"verdict: {verdict['summary'][0].lower()}{verdict['summary'][1:]}{reasons}", markup=False)


def print_rows(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of text, numbers to the right."""
    table = Table(title=title, title_justify="left")
    for i, name in enumerate(columns):
        table.add_column(name, justify="left" if i < 2 else "right")
    for row in rows:
        table.add_row(*row)
    _console().print(table)


def print_devices(devices: Sequence[Device]) -> None:
    """Print error, standard deviation and their ratio, rms over each group, for every device."""
    table = Table(
        title="rms error against the truth (rms standard deviation; rms of error over it)", title_justify="left"
    )
    table.add_column("group")
    table.add_column("unit")
    for device in devices:
        table.add_column(device.name, justify="right")
    for name, group in devices[0].errors.items():
        cells = [device.errors[name] for device in devices]
        table.add_row(group.title, group.unit, *(f"{c.size:.3g} ({c.believed:.3g}; {c.ratio:.1f})" for c in cells))
    console = _console()
    console.print(table)
    console.print("the paper's accelerometer offsets were uncertain by up to 0.1 mg", markup=False)


def print_injection(injection: Injection) -> None:
    """Print injected errors against what was found."""
    table = Table(title="injected errors", title_justify="left")
    for name in ("parameter", "injected", "found", "difference / sd"):
        table.add_column(name, justify="left" if name == "parameter" else "right")
    for name, a, b, sd in zip(injection.names, injection.injected, injection.found, injection.deviation, strict=True):
        if abs(a) > 1e-12:
            table.add_row(name, f"{a:.6g}", f"{b:.6g}", f"{(b - a) / sd:.2f}")
    _console().print(table)
