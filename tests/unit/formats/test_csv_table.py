from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kreisel.errors import RecordingError
from kreisel.formats import csv_table as module
from kreisel.formats.csv_table import Table, read_table
from kreisel.formats.folder import load_folder
from kreisel.recording.location import fault, line_of
from kreisel.recording.recording import NO_STAMP
from kreisel.recording.recording_settings import read_settings
from kreisel.units import DEG, STANDARD_GRAVITY

HEADER = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"


def table(tmp_path: Path, text: str | bytes, name: str = "data.csv") -> Table:
    file = tmp_path / "imu0" / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_table(file, "numbers")


def message(tmp_path: Path, text: str | bytes) -> str:
    with pytest.raises(RecordingError) as error:
        table(tmp_path, text)
    return str(error.value)


def numbers(table: Table) -> np.ndarray:
    """All columns but the stamp's, as they stand in the file."""
    return table.values[:, 1:]


def test_a_table_as_euroc_writes_it(tmp_path: Path) -> None:
    got = table(tmp_path, f"{HEADER}\n10,1,2,3,4,5,6\n20,-1e-3,2.5,3,4,5,6\n")
    np.testing.assert_array_equal(got.stamps_ns, [10, 20])
    np.testing.assert_array_equal(numbers(got), [[1, 2, 3, 4, 5, 6], [-1e-3, 2.5, 3, 4, 5, 6]])
    assert [column.unit for column in got.columns] == ["ns", "rad s^-1", None, None, "m s^-2", None, None]
    assert [column.unit for column in got.with_units(list(got.columns[4:7]))] == 3 * ["m s^-2"]
    assert got.warnings == ()


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("[deg s^-1]", "rate", DEG),
        ("(°/s)", "rate", DEG),
        ("[ mdps ]", "rate", 1e-3 * DEG),
        ("[rad  s^-1]", "rate", 1.0),
        ("[g]", "acceleration", STANDARD_GRAVITY),
        ("[mm]", "length", 1e-3),
        ("[]", "quaternion", 1.0),
        ("", "length", 1.0),
    ],
)
def test_units_are_converted(tmp_path: Path, unit: str, quantity: str, factor: float) -> None:
    got = table(tmp_path, f"t,x {unit}\n1,2\n2,4\n")
    np.testing.assert_allclose(got.take([got.columns[1]], quantity), [[2 * factor], [4 * factor]], rtol=1e-15)


def readings(tmp_path: Path, header: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Rates and accelerations of a folder whose rows are ones, and what is said."""
    (tmp_path / "imu0").mkdir(exist_ok=True)
    (tmp_path / "imu0" / "data.csv").write_text(f"#timestamp [ns],{header}\n1,1,1,1,1,1,1\n")
    got = load_folder(tmp_path)
    return got.imu.rates[0], got.imu.accelerations[0], [warning.message for warning in got.warnings]


@pytest.mark.parametrize(
    "names",
    [
        ("gx", "gy", "gz", "ax", "ay", "az"),
        ("wx", "wy", "wz", "fx", "fy", "fz"),
        ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z"),
        ("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z"),
        ("omega x", "omega y", "omega z", "force x", "force y", "force z"),
        ("rate", "pitch rate", "yaw rate", "first", "second", "third"),
    ],
)
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_unit_stated_once_holds_for_its_group(tmp_path: Path, names: tuple[str, ...], place: int) -> None:
    columns = [f"{name} [{'g' if k > 2 else 'deg/s'}]" if k % 3 == place else name for k, name in enumerate(names)]
    rates, accelerations, said = readings(tmp_path, ",".join(columns))
    np.testing.assert_allclose(rates, DEG, rtol=1e-15)
    np.testing.assert_allclose(accelerations, STANDARD_GRAVITY, rtol=1e-15)
    assert said == ["converted from [deg/s], [g] to SI"]


def test_a_unit_of_one_group_is_none_of_the_next(tmp_path: Path) -> None:
    rates, accelerations, _ = readings(tmp_path, "x [deg/s],y,z,ax,ay,az")
    np.testing.assert_allclose(rates, DEG, rtol=1e-15)
    np.testing.assert_array_equal(accelerations, 1.0)


def test_each_column_may_state_its_own_unit(tmp_path: Path) -> None:
    rates, _, _ = readings(tmp_path, "gx [deg/s],gy [rad/s],gz [mdps],ax,ay,az")
    np.testing.assert_allclose(rates, [DEG, 1.0, 1e-3 * DEG], rtol=1e-15)


@pytest.mark.parametrize("header", ["gx [deg/s],gy [rad/s],gz,ax,ay,az", "gx,gy [deg/s],gz [rad/s],ax,ay,az"])
def test_units_that_differ_where_one_is_missing_are_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(
        RecordingError, match=r"data\.csv, line 1: the columns .* belong together, and the unit of each is not clear"
    ):
        readings(tmp_path, header)


def test_units_of_poses_and_joints_hold_for_their_groups(tmp_path: Path) -> None:
    readings(tmp_path, "w_x,w_y,w_z,a_x,a_y,a_z")
    for name, header, row in (
        ("pose0", "z [mm],x,y,q_w [],q_x,q_y,q_z", "1,2,3,1,0,0,0"), ("joint0", "A1 [deg],A2,axis 3", "1,2,3"),
    ):  # fmt: skip
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.csv").write_text(f"t,{header}\n1,{row}\n")
    got = load_folder(tmp_path)
    np.testing.assert_allclose(got.reference.positions, [[2e-3, 3e-3, 1e-3]], rtol=1e-15)
    np.testing.assert_allclose(got.joints.angles, [[DEG, 2 * DEG, 3 * DEG]], rtol=1e-15)
    assert (got.reference.units.length, got.joints.units.angle) == ("mm", "deg")
    assert [str(warning) for warning in got.warnings] == [
        "pose0/data.csv: converted from [mm] to SI", "joint0/data.csv: converted from [deg] to SI"
    ]  # fmt: skip


def test_an_unknown_unit_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    got = table(tmp_path, "t,x [furlong]\n1,2\n")
    with pytest.raises(
        RecordingError, match=r"data.csv, line 1: column 2 \('x'\) is in \[furlong\].*\[m\], \[cm\], \[mm\]"
    ):
        got.take([got.columns[1]], "length")


@pytest.mark.parametrize(
    ("unit", "stamp"), [("s", "1700000000.123456"), ("ms", "1700000000123.456"), ("us", "1700000000123456")]
)
def test_stamps_in_other_units_keep_their_digits(tmp_path: Path, unit: str, stamp: str) -> None:
    got = table(tmp_path, f"t [{unit}],x\n{stamp},1\n")
    assert abs(int(got.stamps_ns[0]) - 1_700_000_000_123_456_000) < 300  # what a float64 of seconds resolves


@pytest.mark.parametrize("stamp", ["inf", "-1e300", "1e20"])
def test_impossible_stamps_have_their_line(tmp_path: Path, stamp: str) -> None:
    assert "line 3: the stamp" in message(tmp_path, f"t [s],x\n1,1\n{stamp},1\n2,1\n")


@pytest.mark.parametrize("unit", ["ns", "s"])
@pytest.mark.parametrize("cell", ["", "nan", " ", "NaN"])
def test_missing_cells_are_no_numbers_and_missing_stamps_no_stamps(tmp_path: Path, unit: str, cell: str) -> None:
    got = table(
        tmp_path, f"t [{unit}],x,y\n1,1,2\n{cell},3,4\n3,{cell},6\n4,7,{cell}\n5,{cell},{cell}\n# a,,b\n6,9,10\n"
    )
    size = {"ns": 1, "s": 10**9}[unit]
    assert got.stamps_ns.tolist() == [size, NO_STAMP, *(size * k for k in (3, 4, 5, 6))]
    nan = np.nan
    np.testing.assert_array_equal(got.values[:, 1:], [[1, 2], [3, 4], [nan, 6], [7, nan], [nan, nan], [9, 10]])


@pytest.mark.parametrize(
    ("end", "rows"), [("", 1), ("\n", 2), ("\r\n", 2), (",", 1)], ids=["none", "unix", "windows", "comma"]
)
def test_a_line_without_an_end_is_left_out(tmp_path: Path, end: str, rows: int) -> None:
    got = table(tmp_path, f"t,x\n1,2.5\n2,3.5{end}")
    assert got.stamps_ns.size == rows
    assert len(got.warnings) == 2 - rows


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("1,2,3\n4,5,6\n", "line 1: has no header"),
        ("t,x\n", "no rows"),
        ("t;x\n1;2\n", "line 1: columns are divided by semicolons"),
        ("t,x [m\n1,2\n", "line 1: column 2 of the header, 'x [m'"),
        ("t,x\n1,2\n2\n", "line 3: 1 values, expected 2 values"),
        ("t,x\n1,2\n\n# note\n2,y\n", "line 5: 'y' in column 2 ('x') is not a number"),
        ("t,x\n1,2\n1_0,2\n", "line 3: '1_0' in column 1 ('t') is not a whole number"),
        ("t,x\n1.5,2\n", "line 2: '1.5' in column 1 ('t') is not a whole number of nanoseconds; write whole ones"),
        ("t,x\n99999999999999999999,2\n", "line 2: '99999999999999999999' in column 1 ('t') is not a time that fits"),
        ("t [min],x\n1,2\n", "line 1: stamps are in [min]"),
        (b"t,x\n1,\xff\n", "line 2: not UTF-8"),
        (b"t,x\n1,2\n\0\0\0", "line 3: holds a zero byte"),
        ("t,x\n1,2\n".encode("utf-16"), "UTF-16"),
    ],
)
def test_what_is_no_table_is_refused_with_its_line(tmp_path: Path, text: str | bytes, said: str) -> None:
    assert said in message(tmp_path, text)


@given(
    st.binary(max_size=300) | st.text(st.sampled_from("0123456789.,-+e#[]() tx\n\rnaif"), max_size=120).map(str.encode)
)
@example(b"\x01\r#\r")  # no row but a comment
def test_any_bytes_are_a_table_or_an_error_of_ours(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    file = tmp_path_factory.getbasetemp() / "any.csv"
    file.write_bytes(data)
    with suppress(RecordingError):
        got = read_table(file, "anything")
        assert numbers(got).shape == (got.stamps_ns.size, len(got.columns) - 1)


@pytest.mark.parametrize("method", ["is_file", "open"])
def test_what_may_not_be_read_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "data.csv").write_text("t,x\n1,2\n")
    monkeypatch.setattr(Path, method, forbidden)
    with pytest.raises(RecordingError, match="cannot be read: Permission denied; check its permissions"):
        read_table(tmp_path / "data.csv", "numbers")


def test_settings_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", forbidden)
    with pytest.raises(RecordingError, match=r"recording\.toml: cannot be read: Permission denied"):
        read_settings(tmp_path / "recording.toml")


def test_lines_are_counted_past_comments_and_empty_lines(tmp_path: Path) -> None:
    file = tmp_path / "data.csv"
    file.write_text("t,x\n1,1\n\n# note\n2,2\n   # more\n3,3\n")
    assert [line_of(file, row) for row in range(3)] == [2, 5, 7]
    assert line_of(tmp_path / "gone.csv", 5) == 7
    assert str(fault(tmp_path / "run.mcap" / "imu", "no", 5)).endswith("run.mcap/imu: message 6: no")


IMU_NAMES = [
    "w_x,w_y,w_z,a_x,a_y,a_z",
    "w_RS_S_x,w_RS_S_y,w_RS_S_z,a_RS_S_x,a_RS_S_y,a_RS_S_z",
    "gx,gy,gz,ax,ay,az",
    "gyro x,gyro y,gyro z,acc x,acc y,acc z",
    "angular_velocity.x,angular_velocity.y,angular_velocity.z,linear_acceleration.x,linear_acceleration.y,linear_acceleration.z",
    "1,2,3,4,5,6",
]


@pytest.mark.parametrize("names", IMU_NAMES)
def test_names_of_all_kinds_are_taken_by_position(tmp_path: Path, names: str) -> None:
    table(tmp_path, f"t,{names}\n1,1,2,3,4,5,6\n")
    assert load_folder(tmp_path).imu.accelerations.tolist() == [[4, 5, 6]]


@pytest.mark.parametrize(
    "names", ["ax,ay,az,gx,gy,gz", "gz,gy,gx,az,ay,ax", "temp,gx,gy,gz,ax,ay", "w_x,w_y,w_z,m_x,m_y,m_z"]
)
def test_names_that_contradict_their_position_are_refused(tmp_path: Path, names: str) -> None:
    table(tmp_path, f"t,{names}\n1,1,2,3,4,5,6\n")
    with pytest.raises(RecordingError, match=r"line 1: column [25] is"):
        load_folder(tmp_path)


def write_poses(tmp_path: Path, text: str) -> None:
    table(tmp_path, f"{HEADER}\n1,1,2,3,4,5,6\n")
    (tmp_path / "pose0").mkdir()
    (tmp_path / "pose0" / "data.csv").write_text(text)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("t,p_x [mm],p_y,p_z,q_w,q_x,q_y,q_z", "1,1000,2000,3000,0.1,0.2,0.3,0.4"),
        ("t,q_x,q_y,q_z,q_w,p_z,p_y,p_x", "1,0.2,0.3,0.4,0.1,3,2,1"),
        ("t,tx,ty,tz,qx,qy,qz,qw", "1,1,2,3,0.2,0.3,0.4,0.1"),
        ("t,x,y,z,qw,qx,qy,qz,v_x,v_y,v_z,b_w_RS_S_x", "1,1,2,3,0.1,0.2,0.3,0.4,7,7,7,7"),
    ],
)
def test_poses_are_read_by_name(tmp_path: Path, header: str, row: str) -> None:
    write_poses(tmp_path, f"{header}\n{row}\n")
    reference = load_folder(tmp_path).reference
    assert reference.positions.tolist() == [[1, 2, 3]]
    assert reference.quaternions.tolist() == [[0.1, 0.2, 0.3, 0.4]]


@pytest.mark.parametrize(
    "header", ["t,a,b,c", "t,p_x,p_y,q_w", "t,p_x,p_y,p_z,roll,pitch,yaw", "t,x,y,z,rx,ry,rz", "t"]
)
def test_what_are_no_poses_is_refused(tmp_path: Path, header: str) -> None:
    write_poses(tmp_path, header + "\n" + ",".join("1" for _ in header.split(",")) + "\n")
    with pytest.raises(RecordingError, match=r"pose0/data.csv, line 1: columns are .*expected #timestamp \[ns\],p_x"):
        load_folder(tmp_path)


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("size", [1, 2, 7, 64])
def test_blocks_are_joined_as_if_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, size: int
) -> None:
    lines = ["#timestamp [ns],a [m]", *(f"{10 * k},{k / 7!r}" for k in range(30)), "300,cut"]
    whole = table(tmp_path, ending.join(lines), "whole.csv")
    monkeypatch.setattr(module, "_BLOCK", size)
    parts = table(tmp_path, ending.join(lines), "parts.csv")
    np.testing.assert_array_equal(parts.stamps_ns, whole.stamps_ns)
    np.testing.assert_array_equal(numbers(parts), numbers(whole))
    np.testing.assert_array_equal(parts.take([parts.columns[1]], "length"), whole.take([whole.columns[1]], "length"))
    assert len(parts.warnings) == len(whole.warnings) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,x\n1,2\n2,oops\n3,4\n", "'oops'"),
        ("t,x\n1,2\n2\x00,3\n", "zero byte (byte 9)"),
        ("t,x\n1,2\n2\xff,3\n", "byte 9"),
    ],
    ids=["no number", "zero byte", "not UTF-8"],
)
def test_a_fault_keeps_its_place_in_a_later_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, said: str
) -> None:
    monkeypatch.setattr(module, "_BLOCK", 5)
    file = tmp_path / "data.csv"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(RecordingError) as error:
        read_table(file, "numbers")
    assert said in str(error.value)
    assert error.value.line == 3


@pytest.mark.parametrize(
    ("header", "rate", "acceleration"),
    [
        ("timestamp,gyro_x_dps,gyro_y_dps,gyro_z_dps,acc_x,acc_y,acc_z", DEG, 1.0),
        ("timestamp_ns,gx_deg_s,gy_deg_s,gz_deg_s,ax_g,ay_g,az_g", DEG, STANDARD_GRAVITY),
        ("timestamp,gyro_x_dps [rad/s],gyro_y,gyro_z,acc_x_mg,acc_y_mg,acc_z_mg", 1.0, 1e-3 * STANDARD_GRAVITY),
    ],
)
def test_units_at_the_end_of_names_hold(tmp_path: Path, header: str, rate: float, acceleration: float) -> None:
    """Ten degrees in a second had been ten radians in a second."""
    got = table(tmp_path, f"{header}\n10,1,2,3,4,5,6\n")
    np.testing.assert_allclose(got.take(list(got.columns[1:4]), "rate")[0], rate * np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(
        got.take(list(got.columns[4:7]), "acceleration")[0], acceleration * np.array([4.0, 5.0, 6.0])
    )


def poses(tmp_path: Path, header: str) -> tuple[np.ndarray, np.ndarray]:
    for folder, text in (("imu0", f"{HEADER}\n10,1,2,3,4,5,6\n"), ("pose0", f"{header}\n10,1,2,3,4,5,6,7\n")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "data.csv").write_text(text)
    found = load_folder(tmp_path).reference
    assert found is not None
    assert found.positions is not None
    assert found.quaternions is not None
    return found.positions[0], found.quaternions[0]


@pytest.mark.parametrize(
    ("header", "size", "order"),
    [
        ("t,x_mm,y_mm,z_mm,qw,qx,qy,qz", 1e-3, (4, 5, 6, 7)),
        ("t,pose.position.x,pose.position.y,pose.position.z,"
         "pose.orientation.x,pose.orientation.y,pose.orientation.z,pose.orientation.w", 1.0, (7, 4, 5, 6)),
        ("t,position_x,position_y,position_z,orientation_w,orientation_x,orientation_y,orientation_z", 1.0,
         (4, 5, 6, 7)),
    ],
)  # fmt: skip
def test_poses_under_usual_names(tmp_path: Path, header: str, size: float, order: tuple[int, ...]) -> None:
    p, q = poses(tmp_path, header)
    np.testing.assert_allclose(p, size * np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(q, order)


def test_quaternions_without_axes_are_refused(tmp_path: Path) -> None:
    """They had been left out without a word."""
    with pytest.raises(RecordingError, match=r"columns are x, y, z, q1, q2, q3, q4; .*name each column by its axis"):
        poses(tmp_path, "t,x,y,z,q1,q2,q3,q4")


def test_columns_of_words_are_not_read(tmp_path: Path) -> None:
    """As rows of numbers alone are; they may have an empty cell, or a number among the words."""
    rows = ["10,1,2,3,4,5,6,0,imu link", "20,-1e-3,,3,4,5,6,1,", "30,1,2,3,4,5,6,,7"]
    got = table(tmp_path, f"{HEADER},status,frame\n" + "\n".join(rows) + "\n")
    plain = table(tmp_path, f"{HEADER},status\n" + "\n".join(row.rpartition(",")[0] for row in rows) + "\n")
    np.testing.assert_array_equal(got.stamps_ns, plain.stamps_ns)
    np.testing.assert_array_equal(got.values[:, :-1], plain.values)
    assert np.isnan(got.values[:, -1]).all()
    assert got.columns[:-1] == plain.columns
    assert got.columns[-1].words == ("imu link", 2)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("10,1,2,3,4,5,6,on\n20,1,2,x,4,5,6,on\n", "line 3: 'x' in column 4 ('w_z') is not a number"),
        ("10,1,2,3,4,5,6,on\n20,1,2,4,5,6,on\n", "line 3: 7 values, expected 8"),
        ("10,1,2,3,4,5,6,on\n20,1,2,3,4,5,6,on,8\n", "line 3: 9 values, expected 8"),
    ],
)
def test_rows_with_words_are_checked(tmp_path: Path, rows: str, said: str) -> None:
    assert said in message(tmp_path, f"{HEADER},state\n{rows}")


def test_words_where_numbers_are_needed_are_named(tmp_path: Path) -> None:
    table(tmp_path, f"{HEADER}\n# made by hand\n10,1,2,none,4,5,6\n20,1,2,3,4,5,6\n")
    with pytest.raises(RecordingError, match=r"line 3: 'none' in column 4 \('w_z'\) is not a number; repair or delete"):
        load_folder(tmp_path)


def test_a_joint_has_no_words(tmp_path: Path) -> None:
    table(tmp_path, f"{HEADER}\n10,1,2,3,4,5,6\n20,1,2,3,4,5,6\n")
    for name, text in {
        "pose0": "#timestamp [ns],body,p_x [m],p_y,p_z,q_w,q_x,q_y,q_z\n10,tool,1,2,3,1,0,0,0\n20,tool,1,2,3,1,0,0,0\n",
        "joint0": "#timestamp [ns],q_1 [deg],mode,q_2\n10,180,auto,0\n20,90,hand,0\n",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.csv").write_text(text)
    recording = load_folder(tmp_path)
    np.testing.assert_allclose(recording.joints.angles, [[np.pi, 0.0], [np.pi / 2.0, 0.0]])
    np.testing.assert_array_equal(recording.reference.positions[0], [1.0, 2.0, 3.0])
