"""Bags copied with corrected readings: all that was in them, byte for byte, and one topic more."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from kreisel.application.corrected_files import TOPIC, apply_to_file
from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.bag_copy import imu_messages

from ..calibration.example import calibration
from ..formats.test_bag import N, reference_messages, text_messages, write_bag
from ..formats.test_bag import imu_messages as imu_of_bag

TOOL = calibration()


def bag(folder: Path, kind: str) -> Path:
    """Return a bag with two topics of an IMU and one of poses, or, for `file`, one MCAP file of it."""
    messages = sorted([*imu_of_bag(), *reference_messages(), *text_messages()], key=lambda m: m.stamp_ns)
    path = write_bag(folder, "mcap" if kind == "file" else kind, messages)
    return next(path.glob("*.mcap")) if kind == "file" else path


def contents(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    with Ros1Reader(path) if path.suffix == ".bag" else Ros2Reader(path) as reader:
        out: dict[str, list[tuple[int, bytes]]] = {}
        for connection, log_time, payload in reader.messages():
            out.setdefault(connection.topic, []).append((log_time, bytes(payload)))
        return out


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "file"])
def test_a_copy_holds_everything_and_the_corrected_readings(tmp_path, kind):
    raw = bag(tmp_path, kind)
    out = tmp_path / ("out.bag" if kind == "ros1" else "out.mcap" if kind == "file" else "out")
    done = apply_to_file(TOOL, raw, out)
    assert done.samples == N
    if kind != "file":
        before, after = contents(raw), contents(out)
        assert set(after) == {*before, TOPIC}
        assert all(after[topic] == before[topic] for topic in before)
        # in the order of time, not at the end
        assert after[TOPIC][0][0] == before["/imu"][0][0]
    samples = imu_messages(raw).samples
    omega, f = TOOL.correct(samples.rates, samples.accelerations, samples.stamps_ns)
    found = imu_messages(out, TOPIC).samples
    np.testing.assert_array_equal(found.stamps_ns, samples.stamps_ns)
    np.testing.assert_allclose(np.hstack([found.rates, found.accelerations]), np.hstack([omega, f]), atol=1e-15)
    np.testing.assert_array_equal(imu_messages(out, "/imu").samples.rates, samples.rates)


def test_a_bag_to_a_table(tmp_path):
    apply_to_file(TOOL, bag(tmp_path, "ros1"), tmp_path / "out.csv")
    assert len((tmp_path / "out.csv").read_text().splitlines()) == N + 1


def test_what_is_written_is_of_the_same_kind(tmp_path):
    raw = bag(tmp_path, "ros1")
    with pytest.raises(SettingsError, match=r"a name that ends in \.bag is written, or a \.csv file"):
        apply_to_file(TOOL, raw, tmp_path / "out.mcap")
    apply_to_file(TOOL, raw, tmp_path / "out.bag")
    with pytest.raises(RecordingError, match=f"has a topic '{TOPIC}' already"):
        apply_to_file(TOOL, tmp_path / "out.bag", tmp_path / "again.bag", imu="/imu")
    assert not (tmp_path / "again.bag").exists()


def test_a_stream_of_the_wrong_topic_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="/robot"):
        apply_to_file(TOOL, bag(tmp_path, "mcap"), tmp_path / "out", imu="/robot")
