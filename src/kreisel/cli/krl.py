"""`kreisel krl`: the program that runs on a KUKA controller."""

from __future__ import annotations

from pathlib import Path

import typer


def krl(
    output: Path = typer.Option(..., "-o", "--output", help="Folder to write the files into."),
    ip: str = typer.Option("0.0.0.0", help="The controller's own address, on which it listens."),
    port: int = typer.Option(54600, min=54600, max=54614, help="Port for moves; the next one is for poses."),
) -> None:
    """Write the KRL program that receives moves from `kreisel run` and sends poses to `kreisel record`.

    Over EthernetKRL (kreisel.src, .dat and two .xml), or over a serial line (kreisel_serial.src, .dat).
    """
    import ipaddress

    from kreisel.devices.krl import write_krl
    from kreisel.errors import SettingsError

    try:
        ipaddress.ip_address(ip)
    except ValueError as error:
        raise SettingsError(f"--ip '{ip}' is not an address ({error}); write it as 172.31.1.147") from error
    for file in write_krl(output, ip, port):
        typer.echo(f"written: {file}")
    typer.echo(
        "copy the .src and .dat files to KRC:\\R1\\Program, the .xml files to "
        "C:\\KRC\\ROBOTER\\Config\\User\\Common\\EthernetKRL; select kreisel, run it in T1 first"
    )
