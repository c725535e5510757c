"""Tables of readings corrected: the same numbers as `Calibration.correct`, however they come; and what is refused."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.application.corrected_files import apply_to_file, apply_to_pipe, check_usable
from kreisel.application.corrected_tables import CorrectedTable
from kreisel.application.unit_check import check_units
from kreisel.calibration.result_sections import RecordingFacts, Verdict
from kreisel.errors import RecordingError, SettingsError
from kreisel.recording.recording import ImuSamples

from ..calibration.example import calibration

N = 300
STAMPS = 1_700_000_000_000_000_000 + 2_500_000 * np.arange(N)
PHASE = np.add(np.outer(np.arange(N) * 0.0025, [3.0, 5.0, 7.0]), [0.0, 1.0, 2.0])
RATES, FORCES = np.sin(PHASE), np.add(5.0 * np.cos(PHASE), [0.0, 0.0, 9.8])
HEADER = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
TOOL = calibration()


def table(header: str = HEADER, rows=None, others: str = "") -> bytes:
    rows = [(s, *w, *a) for s, w, a in zip(STAMPS, RATES, FORCES, strict=True)] if rows is None else rows
    lines = [",".join(repr(float(x)) if i else str(x) for i, x in enumerate(row)) + others for row in rows]
    return ("\n".join([header, *lines]) + "\n").encode()


def numbers(out: bytes) -> tuple[list[str], np.ndarray]:
    head, *lines = out.decode().strip().split("\n")
    assert head.startswith("#timestamp")
    return [line.split(",")[0] for line in lines], np.array([line.split(",")[1:7] for line in lines], dtype=float)


def everything(data: bytes, cuts=()) -> bytes:
    stream = CorrectedTable(TOOL, Path("raw.csv"))
    edges = [0, *sorted(cuts), len(data)]
    parts = [stream.feed(data[a:b]) for a, b in pairwise(edges)]
    return b"".join(parts) + stream.close()[0]


@given(st.lists(st.integers(0, len(table())), max_size=10))
def test_any_split_of_the_bytes_gives_the_rows_of_correct(cuts):
    stamps, found = numbers(everything(table(), cuts))
    assert stamps == [str(s) for s in STAMPS]
    omega, f = TOOL.correct(RATES, FORCES, STAMPS)
    np.testing.assert_allclose(found, np.hstack([omega, f]), atol=1e-10)


def test_units_of_the_header_are_converted_and_other_columns_kept():
    header = "t [s],w_x [deg/s],w_y,w_z,a_x [g],a_y,a_z,count []"
    rows = [(f"{0.0025 * k:.4f}", *np.rad2deg(w), *(a / 9.80665))
            for k, (w, a) in enumerate(zip(RATES, FORCES, strict=True))]  # fmt: skip
    out = everything(table(header, rows, ",7"))
    assert out.decode().split("\n")[0] == "t [s],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z,count []"
    assert all(line.endswith(",7") for line in out.decode().strip().split("\n")[1:])
    assert out.decode().split("\n")[2].startswith("0.0025,")
    omega, f = TOOL.correct(RATES, FORCES, STAMPS)
    # a second's stamp in a double of nanoseconds
    np.testing.assert_allclose(numbers(out.replace(b"t [s]", b"#timestamp"))[1], np.hstack([omega, f]), atol=1e-6)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is empty; expected IMU readings as CSV"),
        (b"1,2,3\n", "line 1: has no header line"),
        (HEADER.encode() + b"\r", "has a header but no rows"),
        (b"t,a\n1,2\n", "2 columns, expected 7 or more"),
        (table().replace(repr(float(RATES[7, 1])).encode(), b"x"), "line 9: 'x' in column 3"),
        (table().replace(repr(float(RATES[7, 1])).encode(), b"inf"), "line 9: a reading is not a finite number"),
        (table()[:4000] + b"\n" + table()[100:], "expected 7 values"),
        (table() + table().split(b"\n")[1] + b"\n", "expected ascending stamps"),
        (HEADER.encode() + b"\n" + b"9" * 70_000, "a line of more than 65536 bytes"),
        (b"\xff\xfe" + table(), "not UTF-8 text"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line(data, said):
    with pytest.raises(RecordingError, match=said):
        everything(data)


@given(st.lists(st.integers(0, len(table())), max_size=10), st.sampled_from([b"\r\n", b"\r"]))
def test_other_line_ends_give_the_same_rows(cuts, end):
    assert everything(table().replace(b"\n", end), cuts) == everything(table())


def test_a_comment_behind_a_row_is_no_cell():
    whole = table(HEADER + ",count []", others=",7")
    rows = whole.split(b"\n")
    rows[5] += b" # a, b"
    assert everything(b"\n".join(rows)) == everything(whole)


@pytest.mark.parametrize("cut", [0, 700])
def test_lines_are_counted_behind_comments_and_blank_ones(cut):
    first, second, third, *rest = table().split(b"\n")
    data = b"\n".join([first, b"# a comment", second, b"", third, *rest])
    row = rest[4]
    with pytest.raises(RecordingError, match="line 10: a reading is not a finite number"):
        everything(data.replace(row, row.split(b",")[0] + b",inf,0,0,0,0,0"), [cut])
    with pytest.raises(RecordingError, match="line 11: the stamp .* does not follow .*; expected ascending stamps"):
        everything(data.replace(row, row + b"\n" + row), [cut])


@pytest.mark.parametrize("cell", [b"nan", b""])
def test_rows_without_a_number_are_left_out_and_counted(tmp_path, cell):
    """As where readings are calibrated: the others are corrected as if the row had been lost."""
    raw, lost = tmp_path / "raw.csv", tmp_path / "lost.csv"
    number = repr(float(RATES[7, 1])).encode()
    raw.write_bytes(table().replace(number, cell, 1))
    lines = table().split(b"\n")
    lost.write_bytes(b"\n".join(lines[:8] + lines[9:]))
    done = apply_to_file(TOOL, raw, tmp_path / "out.csv")
    apply_to_file(TOOL, lost, tmp_path / "of_lost.csv")
    assert done.samples == N - 1
    assert any("rows without a number, left out: 1 (first: line 9)" in warning for warning in done.warnings)
    assert (tmp_path / "out.csv").read_bytes() == (tmp_path / "of_lost.csv").read_bytes()
    assert everything(raw.read_bytes()).count(b"\n") == N


def test_a_second_header_holds_only_where_it_is_the_first_one_again():
    """It is a comment otherwise, and degrees after it were read as radians."""
    first, *rows = table().split(b"\n")
    again = b"\n".join([first, *rows[:50], first, *rows[50:]])
    assert everything(again) == everything(table())
    others = again.replace(b"\n" + first, b"\n" + first.replace(b"rad s^-1", b"deg s^-1"))
    for cuts in ([], [100, 900]):
        with pytest.raises(RecordingError, match="line 52: another header .* than that of the first line"):
            everything(others, cuts)


@pytest.mark.parametrize("header", [b"", b","])
def test_a_comma_after_the_last_cell_is_no_cell(tmp_path, header):
    first, *rows = table().strip().split(b"\n")
    data = b"\n".join([first + header, *(row + b"," for row in rows), b""])
    for cuts in ([], [60, 900]):
        assert everything(data, cuts) == everything(table())
    raw = tmp_path / "raw.csv"
    raw.write_bytes(data)
    assert apply_to_file(TOOL, raw, tmp_path / "out.csv").samples == N
    assert (tmp_path / "out.csv").read_bytes() == everything(table())


def test_a_cut_last_line_is_left_out_and_told(tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_bytes(table()[:-30])
    done = apply_to_file(TOOL, raw, tmp_path / "out.csv")
    assert done.samples == N - 1
    assert "the last line has no end" in done.warnings[0]


def test_folders_and_files_of_a_recording(tmp_path):
    (tmp_path / "rec" / "imu0").mkdir(parents=True)
    (tmp_path / "rec" / "imu0" / "data.csv").write_bytes(table())
    apply_to_file(TOOL, tmp_path / "rec", tmp_path / "new" / "out")
    apply_to_file(TOOL, tmp_path / "rec", tmp_path / "out.csv")
    got = (tmp_path / "new" / "out" / "imu0" / "data.csv").read_bytes()
    assert got == (tmp_path / "out.csv").read_bytes() == everything(table())
    with pytest.raises(RecordingError, match="exists already"):
        apply_to_file(TOOL, tmp_path / "rec", tmp_path / "out.csv")
    with pytest.raises(RecordingError, match="no such file or folder"):
        apply_to_file(TOOL, tmp_path / "none", tmp_path / "x")


def test_readings_of_another_device_are_refused_unless_forced(tmp_path):
    (tmp_path / "rec" / "imu0").mkdir(parents=True)
    (tmp_path / "rec" / "imu0" / "data.csv").write_bytes(table())
    (tmp_path / "rec" / "recording.toml").write_text('[device]\nserial_number = "B"\n')
    facts = RecordingFacts("r", "", 1, 1.0, 0, 1.0, device={"serial_number": "A"})
    other = replace(TOOL, recording=facts)
    for k, raw in enumerate((tmp_path / "rec", tmp_path / "rec" / "imu0" / "data.csv")):
        with pytest.raises(RecordingError, match="serial number 'B', and the calibration is that of 'A'"):
            apply_to_file(other, raw, tmp_path / f"out{k}")
        assert apply_to_file(other, raw, tmp_path / f"out{k}", force=True).samples
    own = replace(TOOL, recording=replace(facts, device={"serial_number": "B"}))
    assert apply_to_file(own, tmp_path / "rec", tmp_path / "own.csv").samples


def test_which_of_several_imus_was_corrected_is_said(tmp_path):
    for name in ("imu0", "imu1"):
        (tmp_path / "rec" / name).mkdir(parents=True)
        (tmp_path / "rec" / name / "data.csv").write_bytes(table())
    (said,) = apply_to_file(TOOL, tmp_path / "rec", tmp_path / "a").warnings
    assert said == "readings of imu0, the first of 2 IMUs, were corrected; --imu names another"
    assert not apply_to_file(TOOL, tmp_path / "rec", tmp_path / "b", imu="imu1").warnings


def test_a_fault_leaves_nothing_behind(tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_bytes(table() + b"x\n")
    with pytest.raises(RecordingError):
        apply_to_file(TOOL, raw, tmp_path / "out.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["raw.csv"]


def test_a_table_of_another_shape_is_mapped(tmp_path):
    raw = tmp_path / "log.csv"
    rows = [f"{k * 2.5};{a[0]};{a[1]};{a[2]};{w[2]};{w[0]};{w[1]}"
            for k, (w, a) in enumerate(zip(np.rad2deg(RATES), FORCES, strict=True))]  # fmt: skip
    raw.write_text("\n".join(["ms;fx;fy;fz;gz;gx;gy", *rows]) + "\n")
    mapping = ["imu.time=ms [ms]", "imu.rate=gx,gy,gz [deg/s]", "imu.acceleration=fx,fy,fz [m/s^2]"]
    apply_to_file(TOOL, raw, tmp_path / "out.csv", columns=mapping)
    omega, f = TOOL.correct(RATES, FORCES, 2_500_000 * np.arange(N))
    np.testing.assert_allclose(numbers((tmp_path / "out.csv").read_bytes())[1], np.hstack([omega, f]), atol=1e-9)


def test_units_that_cannot_be_are_refused_unless_forced(tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_bytes(table(HEADER, [(s, *w, *(a / 9.80665)) for s, w, a in zip(STAMPS, RATES, FORCES, strict=True)]))
    with pytest.raises(RecordingError, match=r"median length of .*expected 9.807 m/s\^2.*\[g\]"):
        apply_to_file(TOOL, raw, tmp_path / "out.csv")
    assert apply_to_file(TOOL, raw, tmp_path / "out.csv", force=True).samples == N
    raw.write_bytes(table(HEADER, [(s, *(57.3 * w), *a) for s, w, a in zip(STAMPS, RATES, FORCES, strict=True)]))
    with pytest.raises(RecordingError, match="are they in deg/s"):
        apply_to_file(TOOL, raw, tmp_path / "other.csv")


def test_stamps_in_another_unit_are_refused_unless_forced(tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_bytes(table(HEADER, [(s // 1000, *w, *a) for s, w, a in zip(STAMPS, RATES, FORCES, strict=True)]))
    said = r"4e\+05 samples a second, expected 1 to 20000: are the stamps in nanoseconds"
    with pytest.raises(RecordingError, match=said):
        apply_to_file(TOOL, raw, tmp_path / "out.csv")
    assert apply_to_file(TOOL, raw, tmp_path / "out.csv", force=True).samples == N
    short = table(HEADER, [(s // 1000, *w, *a) for s, w, a in zip(STAMPS[:50], RATES, FORCES, strict=False)])
    with pytest.raises(RecordingError, match=said):
        everything(short)
    with pytest.raises(RecordingError, match="the usual step is 2500 ns; give seconds as floats"):
        TOOL.correct(RATES, FORCES, STAMPS // 1000)


def test_a_stated_mapping_counts_for_usual_tables_too(tmp_path):
    """The header says nothing of units: recording.toml does."""
    folder = tmp_path / "rec" / "imu0"
    folder.mkdir(parents=True)
    rows = [(s, *np.rad2deg(w), *a) for s, w, a in zip(STAMPS, RATES, FORCES, strict=True)]
    (folder / "data.csv").write_bytes(table("t,w_x,w_y,w_z,a_x,a_y,a_z", rows))
    (tmp_path / "rec" / "recording.toml").write_text(
        '[columns]\nimu.file = "imu0/data.csv"\nimu.time = "t [ns]"\nimu.rate = "w_x, w_y, w_z [deg/s]"\n'
        'imu.acceleration = "a_x, a_y, a_z [m/s^2]"\n'
    )
    apply_to_file(TOOL, tmp_path / "rec", tmp_path / "out.csv")
    (folder / "recording.toml").write_text('[columns.imu]\nrate = "w_x, w_y, w_z [deg/s]"\n')
    for raw in (folder / "data.csv", tmp_path / "rec"):
        with pytest.raises(SettingsError, match="-o - is for a table as kreisel writes them"):
            apply_to_pipe(TOOL, raw, print)
    omega, f = TOOL.correct(RATES, FORCES, STAMPS)
    np.testing.assert_allclose(numbers((tmp_path / "out.csv").read_bytes())[1], np.hstack([omega, f]), atol=1e-9)


def arrivals(stamps):
    """Return stamps of arrival, ns: on average half an interval late."""
    late = np.random.default_rng(1).exponential(1.25e6, stamps.size)
    return np.maximum.accumulate(stamps + late.astype(np.int64)) + np.arange(stamps.size)


def test_derivatives_are_those_at_the_moments_of_sampling(tmp_path):
    late = arrivals(STAMPS)
    raw = table(rows=[(s, *w, *a) for s, w, a in zip(late, RATES, FORCES, strict=True)])
    (tmp_path / "raw.csv").write_bytes(raw)
    done = apply_to_file(TOOL, tmp_path / "raw.csv", tmp_path / "out.csv")
    assert "a straight line through them is used instead" in done.warnings[0]
    assert "written as they were read" in done.warnings[0]
    stamps, found = numbers((tmp_path / "out.csv").read_bytes())
    assert stamps == [str(s) for s in late]
    omega, f = TOOL.correct(RATES, FORCES, STAMPS)
    np.testing.assert_allclose(found, np.hstack([omega, f]), atol=1e-3)  # 300 stamps give the interval to 2e-4
    by_stamps = TOOL.correct(RATES, FORCES, late)[1]
    assert np.abs(by_stamps - f).max() > 0.02


@pytest.mark.parametrize(("packet", "noted"), [(4, True), (1, False)])
def test_samples_of_a_packet_with_one_stamp_are_corrected_at_their_own_moments(tmp_path, packet, noted):
    """Or rows that were written twice are corrected once."""
    times, phase = STAMPS[0] + 2_500_000 * np.arange(10 * N), np.outer(np.arange(10 * N) * 0.0025, [3.0, 5.0, 7.0])
    rates, forces = np.sin(phase), np.add(5.0 * np.cos(phase), [0.0, 0.0, 9.8])
    which = np.arange(times.size) if packet > 1 else np.repeat(np.arange(times.size), 2)
    stamps = times[which // packet * packet + packet - 1]
    raw = table(rows=[(s, *w, *a) for s, w, a in zip(stamps, rates[which], forces[which], strict=True)])
    (tmp_path / "raw.csv").write_bytes(raw)
    done = apply_to_file(TOOL, tmp_path / "raw.csv", tmp_path / "out.csv")
    assert ("a straight line" in " ".join(done.warnings)) is noted
    written, found = numbers((tmp_path / "out.csv").read_bytes())
    assert written == [str(s) for s in stamps]
    np.testing.assert_allclose(found, np.hstack(TOOL.correct(rates, forces, times))[which], atol=1e-3)
    with pytest.raises(RecordingError, match="expected ascending stamps"):  # a stream does not know what comes
        everything(raw)


def test_sums_after_lost_samples_are_corrected_as_one_sample(tmp_path):
    kept = np.delete(np.arange(N), [50, 120, 201, 202, 250])
    rates, forces = RATES[kept].copy(), FORCES[kept].copy()
    for last, lost in ((51, 1), (121, 1), (203, 2), (251, 1)):
        k = int(np.flatnonzero(kept == last)[0])
        rates[k] = RATES[last - lost : last + 1].sum(axis=0)
        forces[k] = FORCES[last - lost : last + 1].sum(axis=0)
    raw = table(rows=[(s, *w, *a) for s, w, a in zip(STAMPS[kept], rates, forces, strict=True)])
    (tmp_path / "raw.csv").write_bytes(raw)
    done = apply_to_file(TOOL, tmp_path / "raw.csv", tmp_path / "out.csv")
    assert done.samples == kept.size
    assert "are sums over these and themselves" in done.warnings[0]
    found = numbers((tmp_path / "out.csv").read_bytes())[1]
    np.testing.assert_allclose(found[:, :3], TOOL.correct(RATES, FORCES, STAMPS)[0][kept], atol=1e-3)


def test_streams_with_scattering_stamps_have_a_note():
    for stamps, noted in ((STAMPS, False), (arrivals(STAMPS), True)):
        stream = CorrectedTable(TOOL, Path("raw.csv"))
        stream.feed(table(rows=[(s, *w, *a) for s, w, a in zip(stamps, RATES, FORCES, strict=True)]))
        stream.close()
        assert any("scatter by" in note for note in stream.notes) is noted


def test_a_stream_in_degrees_is_refused_though_it_begins_at_rest():
    rates = np.vstack([1e-3 * RATES, np.rad2deg(RATES)])
    stamps = STAMPS[0] + 2_500_000 * np.arange(2 * N)
    rows = [(s, *w, *a) for s, w, a in zip(stamps, rates, np.vstack([FORCES, FORCES]), strict=True)]
    raw = table(rows=rows)
    with pytest.raises(RecordingError, match="are they in deg/s"):
        everything(raw, range(len(raw) // 2, len(raw), 2000))
    fast = [
        (s, *w, *a)
        for (s, *_), w, a in zip(rows, 15.0 * np.vstack([RATES, RATES]), np.vstack([FORCES] * 2), strict=True)
    ]
    assert numbers(everything(table(rows=fast)))[1].shape == (2 * N, 6)


def test_stamps_that_repeat_and_folders_of_several_recordings_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="inf samples a second"):
        check_units(ImuSamples(np.zeros(9, dtype=np.int64), RATES[:9], FORCES[:9], tmp_path), stated=False)
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(RecordingError, match=r"holds several recordings \(a.mcap, b.mcap\); give one of them"):
        apply_to_file(TOOL, tmp_path, tmp_path / "out.csv")


def test_a_table_does_not_become_a_bag(tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_bytes(table())
    for name in ("out.mcap", "out.bag"):
        with pytest.raises(SettingsError, match=r"a \.csv file is written, or a folder"):
            apply_to_file(TOOL, raw, tmp_path / name)


def test_a_table_of_another_shape_must_state_its_units(tmp_path):
    raw = tmp_path / "log.csv"
    rows = [f"{k * 2.5};{a[0]};{a[1]};{a[2]};{w[0]};{w[1]};{w[2]}"
            for k, (w, a) in enumerate(zip(RATES, FORCES, strict=True))]  # fmt: skip
    raw.write_text("\n".join(["ms;fx;fy;fz;gx;gy;gz", *rows]) + "\n")
    mapping = ["imu.time=ms [ms]", "imu.rate=gx,gy,gz", "imu.acceleration=fx,fy,fz [m/s^2]"]
    with pytest.raises(RecordingError, match=r"the unit of imu.rate is not stated.*\[deg/s\] or \[rad/s\]"):
        apply_to_file(TOOL, raw, tmp_path / "out.csv", columns=mapping)


def test_a_rejected_calibration_is_used_by_force_only():
    from dataclasses import replace

    rejected = replace(TOOL, verdict=Verdict(False, ("the innovations do not fit",)))
    with pytest.raises(SettingsError, match=r"rejected \(the innovations do not fit\); --force"):
        check_usable(rejected, force=False)
    check_usable(rejected, force=True)
