"""Figures for scripts and notebooks show the numbers of a calibration."""

import subprocess
import sys

import numpy as np
import pytest

import kreisel
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.own_estimator import Estimates
from kreisel.errors import RecordingError, SettingsError
from kreisel.model.groups import REGISTRY
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.units import MG, MM, MRAD

pytest.importorskip("matplotlib")
from kreisel.report import matplotlib_figures
from kreisel.report.shown_figure import ShownFigure


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    truth, recording = simulate(Cell(seed=5, seconds=60.0), folder / "recording")
    calibration = kreisel.calibrate(recording)
    calibration.save(folder / "result")
    return truth, recording, calibration, folder / "result"


def bars(axes):
    """Return the middles and half lengths of vertical bars."""
    ends = [np.asarray(one.lines[2][0].get_segments()[0])[:, 1] for one in axes.containers]
    return [0.5 * (low + high) for low, high in ends], [0.5 * (high - low) for low, high in ends]


def test_kreisel_has_the_figures_by_name():
    assert kreisel.plot is matplotlib_figures
    with pytest.raises(AttributeError, match="no attribute 'plots'"):
        _ = kreisel.plots


def test_parameters_have_bars_of_one_deviation(made):
    _, _, calibration, _ = made
    axes = kreisel.plot.parameters(calibration).axes
    assert len(axes) == 9
    for one, quantity in zip(axes, QUANTITIES, strict=True):
        middle, half = bars(one)
        np.testing.assert_allclose(middle, calibration.derived[quantity.name].value, rtol=1e-9)
        np.testing.assert_allclose(half, calibration.derived[quantity.name].deviation, rtol=1e-6)


def test_parameters_are_shown_less_the_truth(made):
    truth, _, calibration, _ = made
    (axes,) = kreisel.plot.parameters(calibration, truth, ["accel_bias_mg"]).axes
    error = (truth.sensors.k_a[0] - calibration.sensors.k_a[0]) / MG
    np.testing.assert_allclose(bars(axes)[0], error, atol=1e-9)
    assert np.abs(error).max() > 1e-4


@pytest.mark.parametrize("stored", [False, True])
def test_estimates_end_at_the_result(made, stored):
    truth, _, calibration, folder = made
    figure = kreisel.plot.estimates(folder if stored else calibration, "accel_offset", truth, deviations=3.0)
    assert len(figure.axes) == 3
    n = len(calibration.names)
    for i, axes in enumerate(figure.axes):
        own = calibration.names.index(f"accelerometer.offset[{i}]")
        line, true = axes.lines
        assert line.get_ydata()[-1] == pytest.approx(calibration.sensors.k_a[0][i] / MG, rel=1e-6)
        assert true.get_ydata()[0] == pytest.approx(truth.sensors.k_a[0][i] / MG)
        band = axes.collections[0].get_paths()[0].vertices
        last = band[np.isclose(band[:, 0], calibration.estimates[-1, 0], rtol=1e-7), 1]
        assert 0.5 * np.ptp(last) == pytest.approx(3.0 * calibration.estimates[-1, 1 + n + own] / MG, rel=1e-3)


def test_matrices_have_nine_panels(made):
    assert len(kreisel.plot.estimates(made[2], "gyro_cross_coupling").axes) == 9


def test_residuals_are_the_innovations_of_all_updates(made):
    _, _, calibration, _ = made
    history = calibration.updates
    position, orientation, nis = kreisel.plot.residuals(calibration).axes
    assert history.used.all()
    for axes, part, size in ((position, slice(0, 3), MM), (orientation, slice(3, 6), MRAD)):
        shown = np.concatenate([np.asarray(one.get_offsets())[:, 1] for one in axes.collections])
        np.testing.assert_allclose(np.sort(shown), np.sort((history.innovation[:, part] / size).ravel()))
    shown = np.concatenate([np.asarray(one.get_offsets())[:, 1] for one in nis.collections])
    np.testing.assert_allclose(np.sort(shown), np.sort(history.nis / history.degrees))


def test_correlations_leave_out_the_robot(made):
    _, _, calibration, _ = made
    kept = [i for i, name in enumerate(calibration.names) if not name.startswith("robot.")]
    axes, _ = kreisel.plot.correlations(calibration).axes
    shown = np.asarray(axes.images[0].get_array())
    P = calibration.covariance[np.ix_(kept, kept)]
    np.testing.assert_allclose(shown, P / np.sqrt(np.outer(np.diag(P), np.diag(P))), atol=1e-12)
    two = kreisel.plot.correlations(calibration, ["accel_offset", "gyro_offset"]).axes[0]
    assert np.asarray(two.images[0].get_array()).shape == (6, 6)


def test_shares_of_the_budget_add_up(made):
    (axes,) = kreisel.plot.budget(made[2]).axes
    widths = np.array([[bar.get_width() for bar in one] for one in axes.containers])
    np.testing.assert_allclose(widths.sum(axis=0), 100.0)
    assert len(axes.get_yticklabels()) == widths.shape[1] == 10


class Constant:
    """Says the same of every recording."""

    name = "constant"

    def estimate(self, measured):
        del measured
        return Estimates({"gyroscope": {"offset": np.zeros(3)}}, {"gyroscope": {"offset": np.full(3, 1e-5)}})


def test_estimators_are_shown_side_by_side(made):
    compared = kreisel.compare_methods(made[1], ["ekf", Constant()])
    (axes,) = kreisel.plot.methods(compared, ["gyro_bias_deg_h"]).axes
    middle, half = bars(axes)
    first, own = compared.found
    name = "gyro_bias_deg_h"
    np.testing.assert_allclose(middle[:3], 0.0, atol=1e-9)
    np.testing.assert_allclose(middle[3:], own.derived[name].value - first.derived[name].value, rtol=1e-9)
    np.testing.assert_allclose(half, [*first.derived[name].deviation, *own.derived[name].deviation], rtol=1e-6)


def test_every_symbol_can_be_typeset():
    from matplotlib.mathtext import MathTextParser

    for group in REGISTRY:
        MathTextParser("path").parse(matplotlib_figures.symbol_of(group))


def test_a_notebook_shows_a_figure_once(made):
    """It is no figure of pyplot, which would show it a second time."""
    figure = kreisel.plot.budget(made[2])
    assert isinstance(figure, ShownFigure)
    picture, size = figure._repr_png_()
    assert picture.startswith(b"\x89PNG")
    assert int.from_bytes(picture[16:20]) == 2 * size["width"]
    from matplotlib import pyplot

    assert pyplot.get_fignums() == []


def test_a_given_figure_is_drawn_in(made):
    from matplotlib.figure import Figure

    own = Figure(layout="constrained")
    upper, lower = own.subfigures(2, 1)
    assert kreisel.plot.budget(made[2], figure=upper) is upper
    kreisel.plot.estimates(made[2], figure=lower)
    assert len(own.axes) == 4


def without(**parts):
    """Return a calibration without some of its arrays."""
    from dataclasses import replace

    return lambda calibration: replace(calibration, **parts)


@pytest.mark.parametrize(
    ("draw", "change", "said"),
    [
        (lambda c: kreisel.plot.parameters(c, quantities=["bias"]), None, "unknown quantity 'bias'; known are: accel_"),
        (lambda c: kreisel.plot.estimates(c, "offset"), None, "unknown group 'offset'; known are: accel_"),
        (lambda c: kreisel.plot.estimates(c), without(estimates=np.zeros((0, 1))), "no estimates over time"),
        (kreisel.plot.residuals, without(updates=None), "has no updates"),
        (lambda c: kreisel.plot.correlations(c, ["offset"]), None, "unknown group 'offset'"),
        (kreisel.plot.correlations, without(names=()), "has no covariance"),
        (kreisel.plot.budget, without(budget=None), "has no budget"),
        (lambda c: kreisel.plot.parameters(c, quantities=[]), None, "nothing can be shown"),
    ],
)
def test_what_cannot_be_shown_is_said(made, draw, change, said):
    with pytest.raises(SettingsError, match=said):
        draw(made[2] if change is None else change(made[2]))


def test_a_folder_without_estimates_is_named(tmp_path):
    with pytest.raises(RecordingError, match="give a result folder"):
        kreisel.plot.estimates(tmp_path)
    (tmp_path / "estimates.csv").write_text('"time [s]","a"\n1,2,3\n')
    with pytest.raises(RecordingError, match=r"estimates\.csv: a table of 3 columns under 2 names"):
        kreisel.plot.estimates(tmp_path)


def test_what_was_read_or_is_in_other_axes_has_no_updates(made):
    _, _, calibration, folder = made
    assert kreisel.Calibration.load(folder).updates is None
    assert calibration.in_axes("imu").updates is None


def test_without_matplotlib_the_extra_is_named():
    code = (
        "import sys; sys.modules['matplotlib'] = sys.modules['matplotlib.figure'] = None\n"
        "import kreisel\nfrom kreisel.errors import SettingsError\n"
        "try:\n    kreisel.plot.methods\n    kreisel.plot._drawn_in(None, 1.0)\n"
        "except SettingsError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "figures need matplotlib: pip install 'kreisel[plot]'\n"
