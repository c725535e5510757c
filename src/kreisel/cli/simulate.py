"""`kreisel simulate`: write a simulated recording."""

from __future__ import annotations

from pathlib import Path

import typer


def simulate(
    cell: Path | None = typer.Argument(None, help="CELL.toml; the default cell if not given."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Recording: a folder, or an .mcap file."),
    seed: int | None = typer.Option(None, help="Seed to use instead of the cell's."),
    number: int | None = typer.Option(
        None, "--run", help="Number of the recording: those of one seed have the same device, arm and place."
    ),
    seconds: float | None = typer.Option(None, help="Length to use instead of the cell's, s."),
    example: bool = typer.Option(False, "--example", help="Print a CELL.toml with every key, and exit."),
    example_program: bool = typer.Option(False, "--example-program", help="Print a program of moves, and exit."),
) -> None:
    """Simulate a robot that moves an IMU, and write the recording with its truth."""
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import SettingsError
    from kreisel.simulation.cell_settings import Cell, parse_cell, read_cell
    from kreisel.simulation.cell_settings import example as example_cell

    if (example or example_program) and (cell is not None or output is not None):
        raise SettingsError("--example and --example-program print, and simulate nothing; leave out CELL and -o")
    if example or example_program:
        from kreisel.robot.program import EXAMPLE

        typer.echo(EXAMPLE if example_program else example_cell(), nl=False)
        return
    if output is None:
        raise SettingsError("no output is given; `-o RECORDING` names a folder or an .mcap file")
    check_output(output.parent if output.suffix else output)
    described = Cell() if cell is None else read_cell(cell)
    given = {"seed": seed, "run": number, "seconds": seconds}
    changes = {name: value for name, value in given.items() if value is not None}
    if changes:
        described = parse_cell({**described.model_dump(), **changes}, cell or Path("CELL.toml"))
    from kreisel.formats.write import write, write_imu
    from kreisel.simulation.cell import simulate as simulate_cell
    from kreisel.simulation.cell import write_truth

    if described.tray.units > 1 and output.suffix:
        raise SettingsError("several IMUs are written as a folder; name one, without a suffix")
    with progress_bar() as show:
        truth, recording = simulate_cell(described, output, show)
        if show is not None:
            show("write", 0.9)
        write(recording, output)
        write_truth(truth, output / "truth.json" if output.is_dir() else output.with_suffix(".truth.json"))
        for unit in range(1, described.tray.units):
            own_truth, own = simulate_cell(described, output, unit=unit)
            write_imu(own.imu, output / f"imu{unit}")
            write_truth(own_truth, output / f"imu{unit}" / "truth.json")
            if show is not None:
                show("simulate and write further IMUs", (unit + 1) / described.tray.units)
    imu, poses = recording.imu, recording.reference
    typer.echo(
        f"{output}: {imu.seconds[-1]:.0f} s, {imu.stamps_ns.size} IMU samples, "
        f"{0 if poses is None else poses.stamps_ns.size} poses; next: kreisel calibrate {output} -o OUT"
    )
