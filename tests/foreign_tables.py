"""Forty recordings as other programs write them, made from one: what each file looks like, and its mapping."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.recording.recording import Recording
from kreisel.units import STANDARD_GRAVITY

DEG = np.pi / 180.0
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Shape:
    """A shape: writes a recording into an empty folder; the mapping, and what is calibrated (a file or the folder)."""

    name: str
    make: Callable[[Recording, Path], None]
    mapping: dict[str, str]
    path: str = "."
    proposed: bool = True


def imu_columns(r: Recording, rate: float = 1.0, force: float = 1.0) -> Columns:
    w, a = r.imu.rates / rate, r.imu.accelerations / force
    return dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), np.hstack([w, a]).T, strict=True))


def euler(q: np.ndarray, sequence: str) -> np.ndarray:
    """Return Euler angles (n, 3) by SciPy, rad."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(q, -1, axis=1)).as_euler(sequence)


def matrices(q: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(q, -1, axis=1)).as_matrix()


def text(columns: Columns, delimiter: str = ",", header: str | None = None, comma: bool = False) -> str:
    """Return columns as text with a header of their names, of another, or (empty) of none."""
    names = delimiter.join(columns) if header is None else header
    rows = []
    for row in zip(*(x.tolist() for x in columns.values()), strict=True):
        cells = ["" if isinstance(x, float) and np.isnan(x) else x if isinstance(x, str) else repr(x) for x in row]
        rows.append(delimiter.join(x.replace(".", ",") if comma else x for x in cells))
    return "\n".join([names, *rows] if names else rows) + "\n"


def pose_columns(r: Recording, length: float = 1.0) -> Columns:
    return dict(zip(("x", "y", "z"), r.reference.positions.T / length, strict=True))


def quaternion_columns(r: Recording, order: str = "wxyz") -> Columns:
    return {f"q{c}": r.reference.quaternions[:, "wxyz".index(c)] for c in order}


def seconds(stamps: np.ndarray) -> np.ndarray:
    return (stamps - 1_000_000_000_000) * 1e-9


def two_files(folder: Path, imu: str, poses: str) -> None:
    for name, content in (("imu.csv", imu), ("poses.csv", poses)):
        (folder / name).write_text(content)


PLAIN = {"imu.file": "imu.csv", "imu.time": "t [s]", "imu.rate": "gx, gy, gz", "imu.acceleration": "ax, ay, az",
         "reference.file": "poses.csv", "reference.time": "t [s]", "reference.position": "x, y, z",
         "reference.orientation": "quaternion wxyz: qw, qx, qy, qz"}  # fmt: skip


def imu_text(r: Recording, **options: object) -> str:
    return text({"t": seconds(r.imu.stamps_ns)} | imu_columns(r), **options)


def pose_text(r: Recording, rotation: Columns | None = None, length: float = 1.0, **options: object) -> str:
    rotation = quaternion_columns(r) if rotation is None else rotation
    return text({"t": seconds(r.reference.stamps_ns)} | pose_columns(r, length) | rotation, **options)


def plain(r: Recording, folder: Path) -> None:
    two_files(folder, imu_text(r), pose_text(r))


def units(rate: float, force: float, length: float) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        imu = text({"t": seconds(r.imu.stamps_ns)} | imu_columns(r, rate, force))
        two_files(folder, imu, pose_text(r, length=length))

    return make


def delimited(delimiter: str, comma: bool = False) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        options = {"delimiter": delimiter, "comma": comma}
        two_files(folder, imu_text(r, **options), pose_text(r, **options))

    return make


def timed(factor: float, whole: bool = True) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        t, tau = ((x / factor if not whole else np.round(x / factor).astype(np.int64))
                  for x in (r.imu.stamps_ns, r.reference.stamps_ns))  # fmt: skip
        imu = text({"t": t} | imu_columns(r))
        two_files(folder, imu, text({"t": tau} | pose_columns(r) | quaternion_columns(r)))

    return make


def rotated(make_rotation: Callable[[np.ndarray], Columns]) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        two_files(folder, imu_text(r), pose_text(r, make_rotation(r.reference.quaternions)))

    return make


def angles(sequence: str, size: float = DEG, names: str = "abc") -> Callable[[np.ndarray], Columns]:
    return lambda q: dict(zip(names, euler(q, sequence).T / size, strict=True))


def rotation_vectors(q: np.ndarray) -> Columns:
    from scipy.spatial.transform import Rotation

    return dict(zip(("rx", "ry", "rz"), Rotation.from_quat(np.roll(q, -1, axis=1)).as_rotvec().T, strict=True))


def rows_of_matrices(q: np.ndarray) -> Columns:
    return {f"r{k // 3 + 1}{k % 3 + 1}": x for k, x in enumerate(matrices(q).reshape(-1, 9).T)}


def pose_matrices(size: int) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        T = np.tile(np.eye(4), (len(r.reference.positions), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = matrices(r.reference.quaternions), r.reference.positions
        columns = {f"m{k}": x for k, x in enumerate(T.reshape(-1, 16)[:, :size].T)}
        two_files(folder, imu_text(r), text({"t": seconds(r.reference.stamps_ns)} | columns))

    return make


def one_file(r: Recording, folder: Path, held: bool = False) -> None:
    """One log at the IMU's rate: poses in the rows in which one arrives, or repeated until the next."""
    t, tau = r.imu.stamps_ns, r.reference.stamps_ns
    columns = {"t": seconds(t)} | imu_columns(r)
    both = pose_columns(r) | quaternion_columns(r)
    if held:
        last = np.searchsorted(tau, t, side="right") - 1
        inside = last >= 0
        columns = {n: x[inside] for n, x in columns.items()}
        columns |= {"tp": seconds(tau)[last[inside]]} | {n: x[last[inside]] for n, x in both.items()}
    else:
        at = np.searchsorted(t, tau)
        at, first = np.unique(at[at < t.size], return_index=True)
        for name, x in ({"tp": seconds(tau)} | both).items():
            column = np.full(t.size, np.nan)
            column[at] = x[first]
            columns[name] = column
    (folder / "log.csv").write_text(text(columns))


def merged(r: Recording, folder: Path) -> None:
    """Rows of either kind in the order of time, each with its own cells only."""
    t = np.append(r.imu.stamps_ns, r.reference.stamps_ns)
    order, n = np.argsort(t, kind="stable"), r.imu.stamps_ns.size
    columns = {"t": seconds(t)[order]}
    for name, x in imu_columns(r).items():
        columns[name] = np.append(x, np.full(t.size - n, np.nan))[order]
    for name, x in (pose_columns(r) | quaternion_columns(r)).items():
        columns[name] = np.append(np.full(n, np.nan), x)[order]
    (folder / "log.csv").write_text(text(columns))


def headerless(r: Recording, folder: Path) -> None:
    two_files(folder, imu_text(r, header=""), pose_text(r, header=""))


def packed(r: Recording, folder: Path) -> None:
    for name, content in (("imu.csv.gz", imu_text(r)), ("poses.csv.gz", pose_text(r))):
        (folder / name).write_bytes(gzip.compress(content.encode(), 1))


def commented(r: Recording, folder: Path) -> None:
    above = "% logger 1.7\n% site: hall 3\n"
    two_files(folder, above + "% " + imu_text(r), above + "% " + pose_text(r))


def units_row(r: Recording, folder: Path) -> None:
    imu = "t,gx,gy,gz,ax,ay,az\ns,deg/s,deg/s,deg/s,g,g,g\n"
    poses = "t,x,y,z,qw,qx,qy,qz\ns,mm,mm,mm,-,-,-,-\n"
    columns = {"t": seconds(r.imu.stamps_ns)} | imu_columns(r, DEG, STANDARD_GRAVITY)
    two_files(folder, imu + text(columns, header=""), poses + pose_text(r, length=1e-3, header=""))


def units_in_header(r: Recording, folder: Path) -> None:
    columns = {"t": seconds(r.imu.stamps_ns)} | imu_columns(r, DEG, STANDARD_GRAVITY)
    header = "Time (s),Gyro X (deg/s),Gyro Y (deg/s),Gyro Z (deg/s),Acc X (g),Acc Y (g),Acc Z (g)"
    poses = "Time (s),Pos X (mm),Pos Y (mm),Pos Z (mm),QW,QX,QY,QZ"
    two_files(folder, text(columns, header=header), pose_text(r, length=1e-3, header=poses))


def other_order(r: Recording, folder: Path) -> None:
    c = imu_columns(r)
    columns = {n: c[n] for n in ("ax", "ay", "az", "gx", "gy", "gz")}
    columns["mag_x"] = 40.0 + 0.0 * c["ax"] + np.sin(np.arange(c["ax"].size))
    columns["t"] = seconds(r.imu.stamps_ns)
    poses = quaternion_columns(r) | pose_columns(r) | {"t": seconds(r.reference.stamps_ns)}
    two_files(folder, text(columns), text(poses))


def reversed_axes(r: Recording, folder: Path) -> None:
    c = imu_columns(r)
    columns = {"t": seconds(r.imu.stamps_ns)} | {n: -x if n[1] in "yz" else x for n, x in c.items()}
    two_files(folder, text(columns), pose_text(r))


def ticks(r: Recording, folder: Path) -> None:
    count = np.round(seconds(r.imu.stamps_ns) * 32768.0).astype(np.int64)
    two_files(folder, text({"tick": count} | imu_columns(r)), pose_text(r))


def no_time(r: Recording, folder: Path) -> None:
    two_files(folder, text(imu_columns(r)), pose_text(r))


def two_time_columns(r: Recording, folder: Path) -> None:
    t = r.imu.stamps_ns
    columns = {"sec": t // 10**9, "nsec": t % 10**9} | imu_columns(r)
    two_files(folder, text(columns), pose_text(r))


def dates(only_time: bool) -> Callable[[Recording, Path], None]:
    def make(r: Recording, folder: Path) -> None:
        start = np.datetime64("2026-05-01T23:59:50", "ns")

        def written(stamps: np.ndarray) -> np.ndarray:
            moments = np.datetime_as_string(start + (stamps - 1_000_000_000_000).astype("timedelta64[ns]"))
            return np.array([m.split("T")[1] if only_time else m.replace("T", " ").replace("-", "/") for m in moments])

        imu = text({"utc": written(r.imu.stamps_ns)} | imu_columns(r))
        two_files(folder, imu, text({"utc": written(r.reference.stamps_ns)} | pose_columns(r) | quaternion_columns(r)))

    return make


def matlab(r: Recording, folder: Path) -> None:
    from scipy.io import savemat

    savemat(folder / "run.mat", {
        "imu": {"t": seconds(r.imu.stamps_ns), "gyro": r.imu.rates, "acc": r.imu.accelerations},
        "pose": {"t": seconds(r.reference.stamps_ns), "p": r.reference.positions, "q": r.reference.quaternions},
    })  # fmt: skip


def matlab_73(r: Recording, folder: Path) -> None:
    import h5py

    with h5py.File(folder / "run.mat", "w") as file:
        imu = (("t", seconds(r.imu.stamps_ns)[None]), ("gyro", r.imu.rates.T), ("acc", r.imu.accelerations.T))
        for name, values in imu:
            file[f"imu/{name}"] = values
        for name, values in (("t", seconds(r.reference.stamps_ns)[None]), ("p", r.reference.positions.T),
                             ("q", r.reference.quaternions.T)):  # fmt: skip
            file[f"pose/{name}"] = values


def parquet(r: Recording, folder: Path) -> None:
    import pyarrow
    from pyarrow import parquet as writer

    imu = {"t": r.imu.stamps_ns} | imu_columns(r)
    poses = {"t": r.reference.stamps_ns} | pose_columns(r) | quaternion_columns(r)
    for name, columns in (("imu", imu), ("poses", poses)):
        writer.write_table(pyarrow.table(columns), folder / f"{name}.parquet")


def euroc_names(r: Recording, folder: Path) -> None:
    """Our own headers, but other file names."""
    imu = text(
        {"t": r.imu.stamps_ns} | imu_columns(r), header="#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
    )
    poses = {"t": r.reference.stamps_ns} | pose_columns(r) | quaternion_columns(r)
    two_files(folder, imu, text(poses, header="#timestamp [ns],p_x [m],p_y,p_z,q_w [],q_x,q_y,q_z"))


def with_gaps_and_tail(r: Recording, folder: Path) -> None:
    """Windows line ends, and a last line that was cut."""
    imu = imu_text(r).replace("\n", "\r\n")
    (folder / "imu.csv").write_bytes((imu + "41.0,0.1,0.2").encode())
    (folder / "poses.csv").write_text(pose_text(r))


def orientation_file(r: Recording, folder: Path) -> None:
    poses = {"t": seconds(r.reference.stamps_ns)} | quaternion_columns(r, "xyzw")
    two_files(folder, imu_text(r), text(poses))


def _with(**changed: str) -> dict[str, str]:
    return PLAIN | {key.replace("__", "."): value for key, value in changed.items()}


def _files(imu: str, poses: str) -> dict[str, str]:
    return _with(imu__file=imu, reference__file=poses)


LOG = {k: v for k, v in PLAIN.items() if not k.endswith("file")} | {"reference.time": "tp [s]"}
MAT = {"imu.time": "imu.t [s]", "imu.rate": "imu.gyro(1), imu.gyro(2), imu.gyro(3)",
       "imu.acceleration": "imu.acc(1), imu.acc(2), imu.acc(3)", "reference.time": "pose.t [s]",
       "reference.position": "pose.p(1), pose.p(2), pose.p(3)",
       "reference.orientation": "quaternion wxyz: pose.q(1), pose.q(2), pose.q(3), pose.q(4)"}  # fmt: skip
NUMBERED = _with(imu__time="#1 [s]", imu__rate="#2-4", imu__acceleration="#5-7", reference__time="#1 [s]",
                 reference__position="#2-4", reference__orientation="quaternion wxyz: #5-8")  # fmt: skip


def _rotation(value: str) -> dict[str, str]:
    return _with(reference__orientation=value)


SHAPES = (
    Shape("plain", plain, PLAIN),
    Shape("degrees and g", units(DEG, STANDARD_GRAVITY, 1e-3), _with(
        imu__rate="gx, gy, gz [deg/s]", imu__acceleration="ax, ay, az [g]", reference__position="x, y, z [mm]")),
    Shape("millidegrees and mg", units(1e-3 * DEG, 1e-3 * STANDARD_GRAVITY, 1.0), _with(
        imu__rate="gx, gy, gz [mdps]", imu__acceleration="ax, ay, az [mg]")),
    Shape("degrees per second alone", units(DEG, 1.0, 1.0), _with(imu__rate="gx [deg/s], gy, gz")),
    Shape("semicolons", delimited(";"), PLAIN),
    Shape("semicolons and decimal commas", delimited(";", comma=True), PLAIN),
    Shape("tabs", delimited("\t"), PLAIN),
    Shape("blanks", delimited(" "), PLAIN),
    Shape("tabs and decimal commas", delimited("\t", comma=True), PLAIN),
    Shape("milliseconds", timed(1e6, whole=False), _with(imu__time="t [ms]", reference__time="t [ms]")),
    Shape("microseconds", timed(1e3), _with(imu__time="t [us]", reference__time="t [us]")),
    Shape("nanoseconds", timed(1.0), _with(imu__time="t [ns]", reference__time="t [ns]")),
    Shape("ticks", ticks, _with(imu__time="tick [32768 Hz]"), proposed=False),
    Shape("counted rows", no_time, _with(imu__time="100 Hz"), proposed=False),
    Shape("seconds and nanoseconds", two_time_columns, _with(imu__time="sec [s] + nsec [ns]"), proposed=False),
    Shape("dates", dates(False), _with(imu__time="utc [date]", reference__time="utc [date]")),
    Shape("times of the day past midnight", dates(True), _with(imu__time="utc [date]", reference__time="utc [date]")),
    Shape("scalar last", rotated(lambda q: {f"q{c}": q[:, "wxyz".index(c)] for c in "xyzw"}),
          _rotation("quaternion xyzw: qx, qy, qz, qw")),
    Shape("quaternions without names", rotated(lambda q: {f"c{k}": q[:, (k + 1) % 4] for k in range(4)}),
          _rotation("quaternion xyzw: c0, c1, c2, c3")),
    Shape("KUKA", rotated(angles("ZYX", names="ABC")), _rotation("kuka abc: A, B, C [deg]")),
    Shape("Euler XYZ, degrees", rotated(angles("XYZ")), _rotation("euler XYZ: a, b, c [deg]")),
    Shape("Euler xyz, radians", rotated(angles("xyz", 1.0)), _rotation("euler xyz: a, b, c [rad]")),
    Shape("Euler ZXY, degrees", rotated(angles("ZXY")), _rotation("euler ZXY: a, b, c [deg]")),
    Shape("Euler ZYZ, degrees", rotated(angles("ZYZ")), _rotation("euler ZYZ: a, b, c [deg]")),
    Shape("Euler zxz, degrees", rotated(angles("zxz")), _rotation("euler zxz: a, b, c [deg]"), proposed=False),
    Shape("rotation vector", rotated(rotation_vectors), _rotation("rotation vector: rx, ry, rz [rad]")),
    Shape("matrix", rotated(rows_of_matrices), _rotation("matrix: r11, r12, r13, r21, r22, r23, r31, r32, r33")),
    Shape("pose matrix 4x4", pose_matrices(16), {k: v for k, v in PLAIN.items() if k != "reference.position"} | {
        "reference.orientation": "pose matrix: #2-17"}),
    Shape("pose matrix 3x4", pose_matrices(12), {k: v for k, v in PLAIN.items() if k != "reference.position"} | {
        "reference.orientation": "pose matrix: #2-13"}),
    Shape("one log, poses now and then", one_file, LOG, "log.csv"),
    Shape("one log, poses held", lambda r, f: one_file(r, f, held=True), LOG, "log.csv"),
    Shape("one log, merged rows", merged, LOG | {"reference.time": "t [s]"}, "log.csv"),
    Shape("no header", headerless, NUMBERED),
    Shape("gzip", packed, _files("imu.csv.gz", "poses.csv.gz")),
    Shape("comments above", commented, PLAIN),
    Shape("units in a row", units_row, PLAIN),
    Shape("units in parentheses", units_in_header, _with(
        imu__time="Time", imu__rate="Gyro X, Gyro Y, Gyro Z", imu__acceleration="Acc X, Acc Y, Acc Z",
        reference__time="Time", reference__position="Pos X, Pos Y, Pos Z",
        reference__orientation="quaternion wxyz: QW, QX, QY, QZ")),
    Shape("other order", other_order, PLAIN),
    Shape("signs", reversed_axes, _with(imu__rate="gx, -gy, -gz", imu__acceleration="ax, -ay, -az"), proposed=False),
    Shape("MATLAB", matlab, MAT, "run.mat"),
    Shape("MATLAB 7.3", matlab_73, MAT, "run.mat"),
    Shape("Parquet", parquet, _files("imu.parquet", "poses.parquet") | {
        "imu.time": "t [ns]", "reference.time": "t [ns]"}),
    Shape("our headers", euroc_names, _with(
        imu__time="timestamp", imu__rate="w_x, w_y, w_z", imu__acceleration="a_x, a_y, a_z",
        reference__time="timestamp", reference__position="p_x, p_y, p_z",
        reference__orientation="quaternion wxyz: q_w, q_x, q_y, q_z")),
    Shape("cut last line", with_gaps_and_tail, PLAIN),
    Shape("orientations alone", orientation_file, {k: v for k, v in PLAIN.items() if k != "reference.position"} | {
        "reference.orientation": "quaternion xyzw: qx, qy, qz, qw"}),
)  # fmt: skip
