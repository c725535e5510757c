"""Addresses of devices: ``rsi://0.0.0.0:49152``, ``ixcom://192.168.1.30:3000?divider=2``.

A recording can replace a device: ``mcap:///data/run/recording.mcap?speed=10``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from urllib.parse import SplitResult, parse_qsl, unquote, urlencode, urlsplit

from kreisel.errors import SettingsError, unknown_name


@dataclass(frozen=True)
class Scheme:
    """A protocol: its usual port, its options, and an example.

    Attributes
    ----------
    port
        0 if a path on this machine replaces host and port.
    device
        `imu` or `robot`, if the protocol serves both.
    """

    port: int
    example: str
    options: tuple[str, ...] = ()
    listens: bool = False
    device: str = ""


_ROS2 = ("domain", "peers")

ROBOTS = {
    "rsi": Scheme(
        49152,
        "rsi://0.0.0.0:49152?from=192.168.1.10 (listens; &answer=yes if the controller needs answers)",
        ("answer", "from"),
        True,
    ),
    "rtde": Scheme(30004, "rtde://192.168.1.20 (?rate=500)", ("rate", "script", "dashboard", "watchdog")),
    "egm": Scheme(6510, "egm://0.0.0.0:6510?from=192.168.1.10 (listens)", ("from",), True),
    "ekrl": Scheme(54601, "ekrl://192.168.1.10 (poses of kreisel's KRL program, see `kreisel krl`)", ("moves",)),
    "varproxy": Scheme(7000, "varproxy://192.168.1.10 (?rate=50)", ("rate",)),
    "ros2": Scheme(
        7400,
        "ros2://192.168.1.5?joints=/joint_states (this machine's address; or ?pose=/tf&base=base_link&tool=tool0)",
        (*_ROS2, "joints", "names", "pose", "base", "tool"),
        device="robot",
    ),
    "mcap": Scheme(0, "mcap:///PATH/FILE.mcap (?topic=/robot/pose&speed=1)", ("topic", "speed"), device="robot"),
}
"""Protocols for poses, with their usual ports. 30004 is RTDE's, by Universal Robots; 54601 is explained in
`devices.krl`. RSI and EGM send to the port that their configuration names: 49152, the first dynamic one (RFC 6335), is
chosen; 6510 is usual for EGM, and 7000 for KUKAVARPROXY; no document is known for these. 7400 is DDS's first port; the
ports that are used follow from the number of the domain."""

_MAVLINK = ("message", "rate", "system")

IMUS = {
    "ixcom": Scheme(3000, "ixcom://192.168.1.30:3000 (?channel=0&divider=1)", ("channel", "divider")),
    "csv": Scheme(4000, "csv://127.0.0.1:4000 (?columns=t [ms],w_x [deg/s],…)", ("columns",)),
    "serial": Scheme(
        0,
        "serial:///dev/ttyUSB0?baud=115200 (&columns=…, or &protocol=mavlink)",
        ("columns", "baud", "protocol", *_MAVLINK),
    ),
    "mavlink": Scheme(
        14550,
        "mavlink://0.0.0.0:14550?from=192.168.1.40 (listens; ?link=tcp connects; &message=HIGHRES_IMU&rate=200)",
        ("from", "link", *_MAVLINK),
        True,
    ),
    "ros2": Scheme(
        7400,
        "ros2://192.168.1.5?topic=/imu/data_raw (this machine's address; &domain=0&peers=192.168.1.6)",
        (*_ROS2, "topic"),
        device="imu",
    ),
    "mcap": Scheme(0, "mcap:///PATH/FILE.mcap (?topic=/imu/data_raw&speed=1)", ("topic", "speed"), device="imu"),
}
"""Protocols for readings, with their usual ports. 3000 is usual for iXCOM; no document is known for it. 4000 is chosen:
lines of text have no usual port. 14550 is where autopilots send to ground stations (mavlink.io, "Router")."""

MOVERS = {
    "urscript": Scheme(30002, "urscript://192.168.1.20 (?watchdog=24)", ("dashboard", "rtde", "watchdog")),
    "ekrl": Scheme(54600, "ekrl://192.168.1.10 (kreisel's KRL program, see `kreisel krl`)"),
    "serial": Scheme(0, "serial:///dev/ttyS0?baud=115200 (the same program's telegrams)", ("baud",), device="robot"),
}
"""Protocols for sending moves."""


@dataclass(frozen=True)
class Address:
    """A device's address in its parts."""

    scheme: str
    host: str
    port: int
    path: str = ""
    options: dict[str, str] = field(default_factory=dict)
    device: str = ""

    def __str__(self) -> str:
        place = f"?domain={self.options.get('domain', 0)}" if self.scheme == "ros2" else f":{self.port}"
        where = f"{self.scheme}://{self.path}" if self.path else f"{self.scheme}://{self.host}{place}"
        return f"{self.device} {where}" if self.device else where

    def number(self, name: str, default: float, low: float, high: float) -> float:
        """Return an option that is a number.

        Raises
        ------
        SettingsError
            If it is not a number, or out of bounds.
        """
        text = self.options.get(name, str(default))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise SettingsError(f"{self}: {name} is '{text}', expected {low:g} to {high:g}")
        return value


def default_mover(robot: Address) -> str | None:
    """Return the mover's address that belongs to a robot's address, None if there is none; see `MOVERS`."""
    for scheme, option, mover in (("rtde", "script", "urscript"), ("ekrl", "moves", "ekrl")):
        if robot.scheme == scheme:
            options = {name: value for name, value in robot.options.items() if name in ("dashboard", "watchdog")}
            where = f"{mover}://{robot.host}:{robot.number(option, MOVERS[mover].port, 1, 65535):.0f}"
            return f"{where}?{urlencode(options)}" if options else where
    return None


def with_rtde_of(mover: Address, robot: Address) -> Address:
    """Return a mover's address with the RTDE port of the robot's, if both are of one controller."""
    if mover.scheme != "urscript" or robot.scheme != "rtde" or mover.host != robot.host or "rtde" in mover.options:
        return mover
    return replace(mover, options={**mover.options, "rtde": str(robot.port)})


def check_sender(robot: Address) -> None:
    """Check that only one host may tell where an arm is that is driven.

    Raises
    ------
    SettingsError
        If anybody who reaches the port may: it listens beyond this machine, and no host is stated; or if it is read
        from ROS 2, where anybody in the domain may say it.
    """
    if robot.scheme == "ros2":
        raise SettingsError(
            f"{robot}: an arm is not driven by what ROS 2 says of it: anybody in the domain may publish that; give the "
            "controller's own address, as rtde://192.168.1.20"
        )
    if ROBOTS[robot.scheme].listens and "from" not in robot.options and not robot.host.startswith("127."):
        raise SettingsError(
            f"{robot}: whoever reaches this port could tell where the arm is; give the controller's address, "
            f"{robot.scheme}://{robot.host}:{robot.port}?from=192.168.1.10"
        )


def parse_address(text: str, schemes: dict[str, Scheme]) -> Address:
    """Return the address that a text describes.

    Raises
    ------
    SettingsError
        If scheme, host, port or an option is invalid; the message lists the known ones.
    """
    examples = "; ".join(scheme.example for scheme in schemes.values())
    try:
        parts = urlsplit(text, allow_fragments=False)
        port = parts.port
    except ValueError as error:
        raise SettingsError(f"'{text}' is not an address ({error}); expected one of: {examples}") from error
    if parts.scheme not in schemes:
        raise SettingsError(f"'{text}': {unknown_name('scheme', parts.scheme, schemes)}; examples: {examples}")
    scheme = schemes[parts.scheme]
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    for name in options:
        if name not in scheme.options:
            raise SettingsError(f"'{text}': {unknown_name('option', name, scheme.options)}")
    if not scheme.port:
        return Address(parts.scheme, "", 0, _path(text, parts), options, scheme.device)
    if not parts.hostname:
        raise SettingsError(f"'{text}' names no host; write it as {scheme.example}")
    return Address(parts.scheme, parts.hostname, scheme.port if port is None else port, "", options, scheme.device)


def _path(text: str, parts: SplitResult) -> str:
    """Return the path in an address."""
    if parts.netloc:
        raise SettingsError(
            f"'{text}' names a host, '{parts.netloc}', expected a path from the root, with three slashes: "
            f"{parts.scheme}:///{parts.netloc}{parts.path}"
        )
    if not parts.path.strip("/"):
        raise SettingsError(f"'{text}' names no path, expected for example {parts.scheme}:///PATH")
    return unquote(parts.path)
