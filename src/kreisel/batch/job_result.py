"""What became of one recording of a batch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

from kreisel.calibration.result import Calibration
from kreisel.calibration.result_document import from_document
from kreisel.calibration.result_sections import CalibrationParts
from kreisel.errors import RecordingError
from kreisel.recording.nanoseconds import date_of_stamp


@dataclass(frozen=True)
class Run:
    """A unit of a batch, calibrated or not: that of a recording, or one of a tray.

    Attributes
    ----------
    key
        Of its `Job`; of a unit of a tray with its IMU, see `key_of_unit`.
    name, unit
        The recording, of a tray with the IMU (`lot/tray/imu3`); the device's serial number, or the name where none is
        stated.
    maker, type
        Of the device, empty where they are not stated.
    date
        Of the recording, ISO; None where neither recording.toml nor the stamps tell it.
    error
        Why it was not calibrated; None where it was.
    text
        The result document as JSON; None where it was not calibrated.
    """

    key: str
    name: str
    unit: str
    maker: str
    type: str
    date: str | None
    error: str | None
    text: str | None

    @property
    def device(self) -> tuple[str, str, str]:
        """Maker, type and serial number: devices of several types may have the same number."""
        return self.maker, self.type, self.unit

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """The result document; empty where it was not calibrated.

        Raises
        ------
        RecordingError
            If the text was changed.
        """
        try:
            return {} if self.text is None else dict(json.loads(self.text))
        except (ValueError, TypeError, RecursionError) as error:
            raise _damaged(self.name, error) from error

    @cached_property
    def parts(self) -> CalibrationParts | None:
        """The result; None where it was not calibrated.

        Raises
        ------
        RecordingError
            If the text was changed.
        """
        try:
            return None if self.text is None else from_document(self.document)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise _damaged(self.name, error) from error

    @property
    def tray(self) -> str:
        """The recording's name if it is of a tray; empty where it is of one unit."""
        tray, _, imu = self.name.rpartition("/")
        return tray if self.key.endswith(key_of_unit("", imu)) else ""

    @property
    def data(self) -> str:
        """The fingerprint of the recording's data, or its name where there is none: the same for one recording."""
        recording = None if self.parts is None else self.parts.recording
        return (None if recording is None else recording.digest) or self.name

    @property
    def accepted(self) -> bool:
        """Whether it was calibrated, and accepted."""
        return self.parts is not None and self.parts.verdict.accepted

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        return "Failed" if self.parts is None else self.parts.verdict.headline


def key_of_unit(key: str, imu: str) -> str:
    """Return the key of a unit's run by that of its tray."""
    return f"{key}/{imu}"


def run_of_result(calibration: Calibration) -> Run:
    """Return the run of a single calibration; its key is empty: it belongs to no batch."""
    facts = calibration.recording
    device = {} if facts is None else facts.device
    name = "" if facts is None else facts.name
    date = None if facts is None else date_of(facts.certificate, facts.begin_ns)
    serial, maker, type_ = (device.get(key, "") for key in ("serial_number", "maker", "type"))
    return Run("", name, serial or name, maker, type_, date, None, json.dumps(calibration.document))


def _damaged(name: str, error: Exception) -> RecordingError:
    return RecordingError(
        f"the result of {name} in the file of results is damaged ({error}); delete its folder in results, and run the "
        "batch again"
    )


def date_of(certificate: Mapping[str, str], begin_ns: int | None) -> str | None:
    """Return the date of a recording: as stated, or that of its first stamp where this is one."""
    stated = certificate.get("date")
    if stated is not None:
        try:
            return datetime.fromisoformat(stated).date().isoformat()
        except ValueError:
            return None
    return date_of_stamp(begin_ns)
