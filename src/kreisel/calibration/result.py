"""The answer: parameters, their uncertainty, what supports them, and how to apply them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel.calibration.arguments import elapsed_seconds, triads
from kreisel.errors import RecordingError
from kreisel.files import LARGEST_YAML, finish_replacing, read_text, replaced_together
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import (
    FORMULA,
    SensorParameters,
    SizeEffect,
    correct_specific_force,
)
from kreisel.inertial.strapdown import SensorColumns, prepare

SCHEMA = "kreisel/calibration/1"

RESULT_FILES = ("calibration.yaml", "report.html", "estimates.csv", "covariance.npz", "robot_calibrated.urdf")
"""Files of a result, which are of one recording."""

_MOST_ENTRIES = 100_000
_LARGEST_ARRAYS = 1 << 26

FRAMES = (
    "b: body whose pose the reference gives (robot tool centre point, marker body). r: reference frame. "
    "i: inertial. Raw readings (primed) are corrected to true values: omega_ib_b, angular rate of b against i, "
    "and f_b, specific force at the origin of b (at rest +g, upward), both along the axes of b. Row j of "
    "lever_arms is the position of accelerometer j in b; rows of the inverse of cross_coupling are the "
    "sensitive axes in b. SI and radians throughout."
)


@dataclass(frozen=True)
class Calibration:
    """A calibration: the document of `calibration.yaml`, and what is too large for it.

    Attributes
    ----------
    document
        The content of `calibration.yaml`, schema ``kreisel/calibration/1``.
    names
        Estimated parameters in the order of `covariance` and of the columns of `estimates`.
    covariance : (n, n)
    prior_deviation : (n,)
    estimates : (updates, 1 + 2 n)
        IMU seconds, estimates, standard deviations.
    robot_urdf
        The robot's description with the errors found, where they were estimated.
    """

    document: dict[str, Any]
    names: tuple[str, ...]
    covariance: Array
    prior_deviation: Array
    estimates: Array
    robot_urdf: str | None = None

    @property
    def accepted(self) -> bool:
        """Whether the verdict is that the result may be used."""
        return bool(self.document["verdict"]["accepted"])

    @property
    def sensors(self) -> SensorParameters:
        """Parameters of the sensor model."""
        return sensor_parameters(self.document)

    @property
    def size_effect(self) -> SizeEffect:
        """Form of the eccentricity term the parameters belong to."""
        return SizeEffect(self.document["estimator"].get("size_effect", SizeEffect.COMPLETED.value))

    def correct(self, rates: ArrayLike, accelerations: ArrayLike, timestamps: ArrayLike) -> tuple[Array, Array]:
        """Return angular rate and specific force of b, (n, 3) each, from raw readings.

        Parameters
        ----------
        rates, accelerations : (n, 3)
            Raw readings, rad/s and m/s^2.
        timestamps : (n,)
            Ascending; the lever arms need the rate's derivative. Integers are nanoseconds, taken exactly; floats are
            seconds. Seconds since 1970 as floats resolve 0.2 us only: give nanoseconds, or seconds since the start.

        Raises
        ------
        RecordingError
            If an argument is of another shape, not finite, or timestamps do not ascend or are in another unit; the
            message begins with its name.
        """
        raw, a = triads(rates, "rates"), triads(accelerations, "accelerations")
        if len(a) != len(raw):
            raise RecordingError(f"accelerations: got the shape {a.shape}, expected {raw.shape} as of rates")
        seconds = elapsed_seconds(timestamps, len(raw), "timestamps")
        sensors = self.sensors
        signal = prepare(seconds, raw, a, order=sensors.k_w.shape[0])
        columns = SensorColumns.single(sensors, self.size_effect)
        omega, alpha = (part.T @ columns.rate[..., 0] for part in (signal.samples.rates, signal.samples.slopes))
        return omega, correct_specific_force(a, omega, alpha, sensors, self.size_effect)

    def save(self, folder: str | Path) -> None:
        """Write `calibration.yaml`, `estimates.csv`, `covariance.npz`, `robot_calibrated.urdf` into a folder.

        They take the place of an earlier result with its report, all together; other files there are kept.
        """
        with replaced_together(Path(folder), RESULT_FILES) as writing:
            self.write(writing)

    def write(self, folder: Path) -> None:
        """Write the files of `save` into an empty folder."""
        yaml = YAML()
        yaml.default_flow_style = None
        yaml.width = 120
        with (folder / "calibration.yaml").open("w", encoding="utf-8") as stream:
            yaml.dump(self.document, stream)
        np.savez_compressed(
            folder / "covariance.npz",
            names=np.array(self.names),
            covariance=self.covariance,
            prior_deviation=self.prior_deviation,
        )
        if self.robot_urdf is not None:
            (folder / "robot_calibrated.urdf").write_text(self.robot_urdf, encoding="utf-8")
        header = ["time [s]", *self.names, *(f"sd {name}" for name in self.names)]
        np.savetxt(
            folder / "estimates.csv",
            self.estimates,
            delimiter=",",
            header=",".join(f'"{h}"' for h in header),
            comments="",
            fmt="%.9g",
        )

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Return the calibration in a result folder, or in a `calibration.yaml` alone.

        Raises
        ------
        RecordingError
            If the file is missing, no calibration, or of another schema.
        """
        path = Path(path)
        file = path / "calibration.yaml" if path.is_dir() else path
        try:
            finish_replacing(file.parent, RESULT_FILES)
            document = YAML(typ="safe").load(read_text(file, LARGEST_YAML))
        except OSError as error:
            raise RecordingError(
                f"cannot be read ({error.strerror}); give a result folder of `kreisel calibrate`, or its "
                "calibration.yaml",
                file=file,
            ) from error
        except (YAMLError, UnicodeDecodeError, RecursionError) as error:
            raise RecordingError(f"not valid YAML: {str(error).splitlines()[0]}", file=file) from error
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            found = document.get("schema") if isinstance(document, dict) else None
            named = f"'{found[:60]}'" if isinstance(found, str) else f"of type {type(found).__name__}"
            raise RecordingError(f"schema is {named}, expected '{SCHEMA}'", file=file)
        try:
            _check_entries(document)
            sensor_parameters(document)
        except (KeyError, TypeError, ValueError) as error:
            raise RecordingError(f"incomplete: {error}; write it anew with `kreisel calibrate`", file=file) from error
        extra = file.parent / "covariance.npz"
        names: tuple[str, ...] = ()
        covariance, prior = np.zeros((0, 0)), np.zeros(0)
        if extra.is_file():
            _check_size(extra)
            with np.load(extra) as data:
                names = tuple(str(name) for name in data["names"])
                covariance, prior = data["covariance"], data["prior_deviation"]
        return cls(document, names, covariance, prior, np.zeros((0, 1 + 2 * len(names))))


def _check_size(archive: Path) -> None:
    """Raise an error for arrays that are far larger than those of a result, before they are read."""
    try:
        with zipfile.ZipFile(archive) as parts:
            size = sum(part.file_size for part in parts.infolist())
    except zipfile.BadZipFile as error:
        raise RecordingError(f"not an archive of arrays ({error}); copy the result again", file=archive) from error
    if size > _LARGEST_ARRAYS:
        raise RecordingError(
            f"arrays of {size} bytes, expected {_LARGEST_ARRAYS} at most; copy the result again", file=archive
        )


def _check_entries(document: object) -> None:
    """Raise an error for more entries than a result can have: references to others may stand for any number."""
    waiting, count = [document], 0
    while waiting:
        entry = waiting.pop()
        parts = list(entry.values() if isinstance(entry, dict) else entry) if isinstance(entry, dict | list) else []
        waiting += parts
        count += len(parts)
        if count > _MOST_ENTRIES:
            raise ValueError(f"more than {_MOST_ENTRIES} entries")


def sensor_parameters(document: Mapping[str, Any]) -> SensorParameters:
    """Return the sensor model's parameters from a document."""

    def coefficients(table: Mapping[str, Any]) -> Array:
        polynomial = table.get("polynomial", {})
        order = max([1, *(int(power) for power in polynomial)])
        rows = [table["offset"]] + [
            polynomial.get(i, polynomial.get(str(i), [0.0, 0.0, 0.0])) for i in range(2, order + 1)
        ]
        return np.array(rows, dtype=float)

    gyro, accel = document["gyroscope"], document["accelerometer"]
    k_w, k_a = coefficients(gyro), coefficients(accel)
    order = max(len(k_w), len(k_a))
    k_w, k_a = (np.vstack([k, np.zeros((order - len(k), 3))]) for k in (k_w, k_a))
    return SensorParameters(
        K_omega=np.array(gyro["cross_coupling"], dtype=float).reshape(3, 3),
        k_w=k_w,
        K_a=np.array(accel["cross_coupling"], dtype=float).reshape(3, 3),
        k_a=k_a,
        lever_arms=np.array(accel["lever_arms"], dtype=float).reshape(3, 3),
    )


__all__ = ["FORMULA", "FRAMES", "RESULT_FILES", "SCHEMA", "Calibration", "sensor_parameters"]
