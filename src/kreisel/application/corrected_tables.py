"""A calibration applied to a table of readings, line by line."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np

from kreisel.application.unit_check import check_rates, check_units
from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.formats.imu_lines import ImuLines, ImuRows
from kreisel.geometry.rotation import Array, lengths
from kreisel.inertial.effects import follows_temperature
from kreisel.recording.recording import ImuSamples, Stamps
from kreisel.validation.as_sampled import scatter_of

HEADER = "w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
"""Columns of what is written; in front of it the stamps as they were read, after it the other columns."""

CHECKED = 200
"""Rows whose units are checked together, where there are so many: fewer may be a moment of free fall."""


class CorrectedTable:
    """A table of raw readings to one of angular rates and specific forces, as bytes, row by row.

    Parameters
    ----------
    calibration
        It says in which axes.
    source
        The file, or a name of the stream, for messages.
    check
        Whether to check the units of the first readings.
    corrected
        Angular rate and specific force of every row, (n, 3), where they are known: of a table that was read whole.

    Attributes
    ----------
    rows
        Number of rows returned so far.
    """

    def __init__(
        self,
        calibration: Calibration,
        source: Path,
        *,
        check: bool = True,
        corrected: tuple[Array, Array] | None = None,
    ) -> None:
        self._check, self._warm = check, follows_temperature(calibration.sensors.effects)
        self._counts = calibration.counts
        self._first: list[ImuRows] = []
        self._lines, self._stream = ImuLines(source, packets=corrected is not None), calibration.stream(check=False)
        self._waiting: deque[tuple[str, str]] = deque()
        self._source, self._header_written = source, False
        self._corrected = corrected
        self._scatter: list[str] = []
        self._lasting: Array | None = np.zeros(0) if check and calibration.counts is None else None
        self.rows = 0

    def feed(self, data: bytes) -> bytes:
        """Return the rows that are complete after more bytes of the raw table; the header comes first.

        Raises
        ------
        RecordingError
            If a line cannot be read.
        """
        found = self._lines.feed(data)
        out = self._header()
        if found is None:
            return out
        if self._check:
            self._first.append(found)
            self._look_at(CHECKED)
        elif self._lasting is not None:
            self._lasting = self._last_rates(self._lasting, found.rates)
        self._waiting.extend(zip(found.stamp_texts, found.others, strict=True))
        if self._corrected is not None:
            own = slice(self.rows, self.rows + len(found.rates))
            if own.stop > len(self._corrected[0]):
                raise RecordingError("changed while it was read; apply the calibration again", file=self._source)
            return out + self._written(*(values[own] for values in self._corrected))
        try:
            _, omega, f = self._stream.push(found.rates, found.accelerations, found.stamps_ns, found.temperature)
        except RecordingError as error:
            raise RecordingError(error.message, file=self._source) from error
        return out + self._written(omega, f)

    def _last_rates(self, before: Array, rates: Array) -> Array:
        """Return the sizes of the last rates, and check them: at the first ones the device may have rested."""
        last = np.concatenate([before, lengths(rates)])[-max(CHECKED, len(rates)) :]
        if last.size >= CHECKED:
            check_rates(float(np.median(last)), self._source)
        return last

    def _look_at(self, least: int) -> None:
        """Check the units of the first rows, once there are so many of them."""
        if not self._check or sum(len(part.rates) for part in self._first) < least:
            return
        stamps, rates, forces = (
            np.concatenate([getattr(part, name) for part in self._first])
            for name in ("stamps_ns", "rates", "accelerations")
        )
        warm = [part.temperature for part in self._first if part.temperature is not None]
        samples = ImuSamples(stamps, rates, forces, self._source, temperature=np.concatenate(warm) if warm else None)
        check_units(samples, stated=False, warm=self._warm, counts=self._counts)
        if self._corrected is None:
            self._scatter = scatter_of_stamps(stamps)
        self._check, self._first = False, []

    def close(self) -> tuple[bytes, str | None]:
        """Return the last rows, and the text of a last line without an end, which was left out.

        Raises
        ------
        RecordingError
            If the table has no rows, or its few rows are in implausible units.
        """
        last = self.feed(b"\n") if self._lines.ends_with_return else b""
        left = self._lines.close()
        self._look_at(1)
        _, omega, f = self._stream.close()
        out = last + self._written(omega, f)
        if not self.rows:
            raise RecordingError("has a header but no rows; expected IMU readings", file=self._source)
        return out, left

    @property
    def notes(self) -> list[str]:
        """What to know about the columns, and about readings that a calibration would not take as they are."""
        lines = self._lines
        out = [str(note) for note in lines.notes] if self._warm else []
        if lines.missing:
            places = f"{lines.missing} (first: line {lines.first_missing})"
            out.append(f"{self._source}: rows without a number, left out: {places}")
        return out + self._scatter

    def _header(self) -> bytes:
        if self._header_written or self._lines.header is None:
            return b""
        self._header_written = True
        first, others = self._lines.header
        return f"{first},{HEADER}{others}\n".encode()

    def _written(self, omega: Array, f: Array) -> bytes:
        self.rows += len(omega)
        texts = [self._waiting.popleft() for _ in range(len(omega))]
        rows = zip(texts, np.hstack([omega, f]).tolist(), strict=True)
        return "".join(f"{stamp},{','.join(map(repr, row))}{others}\n" for (stamp, others), row in rows).encode()


def scatter_of_stamps(stamps: Stamps) -> list[str]:
    """Return a note where steps between the first stamps of a stream, ns, scatter about whole intervals."""
    found = scatter_of(stamps)
    if found is None:
        return []
    interval, scatter = found
    return [
        f"steps between the first {stamps.size} stamps scatter by {1e-6 * scatter:.2g} ms about "
        f"{1e-6 * interval:.4g} ms, and with them what lever arms contribute to the forces; where stamps are moments "
        "of arrival, apply to a file"
    ]
