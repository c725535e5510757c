"""Rates and accelerations in files of their own, as apps on phones write them."""

import tomllib

import numpy as np
import pytest

from kreisel.errors import RecordingError, UnknownColumnsError
from kreisel.formats.loading import load

RATE = 100.0


def motion(t):
    """Rates and accelerations of slow swings, smooth enough to be interpolated."""
    w = 0.3 * np.sin(np.outer(t, [1.0, 1.3, 0.7]))
    a = np.column_stack([2.0 * np.sin(0.5 * t), 1.0 * np.cos(0.4 * t), np.full(t.size, 9.6)])
    return w, a


def write(folder, gravity="TotalAcceleration", linear="Accelerometer", late=0.0037):
    t = np.arange(0.0, 20.0, 1.0 / RATE)
    w, a = motion(t)
    _, later = motion(t + late)
    header = "time,seconds_elapsed,z,y,x"
    for name, seconds, values in (("Gyroscope", t, w), (gravity, t + late, later), (linear, t + late, 0.01 * w)):
        if name:
            ns = np.round(seconds * 1e9).astype(np.int64) + 10**18
            rows = [
                f"{stamp},{s:.9f},{z:.9f},{y:.9f},{x:.9f}"
                for stamp, s, (x, y, z) in zip(ns, seconds, values, strict=True)
            ]
            (folder / f"{name}.csv").write_text("\n".join([header, *rows]) + "\n")
    return a


def proposed(folder):
    with pytest.raises(UnknownColumnsError) as refused:
        load(folder)
    (folder / "recording.toml").write_text(refused.value.proposal)
    return refused.value.proposal


def test_files_of_a_phone_are_proposed_and_read(tmp_path):
    a = write(tmp_path)
    text = proposed(tmp_path)
    assert 'acceleration_file = "TotalAcceleration.csv"' in text  # the other one is without gravity
    recording = load(tmp_path)
    assert any("were interpolated to the stamps of the rates" in str(one) for one in recording.warnings)
    imu = recording.imu
    assert imu.stamps_ns.size == a.shape[0] - 1  # the first rates are before the first accelerations
    np.testing.assert_allclose(imu.accelerations, a[1:], atol=1e-4)  # t h^2 / 8 of the largest second derivative
    np.testing.assert_allclose(imu.rates, motion(np.arange(1, a.shape[0]) / RATE)[0], atol=1e-8)


def test_nothing_is_interpolated_over_a_gap(tmp_path):
    write(tmp_path)
    proposed(tmp_path)
    file = tmp_path / "TotalAcceleration.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:501] + lines[601:]) + "\n")
    imu = load(tmp_path).imu
    assert np.diff(imu.stamps_ns).max() * 1e-9 == pytest.approx(1.01, abs=0.011)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"gravity": ""}, "no other file accelerations that contain gravity"),
        ({"gravity": "Orientation"}, "no other file accelerations that contain gravity"),
    ],
)
def test_gravity_must_be_there(tmp_path, files, words):
    write(tmp_path, **files)
    with pytest.raises(RecordingError, match=words):
        load(tmp_path)


def test_the_counter_of_xsens_is_known_by_its_name(tmp_path):
    """SampleTimeFine counts ten thousand a second; taken for milliseconds, all turns would be ten times too large."""
    t = np.arange(0.0, 20.0, 1.0 / RATE)
    w, a = motion(t)
    rows = np.column_stack([np.arange(t.size), np.round(1e4 * t), a, w])
    names = ["PacketCounter", "SampleTimeFine", *(f"Acc_{axis}" for axis in "XYZ"), *(f"Gyr_{axis}" for axis in "XYZ")]
    lines = ["\t".join(names), *("\t".join(f"{value:.9g}" for value in row) for row in rows)]
    (tmp_path / "MT.txt").write_text("\n".join(lines) + "\n")
    text = proposed(tmp_path)
    assert 'time = "SampleTimeFine [10000 Hz]"' in text
    assert "SampleTimeFine [ms]" not in text


def test_orientations_beside_them_are_shown_as_a_comment(tmp_path):
    write(tmp_path)
    t = np.arange(0.0, 20.0, 0.02)
    rows = [f"{s:.3f},{np.sin(s):.6f},0.5,{0.1 * s:.6f},{np.cos(0.1 * s):.9f},{np.sin(0.1 * s):.9f},0.0,0.0" for s in t]
    (tmp_path / "mocap.csv").write_text("\n".join(["t [s],x,y,z,qw,qx,qy,qz", *rows]) + "\n")
    text = proposed(tmp_path)
    assert '\n# orientation = "quaternion wxyz: qw, qx, qy, qz"' in text
    assert load(tmp_path).reference is None
    own = text[text.index("# [columns.reference]") :].replace("# ", "")
    assert tomllib.loads(own)["columns"]["reference"]["file"] == "mocap.csv"
