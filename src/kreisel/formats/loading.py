"""Open a recording in any supported format."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.imus import ALL
from kreisel.formats.input_formats import format_of, names_of_files
from kreisel.progress import Progress
from kreisel.recording.recording import Recording
from kreisel.tasks import Executor, sequential
from kreisel.validation.checks import check_streams


def load(
    path: str | Path,
    reference: str | None = None,
    imu: str | None = None,
    *,
    columns: Iterable[str] | Mapping[str, str] = (),
    executor: Executor = sequential,
    progress: Progress | None = None,
) -> Recording:
    """Return the recording at a path: a folder, an MCAP file, a ROS 1 bag, a ROS 2 bag folder, or tables of any shape.

    Parameters
    ----------
    reference
        Name of the reference: a folder's name, or a topic in a bag.
    imu
        Name of the IMU: a folder's name (by default `imu0`), in a bag a topic or the name of a unit (`imu1`), in tables
        that of `[columns.imu1]`.
    columns
        Which columns of tables of another shape hold what, 'imu.time=t [ms]' each; see `mapping`. They replace those of
        `[columns]` in recording.toml.
    executor
        Reads the files of a folder, which do not depend on each other.
    progress
        Shows how far the search for a mapping has come, where nobody says what columns hold.

    Raises
    ------
    RecordingError
        If there is nothing that can be read, or its streams are unsorted, not finite, or of impossible
        units; the message says where.
    SettingsError
        If `imu` asks for all IMUs, or names none where `columns` name several.
    """
    path = Path(path)
    if imu == ALL:
        raise SettingsError(
            f"--imu {ALL} is for calibrate, array, convert, info and apply --fuse, of one recording; name an IMU, "
            "as --imu imu1"
        )
    if not path.exists():
        raise RecordingError("no such file or folder; give a folder, an .mcap file or a bag", file=path)
    mapped = mapped_recording(path, columns, progress, imu)
    if mapped is not None:
        recording = mapped
    elif (form := format_of(path)) is not None:
        recording = form.read(path, reference, imu, executor)
    else:
        raise not_a_recording(path)
    return check_streams(recording)


def not_a_recording(path: Path) -> RecordingError:
    """Return the error for a path at which there is nothing that can be read."""
    if not path.is_dir():
        return RecordingError(f"is neither a folder nor an {names_of_files()} file, nor a table", file=path)
    several = sorted(file.name for file in path.glob("*.mcap"))
    if several:
        return RecordingError(f"holds several recordings ({', '.join(several[:3])}); give one of them", file=path)
    return RecordingError(
        "holds no imu0/data.csv (nor mav0/imu0/data.csv, nor metadata.yaml or .mcap files of a bag, nor tables)",
        file=path,
    )


def mapped_recording(
    path: Path, columns: Iterable[str] | Mapping[str, str], progress: Progress | None = None, imu: str | None = None
) -> Recording | None:
    """Return the recording in tables of another shape, or None where the path is no such thing.

    imu: as for `load`.

    Raises
    ------
    UnknownColumnsError
        If the columns are not assigned.
    """
    if isinstance(columns, Mapping):
        given: list[str] | dict[str, str] = dict(columns)
    else:
        given = [columns] if isinstance(columns, str) else list(columns)
    usual = format_of(path) is not None
    if usual and not given and not (path / "recording.toml").is_file():
        return None
    from kreisel.formats.mapped import load_mapped, settings_beside, tables_in

    if not given and not usual and not tables_in(path):
        return None
    settings = settings_beside(path)
    if settings.columns is None and not given:
        if usual:
            return None
        from kreisel.formats.proposal import unknown_columns

        raise unknown_columns(path, progress)
    from kreisel.formats.mapping import merged

    columns_of = merged(settings.columns, given)
    own = columns_of.of_imu(columns_of.names[0]).imu
    if settings.columns is None and not usual and None in (own.time, own.rate, own.acceleration):
        from kreisel.formats.proposal import unknown_columns

        raise unknown_columns(path, progress, columns_of)  # some entries alone: they stand in the proposal
    if given and imu is None and len(columns_of.names) > 1:
        raise SettingsError(
            f"--map with {len(columns_of.names)} IMUs: choose one with --imu, or write [columns.imu1] in recording.toml"
        )
    return load_mapped(path, settings, columns_of, imu=imu)
