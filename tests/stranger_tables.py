"""Recordings as loggers of other people write them, each in a shape that names, units or structure must explain."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kreisel.recording.recording import Recording
from kreisel.units import STANDARD_GRAVITY

from .foreign_tables import DEG, euler, matrices, seconds, text

Columns = dict[str, np.ndarray]


def common(r: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return time, rates, accelerations, positions and quaternions in rows of one table, at the moments of the IMU."""
    from scipy.spatial.transform import Rotation, Slerp

    tau, t = seconds(r.reference.stamps_ns), seconds(r.imu.stamps_ns)
    keep = (t > tau[0]) & (t < tau[-1])
    turned = Slerp(tau, Rotation.from_quat(np.roll(r.reference.quaternions, -1, axis=1)))(t[keep])
    p = np.column_stack([np.interp(t[keep], tau, x) for x in r.reference.positions.T])
    return t[keep], r.imu.rates[keep], r.imu.accelerations[keep], p, np.roll(turned.as_quat(), 1, axis=1)


def triad(name: str, values: np.ndarray, axes: str = "xyz", order: str = "xyz") -> Columns:
    """Return columns named by a pattern with {} for the axis, in an order."""
    return {name.format(axes["xyz".index(a)]): values[:, "xyz".index(a)] for a in order}


def magnetic(q: np.ndarray) -> np.ndarray:
    return np.einsum("nji,j->ni", matrices(q), [20.0, 3.0, -42.0])


def one_table(r: Recording, folder: Path) -> Path:
    """gx and px, but not in the mapping of each other."""
    t, w, f, p, q = common(r)
    columns = {"t": t} | triad("g{}", w / DEG) | triad("a{}", f / STANDARD_GRAVITY) | triad("p{}", p)
    (folder / "log.csv").write_text(text(columns | {f"q{c}": q[:, k] for k, c in enumerate("wxyz")}))
    return folder / "log.csv"


def matlab_rate(r: Recording, folder: Path) -> Path:
    """Variables with a prefix, a magnetometer among them, and a rate instead of times."""
    from scipy.io import savemat

    _, w, f, p, q = common(r)
    sensor = {"SENSmag": magnetic(q), "SENSgyro": w, "SENSacc": f}
    optical = {"OPTquat": np.roll(q, -1, axis=1), "OPTpos": p}
    savemat(folder / "trial.mat", sensor | optical | {"sampling_rate": 100.0})
    return folder / "trial.mat"


def seventy_columns(r: Recording, folder: Path) -> Path:
    t, w, f, p, q = common(r)
    rng = np.random.default_rng(7)
    columns = {"Time (ms)": 1e3 * t}
    for owner, moved in (("flange", 1.0), ("floor", 0.0)):
        still = 0.577 + rng.normal(0.0, 1e-3, f.shape)
        columns |= triad(owner + "_Acc_{}", f / STANDARD_GRAVITY if moved else still, "XYZ")
        columns |= triad(owner + "_Gyr_{}", moved * w / DEG + (1.0 - moved) * rng.normal(0.0, 0.1, w.shape), "XYZ")
        columns |= triad(owner + "_Mag_{}", magnetic(q) + rng.normal(0.0, 0.1, w.shape), "XYZ")
        columns[f"{owner}_Temp"] = 30.0 + 0.01 * t
    for body, moved in (("tool", 1.0), ("table", 0.0)):
        columns |= triad(
            f"RigidBody_{body}" + "_Pos_{}", 1e3 * p if moved else 900.0 + rng.normal(0.0, 1e-3, p.shape), "XYZ"
        )
        turned = q if moved else np.array([1.0, 0.0, 0.0, 0.0]) + rng.normal(0.0, 1e-4, q.shape)
        columns |= {f"RigidBody_{body}_Rot_{c}": turned[:, "WXYZ".index(c)] for c in "XYZW"}
        columns[f"RigidBody_{body}_MeanError"] = rng.uniform(0.0, 0.5, t.size)
    for m in range(10):
        columns |= triad(f"Marker{m}" + "_{}", 1e3 * (p + 0.01 * m), "XYZ")
    while len(columns) < 70:
        columns[f"aux{len(columns)}"] = rng.normal(size=t.size)
    (folder / "wide.tsv").write_text(text(columns, "\t"))
    return folder / "wide.tsv"


def stacked_matrices(r: Recording, folder: Path) -> Path:
    """MATLAB 7.3 stores its arrays the other way round: 3 x 3 x n matrices."""
    import h5py

    with h5py.File(folder / "run.mat", "w") as file:
        file["imu/stamp_us"] = np.round((r.imu.stamps_ns - r.imu.stamps_ns[0]) / 1e3)[None]
        file["imu/omega"], file["imu/specificForce"] = r.imu.rates.T, r.imu.accelerations.T
        file["truth/stamp_us"] = np.round((r.reference.stamps_ns - r.imu.stamps_ns[0]) / 1e3)[None]
        file["truth/Rot"] = np.swapaxes(matrices(r.reference.quaternions), 1, 2)
        file["truth/trans"] = r.reference.positions.T
    return folder / "run.mat"


def two_imus(r: Recording, folder: Path) -> Path:
    """Two IMUs on one body, axes in a mixed order: which one is meant, only the user knows."""
    import pyarrow
    from pyarrow import parquet

    t, w, f, p, q = common(r)
    C = matrices(np.array([[0.8, 0.36, -0.48, 0.0]]))[0]
    columns: Columns = {"epoch_ns": (1.7e18 + 1e9 * t).astype(np.int64)}
    for side, (rates, forces) in (("left", (w, f)), ("right", (w @ C.T, f @ C.T))):
        columns |= triad("acc_{}_" + side, forces, order="zxy")
        columns |= triad("gyro_{}_" + side + "_dps", rates / DEG, order="yzx")
    columns |= {f"ref_q{c}": q[:, "wxyz".index(c)] for c in "xyzw"} | triad("ref_{}", p)
    parquet.write_table(pyarrow.table(columns), folder / "two.parquet")
    return folder / "two.parquet"


def no_header(r: Recording, folder: Path) -> Path:
    """Quaternions first, the time last, nothing named."""
    t, w, f, p, q = common(r)
    numbers = np.column_stack([np.roll(q, -1, axis=1), f, w / DEG, p, t])
    (folder / "raw.txt").write_text(text({str(k): x for k, x in enumerate(numbers.T)}, " ", header=""))
    return folder / "raw.txt"


def german(r: Recording, folder: Path) -> Path:
    """Date and time in two columns, over midnight; decimal commas; roll, pitch and yaw."""
    start = np.datetime64("2026-03-14T23:59:40", "ns")

    def when(stamps: np.ndarray) -> Columns:
        moments = np.datetime_as_string(start + (stamps - r.imu.stamps_ns[0]).astype("timedelta64[ns]"), unit="us")
        return {"Datum": np.array([".".join(m[:10].split("-")[::-1]) for m in moments]),
                "Uhrzeit": np.array([m[11:] for m in moments])}  # fmt: skip

    imu = triad("Beschl_{}", r.imu.accelerations, "XYZ") | triad("Drehrate_{} (°/s)", r.imu.rates / DEG, "XYZ")
    (folder / "imu.csv").write_text(text(when(r.imu.stamps_ns) | imu, ";", comma=True))
    angles = euler(r.reference.quaternions, "ZYX") / DEG
    poses = {"Roll": angles[:, 2], "Pitch": angles[:, 1], "Yaw": angles[:, 0]}
    poses |= triad("Pos_{}", r.reference.positions, "XYZ")
    (folder / "pose.csv").write_text(text(when(r.reference.stamps_ns) | poses, ";", comma=True))
    return folder


def interleaved(r: Recording, folder: Path) -> Path:
    """Axes of three sensors in turn, a packet number; a KUKA's poses."""
    columns = {"packet": np.arange(r.imu.stamps_ns.size), "t_us": (r.imu.stamps_ns - r.imu.stamps_ns[0]) // 1000}
    field = 40.0 + np.sin(0.01 * np.arange(r.imu.stamps_ns.size))
    for k, axis in enumerate("xyz"):
        columns |= {f"accel_{axis}": r.imu.accelerations[:, k], f"mag_{axis}": field, f"gyro_{axis}": r.imu.rates[:, k]}
    (folder / "sensor.tsv").write_text(text(columns, "\t"))
    angles = euler(r.reference.quaternions, "ZYX") / DEG
    poses = {"IPOC": (r.reference.stamps_ns - r.imu.stamps_ns[0]) * 1e-6}
    poses |= triad("{}", 1e3 * r.reference.positions, "XYZ") | dict(zip("ABC", angles.T, strict=True))
    (folder / "robot.csv").write_text(text(poses))
    return folder


def own_estimate(r: Recording, folder: Path) -> Path:
    """The sensor's own attitude beside that of a Vicon, and the time of the PC beside that of the sensor."""
    t, w, f, p, q = common(r)
    rng = np.random.default_rng(3)
    columns = {"host_time": t + 1e3 + rng.uniform(0.0, 2e-3, t.size), "time": t}
    columns |= triad("imu_gyr_{}", w) | triad("imu_acc_{}", f) | {f"imu_q{k}": x for k, x in enumerate(q.T)}
    columns |= {f"vicon_rot_{c}": q[:, "wxyz".index(c)] for c in "xyzw"} | triad("vicon_trans_{}", 1e3 * p)
    (folder / "ahrs.csv").write_text(text(columns))
    return folder / "ahrs.csv"


def one_matrix(r: Recording, folder: Path) -> Path:
    """All in one array without names."""
    from scipy.io import savemat

    t, w, f, p, q = common(r)
    savemat(folder / "m.mat", {"data": np.column_stack([t, w / DEG, f / STANDARD_GRAVITY, 1e3 * p, q])})
    return folder / "m.mat"


def robot_log(r: Recording, folder: Path) -> Path:
    """Joint angles and wrench of a UR beside its pose: position and rotation vector in six numbers."""
    from scipy.spatial.transform import Rotation

    t, w, f, p, q = common(r)
    rng = np.random.default_rng(5)
    columns: Columns = {"timestamp": t}
    columns |= {f"actual_q_{k}": np.sin(0.1 * (k + 1) * t) for k in range(6)}
    pose = np.hstack([p, Rotation.from_quat(np.roll(q, -1, axis=1)).as_rotvec()])
    columns |= {f"actual_TCP_pose_{k}": x for k, x in enumerate(pose.T)}
    columns |= {f"actual_TCP_force_{k}": rng.normal(3.0 * (k == 2), 1.0, t.size) for k in range(6)}
    columns |= triad("AngularVelocity{}", w, "XYZ") | triad("LinearAcceleration{}", f, "XYZ")
    (folder / "ur.csv").write_text(text(columns))
    return folder / "ur.csv"


def given_the_other_way(r: Recording, folder: Path) -> Path:
    """Quaternions of the reference against the body, as some define an attitude; mg and mdps; ROS's stamps."""
    t, w, f, p, q = common(r)
    ns = np.round(1e9 * (t - t[0])).astype(np.int64) + 1_600_000_000 * 10**9
    other = q * [1.0, -1.0, -1.0, -1.0]
    columns = {"stamp.secs": ns // 10**9, "stamp.nsecs": ns % 10**9}
    columns |= {f"orientation.{c}": other[:, "wxyz".index(c)] for c in "xyzw"}
    columns |= triad("angular_velocity.{}", 1e3 * w / DEG) | triad("linear_acceleration.{}", 1e3 * f / STANDARD_GRAVITY)
    (folder / "bag.txt").write_text(text(columns | triad("pose.position.{}", p), " "))
    return folder / "bag.txt"


CLEAR = (one_table, matlab_rate, seventy_columns, stacked_matrices, no_header, german, interleaved, own_estimate,
         one_matrix, robot_log, given_the_other_way)  # fmt: skip
COMMON = {one_table, matlab_rate, seventy_columns, no_header, own_estimate, one_matrix, robot_log, given_the_other_way}
"""Those with both streams in the same rows."""
