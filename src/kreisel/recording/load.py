"""Open a recording, whatever it is stored as."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError
from kreisel.recording.checks import check_streams
from kreisel.recording.folder import is_folder, load_folder
from kreisel.recording.recording import Recording


def load(path: str | Path, reference: str | None = None) -> Recording:
    """Return the recording at a path: a folder, an MCAP file, a ROS 1 bag or a ROS 2 bag folder.

    Parameters
    ----------
    reference
        Name of the reference: a folder's name, or a topic in a bag.

    Raises
    ------
    RecordingError
        If there is nothing that can be read, or its streams are unsorted, not finite, or of impossible
        units; the message says where.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError("no such file or folder; give a recording folder, an .mcap file or a bag", file=path)
    if is_folder(path):
        recording = load_folder(path, reference)
    elif path.suffix in (".mcap", ".bag", ".db3") or (path.is_dir() and (path / "metadata.yaml").is_file()):
        from kreisel.recording.bag import load_bag  # noqa: PLC0415 - rosbags takes half a second to import

        recording = load_bag(path, reference)
    elif path.is_dir():
        raise RecordingError("holds no imu0/data.csv (nor mav0/imu0/data.csv, nor metadata.yaml of a bag)", file=path)
    else:
        raise RecordingError("is neither a folder nor an .mcap, .bag or .db3 file", file=path)
    return check_streams(recording)
