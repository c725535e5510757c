"""A calibration applied to the readings of a device while they come."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable

import numpy as np

from kreisel.application.corrected_tables import CHECKED, HEADER, scatter_of_stamps
from kreisel.calibration.result import Calibration
from kreisel.devices.events import Arrival, Event
from kreisel.errors import RecordingError
from kreisel.protocols.samples import ImuSample


async def correct_events(
    calibration: Calibration,
    events: AsyncIterator[Event],
    write: Callable[[bytes], object],
    note: Callable[[str], object],
) -> None:
    """Write corrected readings of a device as rows of a table, until its events end.

    Parameters
    ----------
    write
        Takes the bytes of whole rows; the header comes first.
    note
        Takes notices about the device, and about readings that were left out.

    Notes
    -----
    A stamp that does not follow the one before is left out. After a jump of the device's clock a new stream begins.
    """
    write(f"#timestamp [ns],{HEADER}\n".encode())
    stream, last = calibration.stream(check=calibration.accepted), -1
    first: list[int] | None = []
    async for event in events:
        if not isinstance(event, Arrival):
            note(event.text)
            continue
        sample = event.sample
        if not isinstance(sample, ImuSample):
            raise RecordingError("the device sends poses, expected readings of an IMU")
        if sample.stamp_ns <= last:
            if last - sample.stamp_ns < 1_000_000_000:
                note(f"the stamp {sample.stamp_ns} ns does not follow {last} ns: the reading was left out")
                continue
            note(f"the device's clock leapt from {last} to {sample.stamp_ns} ns: a new stream begins")
            write(_rows(*stream.close()))
            stream = calibration.stream(check=calibration.accepted)
        last = sample.stamp_ns
        if first is not None:
            first.append(last)
            if len(first) == CHECKED:
                for text in scatter_of_stamps(np.array(first)):
                    note(text)
                first = None
        done = stream.push([sample.rate], [sample.acceleration], np.array([last]))
        if done[0].size:
            write(_rows(*done))
    write(_rows(*stream.close()))


def _rows(stamps: np.ndarray, omega: np.ndarray, f: np.ndarray) -> bytes:
    rows = zip(stamps.tolist(), np.hstack([omega, f]).tolist(), strict=True)
    return "".join(f"{stamp},{','.join(map(repr, row))}\n" for stamp, row in rows).encode()
