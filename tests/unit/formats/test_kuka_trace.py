"""Traces of KUKA's controllers. The bytes are made here from what is known of the format, not by the reader."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kreisel.errors import RecordingError, RobotError
from kreisel.formats.folder import load_folder
from kreisel.formats.kuka_channels import meaning
from kreisel.formats.kuka_trace import Trace, add_trace, is_trace, read_trace
from kreisel.formats.write import write_folder
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.robot.kinematics import load_arm, poses

from ...kuka_trace import Columns, header, payload

N = 200
STEP = 0.012
T = STEP * np.arange(N)
AXES = [f"AxisPos_Act{k}" for k in range(1, 7)]
TCP = ["X_Act", "Y_Act", "Z_Act", "A_Act", "B_Act", "C_Act"]
DEGREES = np.array([0, -90, 90, 0, 30, 0]) + 40.0 * np.sin(np.outer(T, np.arange(1, 7)) + np.arange(6))
POSE = np.column_stack(
    [
        1500 + 200 * np.sin(T), 100 * np.cos(T), 1200 + 50 * np.sin(2 * T),
        (170 + 100 * T + 180) % 360 - 180, 40 * np.sin(T), (178 + 30 * np.sin(T) + 180) % 360 - 180,
    ]
)  # fmt: skip


def both() -> Columns:
    """Angles stored in rad with the factor to degrees, millimetres as they are, as in traces of KRCIpo."""
    to_degrees = 180.0 / np.pi
    axes = {name: ("°", to_degrees, DEGREES[:, k]) for k, name in enumerate(AXES)}
    place = {name: ("mm", 1.0, POSE[:, k]) for k, name in enumerate(TCP[:3])}
    turn = {name: ("°", to_degrees, POSE[:, 3 + k]) for k, name in enumerate(TCP[3:])}
    return {"AnalogOut1": ("", 1.0, np.zeros(N)), **axes, **place, **turn}


def diadem(folder: Path, columns: Columns | None = None, edit: dict[str, str] | None = None) -> Path:
    columns = both() if columns is None else columns
    folder.mkdir(parents=True, exist_ok=True)
    text = header(columns, "run_KRCIpo.r64", STEP)
    for old, new in (edit or {}).items():
        assert old in text
        text = text.replace(old, new)
    (folder / "run_KRCIpo.r64").write_bytes(payload(columns))
    (folder / "run_KRCIpo.dat").write_bytes(text.encode("latin-1"))
    return folder / "run_KRCIpo.dat"


def table(folder: Path, names: list[str], values: np.ndarray, comma: str = ".", divider: str = "\t") -> Path:
    rows = [divider.join(f"{v:.9f}" for v in row).replace(".", comma) for row in np.column_stack([1e3 * T, values])]
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "trace.txt"
    file.write_bytes(("\r\n".join([divider.join(["t", *names]), *rows]) + "\r\n").encode("latin-1"))
    return file


def refused(path: Path, *words: str) -> str:
    with pytest.raises(RecordingError) as error:
        read_trace(path)
    said = str(error.value)
    assert "\n" not in said
    for word in words:
        assert word in said, said
    return said


def assert_all_read(got: Trace, atol: float = 1e-9) -> None:
    assert got.joints is not None
    assert got.reference is not None
    for stamps in (got.joints.stamps_ns, got.reference.stamps_ns):
        np.testing.assert_array_equal(stamps, 12_000_000 * np.arange(N))
    np.testing.assert_allclose(np.degrees(got.joints.angles), DEGREES, rtol=0, atol=atol)
    np.testing.assert_allclose(1e3 * got.reference.positions, POSE[:, :3], rtol=0, atol=atol)
    q = got.reference.quaternions
    expected = Rotation.from_euler("ZYX", POSE[:, 3:], degrees=True).as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs(np.sum(q * expected, axis=1)), 1.0, rtol=0, atol=1e-12)
    assert np.all(np.sum(q[1:] * q[:-1], axis=1) > 0.9)  # A and C pass 180 degrees, the quaternion does not jump


# What is read


def test_header_and_values_of_a_kr_c4(tmp_path: Path) -> None:
    got = read_trace(diadem(tmp_path))
    assert_all_read(got)
    assert [str(warning) for warning in got.warnings] == [
        f"trace: took {', '.join(AXES)}",
        "trace: took X_Act, Y_Act, Z_Act",
        "trace: took A_Act, B_Act, C_Act",
    ]


def test_codes_divided_by_blanks(tmp_path: Path) -> None:
    file = diadem(tmp_path)
    text = re.sub(r"(?m)^(\d{3}),", r"\1   ", file.read_bytes().decode("latin-1"))
    file.write_bytes(text.encode("latin-1"))
    assert_all_read(read_trace(file))


def test_offset_and_decimal_comma_in_the_header(tmp_path: Path) -> None:
    got = read_trace(diadem(tmp_path, edit={"240,0.00000": "240,-1,5", "241,0.01200000": "241,0,012"}))
    assert_all_read(got)  # stamps count from the first sample on


def test_english_keywords_and_utf8(tmp_path: Path) -> None:
    file = diadem(tmp_path, edit={"IMPLIZIT": "IMPLICIT", "EXPLIZIT": "EXPLICIT", "200,Zeit\r\n": "200,Time\r\n"})
    file.write_bytes(file.read_bytes().decode("latin-1").encode())
    assert_all_read(read_trace(file))


def test_measured_before_commanded(tmp_path: Path) -> None:
    commanded = {name.replace("Act", "CmdIpo"): ("°", 1.0, DEGREES[:, k] + 1.0) for k, name in enumerate(AXES)}
    assert_all_read(read_trace(diadem(tmp_path, {**commanded, **both()})))


def test_values_of_a_renamed_trace(tmp_path: Path) -> None:
    got = read_trace(diadem(tmp_path, edit={"211,run_KRCIpo.r64": r"211,C:\KRC\TRACE\runm1_KRCIpo.r64"}))
    assert_all_read(got)
    assert str(got.warnings[0]) == ("trace: the header names runm1_KRCIpo.r64, which is not there; took run_KRCIpo.r64")


def test_names_in_another_case(tmp_path: Path) -> None:
    file = diadem(tmp_path)
    (tmp_path / "run_KRCIpo.r64").rename(tmp_path / "RUN_KRCIPO.R64")
    assert_all_read(read_trace(file))


@pytest.mark.parametrize("half", [AXES, TCP, TCP[:3], TCP[3:]], ids=["joints", "pose", "positions", "orientations"])
def test_parts(tmp_path: Path, half: list[str]) -> None:
    got = read_trace(diadem(tmp_path, {name: column for name, column in both().items() if name in half}))
    assert (got.joints is not None) == (half is AXES)
    assert (got.reference is not None) == (half is not AXES)
    if got.reference is not None:
        assert (got.reference.positions is not None) == ("X_Act" in half)
        assert (got.reference.quaternions is not None) == ("A_Act" in half)


@pytest.mark.parametrize(("comma", "divider"), [(".", "\t"), (",", "\t"), (",", ";"), (".", ","), (".", ";")])
def test_text_of_a_kr_c2(tmp_path: Path, comma: str, divider: str) -> None:
    file = table(tmp_path, [*AXES, *TCP], np.hstack([DEGREES, POSE]), comma, divider)
    got = read_trace(file)
    assert_all_read(got, 1e-8)
    assert str(got.warnings[0]) == "trace: 't' has no unit, so ms is assumed"
    assert "without unit, so assumed in ° and mm" in str(got.warnings[1])


def test_text_with_units_seconds_and_more_lines_above(tmp_path: Path) -> None:
    file = table(tmp_path, [f"{name} [°]" for name in AXES], DEGREES)
    lines = file.read_bytes().decode("latin-1").split("\r\n")
    lines[0] = lines[0].replace("t\t", "Zeit [s]\t")
    times = [f"{STEP * k:.3f}\t{line.partition(chr(9))[2]}\t" for k, line in enumerate(lines[1:-1])]
    file.write_bytes("\n".join(["Trace of cell 3", lines[0], *times, ""]).encode("latin-1"))
    got = read_trace(file)
    np.testing.assert_allclose(np.degrees(got.joints.angles), DEGREES, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(got.joints.stamps_ns, 12_000_000 * np.arange(N))


def test_text_with_a_line_of_units(tmp_path: Path) -> None:
    file = table(tmp_path, AXES, np.radians(DEGREES))
    head, _, rest = file.read_text().partition("\n")
    file.write_text(f"{head}\n[ms]{6 * chr(9)}\n".replace("\t" * 6, 6 * "\trad") + rest)
    got = read_trace(file)
    np.testing.assert_allclose(np.degrees(got.joints.angles), DEGREES, rtol=0, atol=1e-6)


def test_a_cut_last_line_is_left_out_and_told(tmp_path: Path) -> None:
    file = table(tmp_path, AXES, DEGREES)
    file.write_bytes(file.read_bytes()[:-4])
    got = read_trace(file)
    assert got.joints.angles.shape == (N - 1, 6)
    assert "the last line has no end" in str(got.warnings[0])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("AxisPos_Act3", ("measured", "A3")), ("AxisPos_CmdIpo3", ("commanded", "A3")), ("X_Act", ("measured", "X")),
        ("$AXIS_ACT.A1", ("measured", "A1")), ("$AXIS_ACT_MEAS.A6", ("measured", "A6")),
        ("$POS_ACT.C", ("measured", "C")), ("Istposition A2", ("measured", "A2")), ("XAct", ("measured", "X")),
        ("Istwert Position Achse 4", ("measured", "A4")), ("Sollposition A2", ("commanded", "A2")),
        ("A1", ("bare", "A1")), ("A", ("bare", "A")), ("Pos_X", ("bare", "X")), ("CartPos_Act_B", ("measured", "B")),
        ("AxisPos_Act7", None), ("AxisVel_Act3", None), ("Torque_A1", None), ("Act1", None), ("1", None), ("", None),
        ("Istposition", None), ("Positionsschleppfehler A1", None), ("CartVel_Act", None), ("E1", None),
        ("Iststrom A1", None), ("X_Act_Error", None),
    ],
)  # fmt: skip
def test_what_names_say(name: str, said: tuple[str, str] | None) -> None:
    assert meaning(name) == said


def test_bare_names_are_taken_where_nothing_is_commanded(tmp_path: Path) -> None:
    bare = {name: ("°", 1.0, DEGREES[:, k]) for k, name in enumerate(["A1", "A2", "A3", "A4", "A5", "A6"])}
    got = read_trace(diadem(tmp_path / "a", bare))
    assert "do not say whether they are measured or commanded" in str(got.warnings[0])
    refused(diadem(tmp_path / "b", {**bare, "AxisPos_Cmd1": ("°", 1.0, DEGREES[:, 0])}), "no measured motion")


# What is refused


def only(names: list[str]) -> Columns:
    return {name: column for name, column in both().items() if name in names}


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ({"202,°": "202,furlong"}, ("line 36", "AxisPos_Act1", "[furlong]", "[°], [deg]")),
        ({"202,°": "202,rad"}, ("AxisPos_Act", "[rad]", "larger than for any robot")),
        ({"202,mm": "202,m"}, ("X_Act", "up to 1700", "correct the unit")),
        ({"241,57.29577951308232": "241,1"}, ("AxisPos_Act2", "they look like [rad]")),
        ({"241,57.29577951308232": "241,5729.5"}, ("before the gear",)),
        ({"112,High -> Low": "112,Low -> High"}, ("line 9", "'Low -> High'", "expected 'High -> Low'")),
        ({"213,BLOCK": "213,CHANNEL"}, ("code 213", "'CHANNEL'", "expected BLOCK")),
        ({"214,REAL64": "214,INT16"}, ("code 214", "'INT16'", "expected REAL64")),
        ({"214,REAL64": "214,REAL64\r\n222,4"}, ("code 222",)),
        ({"221,13\r\n": "221,12\r\n"}, ("code 221", "1 to 13, each once")),
        ({"220,200\r\n221,3\r\n": "220,199\r\n221,3\r\n"}, ("AxisPos_Act2", "199 values", "has 200")),
        ({"220,200\r\n221": "220,210\r\n221"}, ("run_KRCIpo.r64", "20800 bytes", "200 samples of 13", "it is cut")),
        ({"220,200\r\n221": "220,190\r\n221"}, ("run_KRCIpo.r64", "not of one trace", "190 samples")),
        ({"220,200\r\n240,0.0": "220,199\r\n240,0.0"}, ("'Zeit'", "199 values", "has 200")),
        ({"220,200\r\n221": "220,-3\r\n221"}, ("code 220", "-3 is not a whole number")),
        ({"220,200\r\n221": "220,many\r\n221"}, ("code 220", "'many' is not a number")),
        ({"241,0.01200000": "241,0"}, ("'Zeit'", "expected it to grow")),
        ({"241,0.01200000": "241,nan"}, ("code 241", "not a number")),
        ({"241,0.01200000": "241,12"}, ("'Zeit'", "0.0833333 a second in [sec]", "expected 0.5 to 20000")),
        ({"202,sec": "202,min"}, ("'Zeit'", "[min]", "[s], [sec]")),
        ({"210,IMPLIZIT": "210,EGAL"}, ("code 210", "'EGAL'")),
        ({"200,Zeit\r\n": "hello\r\n"}, ("'hello' is not 'code,value'",)),
        ({"200,X_Act\r\n": ""}, ("no code 200",)),
        ({"200,Y_Act": "200,X_Act"}, ("'X_Act' (line", "both mean X")),
        ({"211,run_KRCIpo.r64": "211,other.r64"}, ()),
    ],
)  # fmt: skip
def test_faults_of_a_header(tmp_path: Path, edit: dict[str, str], words: tuple[str, ...]) -> None:
    file = diadem(tmp_path, edit=edit)
    if not words:
        (tmp_path / "run_KRCIpo.r64").unlink()
        words = ("code 211", "no file 'other.r64'", "copy the .r64 with the .dat")
    assert str(file.parent) in refused(file, *words)


def test_no_time(tmp_path: Path) -> None:
    file = diadem(tmp_path)
    text = file.read_bytes()
    begin = text.index(b"#BEGINCHANNELHEADER")
    end = text.index(b"#BEGINCHANNELHEADER", begin + 1)
    file.write_bytes(text[:begin] + text[end:])
    refused(file, "0 channels hold the time", "expected one, 'Zeit'")


def test_only_commanded_positions(tmp_path: Path) -> None:
    names = [name.replace("Act", "CmdIpo") for name in AXES]
    columns = {name: ("°", 1.0, DEGREES[:, k]) for k, name in enumerate(names)}
    refused(diadem(tmp_path, columns), "AxisPos_CmdIpo1, AxisPos_CmdIpo2", "commanded, not measured", "AxisPos_Act1")


def test_a_drives_own_positions(tmp_path: Path) -> None:
    columns = {"Istposition": ("°", 1e-6, 100.0 * DEGREES[:, 0]), "Motortemperatur": ("K", 1.0, 300.0 + T)}
    refused(diadem(tmp_path, columns), "the channels are Istposition, Motortemperatur", "before the gear", "KRCIpo")


@pytest.mark.parametrize("value", [np.nan, np.inf, 9.9e34])
def test_missing_values(tmp_path: Path, value: float) -> None:
    angles = DEGREES[:, 3].copy()
    angles[[70, 75]] = value
    columns = {**both(), "AxisPos_Act4": ("°", 1.0, angles)}
    refused(diadem(tmp_path, columns), "'AxisPos_Act4'", "at sample 71 of 200, and 1 more")


def test_a_channel_that_stands_still(tmp_path: Path) -> None:
    columns = {**only(AXES), "AxisPos_Act4": ("°", 1.0, np.zeros(N))}
    refused(diadem(tmp_path / "a", columns), "'AxisPos_Act4': 0 in all samples, but not all of AxisPos_Act1, ")
    still = {name: ("°", 1.0, np.full(N, 3.0)) for name in AXES}
    refused(diadem(tmp_path / "b", still), "3 in all samples, as are all others", "the robot did not move")


def test_values_alone_and_binary_traces(tmp_path: Path) -> None:
    diadem(tmp_path)
    refused(tmp_path / "run_KRCIpo.r64", "give the .dat next to it")
    (tmp_path / "old.trc").write_bytes(b"TRC\0\1\2")
    refused(tmp_path / "old.trc", "is binary", "export it as text")
    refused(tmp_path / "none.dat", "No such file")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("DEFDAT  RUN\nDECL INT A\nENDDAT\n", ("neither a DIAdem header", "(KR C4)")),
        ("", ("neither a DIAdem header",)),
        ("t\tA1\n", ("holds no row of numbers",)),
        ("1\t2\n2\t3\n", ("line 1", "no line that names the 2 columns")),
        ("t\tA1\nx\ty\n1\t2\n", ("line 2", "neither a row of numbers nor of units")),
        ("t\tA1\n1\t2\n2\tx\n", ("line 3", "'x' is not a number")),
        ("t\tA1\n1\t2\n2\t3\t4\n", ("line 3", "3 values, expected 2")),
        ("t\tA1\n1\t2\n\n2\n", ("line 4", "1 values, expected 2")),
        ("t\tA1\n1\t1,234\n2\t12.5\n", ("line 2", "line 3 a point")),
        ("t\tA1\n1\t1,234.5\n2\t1,5\n", ("line 2", "neither a row of numbers")),
        ("A1\tA2\n1\t1\n2\t1\n", ("the first column is 'A1', expected the time",)),
        ("t\tA1\n10\t1\n5\t2\n7\t3\n", ("time goes from 10 to 5 at sample 2",)),
        ("t\tA1\n0.012\t1\n0.024\t2\n", ("83333.3 a second in [ms]", "Zeit [s]")),
        ("t\tA1\nnan\t1\n1\t2\n", ("nan at sample 1 is not a possible time",)),
        ("t\tTorque_A1\n10\t1\n20\t2\n", ("no measured motion", "the channels are Torque_A1")),
    ],
)  # fmt: skip
def test_faults_of_a_text(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    file = tmp_path / "trace.txt"
    file.write_text(text)
    refused(file, *words)


# Whatever the bytes


@settings(max_examples=150)
@given(cut=st.floats(0.0, 1.0), values=st.booleans())
def test_cut_anywhere(tmp_path_factory: pytest.TempPathFactory, cut: float, values: bool) -> None:
    folder = tmp_path_factory.mktemp("cut")
    file = diadem(folder)
    cut_file = folder / "run_KRCIpo.r64" if values else file
    data = cut_file.read_bytes()
    kept = data[: int(cut * len(data))]
    cut_file.write_bytes(kept)
    if kept == data or (not values and kept.rstrip() == data.rstrip()):
        assert_all_read(read_trace(file))
    else:
        refused(file)


@given(cut=st.floats(0.0, 1.0))
def test_text_cut_anywhere_loses_rows_alone(tmp_path_factory: pytest.TempPathFactory, cut: float) -> None:
    file = table(tmp_path_factory.mktemp("cut"), AXES, DEGREES)
    data = file.read_bytes()
    file.write_bytes(data[: int(cut * len(data))])
    try:
        got = read_trace(file)
    except RecordingError:
        return
    rows = len(got.joints.angles)
    np.testing.assert_allclose(np.degrees(got.joints.angles), DEGREES[:rows], rtol=0, atol=1e-8)


_HEADER = header(both(), "run_KRCIpo.r64", STEP).encode("latin-1")


@settings(max_examples=300)
@given(
    st.one_of(
        st.binary(max_size=300),
        st.text(alphabet="tA1X_Act;,\t\n.0123456789-eE °nainf\r", max_size=300).map(lambda s: s.encode("latin-1")),
        st.tuples(st.integers(0, len(_HEADER)), st.integers(0, 40), st.binary(max_size=20)).map(
            lambda edit: _HEADER[: edit[0]] + edit[2] + _HEADER[edit[0] + edit[1] :]
        ),
        st.tuples(st.sampled_from([202, 210, 213, 214, 220, 221, 240, 241]), st.text(max_size=12)).map(
            lambda e: re.sub(rb"(?m)^%d,[^\r]*" % e[0], lambda m: b"%d," % e[0] + e[1].encode(), _HEADER)
        ),
    )
)
def test_garbage_raises_only_our_errors(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    folder = tmp_path_factory.mktemp("garbage")
    file = diadem(folder)
    file.write_bytes(data)
    try:
        got = read_trace(file)
    except RecordingError as error:
        assert str(file.parent) in str(error)
        return
    assert got.joints is not None or got.reference is not None


# Into a recording


def imu() -> ImuSamples:
    rng = np.random.default_rng(1)
    stamps = 10**18 + 5_000_000 * np.arange(2000)
    force = np.array([0.0, 0.0, 9.8]) + rng.normal(size=(2000, 3))
    return ImuSamples(stamps, rng.normal(size=(2000, 3)), force, Path("imu"))


def test_beside_the_imu(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    write_folder(Recording(folder, imu(), None), folder)
    before = (folder / "imu0" / "data.csv").read_bytes()
    said = add_trace(diadem(tmp_path / "trace"), folder)
    assert not any(warning.subject == "imu0" for warning in said)
    got = load_folder(folder)
    assert got.reference.name == "pose0"
    np.testing.assert_allclose(np.degrees(got.joints.angles), DEGREES, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(got.reference.stamps_ns, got.joints.stamps_ns)
    assert (folder / "imu0" / "data.csv").read_bytes() == before
    with pytest.raises(RecordingError, match=r"joint0: is there already; delete it"):
        add_trace(tmp_path / "trace" / "run_KRCIpo.dat", folder)


def test_into_a_new_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    said = add_trace(diadem(tmp_path / "trace"), folder)
    assert str(said[-1]) == f"imu0: is not there yet: put the IMU's readings into {folder / 'imu0' / 'data.csv'}"
    assert {file.name for file in folder.iterdir()} == {"pose0", "joint0"}


def test_above_mav0(tmp_path: Path) -> None:
    write_folder(Recording(tmp_path, imu(), None), tmp_path / "run" / "mav0")
    add_trace(diadem(tmp_path / "trace"), tmp_path / "run")
    assert load_folder(tmp_path / "run").joints is not None


def test_joint_angles_alone_need_the_robots_description(tmp_path: Path) -> None:
    trace, folder = diadem(tmp_path / "trace", only(AXES)), tmp_path / "run"
    with pytest.raises(RecordingError, match=r"no robot\.urdf in .*run to compute poses from them; put the robot's"):
        add_trace(trace, folder)
    assert not folder.exists()
    arm = load_arm("kr125")
    folder.mkdir()
    (folder / "arm.urdf").write_text(arm.urdf)
    (folder / "recording.toml").write_text('[robot]\nurdf = "arm.urdf"\ntcp = "tool0"\n')
    said = [str(warning) for warning in add_trace(trace, folder)]
    assert "pose0: poses of 'tool0' were computed from these angles with arm.urdf: the trace holds none" in said
    write_folder(Recording(folder, imu(), None), tmp_path / "imu")
    (tmp_path / "imu" / "imu0").rename(folder / "imu0")
    got = load_folder(folder)
    p, q = poses(arm, np.radians(DEGREES))
    np.testing.assert_allclose(got.reference.positions, p, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.reference.quaternions, q, rtol=0, atol=1e-9)


def test_an_arm_of_other_joints(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "robot.urdf").write_text(load_arm("kr125").urdf)
    (folder / "recording.toml").write_text('[robot]\ntcp = "link_4"\n')
    with pytest.raises(RobotError, match="4 joints move 'link_4'.* expected the six"):
        add_trace(diadem(tmp_path / "trace", only(AXES)), folder)
    assert not (folder / "joint0").exists()


def test_a_file_where_the_folder_should_be(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("x")
    with pytest.raises(RecordingError, match="is a file; give a folder"):
        add_trace(diadem(tmp_path / "trace"), tmp_path / "run")


def test_which_files_are_traces(tmp_path: Path) -> None:
    assert is_trace(Path("run_KRCIpo.DAT"))
    assert is_trace(Path("trace.txt"))
    (tmp_path / "recording.dat").mkdir()
    assert not is_trace(tmp_path / "recording.dat")
    assert not is_trace(Path("run.mcap"))
