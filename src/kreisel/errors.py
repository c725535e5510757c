"""The errors that kreisel raises on purpose; each message has what, where, got, expected and what to do.

::

    KreiselError
    ├── RecordingError          a file or a stream that cannot be read, or that holds impossible values
    │   └── UnknownColumnsError tables of which nobody said what their columns hold
    ├── SynchronizationError    reference and IMU cannot be brought onto one clock
    ├── ExcitationError         the motion does not make the parameters observable
    ├── SettingsError           a setting that does not exist or makes no sense
    ├── RobotError              an arm that cannot be read, or a pose it cannot reach
    ├── ProtocolError           bytes that are not what the protocol says
    ├── DeviceError             a device that cannot be reached, or does not answer
    ├── EstimationError         the estimator could not continue, with advice
    └── LibraryError            a part made by the build is missing: the compiled library, the script of plots
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

__all__ = [
    "DeviceError",
    "EstimationError",
    "ExcitationError",
    "KreiselError",
    "LibraryError",
    "ProtocolError",
    "RecordingError",
    "RobotError",
    "SettingsError",
    "SynchronizationError",
    "UnknownColumnsError",
    "unknown_name",
]


class KreiselError(Exception):
    """Base class of all errors that kreisel raises on purpose; its text is one line for the user."""


def reason_of(error: Exception) -> str:
    """Return what a table or a log says of an error: its text, and its type if nobody raised it on purpose."""
    return str(error) if isinstance(error, KreiselError) else f"unexpected {type(error).__name__}: {error}"


def reason(error: Exception) -> str:
    """Return the message of an exception on one line; its name where the message is empty."""
    return one_line(str(error)).rstrip(".") or type(error).__name__


def one_line(text: str) -> str:
    """Return a text without line breaks and control characters, which names in a damaged file may have."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


class RecordingError(KreiselError):
    """A recording that cannot be used as it is.

    Parameters
    ----------
    message
        What is wrong, what was expected and what to do.
    file
        The file or folder at fault.
    line
        The line in the file, counted from 1, if known.
    """

    def __init__(self, message: str, *, file: Path | str | None = None, line: int | None = None) -> None:
        self.message = message
        self.file = None if file is None else Path(file)
        self.line = line
        place = "" if file is None else f"{file}: " if line is None else f"{file}, line {line}: "
        super().__init__(place + message)


class UnknownColumnsError(RecordingError):
    """Tables of which nobody said what their columns hold; `proposal` is the mapping that the data suggest, as TOML."""

    def __init__(self, message: str, proposal: str, *, file: Path) -> None:
        self.proposal = proposal
        super().__init__(message, file=file)


class SynchronizationError(KreiselError):
    """Reference and IMU could not be brought onto one clock; `correlation` is the best that was found."""

    def __init__(self, message: str, *, correlation: float | None = None) -> None:
        self.correlation = correlation
        super().__init__(message)


class ExcitationError(KreiselError):
    """The motion is too poor to make the parameters observable."""


class LibraryError(KreiselError):
    """A part of the package that its build makes is missing, or is not for this machine."""


class SettingsError(KreiselError):
    """A setting that does not exist or makes no sense."""


class RobotError(KreiselError):
    """An arm that cannot be read, or a pose that it cannot reach; the message names joint and limit."""


class ProtocolError(KreiselError):
    """Bytes that are not what the protocol says; `protocol` names it; the message names got and expected."""

    def __init__(self, protocol: str, message: str) -> None:
        self.protocol = protocol
        printable = "".join(character if character.isprintable() else " " for character in message)
        super().__init__(f"{protocol}: {' '.join(printable.split())}")


class DeviceError(KreiselError):
    """A device that cannot be reached, or does not answer; the message names its address and the remedy."""


class EstimationError(KreiselError):
    """The estimator could not continue; the message says at what time and what to try."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return the sentence for an unknown name; it lists the known ones."""
    return f"unknown {kind} '{name}'; known are: {', '.join(sorted(known))}"
