"""Files of other programs that hold no calibration are refused, and of several sensors the chosen one is read."""

import numpy as np
import pytest

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.exchange.targets import read_from

from ..calibration.example import calibration

KALIBR = """
imu0:
  model: scale-misalignment
  accelerometers: {{M: {M_a}}}
  gyroscopes: {{M: {M_w}, C_gyro_i: {eye}, A: {zero}}}
  update_rate: {rate}
"""
EYE, ZERO = np.eye(3).tolist(), np.zeros((3, 3)).tolist()


def px4(scale: float = 1.0, offset: float = 0.1, instance: int = 0) -> str:
    rows = [f"1\t1\tCAL_ACC{instance}_{axis}{name}\t{value}\t9"
            for axis in "XYZ" for name, value in (("SCALE", scale), ("OFF", offset))]  # fmt: skip
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (px4(0.0), "accelerometer has no inverse"),
        (px4(float("inf")), "not a finite number"),
        (px4(1.0, float("nan")), "not a finite number"),
        (px4(1e-200), "has no inverse"),
    ],
)
def test_parameters_that_no_sensor_has_are_refused(text, said, tmp_path):
    path = tmp_path / "file.params"
    path.write_text(text)
    with pytest.raises(RecordingError, match=said):
        read_from("px4", path)


def test_the_chosen_sensor_of_an_autopilot_is_read(tmp_path):
    path = tmp_path / "file.params"
    path.write_text(px4(1.01, 0.1, 0) + px4(0.98, 0.2, 1))
    assert np.diag(read_from("px4", path).sensors.K_a) == pytest.approx([1.01] * 3)
    assert np.diag(read_from("px4", path, 1).sensors.K_a) == pytest.approx([0.98] * 3)
    with pytest.raises(RecordingError, match="has no CAL_ACC2_"):
        read_from("px4", path, 2)


def test_matrices_without_an_inverse_and_aliases_without_end_are_refused(tmp_path):
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR.format(M_a=ZERO, M_w=EYE, eye=EYE, zero=ZERO, rate=200.0))
    with pytest.raises(RecordingError, match=r"not a result of Kalibr|has no inverse"):
        read_from("kalibr", path)
    bomb = "\n".join([f"b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9)])
    path.write_text(f"b0: &b0 [1]\n{bomb}\nmodel: calibrated\n")
    with pytest.raises(RecordingError, match="more than 100000 entries"):
        read_from("kalibr", path)


def test_parameters_that_are_missing_or_twice_are_told(tmp_path):
    path = tmp_path / "file.params"
    path.write_text(px4().replace("XSCALE", "YSCALE"))
    with pytest.raises(RecordingError, match="CAL_ACC0_YSCALE is there twice"):
        read_from("px4", path)
    path.write_text(px4().replace("XSCALE", "WSCALE"))
    with pytest.raises(RecordingError, match="has no CAL_ACC0_XSCALE"):
        read_from("px4", path)
    path.write_text(px4())
    verdict = read_from("px4", path).verdict
    assert verdict.headline == "Not judged"
    assert verdict.summary.endswith("(PX4; without offsets of the gyros); kreisel has not judged it.")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"eye": [[0.5, 0, 0], [0, 1, 0], [0, 0, 1]]}, "is not a rotation"),
        ({"eye": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "is not a rotation"),
        ({"M_a": [[1, 0.3, 0], [0, 1, 0], [0, 0, 1]]}, "is not lower triangular"),
        ({"M_w": "[[true, 0, 0], [0, 1, 0], [0, 0, 1]]"}, "holds what is no number"),
    ],
)
def test_matrices_that_are_not_what_kalibr_writes_are_refused(wrong, said, tmp_path):
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR.format(**({"M_a": EYE, "M_w": EYE, "eye": EYE, "zero": ZERO, "rate": 200.0} | wrong)))
    with pytest.raises(RecordingError, match=said):
        read_from("kalibr", path)


@pytest.mark.parametrize(("rate", "read"), [(200.0, 200.0), (1e-300, 0.0), (1e9, 0.0)])
def test_impossible_rates_count_as_not_stated(rate, read, tmp_path):
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR.format(M_a=EYE, M_w=EYE, eye=EYE, zero=ZERO, rate=rate))
    facts = read_from("kalibr", path).recording
    assert facts is not None
    assert facts.imu_rate_hz == read


@pytest.mark.parametrize("value", [".nan", ".inf", "0.0"])
def test_a_result_with_impossible_numbers_is_not_loaded(value, tmp_path):
    calibration().save(tmp_path / "cal")
    file = tmp_path / "cal" / "calibration.yaml"
    text = file.read_text()
    begin = text.index("cross_coupling:")
    end = text.index("offset:", begin)
    rows = f"cross_coupling: [[{value}, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n  "
    file.write_text(text[:begin] + rows + text[end:])
    with pytest.raises(RecordingError, match=r"not a finite number|has no inverse"):
        Calibration.load(tmp_path / "cal")
