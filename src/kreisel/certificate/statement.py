"""What the signature of a certificate states besides the file itself: one line of JSON in the signed comment."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from kreisel.calibration.result import Calibration, result_file
from kreisel.errors import RecordingError
from kreisel.files import read_bytes

_MARK = "kreisel certificate "


@dataclass(frozen=True)
class Statement:
    """What belongs to a certificate; empty where it is not known.

    Attributes
    ----------
    file, issued
        Name of the certificate's file, and date of issue.
    serial_number
        Of the device, as the certificate states it.
    recording
        Name of the recording.
    data_sha256, calibration_sha256
        Of the recording's data, and of the file calibration.yaml.
    """

    file: str
    issued: str
    serial_number: str
    recording: str
    data_sha256: str
    calibration_sha256: str


def statement_of(file: str, issued: str, serial_number: str, calibration: Calibration, digest: str) -> Statement:
    """Return what the signature of a certificate is to state; `digest` is that of calibration.yaml."""
    facts = calibration.recording
    name, data = ("", "") if facts is None else (facts.name, facts.digest or "")
    return Statement(_line(file), issued, _line(serial_number), _line(name), data, digest)


def as_comment(statement: Statement) -> str:
    """Return the comment to be signed, one line."""
    return _MARK + json.dumps(asdict(statement))


def stated_in(comment: str) -> Statement | None:
    """Return what a signed comment states; None for one that `as_comment` did not write."""
    if not comment.startswith(_MARK):
        return None
    try:
        table = json.loads(comment.removeprefix(_MARK))
        return Statement(**{field.name: str(table[field.name]) for field in fields(Statement)})
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def digest_of(calibration: Path) -> str:
    """Return the SHA-256 of the calibration.yaml of a result."""
    return hashlib.sha256(read_bytes(result_file(calibration))).hexdigest()


def check_name(file: Path, statement: Statement) -> None:
    """Raise an error for a certificate that was signed under another name.

    Raises
    ------
    RecordingError
        If it was renamed, or exchanged for another one together with its signature.
    """
    if _line(file.name) != statement.file:
        raise RecordingError(
            f"was signed under the name '{statement.file}', for serial number '{statement.serial_number}': it was "
            "renamed or exchanged for another certificate; verify it under its own name",
            file=file,
        )


def check_calibration(file: Path, statement: Statement | None, calibration: Path) -> None:
    """Check that a certificate is that of a calibration.

    Raises
    ------
    RecordingError
        If the signature does not say which calibration it is, or if file, recording or serial number are others.
    """
    if statement is None:
        raise RecordingError(
            "its signature does not say which calibration it belongs to, as those of earlier versions; issue it again",
            file=file,
        )
    facts = Calibration.load(calibration).recording
    digest = digest_of(calibration)
    found = [("SHA-256 of calibration.yaml", statement.calibration_sha256, digest)]
    if facts is not None:
        found.append(("name of the recording", statement.recording, _line(facts.name)))
        if number := _line(facts.device.get("serial_number", "")):
            found.append(("serial number", statement.serial_number, number))
    for what, signed, own in reversed(found):
        if signed != own:
            raise RecordingError(
                f"is not the certificate of this calibration: the {what} is '{own}' there, and '{signed}' as signed; "
                "another device's certificate, or calibration.yaml was changed",
                file=file,
            )


def _line(text: str) -> str:
    """Return a text with single blanks, as in a comment of one line."""
    return " ".join(text.split())
