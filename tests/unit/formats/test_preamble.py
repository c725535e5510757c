"""Exports of motion capture: names in several lines, facts above them."""

import numpy as np
import pytest

from kreisel.formats.preamble import without_preamble
from kreisel.formats.proposal import proposal
from kreisel.formats.sheet import read_sheet

from ...foreign_tables import text
from ...small_problem import recorded
from ...stranger_tables import common, triad

MOTIVE = """Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Rotation Type,Quaternion

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker
,Name,imu,imu,imu,imu,imu,imu,imu,imu:Marker1
,ID,1,1,1,1,1,1,1,1
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X
"""
VICON = """Objects
100
,,Global Angle imu:imu,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ
,,rad,rad,rad,mm,mm,mm
"""


def rows(numbers, delimiter=","):
    return "\n".join(delimiter.join(map(repr, row)) for row in np.asarray(numbers).tolist()) + "\n"


@pytest.fixture(scope="module")
def motion():
    t, w, f, p, q = common(recorded()[1])
    return t - t[0], w, f, p, q


def test_names_of_an_export_of_motive_are_those_of_all_its_lines(tmp_path, motion):
    t, w, f, p, q = motion
    frame = np.arange(t.size)
    take = np.column_stack([frame, t, q[:, [1, 2, 3, 0]], p, p[:, 0]])
    (tmp_path / "take.csv").write_text(MOTIVE + rows(take))
    (tmp_path / "imu.csv").write_text(text({"t": t} | triad("g{}", w) | triad("a{}", f)))
    sheet = read_sheet(tmp_path / "take.csv")
    assert sheet.names[2:6] == tuple(f"Rigid Body imu 1 Rotation {axis}" for axis in "XYZW")
    assert sheet.scalars == (("Format Version", 1.23), ("Capture Frame Rate", 100.0))
    found = proposal(tmp_path)
    assert '\norientation = "quaternion wxyz: Rigid Body imu 1 Rotation W' in found
    assert '\nposition = "Rigid Body imu 1 Position X' in found


def test_frames_of_an_export_of_vicon_are_counted_by_its_rate(tmp_path, motion):
    t, _, _, p, _ = motion
    lines = (VICON + rows(np.column_stack([np.arange(t.size), 0.0 * t, 0.1 * p, 1e3 * p]))).split("\n")
    (tmp_path / "take.csv").write_text("\n".join(lines))
    sheet = read_sheet(tmp_path / "take.csv")
    assert sheet.names == ("Frame", "Sub Frame", "RX", "RY", "RZ", "TX", "TY", "TZ")
    assert sheet.units == (None, None, "rad", "rad", "rad", "mm", "mm", "mm")
    assert sheet.scalars == (("frame rate", 100.0),)
    np.testing.assert_allclose(sheet.numbers("TX"), 1e3 * p[:, 0])
    assert without_preamble(lines).lines[5] == lines[5]  # lines keep their numbers


@pytest.mark.parametrize("header", ["", "t,a,b,c\n", "t,a,b,c\ns,m,m,m\n", "# a comment\nt,a,b,c\n"])
def test_usual_headers_stay(header):
    lines = (header + rows(np.arange(200.0).reshape(-1, 4))).split("\n")
    assert without_preamble(lines).lines is lines
