from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.errors import RecordingError
from kreisel.formats.bag import load_bag
from kreisel.formats.folder import load_folder
from kreisel.formats.loading import load
from kreisel.formats.write import settings_toml, write, write_folder
from kreisel.recording.header import HeaderUnits
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording.recording_settings import RecordingSettings, RobotTable, read_settings

N = 300
STAMPS = 1_700_000_000_123_456_789 + 20_000_001 * np.arange(N, dtype=np.int64)


def recording(name: str = "pose0", *, positions: bool = True, quaternions: bool = True) -> Recording:
    rng = np.random.default_rng(5)
    p, q = 1e-3 * np.cumsum(rng.normal(size=(N, 3)), axis=0), rng.normal(size=(N, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    accelerations = np.array([0.0, 0.0, 9.81]) + 0.1 * rng.normal(size=(N, 3))
    return Recording(
        Path("made"),
        ImuSamples(STAMPS, rng.normal(size=(N, 3)) * 10.0 ** rng.integers(-12, 2, (N, 3)), accelerations, Path("i")),
        ReferencePoses(name, STAMPS, p if positions else None, q if quaternions else None, Path("p")),
        JointAngles(STAMPS, rng.normal(size=(N, 6)), Path("j")),
        RecordingSettings.model_validate({"site": {"latitude_deg": 49.3}, "robot": {"tcp": 'a "tool"'}}),
        urdf='<robot name="arm &amp; hand"/>\n',
    )


def assert_same(got: Recording, want: Recording) -> None:
    np.testing.assert_array_equal(got.imu.stamps_ns, want.imu.stamps_ns)
    np.testing.assert_array_equal(got.imu.rates, want.imu.rates)
    np.testing.assert_array_equal(got.imu.accelerations, want.imu.accelerations)
    np.testing.assert_array_equal(got.reference.stamps_ns, want.reference.stamps_ns)
    for have, expected in (
        (got.reference.positions, want.reference.positions),
        (got.reference.quaternions, want.reference.quaternions),
    ):
        assert (have is None) == (expected is None)
        np.testing.assert_array_equal(have, expected)
    np.testing.assert_array_equal(got.joints.angles, want.joints.angles)
    assert got.settings == want.settings
    assert got.urdf == want.urdf


@pytest.mark.parametrize("half", [{}, {"positions": False}, {"quaternions": False}])
def test_a_folder_comes_back_exactly(tmp_path: Path, half: dict[str, bool]) -> None:
    want = recording(**half)
    write_folder(want, tmp_path / "new" / "run")
    got = load_folder(tmp_path / "new" / "run")
    assert_same(got, want)
    assert got.reference.name == "pose0"
    assert got.warnings == ()


def test_load_reads_what_write_wrote(tmp_path: Path) -> None:
    want = recording()
    for name in ("run", "run.mcap", "RUN2.MCAP", "dotted.name"):
        write(want, tmp_path / name)
        got = load(tmp_path / name)
        np.testing.assert_array_equal(got.imu.rates, want.imu.rates)
        assert got.settings == want.settings
    assert (tmp_path / "run").is_dir()
    assert (tmp_path / "run.mcap").is_file()
    assert (tmp_path / "dotted.name").is_dir()


def test_folder_to_mcap_and_back(tmp_path: Path) -> None:
    want = recording()
    write(want, tmp_path / "a.mcap")
    write(load_bag(tmp_path / "a.mcap"), tmp_path / "b")
    assert (tmp_path / "b" / "pose0" / "data.csv").is_file()
    assert_same(load_folder(tmp_path / "b"), want)


def test_headers_are_those_of_the_interface(tmp_path: Path) -> None:
    write_folder(recording(), tmp_path / "run")
    heads = {p.parent.name: p.read_text().splitlines()[0] for p in (tmp_path / "run").glob("*/data.csv")}
    assert heads == {
        "imu0": "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z",
        "pose0": "#timestamp [ns],p_x [m],p_y,p_z,q_w [],q_x,q_y,q_z",
        "joint0": "#timestamp [ns]," + ",".join(f"q_{k} [rad]" for k in range(1, 7)),
    }


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("vicon0", "vicon0"),
        ("/robot/pose", "pose0"),
        ("/vicon/imu/imu", "vicon_imu_imu"),
        ("/camera/pose", "pose_camera_pose"),
        ("../../away", "_away"),
        ("/", "pose0"),
    ],
)
def test_a_reference_finds_a_folder_and_is_found_there(tmp_path: Path, name: str, folder: str) -> None:
    want = recording(name)
    write_folder(want, tmp_path / "run")
    got = load_folder(tmp_path / "run")
    assert got.reference.name == folder
    assert_same(got, want)
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_without_reference_joints_and_settings(tmp_path: Path) -> None:
    write_folder(Recording(Path("made"), recording().imu, None), tmp_path / "run")
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["imu0"]
    got = load_folder(tmp_path / "run")
    assert got.reference is None
    assert got.settings == RecordingSettings()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_folder(recording(), tmp_path / "empty")
    with pytest.raises(RecordingError, match="is a folder that is not empty already"):
        write_folder(recording(), tmp_path / "empty")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RecordingError, match="is a file already"):
        write_folder(recording(), tmp_path / "file")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_folder(recording(), tmp_path / "file" / "below")
    with pytest.raises(RecordingError, match=r"\.bag files are only read"):
        write(recording(), tmp_path / "run.bag")
    assert (tmp_path / "file").read_text() == "mine"


def test_another_imu_folder_by_name(tmp_path: Path) -> None:
    write_folder(recording(), tmp_path / "run")
    (tmp_path / "run" / "imu0").rename(tmp_path / "imu1")
    write_folder(Recording(Path("made"), recording().imu, None), tmp_path / "run2")
    (tmp_path / "run2" / "imu0").rename(tmp_path / "run" / "imu0")
    (tmp_path / "imu1").rename(tmp_path / "run" / "imu1")
    assert load(tmp_path / "run", imu="imu1").imu.source.parent.name == "imu1"
    assert load(tmp_path / "run").imu.source.parent.name == "imu0"
    with pytest.raises(RecordingError, match="unknown IMU 'imu7'; known are: imu0, imu1"):
        load(tmp_path / "run", imu="imu7")
    with pytest.raises(RecordingError, match="no such file"):
        load_folder(tmp_path / "nowhere")


def test_only_what_is_set_is_written() -> None:
    assert settings_toml(RecordingSettings()) == ""
    text = settings_toml(recording().settings)
    assert text == '[site]\nlatitude_deg = 49.3\n\n[robot]\ntcp = "a \\"tool\\""\n'


density = st.floats(min_value=1e-8, max_value=0.1)


@given(
    name=st.text(st.characters(exclude_categories=["Cs"])),
    densities=st.tuples(density, density),
    length=st.floats(min_value=0.0, max_value=0.2),
)
def test_settings_come_back(
    tmp_path_factory: pytest.TempPathFactory, name: str, densities: tuple[float, float], length: float
) -> None:
    want = RecordingSettings.model_validate(
        {
            "imu": {"gyro_noise_density": densities[0], "accel_noise_density": densities[1]},
            "robot": RobotTable(urdf=name, length_sd=length).model_dump(),
        }
    )
    path = tmp_path_factory.getbasetemp() / "settings.toml"
    path.write_text(settings_toml(want), encoding="utf-8", newline="\n")
    assert read_settings(path) == want


def test_a_trajectory_has_the_scalar_last(tmp_path):
    made = recording()
    write(made, tmp_path / "poses.tum")
    lines = (tmp_path / "poses.tum").read_text().splitlines()
    assert lines[0].split()[0] == "1700000000.123456789"
    rows = np.array([[float(x) for x in line.split()[1:]] for line in lines])
    np.testing.assert_array_equal(rows[:, :3], made.reference.positions)
    np.testing.assert_array_equal(rows[:, 6], made.reference.quaternions[:, 0])
    np.testing.assert_array_equal(rows[:, 3:6], made.reference.quaternions[:, 1:])
    with pytest.raises(RecordingError, match="exists already"):
        write(made, tmp_path / "poses.tum")
    with pytest.raises(RecordingError, match="no poses with positions and orientations"):
        write(recording(quaternions=False), tmp_path / "other.tum")


def test_what_a_file_would_lose_or_misname_is_refused(tmp_path):
    warm = replace(recording().imu, temperature=np.full(N, 25.0))
    with pytest.raises(RecordingError, match="do not hold temperatures"):
        write(replace(recording(), imu=warm), tmp_path / "warm.mcap")
    write(replace(recording(), imu=warm), tmp_path / "warm")
    counted = replace(recording().imu, units=HeaderUnits(rate="counts"))
    with pytest.raises(RecordingError, match="raw counts"):
        write(replace(recording(), imu=counted), tmp_path / "counted")
    assert not (tmp_path / "counted").exists()
