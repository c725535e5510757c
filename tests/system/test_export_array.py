"""`kreisel export` of a tray's result folder, from the command line."""

import pytest
from ruamel.yaml import YAML

from ..unit.exchange.small_tray import rejected, units, write_tray
from .breaking import assert_one_line, command


@pytest.fixture
def call(monkeypatch, capsys):
    return command(monkeypatch, capsys)


def refused(call, words, *arguments):
    ended = call(*arguments)
    assert ended.status == 1
    assert_one_line(ended.err, (words,))


def test_a_tray_is_written_for_kalibr_with_its_proof(call, tmp_path):
    folder, out = write_tray(tmp_path / "tray", units()), tmp_path / "imus.yaml"
    to = ("export", folder, "--to", "kalibr", "--grade", "industrial-mems")
    ended = call(*to, "-o", out, "--rate", "250")
    assert ended.status == 0, ended.err
    assert "read back: readings of one motion of the tray" in ended.out
    assert "imu1: the clock's skew: 20 ppm, 12 ms after ten minutes" in ended.out
    assert "left out: imu7: did not turn\n" in ended.out
    table = YAML(typ="safe").load(out.read_text())
    assert [one["rostopic"] for one in table.values()] == [f"/imu{k}/data_raw" for k in range(3)]
    assert {one["update_rate"] for one in table.values()} == {250.0}
    refused(call, "exists already", *to, "-o", out)
    refused(call, "several IMUs need {imu} in it", *to, "-o", tmp_path / "new.yaml", "--topic", "/imu")
    refused(call, "--axes tool: several IMUs", *to, "-o", tmp_path / "new.yaml", "--axes", "tool")
    refused(call, "nothing states the", "export", folder, "--to", "kalibr", "-o", tmp_path / "new.yaml")
    refused(call, "of a single IMU", "export", folder, "--to", "openvins", "-o", tmp_path / "new.yaml")
    assert not (tmp_path / "new.yaml").exists()


@pytest.mark.parametrize("target", ["urdf", "ros-tf"])
def test_a_tray_is_written_for_ros(target, call, tmp_path):
    folder = write_tray(tmp_path / "tray", units())
    ended = call("export", folder / "array.yaml", "--to", target, "-o", tmp_path / "imus.xml")
    assert ended.status == 0, ended.err
    assert "read back: rotations differ by" in ended.out
    assert 'name="imu0_to_imu2"' in (tmp_path / "imus.xml").read_text()
    refused(
        call, "for formats with noise", "export", folder, "--to", target, "-o", tmp_path / "x", "--grade", "fog-mems"
    )
    refused(call, "of several IMUs", "export", folder / "imu1", "--to", target, "-o", tmp_path / "x")


def test_rejected_units_are_named_and_left_out(call, tmp_path):
    tray = units()
    tray["imu1"] = rejected(tray["imu1"], "it turned on its mount")
    to = ("export", write_tray(tmp_path / "tray", tray), "--to", "kalibr", "--grade", "fog-mems", "-o")
    ended = call(*to, tmp_path / "imus.yaml")
    assert ended.status == 0, ended.err
    assert "left out: imu1: rejected: it turned on its mount; --force uses it nevertheless\n" in ended.out
    assert "imu2 is imu1 in the file" in ended.out
    text = (tmp_path / "imus.yaml").read_text()
    assert list(YAML(typ="safe").load(text)) == ["imu0", "imu1"]
    assert YAML(typ="safe").load(text)["imu1"]["rostopic"] == "/imu2/data_raw"
    assert "# Left out: imu1: rejected: it turned on its mount\n" in text
    assert call(*to, tmp_path / "all.yaml", "--force").status == 0
    assert len(YAML(typ="safe").load((tmp_path / "all.yaml").read_text())) == 3


def test_what_cannot_be_exported_is_refused(call, tmp_path):
    tray = units()
    out = tmp_path / "imus.yaml"
    (tmp_path / "empty").mkdir()
    refused(call, "give a result folder", "export", tmp_path / "empty", "--to", "kalibr", "-o", out)
    tray["imu0"] = rejected(tray["imu0"], "noise")
    folder = write_tray(tmp_path / "first", tray)
    refused(call, "imu0 was rejected (noise); --force", "export", folder, "--to", "urdf", "-o", out)
    tray = {name: rejected(one, "shaken") if name != "imu0" else one for name, one in units().items()}
    folder = write_tray(tmp_path / "others", tray)
    refused(call, "no unit is left beside imu0", "export", folder, "--to", "urdf", "-o", out)
    assert not out.exists()
