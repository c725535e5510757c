"""Mappings proposed from names, structure and motion: right, or open to the user's choice, never quietly wrong."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError, UnknownColumnsError
from kreisel.formats.column_names import read_name
from kreisel.formats.loading import load
from kreisel.formats.mapped import load_mapped
from kreisel.formats.proposal import proposal
from kreisel.recording.recording import Recording
from kreisel.recording.recording_settings import ColumnsTable, RecordingSettings

from ...foreign_tables import DEG, text
from ...small_problem import recorded
from ...stranger_tables import CLEAR, COMMON, common, own_estimate, triad, two_imus

Make = Callable[[Recording, Path], Path]


def read_by(proposed: str, path: Path) -> Recording:
    return load_mapped(path, RecordingSettings(), ColumnsTable.model_validate(tomllib.loads(proposed)["columns"]))


def assert_right(got: Recording, *, shared: bool) -> None:
    """Numbers to rounding, q and -q are one rotation, both streams on one clock."""
    r = recorded()[1]
    t, w, f, p, q = common(r)
    tau = t
    if not shared:
        t, w, f = (r.imu.stamps_ns - r.imu.stamps_ns[0]) * 1e-9, r.imu.rates, r.imu.accelerations
        tau, p, q = (r.reference.stamps_ns - r.imu.stamps_ns[0]) * 1e-9, r.reference.positions, r.reference.quaternions
    np.testing.assert_allclose(got.imu.rates, w, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.imu.accelerations, f, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.imu.seconds, t - t[0], atol=2e-6)
    poses = got.reference
    np.testing.assert_allclose(poses.positions, p, atol=1e-9)
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", poses.quaternions, q)), 1.0, atol=1e-9)
    np.testing.assert_allclose((poses.stamps_ns - got.imu.stamps_ns[0]) * 1e-9, tau - t[0], atol=2e-6)


@pytest.mark.parametrize("make", CLEAR, ids=lambda make: make.__name__)
def test_a_mapping_is_right(make: Make, tmp_path: Path) -> None:
    for library in ("h5py", "scipy"):
        pytest.importorskip(library)
    path = make(recorded()[1], tmp_path)
    assert_right(read_by(proposal(path), path), shared=make in COMMON)


def choices(proposed: str) -> list[str]:
    """Return the mappings that a proposal leaves open."""
    head, _, rest = proposed.partition("# several are possible: remove the marks before the lines of one\n")
    block = re.match(r"(#.*\n)*", rest)[0]
    return [head + re.sub(r"(?m)^# ", "", one) + rest[len(block) :] for one in re.split(r"(?m)^#\n", block)]


def test_of_two_imus_the_user_chooses(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    path = two_imus(recorded()[1], tmp_path)
    with pytest.raises(UnknownColumnsError, match="choose among its lines") as error:
        load(path)
    open_one = error.value.proposal
    with pytest.raises(RecordingError, match=r"columns\.imu\.rate is missing"):
        read_by(open_one, path)
    left, right = choices(open_one)
    assert_right(read_by(left, path), shared=True)
    assert "acc_x_right, acc_y_right, acc_z_right [m/s^2]" in right


def test_an_estimate_of_the_device_is_no_reference_beside_one(tmp_path: Path) -> None:
    said = proposal(own_estimate(recorded()[1], tmp_path))
    assert "# imu_q0, imu_q1, imu_q2, imu_q3 follow the motion, too" in said


def table(folder: Path, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Path:
    t, w, f, p, q = common(recorded()[1])
    columns = {"t": t} | triad("g{}", w) | triad("a{}", f) | triad("p{}", p)
    (folder / "log.csv").write_text(text(change(columns | {f"q{c}": q[:, k] for k, c in enumerate("wxyz")})))
    return folder / "log.csv"


def test_a_unit_that_the_motion_contradicts_is_open(tmp_path: Path) -> None:
    path = table(tmp_path, lambda c: {("gx [rad/s]" if n == "gx" else n): x / DEG if n[0] == "g" else x
                                      for n, x in c.items()})  # fmt: skip
    stated, seen = choices(proposal(path))
    assert 'rate = "gx, gy, gz"' in stated
    assert 'rate = "gx, gy, gz [deg/s]"' in seen
    assert_right(read_by(seen, path), shared=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c | {"gx": -c["gx"]}, "the rates mirror the rotation"),
        (lambda c: c | {"ax": c["az"], "az": c["ax"]}, "gravity does not stand still"),
    ],
    ids=["sign", "order"],
)
def test_readings_that_the_motion_contradicts_are_open(change: Callable, words: str, tmp_path: Path) -> None:
    path = table(tmp_path, change)
    said = proposal(path)
    assert "# names and motion contradict each other: " in said
    assert words in said
    with pytest.raises(RecordingError, match=r"columns\.imu\.rate is missing"):
        read_by(said, path)


def test_names_that_are_exchanged_are_refused(tmp_path: Path) -> None:
    path = table(tmp_path, lambda c: c | {f"g{a}": c[f"a{a}"] for a in "xyz"} | {f"a{a}": c[f"g{a}"] for a in "xyz"})
    with pytest.raises(RecordingError, match=r"that of gx, gy, gz is: are the names exchanged\?"):
        proposal(path)


def test_the_unit_of_rates_shows_without_poses(tmp_path: Path) -> None:
    """Gravity turns in the axes of the body as the rates say."""
    path = table(tmp_path, lambda c: {n: x / DEG if n[0] == "g" else x for n, x in c.items() if n[0] in "tga"})
    assert 'rate = "gx, gy, gz [deg/s]"' in proposal(path)


def test_poses_of_another_run_are_not_confirmed(tmp_path: Path) -> None:
    def exchanged(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {n: x[::-1].copy() if n[0] in "pq" else x for n, x in c.items()}

    assert "# the motion does not confirm it" in proposal(table(tmp_path, exchanged))


def test_rows_without_a_rate_are_open(tmp_path: Path) -> None:
    path = table(tmp_path, lambda c: {n: x for n, x in c.items() if n != "t"})
    said = proposal(path)
    assert "# no column of time was found: write the rate of the rows, or the column" in said
    assert "time" not in tomllib.loads(said)["columns"]["imu"]


def test_progress_is_told(tmp_path: Path) -> None:
    told: list[tuple[str, float]] = []
    path = table(tmp_path, lambda c: c)
    with pytest.raises(UnknownColumnsError):
        load(path, progress=lambda step, share: told.append((step, share)))
    steps = list(dict.fromkeys(step for step, _ in told))
    assert steps == ["read tables", "find columns", "compare motion", "choose columns"]
    assert all(0.0 <= share <= 1.0 for _, share in told)


@pytest.mark.parametrize(
    ("name", "quantity", "axis", "owner", "unit"),
    [
        ("gx", "rate", "x", (), None), ("px", "position", "x", (), None), ("SENSgyro(1)", "rate", "1", ("sens",), None),
        ("SENSmag(2)", "magnetometer", "2", ("sens",), None), ("GyroX_dps", "rate", "x", (), "deg/s"),
        ("imu2_ax", "acceleration", "x", ("imu2",), None), ("ax_imu2", "acceleration", "x", ("imu2",), None),
        ("angular_velocity.x", "rate", "x", (), None), ("linear_acceleration_z", "acceleration", "z", (), None),
        ("gyro_bias_x", "other", "", (), None), ("gravity_x", "other", "", (), None), ("temp", "other", "", (), None),
        ("q0", "quaternion", "0", (), None), ("mocap_qw", "quaternion", "w", ("mocap",), None),
        ("roll_deg", "angle", "x", (), "deg"), ("A", "angle", "A", (), None), ("r11", "matrix", "11", (), None),
        ("pos_x_mm", "position", "x", (), "mm"), ("TCP_x", "position", "x", ("tcp",), None),
        ("timestamp_us", "time", "", (), "us"), ("packet_counter", "counter", "", (), None),
        ("pose.p(2)", "position", "2", ("pose",), None), ("Feld_X", "", "x", ("feld",), None),
    ],
)  # fmt: skip
def test_names(name: str, quantity: str, axis: str, owner: tuple[str, ...], unit: str | None) -> None:
    found = read_name(name)
    assert (found.quantity, found.axis, found.unit) == (quantity, axis, unit)
    assert found.owner == owner


def log(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    (folder / "log.csv").write_text(text(columns))
    return folder / "log.csv"


def test_two_devices_under_other_names_are_a_choice(tmp_path):
    """Rates of one had been taken with accelerations of the other."""
    t, w, f, p, q = common(recorded()[1])
    columns = {"time": t} | triad("gyro_{}", w) | triad("g{}", w + 0.02) | triad("a{}", f) | triad("acc_{}", f + 0.3)
    columns |= triad("tcp_p{}", p) | {f"tcp_q{c}": x for c, x in zip("wxyz", q.T, strict=True)}
    found = proposal(log(tmp_path, columns))
    assert 'rate = "' not in re.sub("(?m)^#.*", "", found)
    assert {"gyro_x, gyro_y, gyro_z", "gx, gy, gz"} <= set(re.findall(r'# rate = "(.*?) \[', found))


def test_the_devices_own_orientations_are_a_choice_whatever_stands_first(tmp_path):
    t, w, f, p, q = common(recorded()[1])
    columns = {"time": t} | triad("g{}", w) | triad("a{}", f) | {f"quat_{c}": q[:, k] for k, c in enumerate("wxyz")}
    columns |= triad("{}", p) | {f"q{c}": q[:, k] for k, c in enumerate("wxyz")}
    found = proposal(log(tmp_path, columns))
    assert "an estimate of the device itself is no reference" in found
    assert {"quat_w, quat_x, quat_y, quat_z", "qw, qx, qy, qz"} == set(
        re.findall(r'# orientation = "quaternion wxyz: (.*?)"', found)
    )


@pytest.mark.parametrize(
    ("unit", "size", "line"),
    [
        ("[cm/s^2]", 100.0, r'(?m)^acceleration = "ax, ay, az"$'),
        ("[furlong/s^2]", 1.0, r'(?m)^# acceleration = "ax, ay, az \[m/s\^2\]"$'),
        ("", 100.0, r'(?m)^# acceleration = "ax, ay, az \[cm/s\^2\]"$'),
    ],
)
def test_a_stated_unit_is_used_or_named(tmp_path, unit, size, line):
    t, w, f, p, q = common(recorded()[1])
    columns = {"t [s]": t} | {f"g{c} [rad/s]": w[:, k] for k, c in enumerate("xyz")}
    columns |= {f"a{c} {unit}".strip(): size * f[:, k] for k, c in enumerate("xyz")}
    columns |= triad("tcp_p{}", p) | {f"tcp_q{c}": x for c, x in zip("wxyz", q.T, strict=True)}
    found = proposal(log(tmp_path, columns))
    assert re.search(line, found)
    assert ("is no unit of acceleration that is known" in found) is ("furlong" in unit)


def test_an_index_in_brackets_is_no_unit(tmp_path):
    r = recorded()[1]
    t, w, f, p, q = common(r)
    columns = {"timestamp": t} | {f"gyro_rad[{k}]": w[:, k] for k in range(3)}
    columns |= {f"accelerometer_m_s2[{k}]": f[:, k] for k in range(3)}
    columns |= {f"position[{k}]": p[:, k] for k in range(3)} | {f"q[{k}]": q[:, k] for k in range(4)}
    path = log(tmp_path, columns)
    assert_right(read_by(proposal(path), path), shared=True)


def test_a_table_that_cannot_be_read_beside_another_is_named(tmp_path):
    t, w, f, _, _ = common(recorded()[1])
    log(tmp_path, {"time": t} | triad("g{}", w) | triad("a{}", f))
    (tmp_path / "take.csv").write_text("Format Version,1.23\ntime,X,Y,Z\n" + 500 * "0.0,1.0,2.0,3.0,\n")
    (tmp_path / "notes.txt").write_text("the second sensor was loose")
    found = proposal(tmp_path)
    assert "# take.csv: " in found
    assert "notes.txt" not in found
    (tmp_path / "log.csv").write_text((tmp_path / "log.csv").read_text() + "end of log\n")
    with pytest.raises(RecordingError, match="cells, expected"):
        proposal(tmp_path)


def test_a_column_of_text_is_named(tmp_path):
    """One cell had all positions left out without a word."""
    file = table(tmp_path, lambda columns: columns)
    rows = file.read_text().splitlines()
    names = rows[0].split(",")
    k = next(i for i, name in enumerate(names) if read_name(name).quantity == "position")
    cells = rows[5].split(",")
    rows[5] = ",".join([*cells[:k], "ERR", *cells[k + 1 :]])
    file.write_text("\n".join(rows) + "\n")
    name = re.escape(names[k].split(" [")[0])
    assert re.search(rf"# column '{name}' holds text \('ERR' in row 5\): it is not used", proposal(file))


def test_milliseconds_beside_seconds_may_have_digits(tmp_path):
    """The whole seconds alone had been the time of such poses."""
    path = table(tmp_path, lambda c: {"sec": np.floor(c["t"]), "msec": 1e3 * (c["t"] % 1.0) + 1e-4} | {
        name: x for name, x in c.items() if name != "t"})  # fmt: skip
    assert proposal(path).count('time = "sec [s] + msec [ms]"') == 2
