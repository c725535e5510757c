"""A robot's trace and an IMU's log of one run, from two files to a calibration."""

import subprocess
import sys

import numpy as np
import pytest

import kreisel
from kreisel.formats.write import write_folder
from kreisel.recording.recording import Recording

from ..felt import run as cell
from ..kuka_trace import header, payload

STEP = 0.012


def command(*arguments):
    line = [sys.executable, "-m", "kreisel.cli.main", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """The trace of a KR 125's run, joint angles alone, and the folder with what its IMU felt; then how it was made."""
    folder = tmp_path_factory.mktemp("run")
    truth, recording = cell(60.0, imu={"noise": True}, reference={"interval": STEP, "clock_offset": 0.02})
    write_folder(Recording(folder / "run", recording.imu, None, None, recording.settings), folder / "run")
    (folder / "run" / "robot.urdf").write_text(recording.urdf)
    angles = np.degrees(recording.joints.angles)
    columns = {f"AxisPos_Act{k + 1}": ("°", 180.0 / np.pi, angles[:, k]) for k in range(6)}
    (folder / "run_KRCIpo.dat").write_bytes(header(columns, "run_KRCIpo.r64", STEP).encode("latin-1"))
    (folder / "run_KRCIpo.r64").write_bytes(payload(columns))
    return folder / "run_KRCIpo.dat", folder / "run", truth, recording


def test_a_trace_is_converted_and_calibrated(halves):
    trace, folder, truth, simulated = halves
    done = command("convert", trace, folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].startswith("· trace: took AxisPos_Act1, AxisPos_Act2")
    assert "from these angles with robot.urdf" in done.stdout
    recording = kreisel.load(folder)
    np.testing.assert_allclose(recording.reference.positions, simulated.reference.positions, rtol=0, atol=1e-9)
    again = command("convert", trace, folder)
    assert again.returncode == 1
    assert "is there already" in again.stderr
    calibration = kreisel.calibrate(recording)
    assert calibration.accepted
    sd, found = calibration.document["standard_deviation"], calibration.sensors
    for error, deviation in (
        (found.K_omega - truth.sensors.K_omega, sd["gyroscope"]["cross_coupling"]),
        (found.K_a - truth.sensors.K_a, sd["accelerometer"]["cross_coupling"]),
        (found.lever_arms - truth.sensors.lever_arms, sd["accelerometer"]["lever_arms"]),
    ):
        # of 27 normal numbers one beyond five standard deviations comes once in 60000
        assert np.all(np.abs(error) < 5.0 * np.array(deviation))
    # the controller's clock begins with the trace, the IMU's somewhere else
    began = 1e-9 * simulated.reference.stamps_ns[0]
    assert calibration.document["timing"]["offset"] == pytest.approx(began + truth.time_offset, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["run.mcap"], "give a folder"),
        (["new", "--imu", "imu1"], "leave --reference and --imu out"),
        (["new"], "no robot.urdf in"),
    ],
)
def test_what_convert_refuses_of_a_trace(halves, tmp_path, arguments, telling):
    done = command("convert", halves[0], tmp_path / arguments[0], *arguments[1:])
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert telling in done.stderr
    assert not any(tmp_path.iterdir())
