"""One driver at a time: a lock for each controller, held by the process that moves its arm."""

from __future__ import annotations

import fcntl
import hashlib
import os
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kreisel.devices.address import Address
from kreisel.errors import DeviceError


@contextmanager
def only_driver(mover: Address) -> Iterator[None]:
    """Hold the lock of a controller; it goes with the process, however that ends.

    Raises
    ------
    DeviceError
        If another process of this user on this machine drives the arm.
    """
    folder = Path(tempfile.gettempdir()) / f"kreisel-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        owner = folder.lstat()
        if not stat.S_ISDIR(owner.st_mode) or owner.st_uid != os.getuid():
            raise DeviceError(f"{folder} is not a folder of yours: delete it, for locks are kept there")
        name = hashlib.sha256(f"{_resolved(mover.host)}:{mover.port}{mover.path}".encode()).hexdigest()[:16]
        lock = os.open(folder / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise DeviceError(f"{mover}: its lock cannot be kept in {folder} ({error.strerror})") from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(lock, 20, 0).decode("ascii", "replace").strip()
            raise DeviceError(
                f"nothing was moved: process {holder or 'of another kreisel'} drives the arm at {mover} already"
            ) from error
        os.ftruncate(lock, 0)
        os.pwrite(lock, str(os.getpid()).encode(), 0)
        yield
    finally:
        os.close(lock)


def _resolved(host: str) -> str:
    """Return the IP address of a host, or its name where that is not known: it has several spellings."""
    try:
        return socket.gethostbyname(host) if host else ""
    except OSError:
        return host
