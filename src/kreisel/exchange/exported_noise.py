"""The IMU's noise for other programs: stated, of a grade, by readings at rest, or by `kreisel allan`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

from kreisel.calibration.result import Calibration
from kreisel.errors import SettingsError, unknown_name
from kreisel.inertial.allan import density_and_walk, noise_figures, unrest
from kreisel.inertial.noise_figures import GRADES, equivalent_walk
from kreisel.recording.recording import ImuSamples
from kreisel.validation.imu_checks import check_quantities

SHORTEST = 600.0
"""Seconds at rest that an Allan deviation needs to show a random walk of the offsets at all."""

_KEYS = {
    "gyro_density": "gyro_noise_density",
    "accel_density": "accel_noise_density",
    "gyro_walk": "gyro_random_walk",
    "accel_walk": "accel_random_walk",
}
"""Of the figures in allan.json, as in [imu] of recording.toml."""


@dataclass(frozen=True)
class ExportNoise:
    """Noise figures and where each is from, by name: `gyro_density`, `accel_density`, `gyro_walk`, `accel_walk`, SI."""

    figures: dict[str, float] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)

    def complete(self) -> ExportNoise:
        """Return the figures if all are known.

        Raises
        ------
        SettingsError
            It names those that are missing and what gives them.
        """
        missing = [name for name in NAMES if not self.figures.get(name)]
        if missing:
            words = ", ".join(NAMES[name] for name in missing)
            raise SettingsError(
                f"nothing states the {words}; give --grade NAME, or --at-rest RECORDING with an hour of readings at "
                "rest, or --noise allan.json, or state [imu] gyro_noise_density, gyro_random_walk and so on in "
                "recording.toml and calibrate "
                "again (the noise that the filter assumed contains errors of the model, and is not used)"
            )
        return self


NAMES = {
    "gyro_density": "gyros' noise density",
    "accel_density": "accelerometers' noise density",
    "gyro_walk": "random walk of the gyros' offsets",
    "accel_walk": "random walk of the accelerometers' offsets",
}


def noise_of(
    calibration: Calibration, grade: str | None = None, at_rest: ImuSamples | None = None, written: Path | None = None
) -> ExportNoise:
    """Return the noise figures known: those written first, then those at rest, of the grade, stated in the recording.

    written: allan.json of `kreisel allan`.

    Raises
    ------
    SettingsError
        For an unknown grade, readings that are too short or not at rest, or a file that is no allan.json.
    """
    noise = ExportNoise()
    stated = None if calibration.recording is None else calibration.recording.noise
    if stated is not None:
        own = {name: getattr(stated, name) for name in NAMES}
        noise = _joined(noise, {n: v for n, v in own.items() if v}, f"stated: {stated.source}")
    if grade is not None:
        if grade not in GRADES:
            raise SettingsError(unknown_name("grade", grade, GRADES))
        known = GRADES[grade]
        figures = {
            "gyro_density": known.gyro_noise_density,
            "accel_density": known.accel_noise_density,
            "gyro_walk": equivalent_walk(known.gyro_bias_instability, known.gyro_rate_random_walk),
            "accel_walk": equivalent_walk(known.accel_bias_instability, known.accel_random_walk),
        }
        noise = _joined(noise, figures, f"grade {grade}")
    if at_rest is not None:
        noise = _joined(noise, *_at_rest(at_rest))
    return noise if written is None else _joined(noise, *_written(written))


def _joined(noise: ExportNoise, figures: dict[str, float], source: str) -> ExportNoise:
    return ExportNoise(noise.figures | figures, noise.sources | dict.fromkeys(figures, source))


def _written(path: Path) -> tuple[dict[str, float], str]:
    """Return the figures for a filter in an allan.json."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        own = document["filter"]
        figures = {
            name: float(own[key])
            for name, key in _KEYS.items()
            if own.get(key) is not None and math.isfinite(own[key]) and own[key] > 0.0
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SettingsError(f"--noise {path}: not an allan.json of kreisel allan ({error})") from error
    if not figures:
        raise SettingsError(f"--noise {path}: holds no noise figures")
    return figures, f"{'in motion' if 'gaps' in document else 'at rest'}, {path.name} of kreisel allan"


def _at_rest(imu: ImuSamples) -> tuple[dict[str, float], str]:
    """Return the figures in readings at rest: the rms over the axes."""
    check_quantities(imu)
    seconds = float(imu.seconds[-1])
    if seconds < SHORTEST:
        raise SettingsError(
            f"--at-rest: the readings last {seconds:.0f} s, expected {SHORTEST:.0f} s or more, an hour if possible"
        )
    figures: dict[str, float] = {}
    for name, values in (("gyro", imu.rates), ("accel", imu.accelerations)):
        reason = unrest(values, imu.interval)
        if reason is not None:
            raise SettingsError(f"--at-rest: the {name} readings are not at rest: {reason}")
        found = density_and_walk(noise_figures(values, imu.interval))
        figures |= {f"{name}_{what}": value for what, value in found.items()}
    return figures, f"Allan deviation of {seconds / 3600.0:.2g} h at rest, {imu.source}"
