"""Tables of other shapes: read by a mapping they are the same recording, and the data propose the mapping."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import KreiselError, RecordingError, SettingsError, UnknownColumnsError
from kreisel.formats.imus import imu_reader, imus_in
from kreisel.formats.loading import load
from kreisel.formats.mapped import _as_iso, tables_in
from kreisel.formats.mapping import merged, parse_terms, parse_time
from kreisel.formats.proposal import proposal
from kreisel.formats.rotation_forms import quaternions_of
from kreisel.formats.sheet import read_sheet
from kreisel.formats.write import write
from kreisel.recording.recording import Recording

from ...foreign_tables import PLAIN, SHAPES, Shape, imu_text, plain
from ...small_problem import recorded

SHAPE = pytest.mark.parametrize("shape", SHAPES, ids=[shape.name for shape in SHAPES])


def written(shape: Shape, folder: Path) -> Path:
    for library in {"MATLAB 7.3": ["h5py"], "Parquet": ["pyarrow"]}.get(shape.name, []):
        pytest.importorskip(library)
    shape.make(recorded()[1], folder)
    return folder / shape.path


def assert_same(got: Recording, want: Recording) -> None:
    """Stamps to a microsecond after a common shift, numbers to rounding; q and -q are one rotation."""
    imu = want.imu
    late = imu.stamps_ns.size - got.imu.stamps_ns.size  # a common log begins with the first pose
    assert 0 <= late < 10
    np.testing.assert_allclose(got.imu.rates, imu.rates[late:], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.imu.accelerations, imu.accelerations[late:], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.diff(got.imu.stamps_ns), np.diff(imu.stamps_ns[late:]), atol=4e4)
    poses = want.reference
    assert abs(got.reference.stamps_ns.size - poses.stamps_ns.size) <= 2
    n = got.reference.stamps_ns.size
    np.testing.assert_allclose(np.diff(got.reference.stamps_ns), np.diff(poses.stamps_ns[:n]), atol=2e3)
    if got.reference.positions is not None:
        np.testing.assert_allclose(got.reference.positions, poses.positions[:n], atol=1e-12)
    same = np.abs(np.einsum("ij,ij->i", got.reference.quaternions, poses.quaternions[:n]))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)


@SHAPE
def test_a_mapped_table_is_the_same_recording(shape: Shape, tmp_path: Path) -> None:
    got = load(written(shape, tmp_path), columns=shape.mapping)
    assert_same(got, recorded()[1])
    if shape.name not in ("counted rows", "ticks", "dates", "times of the day past midnight"):
        between = got.reference.stamps_ns[0] - got.imu.stamps_ns[-1]
        want = recorded()[1].reference.stamps_ns[0] - recorded()[1].imu.stamps_ns[-1]
        nanoseconds = shape.name not in ("nanoseconds", "Parquet", "our headers", "microseconds", "milliseconds")
        shift = 1_000_000_000_000 if shape.name == "seconds and nanoseconds" else 0
        assert abs(int(between) - int(want) + shift) <= (2000 if nanoseconds else 1000)


QUICK = (
    "plain",
    "Euler XYZ, degrees",
    "one log, merged rows",
    "MATLAB",
)


@pytest.mark.parametrize(
    "shape",
    [pytest.param(s, id=s.name, marks=[] if s.name in QUICK else pytest.mark.slow) for s in SHAPES if s.proposed],
)
def test_the_data_propose_the_mapping(shape: Shape, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[Path, str] = {}
    monkeypatch.setattr(
        "kreisel.formats.proposal.proposal", lambda path, *more: made.setdefault(path, proposal(path, *more))
    )
    path = written(shape, tmp_path)
    with pytest.raises(UnknownColumnsError, match="no mapping says") as error:
        load(path)
    text = error.value.proposal
    assert made == {path: text}
    tomllib.loads(text)
    (tmp_path / "recording.toml").write_text(text)
    assert_same(load(path), recorded()[1])


def test_single_entries_stand_in_the_proposal(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(imu_text(recorded()[1]))
    with pytest.raises(UnknownColumnsError, match="no mapping says") as error:
        load(
            tmp_path / "imu.csv",
            columns=["imu.temperature=T [degC]", "reference.orientation=quaternion wxyz: a, b, c, d"],
        )
    found = tomllib.loads(error.value.proposal)["columns"]
    own = tomllib.loads(proposal(tmp_path / "imu.csv"))["columns"]
    assert found["imu"] == own["imu"] | {"temperature": "T [degC]"}
    assert found["reference"] == {"orientation": "quaternion wxyz: a, b, c, d"}


def test_a_proposal_without_poses_names_the_imu(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(imu_text(recorded()[1]))
    (tmp_path / "recording.toml").write_text(proposal(tmp_path / "imu.csv"))
    got = load(tmp_path / "imu.csv")
    assert got.reference is None
    np.testing.assert_array_equal(got.imu.accelerations, recorded()[1].imu.accelerations)


@pytest.mark.parametrize("sequence", ["XYZ", "zyx", "ZYZ", "xzx", "YXZ"])
def test_sequences_of_angles_against_scipy(sequence: str) -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    angles = np.random.default_rng(2).uniform(-3.0, 3.0, (50, 3))
    want = np.roll(rotation.from_euler(sequence, angles).as_quat(), 1, axis=1)
    got = quaternions_of(f"euler {sequence}", angles)
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", got, want)), 1.0, atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"imu.rate": "gx, gy"}, "2 columns of rate"),
        ({"imu.rate": "gx, gy, gq"}, "unknown column 'gq'"),
        ({"imu.rate": "gx, gy, gz [furlong]"}, r"\[furlong\] is not a unit of rate"),
        ({"imu.rate": "gx, gy, #99"}, "there are 7 columns"),
        ({"imu.time": "t [fortnight]"}, "is not a unit of time"),
        ({"imu.time": "-t [s]"}, "without signs"),
        ({"imu.time": "t [date]"}, "holds numbers, not dates"),
        ({"imu.rate": "gx, gy, gz [date]"}, "is not a unit of rate"),
        ({"imu.rate": "#4-2, gx, gy, gz"}, "is no range"),
        ({"imu.rate": "--gx, gy, gz"}, "two signs"),
        ({"imu.rate": "#2-99999999999"}, "is no range"),
        ({"reference.orientation": "euler ZZY: qw, qx, qy [rad]"}, "is not a form of rotations"),
        ({"reference.orientation": "matrix: #2-8, #2-3"}, "are no rotations"),
        ({"imu.time": "0 Hz"}, "not a possible rate"),
        ({"reference.orientation": "qw, qx, qy, qz"}, "is not a form of rotations"),
        ({"reference.orientation": "quaternion wxyz: qw, qx, qy"}, "3 columns, but"),
        ({"reference.file": "missing.csv"}, "no such file"),
        ({"reference.orienation": "x"}, "unknown column 'reference.orienation'"),
        ({"imu.acceleration": ""}, "no columns are named"),
        ({"imu.time": "t [ms]"}, r"they are read in \[ms\], but they look like \[s\]|lasts"),
        ({"imu.rate": "gx, gy, gz [deg/s]"}, r"they look like \[rad s\^-1\]"),
    ],
)
def test_a_wrong_mapping_is_refused(changed: dict[str, str], words: str, tmp_path: Path) -> None:
    from kreisel.calibration.calibrate import calibrate

    plain(recorded()[1], tmp_path)
    with pytest.raises(KreiselError, match=words) as error:
        calibrate(load(tmp_path, columns=PLAIN | changed))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "holds no rows"),
        ("a,b\n1,2\n", "unknown column"),
        ("a,b,c\n1,2,3\n1,2\n1,2,3\n", "do not have the same number|2 cells"),
        ("t,gx,gy,gz,ax,ay,az\n" + "0,1,x,3,4,5,6\n" * 9, "holds text"),
        ("\0\1\2", "zero bytes"),
    ],
)
def test_text_that_is_no_table_is_refused(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(content)
    with pytest.raises(RecordingError, match=words):
        load(tmp_path / "imu.csv", columns={k: v for k, v in PLAIN.items() if k.startswith("imu")})


def test_files_that_are_not_what_their_name_says_are_refused(tmp_path: Path) -> None:
    for name in ("run.mat", "run.parquet", "run.csv.gz"):
        (tmp_path / name).write_bytes(b"\x1f\x8b not really" if name.endswith("gz") else b"MATLAB 7.3 not really")
        with pytest.raises(RecordingError):
            read_sheet(tmp_path / name)


@pytest.mark.parametrize(
    ("kind", "telling"),
    [
        ("storage", "'imu/t' is of another file"),
        ("virtual", "'imu/t' is put together from other datasets"),
        ("link", r"'imu' is linked to another file \('t'\)"),
        ("link at the top", r"'/' is linked to another file \('t'\)"),
    ],
)
def test_hdf5_that_would_read_other_files_is_refused(tmp_path: Path, kind: str, telling: str) -> None:
    """With them a file of anybody's could show the content of any file on disk."""
    h5py = pytest.importorskip("h5py")
    (tmp_path / "private").write_bytes(b"not for everybody")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["a"] = np.arange(5.0)
    with h5py.File(tmp_path / "run.mat", "w") as file:
        group = file.create_group("imu")
        if kind == "storage":
            group.create_dataset("t", shape=(17,), dtype="u1", external=[(str(tmp_path / "private"), 0, 17)])
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=(5,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "a", shape=(5,))
            group.create_virtual_dataset("t", layout)
        else:
            (group if kind == "link" else file)["t"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "a")
    with pytest.raises(RecordingError, match=telling):
        read_sheet(tmp_path / "run.mat")


def test_links_inside_a_file_do_no_harm(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.mat", "w") as file:
        file["t"] = np.arange(5.0)
        file["again"] = h5py.SoftLink("/t")
    assert read_sheet(tmp_path / "run.mat").names == ("t",)


def test_entries_of_the_command_line_replace_those_of_the_file() -> None:
    table = merged(merged(None, {"imu.time": "t [s]", "imu.rate": "a, b, c"}), ["imu.time = stamp [ms]"])
    assert table.imu.time == "stamp [ms]"
    assert table.imu.rate == "a, b, c"
    with pytest.raises(SettingsError, match="unknown column 'time'"):
        merged(None, ["time=t"])


def test_terms_and_times() -> None:
    assert [(t.name, t.sign, t.unit) for t in parse_terms("-gx, gy, #3-4 [deg/s]", "rate")] == [
        ("gx", -1.0, "deg/s"), ("gy", 1.0, "deg/s"), ("#3", 1.0, "deg/s"), ("#4", 1.0, "deg/s")]  # fmt: skip
    assert [t.unit for t in parse_terms("a [deg/s], b [rad/s], c", "rate")] == ["deg/s", "rad/s", None]
    assert parse_time("n [2.5e3 Hz]").hertz == 2500.0
    assert [t.unit for t in parse_time("a [s] + b [us]").terms] == ["s", "us"]


def test_whole_nanoseconds_keep_all_digits(tmp_path: Path) -> None:
    """Seconds since 1970 in nanoseconds have more digits than a double."""
    t = 1_700_000_000_123_456_789 + 2_500_001 * np.arange(40)
    rows = [f"{stamp},{0.1 * np.sin(k)},0.2,{k},1.0,{0.01 * k},9.8" for k, stamp in enumerate(t)]
    (tmp_path / "imu.csv").write_text("t,a,b,c,d,e,f\n" + "\n".join(rows) + "\n")
    np.testing.assert_array_equal(read_sheet(tmp_path / "imu.csv").columns[0], t)


def test_counted_rows_are_those_of_the_stream(tmp_path: Path) -> None:
    log = next(shape for shape in SHAPES if shape.name == "one log, merged rows")
    got = load(written(log, tmp_path), columns=log.mapping | {"imu.time": "100 Hz"})
    assert got.imu.seconds[-1] == pytest.approx(40.0)


def test_one_entry_may_be_a_plain_text(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(imu_text(recorded()[1]))
    with pytest.raises(UnknownColumnsError, match="no mapping says") as error:
        load(tmp_path / "imu.csv", columns="imu.time=t [s]")
    assert tomllib.loads(error.value.proposal)["columns"]["imu"]["time"] == "t [s]"


def test_a_header_of_numbers_is_no_row(tmp_path: Path) -> None:
    """As frames without names are written."""
    text = imu_text(recorded()[1])
    (tmp_path / "imu.csv").write_text("0,1,2,3,4,5,6\n" + text.partition("\n")[2])
    got = load(tmp_path / "imu.csv", columns={
        "imu.time": "#1 [s]", "imu.rate": "#2-4", "imu.acceleration": "#5-7"})  # fmt: skip
    np.testing.assert_array_equal(got.imu.rates, recorded()[1].imu.rates)


@pytest.mark.parametrize("header", ["gx (deg/sec)", "gx (DPS)", "Gyro (raw) X [deg/sec]"])
def test_a_unit_that_is_not_known_is_no_si(header: str, tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(imu_text(recorded()[1]).replace("gx", header, 1))
    with pytest.raises(RecordingError, match="no unit of rate"):
        load(tmp_path / "imu.csv", columns={"imu.time": "t [s]", "imu.rate": "#2-4", "imu.acceleration": "ax, ay, az"})


def test_a_name_may_have_parentheses_before_its_unit(tmp_path: Path) -> None:
    text = imu_text(recorded()[1]).replace("gx,gy,gz", "G (raw) X [deg/s],G (raw) Y [deg/s],G (raw) Z [deg/s]", 1)
    (tmp_path / "imu.csv").write_text(text)
    sheet = read_sheet(tmp_path / "imu.csv")
    assert sheet.names[1] == "G (raw) X"
    assert sheet.units[1:4] == ("deg/s",) * 3


def test_points_beside_decimal_commas_are_refused(tmp_path: Path) -> None:
    rows = [f"0,{k:03d};1.234,5;0,1;0,2;0,3;0,4;9,8" for k in range(40)]
    (tmp_path / "imu.csv").write_text("t;gx;gy;gz;ax;ay;az\n" + "\n".join(rows) + "\n")
    with pytest.raises(RecordingError, match="points and numbers with commas"):
        read_sheet(tmp_path / "imu.csv")


def test_left_handed_matrices_and_matrices_by_column_are_refused() -> None:
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(RecordingError, match="left-handed"):
        quaternions_of("matrix", -turned.reshape(1, 9))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned, (1.0, 2.0, 3.0)
    with pytest.raises(RecordingError, match="column by column"):
        quaternions_of("pose matrix", pose.T.reshape(1, 16))


def test_an_unreadable_file_beside_does_not_matter(tmp_path: Path) -> None:
    plain(recorded()[1], tmp_path)
    (tmp_path / "notes.txt").write_text("hall 3, unit 17\nrobot was warm\n")
    assert "euler" not in proposal(tmp_path)


def test_frames_with_equal_names_are_told_apart_by_number(tmp_path: Path) -> None:
    pyarrow, writer = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"t": np.arange(50) * 0.01, "gx [rad/s]": np.arange(50.0), "gx [deg/s]": 57.3 * np.arange(50.0)}
    writer.write_table(pyarrow.table(columns), tmp_path / "imu.parquet")
    with pytest.raises(RecordingError, match="2 columns are called 'gx'"):
        read_sheet(tmp_path / "imu.parquet").place("gx")


def test_the_table_of_a_result_is_none_of_the_recording(tmp_path: Path) -> None:
    for name in ("log.csv", "estimates.csv"):
        (tmp_path / name).write_text("a,b\n1,2\n")
    assert [path.name for path in tables_in(tmp_path)] == ["estimates.csv", "log.csv"]
    (tmp_path / "calibration.yaml").write_text("")
    assert [path.name for path in tables_in(tmp_path)] == ["log.csv"]


SEVERAL = """
[columns.imu]
file = "board.csv"
time = "t [ns]"
rate = "g0x, g0y, g0z"
acceleration = "a0x, a0y, a0z"

[columns.imu1]
rate = "g1x, g1y, g1z"
acceleration = "a1x, a1y, a1z"

[columns.imu12]
file = "other.csv"
time = "ms [ms]"
rate = "-x, y, z [deg/s]"
acceleration = "#5-7 [g]"

[columns.reference]
file = "poses.csv"
time = "t [ns]"
position = "x, y, z"
orientation = "quaternion wxyz: qw, qx, qy, qz"

[imu]
grade = "industrial-mems"

[imu12]
grade = "fog"
"""


def several_imus(folder: Path) -> Recording:
    """Write tables of three IMUs, whose readings are multiples of each other's, and return that of the first."""
    want = recorded()[1]
    imu, poses = want.imu, want.reference
    t, w, a = imu.stamps_ns, imu.rates, imu.accelerations
    board = [t.astype(object), *w.T, *a.T, *(2.0 * w).T, *(0.5 * a).T]
    names = "t,g0x,g0y,g0z,a0x,a0y,a0z,g1x,g1y,g1z,a1x,a1y,a1z"
    other = [1e-6 * t, *np.degrees(3.0 * w * [-1.0, 1.0, 1.0]).T, *(a / 9.80665).T]
    reference = [poses.stamps_ns.astype(object), *poses.positions.T, *poses.quaternions.T]
    for name, header, columns in (
        ("board.csv", names, board),
        ("other.csv", "ms,x,y,z,fx,fy,fz", other),
        ("poses.csv", "t,x,y,z,qw,qx,qy,qz", reference),
    ):
        rows = [",".join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
        (folder / name).write_text("\n".join([header, *rows, ""]))
    (folder / "recording.toml").write_text(SEVERAL)
    return want


def test_columns_of_several_imus_are_units_of_one_recording(tmp_path: Path) -> None:
    want = several_imus(tmp_path)
    assert imus_in(tmp_path) == ("imu0", "imu1", "imu12")
    read = imu_reader(tmp_path)
    for name, factor, share, grade in (
        ("imu0", 1.0, 1.0, "industrial-mems"),
        ("imu1", 2.0, 0.5, "industrial-mems"),
        ("imu12", 3.0, 1.0, "fog"),
    ):
        whole, (samples, warnings) = load(tmp_path, imu=name), read(name)
        for got in (whole.imu, samples):
            np.testing.assert_allclose(got.rates, factor * want.imu.rates, rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(got.accelerations, share * want.imu.accelerations, rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(np.diff(got.stamps_ns), np.diff(want.imu.stamps_ns), atol=2e3)
            assert got.source.name == name
        assert whole.settings.imu.grade == grade
        assert whole.reference.stamps_ns.size == want.reference.stamps_ns.size
        assert not warnings
    np.testing.assert_array_equal(load(tmp_path).imu.rates, load(tmp_path, imu="imu0").imu.rates)


def test_what_is_wrong_with_one_of_several_imus_is_said(tmp_path: Path) -> None:
    several_imus(tmp_path)
    with pytest.raises(RecordingError, match="unknown IMU 'imu7'; known are: imu0, imu1, imu12"):
        load(tmp_path, imu="imu7")
    with pytest.raises(SettingsError, match="--map with 3 IMUs: choose one"):
        load(tmp_path, columns={"imu1.rate": "g0x, g0y, g0z"})
    moved = load(tmp_path, imu="imu1", columns={"imu1.rate": "g0x, g0y, g0z"})
    np.testing.assert_array_equal(moved.imu.rates, load(tmp_path, imu="imu0").imu.rates)
    toml = tmp_path / "recording.toml"
    toml.write_text(SEVERAL.replace('acceleration = "a1x, a1y, a1z"\n', ""))
    with pytest.raises(RecordingError, match=r"columns\.imu1\.acceleration is missing"):
        load(tmp_path, imu="imu1")
    toml.write_text(SEVERAL.replace("columns.imu12", "columns.imo12"))
    with pytest.raises(RecordingError, match=r"unknown key 'columns\.imo12'"):
        load(tmp_path)
    toml.write_text(SEVERAL.replace("[columns.imu12]\nfile", "[columns.imu12]\nfiles"))
    with pytest.raises(RecordingError, match=r"files"):
        load(tmp_path)


def test_one_further_imu_alone_is_the_imu(tmp_path: Path) -> None:
    want = several_imus(tmp_path)
    begin, end = SEVERAL.index("[columns.imu]"), SEVERAL.index("[columns.imu12]")
    (tmp_path / "recording.toml").write_text(SEVERAL[:begin] + SEVERAL[end:])
    assert imus_in(tmp_path) == ("imu12",)
    np.testing.assert_allclose(load(tmp_path).imu.rates, 3.0 * want.imu.rates, rtol=1e-12, atol=1e-15)


def test_a_bag_beside_tables_of_several_imus_is_a_bag(tmp_path: Path) -> None:
    want = several_imus(tmp_path)
    write(want, tmp_path / "run.mcap")
    assert imus_in(tmp_path / "run.mcap") == ("imu0",)
    samples, _ = imu_reader(tmp_path / "run.mcap")("imu0")
    np.testing.assert_allclose(samples.rates, want.imu.rates, atol=1e-12)
    assert len(imus_in(tmp_path / "board.csv")) == 3


@pytest.mark.parametrize(
    ("text", "iso"),
    [
        ("31.12.2026 12:00:00,5", "2026-12-31T12:00:00.5"),
        ("1.2.2026 9:00:01", "2026-02-01T09:00:01"),
        ("9:00:00.514", "09:00:00.514"),
        ("2026/05/01 12:00:00Z", "2026-05-01T12:00:00"),
        ("31.12.2026", "2026-12-31"),
    ],
)
def test_dates_and_times_of_day_as_people_write_them(text, iso):
    assert _as_iso(text) == iso
