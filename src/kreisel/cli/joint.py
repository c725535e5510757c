"""`kreisel calibrate --joint`: one calibration from several recordings of one device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from kreisel.calibration.joint_outcome import Joint
    from kreisel.calibration.result_sections import JointFacts
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.recording.recording import Recording


def calibrate_together(
    paths: list[Path],
    read: Callable[[Path], Recording],
    settings: CalibrationSettings,
    common: tuple[str, ...],
    output: Path | None,
) -> Joint:
    """Calibrate a device from several recordings, and write the result.

    Raises
    ------
    KreiselError
        If there is no such recording, or fewer than two can be used.
    """
    from kreisel.calibration.joint import calibrate_joint
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads, releasing_memory
    from kreisel.errors import RecordingError

    names = names_of(paths)
    with releasing_memory(), progress_bar() as show:
        recordings, unread = {}, []
        for name, path in zip(names, paths, strict=True):
            try:
                recordings[name] = read(path)
            except RecordingError as error:
                if not path.exists():
                    raise
                unread.append((name, f"refused: {error}"))
        joint = calibrate_joint(
            list(recordings.values()), settings, common, show,
            names=list(recordings), unread=unread, executor=in_threads,
        )  # fmt: skip
        if output is not None:
            _save(joint, output)
    return joint


def names_of(paths: list[Path]) -> list[str]:
    """Return a name for each path, all different."""
    names = [path.resolve().name for path in paths]
    longer = [str(path) if names.count(name) > 1 else name for path, name in zip(paths, names, strict=True)]
    return [f"{name} ({i + 1})" if longer.count(name) > 1 else name for i, name in enumerate(longer)]


def _save(joint: Joint, output: Path) -> None:
    from kreisel.calibration.result import RESULT_FILES
    from kreisel.files import replaced_together
    from kreisel.report.joint_page import write_joint

    with replaced_together(output, RESULT_FILES) as writing:
        joint.calibration.write(writing)
        write_joint(joint, writing / "report.html")


def say_joint(joint: Joint, output: Path | None) -> None:
    """Print the result."""
    from kreisel.cli.terminal_tables import print_result, wide_console

    calibration = joint.calibration
    facts = calibration.joint
    print_result(calibration, joint.warnings)
    if facts is not None:
        _print_recordings(facts)
    if output is None:
        typer.echo("nothing written; -o OUT writes the result and a report")
    else:
        robot = "" if calibration.robot_urdf is None else ", robot_calibrated.urdf"
        wide_console().print(
            f"written: {output}/calibration.yaml, report.html, estimates.csv, covariance.npz{robot}", markup=False
        )


def _print_recordings(facts: JointFacts) -> None:
    from kreisel.cli.terminal_tables import print_rows, wide_console
    from kreisel.report.joint_page import OWN_COLUMNS, own_rows

    print_rows("each recording's own", OWN_COLUMNS, [row for one in facts.recordings for row in own_rows(one)], 3)
    console = wide_console()
    console.print(
        f"the same in all: {', '.join(('device', *facts.common))}; chi-square of what the recordings say of it "
        f"{facts.chi_square:.0f}, {facts.degrees} expected",
        markup=False,
    )
