"""Where a device is and how it speaks: ``rsi://0.0.0.0:49152``, ``ixcom://192.168.1.30:3000?divider=2``."""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlsplit

from kreisel.errors import SettingsError, unknown_name


@dataclass(frozen=True)
class Scheme:
    """A way of speaking: its usual port, the options it knows, and an example."""

    port: int
    example: str
    options: tuple[str, ...] = ()
    listens: bool = False


ROBOTS = {
    "rsi": Scheme(
        49152, "rsi://0.0.0.0:49152 (listens; ?answer=yes where the controller wants answers)", ("answer",), True
    ),
    "rtde": Scheme(30004, "rtde://192.168.1.20 (?rate=500)", ("rate", "script")),
    "egm": Scheme(6510, "egm://0.0.0.0:6510 (listens)", (), True),
    "varproxy": Scheme(7000, "varproxy://192.168.1.10 (?rate=50)", ("rate",)),
}
IMUS = {
    "ixcom": Scheme(3000, "ixcom://192.168.1.30:3000 (?channel=0&divider=1)", ("channel", "divider")),
    "csv": Scheme(4000, "csv://127.0.0.1:4000 (?columns=t [ms],w_x [deg/s],…)", ("columns",)),
    "serial": Scheme(0, "serial:///dev/ttyUSB0?baud=115200 (&columns=…)", ("columns", "baud")),
}


@dataclass(frozen=True)
class Address:
    """A device's address, taken apart."""

    scheme: str
    host: str
    port: int
    path: str = ""
    options: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.scheme}://{self.path}" if self.path else f"{self.scheme}://{self.host}:{self.port}"

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Return an option that is a number.

        Raises
        ------
        SettingsError
            If it is none, or out of bounds.
        """
        text = self.options.get(name, str(default))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise SettingsError(f"{self}: {name} is '{text}', expected {low:g} to {high:g}")
        return value


def parse_address(text: str, schemes: dict[str, Scheme]) -> Address:
    """Return the address a text describes.

    Raises
    ------
    SettingsError
        If scheme, host, port or an option makes no sense; the known ones are listed.
    """
    examples = "; ".join(scheme.example for scheme in schemes.values())
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as error:
        raise SettingsError(f"'{text}' is no address ({error}); known are: {examples}") from error
    if parts.scheme not in schemes:
        raise SettingsError(f"'{text}': {unknown_name('scheme', parts.scheme, schemes)}; such as {examples}")
    scheme = schemes[parts.scheme]
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    for name in options:
        if name not in scheme.options:
            raise SettingsError(f"'{text}': {unknown_name('option', name, scheme.options)}")
    path = parts.path if parts.scheme == "serial" else ""
    if not path and not parts.hostname:
        raise SettingsError(f"'{text}' names no host; write it as {scheme.example}")
    return Address(parts.scheme, parts.hostname or "", scheme.port if port is None else port, path, options)
