"""What belongs to a signed certificate: its name, its calibration, its device."""

from dataclasses import replace

import pytest

from kreisel.calibration.result import Calibration
from kreisel.certificate.statement import (
    as_comment,
    check_calibration,
    check_name,
    digest_of,
    stated_in,
    statement_of,
)
from kreisel.errors import RecordingError

from ..calibration.example import calibration


def saved(folder, serial_number="0042", seed=3):
    own = calibration(seed=seed).in_axes("imu")
    assert own.recording is not None
    facts = replace(own.recording, digest="ab" * 32, device={"serial_number": serial_number} if serial_number else {})
    replace(own, recording=facts).save(folder)
    return folder


def stated(result, name="c.pdf", serial_number="0042"):
    found = statement_of(name, "2026-11-23", serial_number, Calibration.load(result), digest_of(result))
    again = stated_in(as_comment(found))
    assert again == found
    return again


def test_the_statement_comes_back_from_one_line(tmp_path):
    found = stated(saved(tmp_path / "a"), 'Prüfung "1"\n {}.pdf', "№ 7  b")
    assert (found.file, found.serial_number, found.recording) == ('Prüfung "1" {}.pdf', "№ 7 b", "example")
    assert "\n" not in as_comment(found)
    assert as_comment(found).isascii()


@pytest.mark.parametrize(
    "comment",
    [
        "",
        "c.pdf 2026-11-23 data sha256 abab",
        "kreisel certificate ",
        "kreisel certificate []",
        "kreisel certificate {}",
    ],
)
def test_other_comments_state_nothing(comment):
    assert stated_in(comment) is None


def test_a_certificate_under_another_name_is_refused(tmp_path):
    found = stated(saved(tmp_path / "a"))
    check_name(tmp_path / "c.pdf", found)
    with pytest.raises(
        RecordingError, match=r"other\.pdf: was signed under the name 'c\.pdf', for serial number '0042'"
    ):
        check_name(tmp_path / "other.pdf", found)


def test_its_own_calibration_and_no_other_belongs_to_it(tmp_path):
    result = saved(tmp_path / "a")
    found, file = stated(result), tmp_path / "c.pdf"
    check_calibration(file, found, result)
    check_calibration(file, found, result / "calibration.yaml")
    with pytest.raises(RecordingError, match="the serial number is '0043' there, and '0042' as signed"):
        check_calibration(file, found, saved(tmp_path / "b", "0043"))
    with pytest.raises(RecordingError, match=r"the SHA-256 of calibration\.yaml is"):
        check_calibration(file, found, saved(tmp_path / "c", seed=4))
    with pytest.raises(RecordingError, match="does not say which calibration it belongs to"):
        check_calibration(file, None, result)
    with (result / "calibration.yaml").open("a") as text:
        text.write("# changed\n")
    with pytest.raises(RecordingError, match=r"calibration\.yaml was changed"):
        check_calibration(file, found, result)


def test_a_serial_number_that_only_the_certificate_states_is_no_contradiction(tmp_path):
    result = saved(tmp_path / "a", "")
    check_calibration(tmp_path / "c.pdf", stated(result, serial_number="7"), result)


# Values that do not fit the parameters


def edited(folder, old, new):
    file = saved(folder) / "calibration.yaml"
    text = file.read_text()
    assert text.count(old) >= 1
    file.write_text(text.replace(old, new, 1))
    return folder


def test_parameters_that_were_changed_by_hand_are_refused(tmp_path):
    offset = repr(float(calibration().sensors.k_a[0, 1]))
    with pytest.raises(RecordingError, match=r"derived\.accel_bias_mg\[1\] is .*, but the parameters give"):
        Calibration.load(edited(tmp_path / "a", offset, repr(float(offset) + 0.01)))


def test_derived_values_that_were_changed_by_hand_are_refused(tmp_path):
    bias = repr(float(calibration().in_axes("imu").derived["gyro_bias_deg_h"].value[2]))
    with pytest.raises(RecordingError, match=r"calibration\.yaml: .*derived\.gyro_bias_deg_h\[2\] is 1,"):
        Calibration.load(edited(tmp_path / "a", bias, "1.0"))


def test_rounded_values_are_those_of_the_parameters(tmp_path):
    found = calibration().in_axes("imu")
    bias, deviation = (getattr(found.derived["accel_bias_mg"], name)[0] for name in ("value", "deviation"))
    rounded = float(bias) + 0.005 * float(deviation)
    again = Calibration.load(edited(tmp_path / "a", repr(float(bias)), repr(rounded)))
    assert again.derived["accel_bias_mg"].value[0] == pytest.approx(bias, rel=1e-12)
