"""What becomes of a unit of a tray that errs in a way of its own, and of the others.

Run: python design/tray_faults.py [--first 1] [--trays 2] [--size 1] [--only NAME]

A line for each fault: whether the unit was used, its largest error over deviation and that of the others. A parameter
that changes during the recording counts as right between its first and its last value.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.array.tray import calibrate_tray
from kreisel.array.tray_outcome import TrayOutcome, UnitOutcome
from kreisel.calibration.device_axes import NAMES, vector_of
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array, exp, matrix
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

UNITS, FAULTY, SECONDS = 4, "imu2", 100.0

Fault = Callable[[ImuSamples, SensorParameters, np.random.Generator], tuple[ImuSamples, list[SensorParameters]]]
"""Returns the unit's readings with a fault, and its parameters at the beginning and at the end."""


def _late(imu: ImuSamples) -> Array:
    """Return the time as a share of the recording, (n, 1)."""
    return np.asarray(imu.seconds / imu.seconds[-1])[:, None]


def _added(imu: ImuSamples, rates: Array | float = 0.0, forces: Array | float = 0.0) -> ImuSamples:
    return replace(imu, rates=imu.rates + rates, accelerations=imu.accelerations + forces)


def _offset(gyro: float, accel: float, shape: Callable[[Array], Array]) -> Fault:
    """Return the fault of offsets that change with the time."""

    def fault(
        imu: ImuSamples, p: SensorParameters, _: np.random.Generator
    ) -> tuple[ImuSamples, list[SensorParameters]]:
        axes, at = np.array([1.0, -0.6, 0.3]), shape(_late(imu))
        ends = [
            replace(p, k_w=p.k_w - np.vstack([gyro * s * axes, np.zeros_like(p.k_w[1:])]),
                    k_a=p.k_a - np.vstack([accel * s * axes, np.zeros_like(p.k_a[1:])]))
            for s in (float(at.min()), float(at.max()))
        ]  # fmt: skip
        return _added(imu, gyro * at * axes, accel * at * axes), ends

    return fault


def _readings(change: Callable[[ImuSamples, np.random.Generator], ImuSamples]) -> Fault:
    """Return a fault that changes readings, and no parameter."""
    return lambda imu, p, rng: (change(imu, rng), [p])


def _drifting_scale(imu: ImuSamples, p: SensorParameters, _: np.random.Generator) -> tuple[
    ImuSamples, list[SensorParameters]
]:  # fmt: skip
    grown = 1.0 + 2e-3 * _late(imu)
    return replace(imu, accelerations=imu.accelerations * grown), [p, replace(p, K_a=p.K_a / 1.002)]


def _creeping(imu: ImuSamples, p: SensorParameters, _: np.random.Generator) -> tuple[
    ImuSamples, list[SensorParameters]
]:  # fmt: skip
    axis = np.array([1e-3, -0.5e-3, 0.7e-3])
    turn = matrix(exp(_late(imu) * axis))
    G, S = (np.asarray(np.linalg.inv(K), dtype=float) for K in (p.K_omega, p.K_a))

    def turned(values: Array, K: Array, inverse: Array, k: Array) -> Array:
        true = (values + k[0]) @ K.T
        return np.asarray(np.einsum("nji,nj->ni", turn, true) @ inverse.T - k[0])

    readings = replace(
        imu, rates=turned(imu.rates, p.K_omega, G, p.k_w), accelerations=turned(imu.accelerations, p.K_a, S, p.k_a)
    )
    C = matrix(exp(axis))
    return readings, [p, replace(p, K_omega=C @ p.K_omega, K_a=C @ p.K_a)]


def _stamps(shift: Callable[[Array], np.ndarray[Any, Any]]) -> Fault:
    return _readings(
        lambda imu, _: replace(imu, stamps_ns=imu.stamps_ns + np.round(1e9 * shift(_late(imu)[:, 0])).astype(np.int64))
    )


def _jitter(imu: ImuSamples, rng: np.random.Generator) -> ImuSamples:
    late = rng.uniform(0.0, 0.8 * imu.interval, size=imu.stamps_ns.size)
    return replace(imu, stamps_ns=imu.stamps_ns + np.round(1e9 * late).astype(np.int64))


def _lost(imu: ImuSamples, rng: np.random.Generator) -> ImuSamples:
    """Samples are lost, and nothing shows it: the stamps are counted."""
    kept = rng.random(imu.stamps_ns.size) > 2e-3
    n = int(kept.sum())
    return replace(imu, stamps_ns=imu.stamps_ns[:n], rates=imu.rates[kept], accelerations=imu.accelerations[kept])


def _cut(imu: ImuSamples, _: np.random.Generator) -> ImuSamples:
    n = 6 * imu.stamps_ns.size // 10
    return replace(imu, stamps_ns=imu.stamps_ns[:n], rates=imu.rates[:n], accelerations=imu.accelerations[:n])


def _clipped(imu: ImuSamples, _: np.random.Generator) -> ImuSamples:
    limit = 0.5 * float(np.abs(imu.rates).max())
    return replace(imu, rates=np.clip(imu.rates, -limit, limit))


def _stuck(imu: ImuSamples, _: np.random.Generator) -> ImuSamples:
    rates, (a, b) = imu.rates.copy(), (int(0.4 * imu.stamps_ns.size), int(0.45 * imu.stamps_ns.size))
    rates[a:b, 1] = rates[a, 1]
    return replace(imu, rates=rates)


def _spikes(imu: ImuSamples, rng: np.random.Generator) -> ImuSamples:
    hit = (rng.random(imu.stamps_ns.size) < 1e-3)[:, None]
    return _added(imu, forces=hit * rng.normal(0.0, 20.0, size=imu.accelerations.shape))


def _lag(imu: ImuSamples, _: np.random.Generator) -> ImuSamples:
    late = np.column_stack([np.interp(imu.seconds - 0.01, imu.seconds, a) for a in imu.accelerations.T])
    return replace(imu, accelerations=late)


def _smooth(imu: ImuSamples, _: np.random.Generator) -> ImuSamples:
    """Means over 0.1 s."""
    width = max(1, round(0.1 / imu.interval))
    kernel = np.ones(width) / width
    rates, forces = (
        np.column_stack([np.convolve(c, kernel, "same") for c in v.T]) for v in (imu.rates, imu.accelerations)
    )
    return replace(imu, rates=rates, accelerations=forces)


def _vibrating(imu: ImuSamples, rng: np.random.Generator) -> ImuSamples:
    hit = np.sin(7.0 * imu.seconds)[:, None] > 0.9
    return _added(imu, forces=hit * rng.normal(0.0, 3.0, size=imu.accelerations.shape))


FAULTS: dict[str, Fault] = {
    "none": _readings(lambda imu, _: imu),
    "gyro offset jumps by 2e-3 rad/s": _offset(2e-3, 0.0, lambda s: (s > 0.5).astype(float)),
    "accelerometer offset jumps by 10 mg": _offset(0.0, 0.1, lambda s: (s > 0.5).astype(float)),
    "offsets drift by 1e-3 rad/s, 5 mg": _offset(1e-3, 0.05, lambda s: s),
    "offsets settle within 20 s": _offset(1e-3, 0.05, lambda s: np.exp(-5.0 * s)),
    "accelerometer scale drifts by 2 per mille": _drifting_scale,
    "creeps on its mount by 1.3 mrad": _creeping,
    "stamps jump by 5 ms": _stamps(lambda s: 5e-3 * (s > 0.5)),
    "clock bends by 5 ms": _stamps(lambda s: np.asarray(2e-2 * s * (1.0 - s))),
    "stamps jitter by 0.8 intervals": _readings(_jitter),
    "2 per mille of samples lost, not stamped": _readings(_lost),
    "ends after 60 s": _readings(_cut),
    "clipped at half of the rates": _readings(_clipped),
    "an axis stuck for 5 s": _readings(_stuck),
    "spikes, 1 per mille": _readings(_spikes),
    "accelerometers 10 ms late": _readings(_lag),
    "means over 0.1 s": _readings(_smooth),
    "bursts of vibration, 3 m/s^2": _readings(_vibrating),
    "cubic gyros, 5e-3 s^2/rad^2": _readings(lambda imu, _: _added(imu, 5e-3 * imu.rates**3)),
    "square accelerometers, 1 mg/g^2": _readings(lambda imu, _: _added(imu, forces=1e-4 * imu.accelerations**2)),
    "gyros feel force, 2e-4 rad/s / (m/s^2)": _readings(lambda imu, _: _added(imu, 2e-4 * imu.accelerations[:, ::-1])),
    "noise ten times": _readings(
        lambda imu, rng: _added(
            imu,
            10.0 * np.diff(imu.rates, axis=0, prepend=imu.rates[:1]).std() * rng.normal(size=imu.rates.shape),
            10.0
            * np.diff(imu.accelerations, axis=0, prepend=imu.accelerations[:1]).std()
            * rng.normal(size=imu.rates.shape),
        )
    ),
    "steps of 50 mg": _readings(lambda imu, _: replace(imu, accelerations=np.round(imu.accelerations / 0.5) * 0.5)),
}

SIMULATED: dict[str, dict[str, float]] = {"soft mount, 1 mrad at 1 g": {"mount_bending_sd": 1e-4}}
"""Faults of the virtual cell, whose true parameters are those at the mean force."""


def main() -> None:
    """Run the faults and print what became of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--trays", type=int, default=2)
    parser.add_argument("--size", type=float, default=1.0, help="factor on what a fault changes")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    for seed in range(given.first, given.first + given.trays):
        tray = {"units": UNITS, "clock_offset": 1.0, "clock_drift_ppm": 20.0}
        cell = Cell.model_validate({
            "seed": seed, "seconds": SECONDS, "imu": {"grade": "industrial-mems"}, "tray": tray
        })  # fmt: skip
        made = {f"imu{k}": simulate(cell, Path("tray"), unit=k) for k in range(UNITS)}
        for name, fault in FAULTS.items():
            if given.only in name:
                print(f"{seed} {name:42s} {_tried(fault, made, seed, given.size)}", flush=True)
        for name, change in SIMULATED.items():
            if given.only in name:
                imu = cell.imu.model_copy(update={key: given.size * value for key, value in change.items()})
                bent = simulate(cell.model_copy(update={"imu": imu}), Path("tray"), unit=int(FAULTY[3:]))
                print(f"{seed} {name:42s} {_tried(FAULTS['none'], made | {FAULTY: bent}, seed, 1.0)}", flush=True)


def _resized(before: ImuSamples, after: ImuSamples, size: float) -> ImuSamples:
    """Return readings and stamps with a part of a change, where there are as many."""
    if len(before.rates) != len(after.rates):
        return after
    rates, forces, stamps = (
        getattr(before, name) + size * (getattr(after, name) - getattr(before, name))
        for name in ("rates", "accelerations", "stamps_ns")
    )
    return replace(after, rates=rates, accelerations=forces, stamps_ns=np.round(stamps).astype(np.int64))


def _tried(fault: Fault, made: dict[str, tuple[Truth, Recording]], seed: int, size: float) -> str:
    """Return what became of the units with a fault in one of them."""
    truth, recording = made[FAULTY]
    imu, changed = fault(recording.imu, truth.sensors, np.random.default_rng(seed))
    imu, right = _resized(recording.imu, imu, size), vector_of(truth.sensors)
    ends = [right + size * (vector_of(end) - right) for end in changed]
    recordings = {name: own for name, (_, own) in made.items()} | {FAULTY: replace(recording, imu=imu)}
    try:
        outcome = calibrate_tray(lambda name: check_streams(recordings[name]), list(made), CalibrationSettings())
    except KreiselError as error:
        return f"refused: {error}"
    by_name = {unit.name: unit for unit in outcome.units}
    others = [_worst(unit, [vector_of(made[unit.name][0].sensors)]) for name, unit in by_name.items() if name != FAULTY]
    rejected = [
        f"{n}: {unit.calibration.verdict.reasons[-1][:50]}"
        for n, unit in by_name.items() if n != FAULTY and not unit.calibration.accepted
    ]  # fmt: skip
    return f"{_faulty(outcome, by_name, ends):70s} others {max(score for score, _ in others):.1f} {rejected or ''}"


def _faulty(outcome: TrayOutcome, by_name: dict[str, UnitOutcome], ends: list[Array]) -> str:
    if FAULTY not in by_name:
        return f"left out: {dict(outcome.left_out)[FAULTY]}"
    unit = by_name[FAULTY]
    score, parameter = _worst(unit, ends)
    state = "accepted" if unit.calibration.accepted else f"rejected ({unit.calibration.verdict.reasons[-1][:40]})"
    return f"{state} {score:.1f} {parameter}{' WRONG' if unit.calibration.accepted and score > 4.0 else ''}"


def _worst(unit: UnitOutcome, ends: list[Array]) -> tuple[float, str]:
    """Return the largest error over deviation of a unit, and of which parameter."""
    all_ends = np.array(ends)
    found, sd = vector_of(unit.calibration.sensors), vector_of(unit.calibration.sensor_sd)
    apart = np.maximum(found - all_ends.max(axis=0), all_ends.min(axis=0) - found)
    scores = np.maximum(apart, 0.0) / sd
    return float(scores.max()), NAMES[int(scores.argmax())]


if __name__ == "__main__":
    main()
