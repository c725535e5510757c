"""A result in scripts and notebooks."""

import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import kreisel
from kreisel.calibration.result import Calibration
from kreisel.errors import SettingsError

from ...small_cell import simulate


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Calibration:
    folder = tmp_path_factory.mktemp("views")
    kreisel.calibrate(simulate(np.random.default_rng(11), 60.0, folder / "small")[1]).save(folder)
    return Calibration.load(folder)


def test_a_result_is_a_few_lines(result):
    lines = repr(result).splitlines()
    assert len(lines) < 15
    assert max(map(len, lines)) <= 120
    assert f"{len(result.names)} parameters: {result.verdict.headline.lower()}" in lines[0]
    bias = result.derived["gyro_bias_deg_h"]
    (line,) = [line for line in lines if "Gyro bias" in line]
    assert line.endswith("deg/h")
    shown = [part.split(" ± ") for part in line.removesuffix(" deg/h").split("Gyro bias")[1].split(";")]
    assert np.array([float(value) for value, _ in shown]) == pytest.approx(np.ravel(bias.value), rel=0.1)
    assert np.array([float(deviation) for _, deviation in shown]) == pytest.approx(np.ravel(bias.deviation), rel=0.1)


def test_a_notebook_shows_a_table(result):
    class Cells(HTMLParser):
        cells = 0

        def handle_starttag(self, tag, attrs):
            self.cells += tag == "td"

    parser = Cells()
    parser.feed(result._repr_html_())
    assert parser.cells == 4 * (len(repr(result).splitlines()) - 1)


def test_a_data_frame_has_every_parameter_with_its_deviation(result):
    frame = result.to_dataframe()
    assert list(frame.index) == list(result.names)
    assert frame["standard_deviation"].to_numpy() == pytest.approx(np.sqrt(np.diag(result.covariance)))
    offset = frame.loc[[f"accelerometer.offset[{i}]" for i in range(3)]]
    assert offset["value"].to_numpy() == pytest.approx(result.sensors.k_a[0])
    assert set(offset["group"]) == {"accel_offset"}
    assert (offset["shown_unit"].iloc[0], offset["shown_factor"].iloc[0]) == ("mg", pytest.approx(9.80665e-3))
    matrix = frame["value"].filter(like="gyroscope.cross_coupling").to_numpy().reshape(3, 3)
    assert matrix == pytest.approx(result.sensors.K_omega)


def test_a_data_frame_needs_pandas(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(SettingsError, match="pip install pandas"):
        result.to_dataframe()
