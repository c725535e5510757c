"""DIAdem data sets as KUKA's KR C4 writes them: a header as text, and the values in a file next to it.

The header names each channel in a block of lines `code,value`; the values of all channels of a file follow each
other sample by sample, as float64, the low byte first. The codes and their sources: docs/reference/kuka-trace.md.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.kuka_channels import Channel
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning

BEGIN, END = "#BEGINCHANNELHEADER", "#ENDCHANNELHEADER"

_NAME, _UNIT, _KIND, _FILE, _STORAGE, _TYPE, _SKIP, _LENGTH, _FIRST, _OFFSET, _FACTOR = (
    200, 202, 210, 211, 213, 214, 222, 220, 221, 240, 241,
)  # fmt: skip
_BYTE_ORDER = 112
"""Codes in the header, and that of the byte order before it: see docs/reference/kuka-trace.md, with their sources."""

_LINE = re.compile(r"(\d{1,3})(?:\s*,\s*|\s+|$)(.*)")
_TIMES = ("zeit", "time", "t")
_REAL64 = np.dtype("<f8")


@dataclass(frozen=True)
class _Block:
    """The header of one channel: its first line, and the text of each code with its line."""

    source: Path
    line: int
    codes: dict[int, tuple[int, str]]

    @property
    def name(self) -> str:
        return self.text(_NAME)

    def text(self, code: int, default: str | None = None) -> str:
        """Return the text of a code; an empty one counts as missing."""
        found = self.codes.get(code, (0, ""))[1]
        if found:
            return found
        if default is None:
            raise RecordingError(
                f"this channel's header has no code {code}; expected name (200), kind (210), file (211), length (220) "
                "and place (221): copy the trace again",
                file=self.source,
                line=self.line,
            )
        return default

    def number(self, code: int, default: str | None = None) -> float:
        """Return the number of a code, with a point or a comma in it."""
        text = self.text(code, default)
        try:
            number = float(text.replace(",", "."))
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self.fault(code, f"'{text[:40]}' is not a number; copy the trace again")
        return number

    def count(self, code: int) -> int:
        """Return the number of a code, a whole number from 1 on."""
        number = self.number(code)
        if number < 1.0 or number != int(number):
            raise self.fault(code, f"{number:g} is not a whole number from 1 on; copy the trace again")
        return int(number)

    def fault(self, code: int, message: str) -> RecordingError:
        """Return the error for the text of a code, at its line."""
        return RecordingError(
            f"channel '{self.text(_NAME, '?')}', code {code}: {message}",
            file=self.source,
            line=self.codes.get(code, (self.line, ""))[0],
        )


def read_diadem(path: Path, text: str) -> tuple[list[Channel], list[DataWarning]]:
    """Return the channels of a data set whose header has this text.

    Raises
    ------
    RecordingError
        If header and values do not belong together, or are not stored as KUKA stores them.
    """
    _check_byte_order(path, text)
    blocks = _blocks(path, text)
    implicit = [block for block in blocks if _is_implicit(block)]
    files: dict[str, list[_Block]] = {}
    for block in blocks:
        if block not in implicit:
            files.setdefault(block.text(_FILE), []).append(block)
    channels: list[Channel] = []
    warnings: list[DataWarning] = []
    for name, members in files.items():
        file = _data_file(path, name, members[0], warnings)
        channels += _explicit(file, members)
    if not channels:
        raise RecordingError("names no channel with values; expected some besides the time: copy it again", file=path)
    return [*(_generated(block, channels[0]) for block in implicit), *channels], warnings


def _check_byte_order(path: Path, text: str) -> None:
    for number, line in enumerate(text.split("\n"), start=1):
        if line.startswith(BEGIN):
            return
        match = _LINE.fullmatch(line.strip())
        if match and int(match[1]) == _BYTE_ORDER and match[2].strip() != "High -> Low":
            raise RecordingError(
                f"the byte order of values is stated as '{match[2][:40]}'; expected 'High -> Low', as KUKA writes: "
                "export the trace as text",
                file=path,
                line=number,
            )


def _blocks(path: Path, text: str) -> list[_Block]:
    blocks: list[_Block] = []
    block: _Block | None = None
    for number, line in enumerate(text.split("\n"), start=1):
        line = line.strip()
        if line == BEGIN and block is None:
            block = _Block(path, number, {})
        elif line == END and block is not None:
            blocks.append(block)
            block = None
        elif line and block is not None:
            match = _LINE.fullmatch(line)
            if match is None:
                raise RecordingError(
                    f"'{line[:40]}' is not 'code,value' of a channel's header; copy the trace again",
                    file=path,
                    line=number,
                )
            block.codes.setdefault(int(match[1]), (number, match[2].strip()))
    if block is not None:
        raise RecordingError(
            f"the header of a channel begins here and does not end; the file is cut, expected {END}: copy it again",
            file=path,
            line=block.line,
        )
    return blocks


def _is_implicit(block: _Block) -> bool:
    kind = block.text(_KIND).upper()
    if kind not in ("IMPLIZIT", "IMPLICIT", "EXPLIZIT", "EXPLICIT"):
        raise block.fault(_KIND, f"'{kind[:40]}' is not known; expected IMPLIZIT or EXPLIZIT: copy the trace again")
    return kind.startswith("IMPLI")


def _data_file(path: Path, name: str, block: _Block, warnings: list[DataWarning]) -> Path:
    """Return the file of values: that of the header's name, or that of the trace's own, in whatever case."""
    siblings = {file.name.lower(): file for file in path.parent.iterdir() if file.is_file()}
    named = re.split(r"[\\/]", name)[-1]
    file = siblings.get(named.lower())
    if file is not None:
        return file
    file = siblings.get(f"{path.stem}.r64".lower())
    if file is None:
        raise block.fault(_FILE, f"there is no file '{named[:120]}' next to this one; copy the .r64 with the .dat")
    warnings.append(DataWarning("trace", f"the header names {named}, which is not there; took {file.name}"))
    return file


def _explicit(file: Path, blocks: list[_Block]) -> list[Channel]:
    """Return the channels whose values are in one file, sample by sample."""
    for block in blocks:
        _check_storage(block)
    length = blocks[0].count(_LENGTH)
    for block in blocks:
        if block.count(_LENGTH) != length:
            raise block.fault(
                _LENGTH,
                f"{block.count(_LENGTH)} values, but '{blocks[0].name}' has {length}; channels stored in turn are of "
                "one length: copy the trace again",
            )
    places = [block.count(_FIRST) for block in blocks]
    if sorted(places) != list(range(1, len(blocks) + 1)):
        raise blocks[0].fault(
            _FIRST,
            f"the {len(blocks)} channels of {file.name} have the places {', '.join(map(str, places))}; expected 1 to "
            f"{len(blocks)}, each once: the header is cut or was changed, copy it again",
        )
    values = _values(file, blocks, length)
    return [_scaled(block, values[:, place - 1]) for block, place in zip(blocks, places, strict=True)]


def _check_storage(block: _Block) -> None:
    for code, expected in ((_STORAGE, "BLOCK"), (_TYPE, "REAL64")):
        if block.text(code).upper() != expected:
            raise block.fault(
                code, f"'{block.text(code)[:40]}'; expected {expected}, as KUKA writes: export the trace as text"
            )
    if block.number(_SKIP, "0") != 0.0:
        raise block.fault(_SKIP, f"{block.number(_SKIP):g}; expected 0, no offset: export the trace as text")


def _values(file: Path, blocks: list[_Block], length: int) -> Array:
    sample = _REAL64.itemsize * len(blocks)
    try:
        size = file.stat().st_size
        if size == length * sample:
            data = file.read_bytes()
            size = len(data)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}; copy it again", file=file) from error
    if size != length * sample:
        state = "it is cut" if size < length * sample else "they are not of one trace"
        raise RecordingError(
            f"holds {size} bytes, {size / sample:.10g} samples of {len(blocks)} channels; {blocks[0].source} "
            f"says {length} samples, {length * sample} bytes: {state}; copy both files again, after the controller has "
            "ended the trace",
            file=file,
        )
    return np.frombuffer(data, dtype=_REAL64).reshape(length, len(blocks))


def _scaled(block: _Block, raw: Array) -> Channel:
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # values that are not numbers are reported where the channel is used
        values = raw * block.number(_FACTOR, "1") + block.number(_OFFSET, "0")
    return Channel(block.name, block.text(_UNIT, "") or None, values, block.line, block.name.lower() in _TIMES)


def _generated(block: _Block, other: Channel) -> Channel:
    """Return a channel that has only a first value and a step, as the time has."""
    length = block.count(_LENGTH)
    if length != other.values.size:
        raise block.fault(_LENGTH, f"{length} values, but '{other.name}' has {other.values.size}; copy the trace again")
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.arange(length, dtype=float) * block.number(_FACTOR) + block.number(_OFFSET, "0")
    return Channel(block.name, block.text(_UNIT, "s"), values, block.line, time=True)
