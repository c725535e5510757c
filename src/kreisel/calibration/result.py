"""The result: parameters, their uncertainty, the evidence for them, and how to apply them."""

from __future__ import annotations

import shutil
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel._kernels.decimal_rows import write_rows
from kreisel.calibration.array_checks import check_si, elapsed_seconds, temperature_difference_of, triads
from kreisel.calibration.data_sheet import QUANTITIES, derive, of_parameters
from kreisel.calibration.device_axes import NAMES, check_axes, clean, device_triads, expressed, with_vector
from kreisel.calibration.result_document import READ, from_document, to_document
from kreisel.calibration.result_form import check_form
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.calibration.result_views import frame_of, html_of, text_of
from kreisel.calibration.stream_correction import CorrectedStream
from kreisel.errors import RecordingError, SettingsError
from kreisel.files import MAX_YAML, check_entries, finish_replacing, read_text, replaced_together
from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array
from kreisel.inertial.correction import Block, corrected
from kreisel.inertial.counts import Counts
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.model.parameters import check_known

RESULT_FILES = ("calibration.yaml", "report.html", "estimates.csv", "covariance.npz", "robot_calibrated.urdf")
"""Files of a result; all of them belong to one recording."""

_MAX_ARRAYS = 1 << 26
"""Bytes of the arrays of a result, 64 MiB. Chosen: a covariance of a thousand parameters has 8 MB, and no result has so
many; a file that is no result must not take all memory before it is refused."""

_MAX_HISTORY = 1 << 28
"""Bytes of the estimates over time that are read. Chosen: ten minutes with 200 parameters have 5 MB."""


@dataclass(frozen=True, repr=False, eq=False)
class Calibration(CalibrationParts):
    """A calibration: the content of `calibration.yaml`, and the arrays that are too large for it.

    Attributes
    ----------
    names
        Estimated parameters in the order of `covariance` and of the columns of `estimates`.
    covariance : (n, n)
    prior_deviation : (n,)
        Of a usual device, or as stated; observability is measured by it.
    estimates : (updates, 1 + 2 n)
        IMU seconds, estimates, standard deviations.
    robot_urdf
        The robot's description with the estimated errors; None where they were not estimated.
    updates
        What happened at every update; None of a calibration that was read from files, joint, or in other axes.
    """

    names: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    prior_deviation: Array = field(default_factory=lambda: np.zeros(0))
    estimates: Array = field(default_factory=lambda: np.zeros((0, 1)))
    robot_urdf: str | None = None
    updates: History | None = None

    def __repr__(self) -> str:
        """Return the result in a few lines."""
        return text_of(self, len(self.names))

    def _repr_html_(self) -> str:
        """Return the result as a table, which notebooks show."""
        return html_of(self, len(self.names))

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of all estimated parameters; see `calibration.result_views.frame_of`."""
        return frame_of(self.document, self.names, self.covariance, self.prior_deviation)

    @property
    def accepted(self) -> bool:
        """Whether the verdict is that the result may be used."""
        return self.verdict.accepted

    @property
    def document(self) -> dict[str, Any]:
        """The content of `calibration.yaml`: mappings, lists, texts and numbers."""
        return to_document(self)

    def correct(
        self,
        rates: ArrayLike,
        accelerations: ArrayLike,
        timestamps: ArrayLike,
        temperatures: ArrayLike | None = None,
        *,
        check: bool = True,
    ) -> tuple[Array, Array]:
        """Return angular rate and specific force of b, (n, 3) each, from raw readings.

        Parameters
        ----------
        rates, accelerations : (n, 3)
            Raw readings, rad/s and m/s^2; counts where those were calibrated (`counts`).
        timestamps : (n,)
            Moments of sampling, ascending; the lever arms need the rate's derivative, and `kreisel apply` replaces
            stamps of arrival. Integers are nanoseconds, used exactly; floats are
            seconds. Seconds since 1970 as floats resolve 0.2 us only: give nanoseconds, or seconds since the start.
        temperatures : (n,)
            Of the sensor, degrees Celsius; needed where the calibration has temperature coefficients.
        check
            Whether readings must be plausible in these units, and a rejected calibration warns (`UserWarning`).

        Raises
        ------
        RecordingError
            If an argument has another shape or is not finite, if timestamps do not ascend, or if readings or
            timestamps seem to be in another unit;
            the message begins with the argument's name.
        """
        raw, a = triads(rates, "rates"), triads(accelerations, "accelerations")
        if len(a) != len(raw):
            raise RecordingError(f"accelerations: got the shape {a.shape}, expected {raw.shape} as of rates")
        if self.counts is not None:
            raw, a = self.counts.in_si(raw, a)
        if check:
            self._warn_if_rejected()
            check_si(raw, a)
        seconds = elapsed_seconds(timestamps, len(raw), "timestamps")
        temperature_difference = temperature_difference_of(temperatures, len(raw), self.sensors, self._temperature)
        out = corrected(Block(seconds, raw, a, temperature_difference), self.sensors, self.size_effect)
        return out.rates, out.forces

    def in_axes(self, axes: str) -> Calibration:
        """Return the calibration in other axes: those of the tool, or of the device itself, without its mounting.

        Parameters
        ----------
        axes
            See `calibration.device_axes.AXES`. The mounting is in `triads[axes]`.

        Raises
        ------
        SettingsError
            If the axes do not exist, if this calibration is in other axes than the tool's already or not of the
            completed model, or, for `nominal`, if the mounting is far from right angles.

        Notes
        -----
        K = C_bs T: deviations and covariance follow by differences. The history in `estimates` is left out.
        """
        check_axes(axes)
        if axes == self.axes:
            return self
        if self.axes != "tool":
            raise SettingsError(f"this calibration is in axes '{self.axes}' already; take the one in axes of the tool")
        if self.size_effect is not SizeEffect.COMPLETED:
            raise SettingsError(
                f"the size effect '{self.size_effect.value}' holds in axes of the tool only; calibrate with the "
                "completed form"
            )
        found, names, P, unpack = expressed(self.sensors, self.sensor_sd, self.names, self.covariance, axes)
        deviation = clean(with_vector(self.sensor_sd, np.sqrt(np.maximum(np.diag(P)[: len(NAMES)], 0.0))), axes)
        prior = dict(zip(self.names, self.prior_deviation, strict=True))
        return replace(
            self,
            sensors=found.sensors,
            sensor_sd=deviation,
            derived=derive(found.sensors, P, unpack, self._not_determined),
            names=names,
            covariance=P,
            prior_deviation=np.array([prior.get(name, np.nan) for name in names]),
            estimates=np.zeros((0, 1 + 2 * len(names))),
            axes=axes,
            budget=None,
            updates=None,
        )

    def stream(self, *, check: bool = True) -> CorrectedStream:
        """Return an object that corrects readings as they come; see `calibration.stream_correction`.

        check: whether stamps must come at a rate that IMUs have, and a rejected calibration warns (`UserWarning`).
        """
        if check:
            self._warn_if_rejected()
        return CorrectedStream(self.sensors, self.size_effect, self._temperature, self.counts, check=check)

    def _warn_if_rejected(self) -> None:
        """Warn the caller of a public method that what it returns may be wrong."""
        if not self.accepted:
            reason = self.verdict.first_reason
            text = f"this calibration was rejected ({reason}); what it corrects may be wrong (check=False: no warning)"
            warnings.warn(text, UserWarning, stacklevel=3)

    @property
    def counts(self) -> Counts | None:
        """What a count of raw converter readings is; None where readings are rad/s and m/s^2."""
        return None if self.recording is None else self.recording.counts

    @property
    def _not_determined(self) -> tuple[str, ...]:
        """Groups on which quantities depend that are NaN here."""
        lost = {q.name for q in QUANTITIES if q.name in self.derived and np.isnan(self.derived[q.name].value).any()}
        known = {group for q in QUANTITIES if q.name not in lost for group in q.groups}
        return tuple({group for q in QUANTITIES if q.name in lost for group in q.groups} - known)

    @property
    def _temperature(self) -> float | None:
        return None if self.recording is None else self.recording.temperature_c

    def save(self, folder: str | Path) -> None:
        """Write `calibration.yaml`, `estimates.csv`, `covariance.npz`, `robot_calibrated.urdf` into a folder.

        They replace an earlier result and its report, all at once; other files in the folder are kept, and so is the
        report of the same result.

        Raises
        ------
        SettingsError
            If the folder is a file.
        """
        place = Path(folder)
        if place.exists() and not place.is_dir():
            raise SettingsError(f"{place} is a file; give a folder for the result")
        with replaced_together(place, RESULT_FILES) as writing:
            self.write(writing)
            report = place / "report.html"
            if report.is_file() and _is_same(place, writing):
                shutil.copy2(report, writing / report.name)

    def write(self, folder: Path) -> None:
        """Write the files of `save` into an empty folder."""
        write_document(self.document, folder / "calibration.yaml")
        np.savez_compressed(
            folder / "covariance.npz",
            names=np.array(self.names),
            covariance=self.covariance,
            prior_deviation=self.prior_deviation,
        )
        if self.robot_urdf is not None:
            (folder / "robot_calibrated.urdf").write_text(self.robot_urdf, encoding="utf-8")
        header = ["time [s]", *self.names, *(f"sd {name}" for name in self.names)]
        heads = ",".join(f'"{name}"' for name in header)
        (folder / "estimates.csv").write_bytes(heads.encode() + b"\n" + write_rows(self.estimates))

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Return the calibration in a result folder, or in a `calibration.yaml` alone.

        Raises
        ------
        RecordingError
            If the file is missing, is not a calibration, or has another schema.
        """
        file = result_file(Path(path))
        parts = _read_parts(file)
        values = {part.name: getattr(parts, part.name) for part in fields(CalibrationParts)}
        extra = file.parent / "covariance.npz"
        if not extra.is_file():
            return cls(**values)
        names, covariance, prior = _read_covariance(extra)
        if not parts.triads and parts.axes == "tool":
            values["triads"] = device_triads(parts.sensors, parts.sensor_sd, names, covariance)
        return cls(
            **values,
            names=names,
            covariance=covariance,
            prior_deviation=prior,
            estimates=_read_estimates(file.parent / "estimates.csv", len(names)),
            robot_urdf=_read_urdf(file.parent / "robot_calibrated.urdf"),
        )


def _is_same(folder: Path, other: Path) -> bool:
    """Return whether two folders hold the same result, by the files that people read."""

    def content(file: Path) -> bytes | None:
        return file.read_bytes() if file.is_file() else None

    return all(content(folder / n) == content(other / n) for n in ("calibration.yaml", "robot_calibrated.urdf"))


def _read_estimates(file: Path, count: int) -> Array:
    """Return the history of `count` parameters, (updates, 1 + 2 count); no rows where the file holds no such table."""
    none = np.zeros((0, 1 + 2 * count))
    if not file.is_file() or file.stat().st_size > _MAX_HISTORY:
        return none
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a header alone is a history without updates
            found = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError):
        return none
    return found if found.shape[1:] == none.shape[1:] else none


def _read_urdf(file: Path) -> str | None:
    """Return the description with estimated errors; None where there is none, or no text."""
    try:
        return read_text(file, MAX_YAML) if file.is_file() else None
    except (OSError, UnicodeDecodeError):
        return None


def result_file(path: Path) -> Path:
    """Return the file of a result: that in its folder, or the file itself."""
    return path / "calibration.yaml" if path.is_dir() else path


def _read_parts(file: Path) -> CalibrationParts:
    try:
        finish_replacing(file.parent, RESULT_FILES)
        document = YAML(typ="safe").load(read_text(file, MAX_YAML))
    except OSError as error:
        raise RecordingError(
            f"cannot be read ({error.strerror}); give a result folder of `kreisel calibrate`, or its calibration.yaml",
            file=file,
        ) from error
    except (YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"not valid YAML: {str(error).splitlines()[0]}", file=file) from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in READ:
        named = f"'{schema[:60]}'" if isinstance(schema, str) else f"of type {type(schema).__name__}"
        raise RecordingError(f"schema is {named}, expected '{READ[-1]}' or '{READ[0]}'", file=file)
    try:
        check_entries(document)
        check_form(document)
        check_known(document)
        parts = from_document(document)
        return replace(parts, derived=of_parameters(parts.derived, parts.sensors, parts.sensor_sd))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise RecordingError(
            f"incomplete or changed: {error}; write it again with `kreisel calibrate`", file=file
        ) from error


def _read_covariance(archive: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, covariance and deviations before the data."""
    _check_size(archive)
    try:
        with np.load(archive) as data:
            names = tuple(str(name) for name in data["names"])
            return names, data["covariance"], data["prior_deviation"]
    except (KeyError, ValueError, OSError) as error:
        raise RecordingError(f"not the arrays of a result ({error}); copy the result again", file=archive) from error


def _check_size(archive: Path) -> None:
    """Raise an error for arrays that are much larger than those of a result, before they are read."""
    try:
        with zipfile.ZipFile(archive) as parts:
            size = sum(part.file_size for part in parts.infolist())
    except zipfile.BadZipFile as error:
        raise RecordingError(f"not an archive of arrays ({error}); copy the result again", file=archive) from error
    if size > _MAX_ARRAYS:
        raise RecordingError(
            f"arrays of {size} bytes, expected {_MAX_ARRAYS} at most; copy the result again", file=archive
        )


def _quoted(representer: Any, text: str) -> Any:
    """Return the node of a text: in double quotes if it has single ones, which would be doubled in single ones."""
    return representer.represent_scalar("tag:yaml.org,2002:str", text, style='"' if "'" in text else None)


def represent_number(representer: Any, value: float) -> Any:
    """Return the node of a number, with a point: readers of YAML 1.1, PyYAML among them, take 5e-05 for a text."""
    node = representer.represent_float(value)
    if "." not in node.value:
        node.value = node.value.replace("e", ".0e")
    return node


def write_document(document: Mapping[str, Any], file: Path) -> None:
    """Write mappings, lists, texts and numbers as YAML that people read: short rows, lists of numbers in one line."""
    yaml = YAML(typ="safe")
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # it is None there
    yaml.representer.add_representer(str, _quoted)
    yaml.representer.add_representer(float, represent_number)
    yaml.width = 120
    with file.open("w", encoding="utf-8") as stream:
        yaml.dump(document, stream)
