"""`kreisel info`: contents of a recording, and warnings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.cli import options
from kreisel.units import MG

if TYPE_CHECKING:
    from kreisel.recording.recording import Recording


def info(
    recording: Path = typer.Argument(..., help="Recording: a folder, an .mcap file, or a ROS bag."),
    reference: str | None = options.REFERENCE,
    imu: str | None = options.ONE_OR_ALL_IMUS,
    columns: list[str] = options.COLUMNS,
    json: bool = typer.Option(False, "--json", help="Print one JSON object."),
) -> None:
    """Print the contents of a recording: rates, jitter, gaps, excitation, standstills, warnings."""
    import json as json_module

    from kreisel.cli.progress_bar import progress_bar
    from kreisel.formats.imus import ALL, imus_in
    from kreisel.formats.loading import load

    names = imus_in(recording, imu) if imu in (None, ALL) and not columns else ()
    with progress_bar() as show:
        first = names[0] if len(names) > 1 else imu
        read = load(recording, reference, first, columns=columns, progress=show)
    facts = _facts(read)
    if len(names) > 1:
        facts = _facts_of_units(facts, read, names)
    if json:
        typer.echo(json_module.dumps(facts))
        return
    from kreisel.cli.terminal_tables import print_sentences

    for title, table in facts.items():
        if isinstance(table, dict):
            typer.echo(f"{title}")
            for name, value in table.items():
                text = _text(value)
                typer.echo(f"  {name:<30}{text}" if len(text) < 48 else f"  {name}\n      {text}")
    print_sentences([f"· {line}" for line in facts["findings"]])


def _facts_of_units(facts: dict[str, Any], base: Recording, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the facts of a recording of several IMUs: those of each IMU by its name, and those of the first one."""
    from kreisel.array.unit_readings import unit_reader
    from kreisel.errors import KreiselError

    of_imus, findings, read = {names[0]: facts["imu"]}, list(facts["findings"]), unit_reader(base, names[0])
    for name in names[1:]:
        try:
            unit = read(name)
        except KreiselError as error:
            findings.append(f"{name}: {error}")
            continue
        of_imus[name] = _facts_of_imu(unit)
        findings += [f"{name}: {warning}" for warning in unit.warnings]
    others = {title: table for title, table in facts.items() if title not in ("imu", "findings")}
    return {**of_imus, **others, "findings": findings}


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "  ".join(_text(v) for v in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _facts_of_imu(recording: Recording) -> dict[str, Any]:
    import numpy as np

    from kreisel.inertial.noise_figures import high_frequency_density

    imu = recording.imu
    steps = np.diff(imu.stamps_ns) * 1e-9
    return {
        "samples": int(imu.stamps_ns.size),
        "sha256 of all data": recording.sha256,
        "duration s": float(imu.seconds[-1]),
        "rate Hz": 1.0 / imu.interval,
        "stamp jitter us": round(float(np.std(steps[steps < 1.6 * imu.interval]) * 1e6), 6),
        "longest step ms": float(steps.max() * 1e3),
        "rate rms x y z deg/s": np.rad2deg(np.sqrt(np.mean(imu.rates**2, axis=0))).tolist(),
        "rate peak x y z deg/s": np.rad2deg(np.abs(imu.rates).max(axis=0)).tolist(),
        "acceleration rms x y z m/s^2": np.sqrt(np.mean(imu.accelerations**2, axis=0)).tolist(),
        "gyro noise deg/s/sqrt(Hz)": np.rad2deg(high_frequency_density(imu.rates, imu.interval)).tolist(),
        "accel noise mg/sqrt(Hz)": (high_frequency_density(imu.accelerations, imu.interval) / MG).tolist(),
    }


def _facts(recording: Recording) -> dict[str, Any]:
    import numpy as np

    from kreisel.errors import KreiselError
    from kreisel.preparation.reference_noise import assumed_noise
    from kreisel.preparation.standstill_search import find_standstills, imu_stillness, may_be_held
    from kreisel.synchronization.correlation import correlate

    imu, reference = recording.imu, recording.reference
    warnings = [str(warning) for warning in recording.warnings]
    facts: dict[str, Any] = {"imu": _facts_of_imu(recording)}
    if reference is not None:
        ref_steps = np.diff(reference.stamps_ns) * 1e-9
        facts["reference"] = {
            "name": reference.name,
            "poses": int(reference.stamps_ns.size),
            "holds": " and ".join(
                name
                for name, part in (("positions", reference.positions), ("orientations", reference.quaternions))
                if part is not None
            ),
            "duration s": float(reference.seconds[-1]),
            "rate Hz": 1.0 / reference.interval,
            "longest step ms": float(ref_steps.max() * 1e3),
        }
        if reference.positions is not None:
            facts["reference"]["workspace x y z m"] = np.ptp(reference.positions, axis=0).tolist()
        try:
            found = correlate(imu, reference)
            noise = assumed_noise(recording.settings.reference, recording.reference_kind, reference)
            standstills = find_standstills(
                imu_stillness(imu, held=may_be_held(recording)), reference, found.clock, noise
            )
            offset = found.clock.offset(int(imu.stamps_ns[0]), int(reference.stamps_ns[0]))
            facts["together"] = {
                "correlation of rates": found.coefficient,
                "time offset s (coarse)": offset,
                "clock ratio - 1 (coarse)": found.clock.skew,
                "standstills": len(standstills),
                "standstill seconds": float(sum(standstill.stop - standstill.start for standstill in standstills)),
            }
        except KreiselError as error:
            warnings.append(f"synchronisation: {error}")
    if recording.joints is not None:
        facts["joints"] = {
            "rows": int(recording.joints.stamps_ns.size),
            "joints": int(recording.joints.angles.shape[1]),
        }
    facts["findings"] = warnings
    return facts
