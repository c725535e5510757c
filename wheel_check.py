"""Checks of a wheel on any machine: its tag, its files, and whether its library is one of the tag's platform."""

from __future__ import annotations

import base64
import csv
import hashlib
import re
import struct
import zipfile
from pathlib import Path
from typing import NamedTuple

OLDEST_GLIBC = (2, 17)
"""That of manylinux2014."""

OLDEST_MACOS = (11, 0)

_ELF = {0x3E: "x86_64", 0xB7: "aarch64"}
_MACHO = {0x01000007: "x86_64", 0x0100000C: "arm64"}
_PE = {0x8664: "amd64"}
_LIBRARY = re.compile(r"^kreisel/_kernels/(libkernels\.so|libkernels\.dylib|kernels\.dll)$")
_CODE_SIGNATURE, _BUILD_VERSION = 0x1D, 0x32


class Library(NamedTuple):
    """What the head of a shared library says of it.

    Attributes
    ----------
    system, machine
        As in the tags of wheels.
    needs
        The newest version of the C library that it needs (Linux), or the oldest of the system (macOS).
    """

    system: str
    machine: str
    needs: tuple[int, ...] = ()


class WheelError(Exception):
    """A wheel that is not what its name says."""


def library_of(content: bytes) -> Library:
    """Return what a shared library is, by its first bytes.

    Raises
    ------
    WheelError
        If it is none of those that are known.
    """
    try:
        if content[:6] == b"\x7fELF\x02\x01":
            versions = re.findall(rb"GLIBC_(\d+)\.(\d+)", content)
            newest = max(((int(a), int(b)) for a, b in versions), default=())
            return Library("linux", _ELF[struct.unpack_from("<H", content, 18)[0]], newest)
        if content[:4] == b"\xcf\xfa\xed\xfe":
            return _of_macos(content)
        if content[:2] == b"MZ":
            at = struct.unpack_from("<I", content, 0x3C)[0]
            if content[at : at + 4] == b"PE\0\0":
                return Library("win", _PE[struct.unpack_from("<H", content, at + 4)[0]])
    except (struct.error, KeyError) as error:
        raise WheelError(f"a library for an unknown machine ({error})") from error
    raise WheelError(f"no shared library: it begins with {content[:4]!r}")


def _of_macos(content: bytes) -> Library:
    machine = _MACHO[struct.unpack_from("<I", content, 4)[0]]
    count, at = struct.unpack_from("<I", content, 16)[0], 32
    needs: tuple[int, ...] = ()
    signed = False
    for _ in range(count):
        command, size = struct.unpack_from("<II", content, at)
        signed |= command == _CODE_SIGNATURE
        if command == _BUILD_VERSION:
            oldest = struct.unpack_from("<I", content, at + 12)[0]
            needs = (oldest >> 16, oldest >> 8 & 0xFF)
        at += size
    if machine == "arm64" and not signed:
        raise WheelError("a library for macOS on arm64 without a signature, which the system does not load")
    return Library("macosx", machine, needs)


def check_wheel(path: Path) -> Library:
    """Return the library of a wheel, which is right in all that can be seen without running it.

    Raises
    ------
    WheelError
        If a file is missing or changed, or the library is not one of the platform that the wheel's name states.
    """
    tag = path.stem.split("-")[-1]
    with zipfile.ZipFile(path) as wheel:
        _check_record(wheel, path)
        info = next(name for name in wheel.namelist() if name.endswith(".dist-info/WHEEL"))
        tags = {line.split("-")[-1] for line in wheel.read(info).decode().splitlines() if line.startswith("Tag: ")}
        if tags != set(tag.split(".")):
            raise WheelError(f"{path.name}: its file WHEEL has the tags {', '.join(sorted(tags))}")
        found = [name for name in wheel.namelist() if _LIBRARY.match(name)]
        if len(found) != 1:
            raise WheelError(f"{path.name}: expected one library, found {found or 'none'}")
        library = library_of(wheel.read(found[0]))
    if not all(one.startswith((library.system, f"many{library.system}")) for one in tags):
        raise WheelError(f"{path.name}: its library is one for {library.system}")
    if not all(one.endswith(library.machine) for one in tags):
        raise WheelError(f"{path.name}: its library is one for {library.machine}")
    if library.system == "linux" and "manylinux" in tag and library.needs > OLDEST_GLIBC:
        raise WheelError(f"{path.name}: its library needs glibc {'.'.join(map(str, library.needs))}")
    if library.system == "macosx" and library.needs > OLDEST_MACOS:
        raise WheelError(f"{path.name}: its library needs macOS {'.'.join(map(str, library.needs))}")
    return library


def _check_record(wheel: zipfile.ZipFile, path: Path) -> None:
    """Check that RECORD lists every file with its hash, and no other."""
    names = {name for name in wheel.namelist() if not name.endswith("/")}
    record = next((name for name in names if name.endswith(".dist-info/RECORD")), None)
    if record is None:
        raise WheelError(f"{path.name}: no RECORD")
    rows = list(csv.reader(wheel.read(record).decode().splitlines()))
    if {row[0] for row in rows} != names:
        raise WheelError(f"{path.name}: RECORD and files differ: {sorted({row[0] for row in rows} ^ names)[:3]}")
    for name, stated, size in rows:
        content = wheel.read(name)
        own = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        if name != record and (stated, size) != (f"sha256={own}", str(len(content))):
            raise WheelError(f"{path.name}: {name} is not as RECORD says")
