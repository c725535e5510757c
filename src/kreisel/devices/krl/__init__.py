"""kreisel's program for KUKA controllers, in KRL."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from kreisel.errors import SettingsError

_PROGRAMS = ("kreisel.src", "kreisel.dat", "kreisel_serial.src", "kreisel_serial.dat")
_CONNECTIONS = {"KreiselMove.xml": 54600, "KreiselState.xml": 54601}
"""TCP ports in the files of the connections: the first two of those for EthernetKRL on a KUKA controller, 54600 to
54615."""


def write_krl(folder: Path, ip: str, port: int) -> list[Path]:
    """Write the program's files into a folder, and return them.

    Parameters
    ----------
    ip, port
        The controller's address and the port where it takes moves; it sends poses at the next port.

    Raises
    ------
    SettingsError
        If one of the files exists already, or cannot be written.
    """
    texts = {name: _text(name) for name in _PROGRAMS}
    for name, usual in _CONNECTIONS.items():
        number = usual - _CONNECTIONS["KreiselMove.xml"] + port
        listens = _text(name).replace("<IP>0.0.0.0</IP>", f"<IP>{ip}</IP>")
        texts[name] = listens.replace(f"<PORT>{usual}</PORT>", f"<PORT>{number}</PORT>")
    there = [name for name in texts if (folder / name).exists()]
    if there:
        raise SettingsError(f"{folder} holds {', '.join(there)} already; delete them, or give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            # the controllers' own line ends
            (folder / name).write_bytes(text.replace("\n", "\r\n").encode("ascii"))
    except OSError as error:
        raise SettingsError(f"{folder} cannot be written: {error.strerror}") from error
    return [folder / name for name in texts]


def _text(name: str) -> str:
    return resources.files(__name__).joinpath(name).read_text(encoding="ascii")
