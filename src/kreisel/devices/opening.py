"""The events of any device, or of a recording that is played in its place."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator

from kreisel.devices.address import Address
from kreisel.devices.datagrams import Clock
from kreisel.devices.drivers import device_events
from kreisel.devices.events import Event
from kreisel.devices.replay import REPLAY, replay
from kreisel.devices.ros2_system import listener_at, ros2_events


def events(address: Address, clock: Clock = time.monotonic_ns) -> AsyncIterator[Event]:
    """Return the events of the device at an address.

    Raises
    ------
    SettingsError, ProtocolError
        If an option of the address is invalid.
    RecordingError
        If the address is a recording that cannot be played.
    """
    if address.scheme == "ros2":
        listener_at(address)  # so that a wrong option raises at once
        return ros2_events(address, clock)
    if address.scheme == REPLAY:
        return replay(address, clock)
    return device_events(address, clock)
