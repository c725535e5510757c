"""Open a recording in any supported format."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError
from kreisel.formats.folder import is_folder, load_folder
from kreisel.progress import Together, one_by_one
from kreisel.recording.checks import check_streams
from kreisel.recording.recording import Recording


def load(
    path: str | Path, reference: str | None = None, imu: str | None = None, *, together: Together = one_by_one
) -> Recording:
    """Return the recording at a path: a folder, an MCAP file, a ROS 1 bag or a ROS 2 bag folder.

    Parameters
    ----------
    reference
        Name of the reference: a folder's name, or a topic in a bag.
    imu
        Name of the IMU: a folder's name (by default `imu0`), or a topic in a bag.
    together
        Reads the files of a folder, which do not depend on each other.

    Raises
    ------
    RecordingError
        If there is nothing that can be read, or its streams are unsorted, not finite, or of impossible
        units; the message says where.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError("no such file or folder; give a folder, an .mcap file or a bag", file=path)
    if is_folder(path):
        recording = load_folder(path, reference, imu or "imu0", together)
    elif _is_bag(path):
        from kreisel.formats.bag import load_bag  # here, because rosbags is slow to import

        recording = load_bag(path, reference, imu)
    elif path.is_dir():
        raise RecordingError(
            "holds no imu0/data.csv (nor mav0/imu0/data.csv, nor metadata.yaml or .mcap files of a bag)",
            file=path,
        )
    else:
        raise RecordingError("is neither a folder nor an .mcap, .bag or .db3 file", file=path)
    return check_streams(recording)


def _is_bag(path: Path) -> bool:
    """Return whether it is a bag; so is a folder that a stopped recorder left without metadata.yaml."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.mcap"))
    return path.suffix.lower() in (".mcap", ".bag", ".db3")
