"""Small files that stand for much: what they say is refused before the memory for it is taken."""

import struct
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import MCAP0_MAGIC, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError, RobotError
from kreisel.formats.bag import load_bag
from kreisel.formats.bag_messages import WANTED
from kreisel.formats.bounds import chunk_content, unbz2, unlz4, unzstd
from kreisel.formats.budget import MAX_CHUNK, Budget, TooLargeError
from kreisel.formats.csv_table import read_table
from kreisel.formats.diadem import read_diadem
from kreisel.formats.folder import load_folder
from kreisel.formats.kuka_trace import read_trace
from kreisel.formats.mcap import read_mcap
from kreisel.formats.robot_description import description_beside
from kreisel.formats.sheet import read_sheet
from kreisel.recording.recording_settings import RecordingSettings, read_settings
from kreisel.robot.kinematics import load_arm

MIB = 1 << 20
BOMB = 400 * MIB
"""Zeros that the files below stand for."""


@contextmanager
def memory(most: int) -> Iterator[None]:
    """Fail if more than so many bytes are taken at a time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def zstd_bomb(*, sized: bool) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=BOMB if sized else -1)
    return b"".join([*(packer.compress(bytes(MIB)) for _ in range(BOMB // MIB)), packer.flush()])


def lz4_bomb() -> bytes:
    with lz4.frame.LZ4FrameCompressor() as packer:
        return b"".join(
            [packer.begin(BOMB), *(packer.compress(bytes(MIB)) for _ in range(BOMB // MIB)), packer.flush()]
        )


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data: bytes, compression: str, size: int) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, size, 0, len(name)) + name + struct.pack("<Q", len(data))
    return record(0x06, head + data)


@pytest.mark.parametrize("stated", [BOMB, 1000, MAX_CHUNK, 2**62])
@pytest.mark.parametrize("kind", ["zstd", "zstd without size", "lz4"])
def test_a_chunk_that_stands_for_much_is_left_out(tmp_path: Path, kind: str, stated: int) -> None:
    data = lz4_bomb() if kind == "lz4" else zstd_bomb(sized=kind == "zstd")
    file = tmp_path / "bomb.mcap"
    file.write_bytes(MCAP0_MAGIC + chunk(data, kind.split()[0], stated) + record(0x02, bytes(20)))
    with memory(200 * MIB):
        got = read_mcap(file, WANTED)
    assert "the chunk at byte 8 is damaged" in got.warnings[0].message
    assert "bytes" in got.warnings[0].message


def test_what_is_as_large_as_it_says_is_read() -> None:
    content = bytes(range(256)) * 100
    for compression, packed in (
        ("zstd", zstandard.compress(content)), ("lz4", lz4.frame.compress(content)), ("", content)
    ):  # fmt: skip
        assert chunk_content(packed, compression, len(content), 0) == content
        with pytest.raises(TooLargeError):
            chunk_content(packed, compression, len(content) - 1, 0)
        with pytest.raises(ValueError, match="25600 bytes, expected 25601"):
            chunk_content(packed, compression, len(content) + 1, 0)
        with pytest.raises(ValueError, match="checksum"):
            chunk_content(packed, compression, len(content), 1)
    with pytest.raises(ValueError, match="compressed by 'rar'"):
        chunk_content(content, "rar", len(content), 0)


@pytest.mark.parametrize("unpack", [unzstd, unlz4, unbz2])
def test_garbage_is_no_chunk(unpack) -> None:
    with pytest.raises((ValueError, OSError, RuntimeError, zstandard.ZstdError)):
        unpack(b"garbage" * 10)


def test_messages_that_are_more_than_their_file_can_hold_are_left_out(tmp_path: Path) -> None:
    file = tmp_path / "many.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=4 * MIB)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        for k in range(300):
            writer.add_message(channel, k, bytes(MIB), k)
        writer.finish()
    assert file.stat().st_size < MIB
    with memory(200 * MIB):
        got = read_mcap(file, WANTED)
    assert "over 100 times the file: more than real ones" in got.warnings[0].message
    assert 40 < len(got.topics[0].payloads) < 150


def text(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


DEFINITIONS = {
    "schema": lambda k, size: record(0x03, struct.pack("<H", k + 1) + text(b"x/y") + text(b"") + text(bytes(size))),
    "channel": lambda k, size: record(
        0x04, struct.pack("<HH", k, 0) + text(b"/t") + text(b"cdr") + text(text(b"k") + text(bytes(size)))
    ),
    "metadata": lambda k, size: record(0x0C, text(b"kreisel") + text(text(b"k%d" % k) + text(bytes(size)))),
}


@pytest.mark.parametrize("size", [3 * MIB, pytest.param(60 * MIB, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", DEFINITIONS)
def test_definitions_that_stand_for_much_are_left_out(tmp_path: Path, kind: str, size: int) -> None:
    file = tmp_path / "bomb.mcap"
    with file.open("wb") as stream:
        stream.write(MCAP0_MAGIC)
        for k in range(max(3, 600 * MIB // size)):
            inner = DEFINITIONS[kind](k, size)
            stream.write(chunk(zstandard.compress(inner), "zstd", len(inner)))
        stream.write(record(0x02, bytes(20)))
    assert file.stat().st_size < MIB
    with memory(300 * MIB):
        got = read_mcap(file, WANTED)
    assert "is damaged" in got.warnings[0].message
    assert ("over 100 times" if size == 3 * MIB else "the most kreisel reads at once") in got.warnings[0].message


def test_many_small_messages_count_with_what_python_takes() -> None:
    budget, most = Budget(0), MAX_CHUNK // 128
    for _ in range(most):
        budget.take(0)
    with pytest.raises(TooLargeError):
        budget.take(0)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_chunk_of_a_ros_1_bag_that_stands_for_much_is_refused(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "bomb.bag"
    writer = Ros1Writer(path)
    writer.set_compression(getattr(Ros1Writer.CompressionFormat, compression.upper()))
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=get_typestore(Stores.ROS1_NOETIC))
        writer.write(connection, 1, bytes(BOMB // 2))
    assert path.stat().st_size < 2 * MIB
    with memory(150 * MIB), pytest.raises(RecordingError, match=f"more than {MAX_CHUNK} bytes"):
        load_bag(path)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_a_compressed_ros_2_bag_that_stands_for_much_is_refused(
    tmp_path: Path, mode: CompressionMode, plugin: StoragePlugin
) -> None:
    writer = Ros2Writer(tmp_path / "run", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        writer.write(connection, 1, bytes(BOMB // 2))
    assert sum(file.stat().st_size for file in (tmp_path / "run").iterdir()) < MIB
    with memory(150 * MIB), pytest.raises(RecordingError, match="more than|becomes"):
        load_bag(tmp_path / "run")


@pytest.mark.parametrize(
    ("start", "part", "end", "said"),
    [
        (b"t", b",x", b"\n", "line 1: a line of more than 65536 bytes"),
        (b"", b"x", b"", "line 1: a line of more than 65536 bytes"),
        (b"t,x\n1,2\n", b"1,", b"\n", "line 3: a line of more than 65536 bytes"),
        (b"t,x\r\n1,2\r\n", b"# ", b"\r\n2,2\r\n", "line 3: a line of more than 65536 bytes"),
    ],
)
def test_a_table_whose_line_does_not_end_is_refused(
    tmp_path: Path, start: bytes, part: bytes, end: bytes, said: str
) -> None:
    file = tmp_path / "data.csv"
    with file.open("wb") as stream:
        stream.write(start)
        for _ in range(64):
            stream.write(part * (MIB // len(part)))
        stream.write(end)
    with memory(60 * MIB), pytest.raises(RecordingError, match=said):
        read_table(file, "numbers")


def test_a_table_of_too_many_columns_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "data.csv"
    file.write_text(f"t{999 * ',x'}\n1{999 * ',2'}\n")
    assert read_table(file, "numbers").values.shape == (1, 1000)
    file.write_text(f"t{1000 * ',x'}\n1{1000 * ',2'}\n")
    with pytest.raises(RecordingError, match="line 1: 1001 columns, expected 1000 at most"):
        read_table(file, "numbers")


def test_lines_as_long_as_may_be_are_read_wherever_blocks_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "data.csv"
    rows = [f"{k},{'0' * (65_000 + 10 * k)}1" for k in range(1, 40)]
    file.write_text("\n".join(["t,x", *rows, ""]))
    for block in (1000, 65_536, 100_001, 1 << 23):
        monkeypatch.setattr("kreisel.formats.csv_table._BLOCK", block)
        assert read_table(file, "numbers").stamps_ns.size == 39


def large(file: Path, size: int) -> Path:
    """Write a file that says to be of a size, without taking it."""
    with file.open("wb") as stream:
        stream.truncate(size)
    return file


def test_small_files_that_are_large_are_not_read(tmp_path: Path) -> None:
    said = "longer than"
    with memory(80 * MIB):
        with pytest.raises(RecordingError, match=said):
            read_settings(large(tmp_path / "recording.toml", 4096 * MIB))
        with pytest.raises(RecordingError, match=said):
            description_beside(large(tmp_path / "robot.urdf", 4096 * MIB).parent, RecordingSettings())
        with pytest.raises(RobotError, match=said):
            load_arm(tmp_path / "robot.urdf")
        with pytest.raises(RecordingError, match=said):
            Calibration.load(large(tmp_path / "calibration.yaml", 4096 * MIB))
        large(tmp_path / "metadata.yaml", 4096 * MIB)
        (tmp_path / "run.db3").touch()
        with pytest.raises(RecordingError, match=said):
            load_bag(tmp_path)


def test_a_datasheet_that_is_large_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "imu0").mkdir()
    (tmp_path / "imu0" / "data.csv").write_text("t,w_x,w_y,w_z,a_x,a_y,a_z\n1,2,3,4,5,6,7\n")
    large(tmp_path / "imu0" / "sensor.yaml", 4096 * MIB)
    with memory(80 * MIB):
        (warning,) = load_folder(tmp_path).warnings
    assert "holds no noise densities" in warning.message


def test_a_trace_that_is_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kreisel.formats.kuka_trace._MAX_TRACE", MIB)
    with memory(20 * MIB), pytest.raises(RecordingError, match=f"longer than {MIB} bytes"):
        read_trace(large(tmp_path / "trace.dat", 4096 * MIB))
    (tmp_path / "trace.txt").write_text(f"Zeit\tA1\n{'1' * 70_000}\t2\n")
    with pytest.raises(RecordingError, match="line 2: a line of 70002 characters"):
        read_trace(tmp_path / "trace.txt")


def test_values_that_are_more_than_the_header_says_are_not_read(tmp_path: Path) -> None:
    large(tmp_path / "trace.r64", 4096 * MIB)
    codes = "200,X\n202,mm\n210,EXPLIZIT\n211,trace.r64\n213,BLOCK\n214,REAL64\n220,10\n221,1\n240,0\n241,1"
    text = f"#BEGINCHANNELHEADER\n{codes}\n#ENDCHANNELHEADER\n"
    with memory(20 * MIB), pytest.raises(RecordingError, match="holds 4294967296 bytes"):
        read_diadem(tmp_path / "trace.dat", text)


def test_a_result_that_refers_to_itself_without_end_is_refused(tmp_path: Path) -> None:
    lines = ["a0: &a0 [1,1,1,1,1,1,1,1,1,1]", *(f"a{k}: &a{k} [{','.join(10 * [f'*a{k - 1}'])}]" for k in range(1, 9))]
    (tmp_path / "calibration.yaml").write_text("\n".join([*lines, "schema: *a8"]))
    with memory(80 * MIB), pytest.raises(RecordingError, match="schema is of type"):
        Calibration.load(tmp_path)
    tail = ["schema: kreisel/calibration/1", "gyroscope: {cross_coupling: *a8, offset: *a8}"]
    (tmp_path / "calibration.yaml").write_text("\n".join([*lines, *tail]))
    with memory(80 * MIB), pytest.raises(RecordingError, match="more than 100000 entries"):
        Calibration.load(tmp_path)


def test_arrays_that_stand_for_much_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "calibration.yaml").write_text(
        "{schema: kreisel/calibration/1, gyroscope: {cross_coupling: [1,0,0,0,1,0,0,0,1], offset: [0,0,0]}, "
        "accelerometer: {cross_coupling: [1,0,0,0,1,0,0,0,1], offset: [0,0,0], lever_arms: [0,0,0,0,0,0,0,0,0]}, "
        "verdict: {accepted: true}}"
    )
    with zipfile.ZipFile(tmp_path / "covariance.npz", "w", zipfile.ZIP_DEFLATED) as file, \
            file.open("covariance.npy", "w") as part:  # fmt: skip
        for _ in range(200):
            part.write(bytes(MIB))
    with memory(80 * MIB), pytest.raises(RecordingError, match=r"covariance\.npz: arrays of 209715200 bytes"):
        Calibration.load(tmp_path)
    (tmp_path / "covariance.npz").write_bytes(b"garbage")
    with pytest.raises(RecordingError, match="not an archive"):
        Calibration.load(tmp_path)


def tables_that_stand_for_much(folder):
    """Tables of a megabyte at most that stand for `BOMB` bytes of zeros and more."""
    import gzip

    h5py, arrow, io = (pytest.importorskip(name) for name in ("h5py", "pyarrow.parquet", "scipy.io"))
    pa = pytest.importorskip("pyarrow")
    rows = BOMB // 8
    with gzip.open(folder / "text.csv.gz", "wb") as file:
        file.write(b"t,x\n")
        for _ in range(BOMB // MIB):
            file.write(b"0,0\n" * (MIB // 4))
    io.savemat(folder / "packed.mat", {"imu": np.zeros((rows // 7, 7))}, do_compression=True)
    with h5py.File(folder / "newer.mat", "w") as file:
        file.create_dataset("imu", shape=(rows, 7), dtype="f8", chunks=(100_000, 7), compression="gzip")
    arrow.write_table(pa.table({"t": np.zeros(rows)}), folder / "table.parquet")


def test_tables_that_stand_for_much_are_refused(tmp_path):
    tables_that_stand_for_much(tmp_path)
    for name, words in (
        ("text.csv.gz", "bytes when unpacked"),
        ("packed.mat", "content of more than"),
        ("newer.mat", "content of more than"),
        ("table.parquet", "content of more than"),
    ):
        assert (tmp_path / name).stat().st_size < MIB
        with memory(300 * MIB), pytest.raises(RecordingError, match=words):
            read_sheet(tmp_path / name)


def test_a_table_that_shrinks_well_is_read(tmp_path):
    """Stamps and readings of a device at rest, with few digits, in every form of file."""
    import gzip

    h5py, arrow, io = (pytest.importorskip(name) for name in ("h5py", "pyarrow.parquet", "scipy.io"))
    pa = pytest.importorskip("pyarrow")
    columns = {"t": np.arange(200_000) * 0.0025, "w_x": np.zeros(200_000), "a_z": np.full(200_000, 9.81)}
    text = "t,w_x,a_z\n" + "".join(f"{t:.4f},0,9.81\n" for t in columns["t"])
    (tmp_path / "text.csv.gz").write_bytes(gzip.compress(text.encode()))
    io.savemat(tmp_path / "packed.mat", columns, do_compression=True)
    with h5py.File(tmp_path / "newer.mat", "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values, compression="gzip")
    arrow.write_table(pa.table(columns), tmp_path / "table.parquet")
    for name in ("text.csv.gz", "packed.mat", "newer.mat", "table.parquet"):
        found = read_sheet(tmp_path / name)
        k = found.names.index("a_z")
        np.testing.assert_allclose(found.columns[k].astype(float), 9.81)
