"""Components of variance: the published example, the analysis of variance, and designs with missing runs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from kreisel.batch import gauge_study as module
from kreisel.batch.gauge_study import counted_once, gauge_study, gauge_table, variance_components
from kreisel.calibration.limits import Limits
from kreisel.errors import SettingsError

from .test_lot import run

# AIAG, Measurement systems analysis, 4th edition (2010), worked example: 3 appraisers x 3 trials, 10 parts
AIAG = np.array([
    0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36,
    0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25,
    0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31,
    0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68,
    0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62,
    0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50,
    0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49,
    -0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77,
    -0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16,
]).reshape(3, 3, 10)  # fmt: skip


def design(values):
    """Return values (appraisers, trials, units) in a line, with their names."""
    a, t, u = values.shape
    return (
        values.ravel(),
        [f"u{k}" for _ in range(a * t) for k in range(u)],
        [f"a{i}" for i in range(a) for _ in range(t * u)],
    )


def test_the_published_example():
    found = variance_components(*design(AIAG))
    # Tables III-B 8 and A 5: EV, AV, INT, GRR, PV, ndc
    assert found.repeatability == pytest.approx(0.199933, abs=2e-6)
    assert found.appraiser == pytest.approx(0.226838, abs=2e-6)
    assert found.interaction == 0.0
    assert found.gauge == pytest.approx(0.302373, abs=2e-6)
    assert found.unit == pytest.approx(1.042327, abs=2e-6)
    assert found.total == pytest.approx(1.085, abs=5e-4)
    assert found.categories == 4


def test_a_complete_design_gives_the_mean_squares():
    rng = np.random.default_rng(7)
    a, t, u = 4, 3, 8
    values = (
        rng.normal(0.0, 1.0, (a, t, u)) + rng.normal(0.0, 2.0, (a, 1, 1)) + rng.normal(0.0, 5.0, (1, 1, u))
        + rng.normal(0.0, 1.5, (a, 1, u))
    )  # fmt: skip
    found = variance_components(*design(values))
    mean, cell = values.mean(), values.mean(axis=1)
    by_a, by_u = cell.mean(axis=1), cell.mean(axis=0)
    ms_a = t * u * np.sum((by_a - mean) ** 2) / (a - 1)
    ms_u = t * a * np.sum((by_u - mean) ** 2) / (u - 1)
    ms_i = t * np.sum((cell - by_a[:, None] - by_u + mean) ** 2) / ((a - 1) * (u - 1))
    ms_e = np.sum((values - cell[:, None]) ** 2) / (a * u * (t - 1))
    assert found.repeatability == pytest.approx(math.sqrt(ms_e))
    assert found.interaction == pytest.approx(math.sqrt((ms_i - ms_e) / t))
    assert found.appraiser == pytest.approx(math.sqrt((ms_a - ms_i) / (t * u)))
    assert found.unit == pytest.approx(math.sqrt((ms_u - ms_i) / (t * a)))


def test_missing_runs_do_not_bias_the_components():
    rng = np.random.default_rng(3)
    sums = np.zeros(3)
    trials = 40
    for _ in range(trials):
        a, t, u = 3, 3, 12
        values = rng.normal(0.0, 1.0, (a, t, u)) + rng.normal(0.0, 1.0, (a, 1, 1)) + rng.normal(0.0, 3.0, (1, 1, u))
        y, units, appraisers = design(values)
        kept = np.sort(rng.permutation(y.size)[: int(0.7 * y.size)])
        found = variance_components(y[kept], [units[i] for i in kept], [appraisers[i] for i in kept])
        sums += [found.repeatability**2, found.reproducibility**2, found.unit**2]
    repeat, appraiser, unit = sums / trials
    assert repeat == pytest.approx(1.0, abs=4 * math.sqrt(2.0 / 60 / trials))  # about 60 degrees of freedom a trial
    assert appraiser == pytest.approx(1.0, abs=4 * math.sqrt(2.0 / 2 / trials))
    assert unit == pytest.approx(9.0, abs=4 * 9.0 * math.sqrt(2.0 / 11 / trials))


def test_the_figures_of_runs():
    rng = np.random.default_rng(5)
    runs = []
    for k in range(24):
        one = run(k, float(3.0 * (k % 8) + rng.normal(0.0, 0.2)), 0.2)
        runs.append(
            type(one)(
                one.key,
                one.name,
                f"unit-{k % 8}",
                *[getattr(one, n) for n in ("maker", "type", "date", "error", "text")],
            )
        )
    found = gauge_study(runs, Limits({"accel_bias_mg": (60.0, np.inf, np.inf)}))
    x = next(one for one in found if one.quantity.name == "accel_bias_mg" and one.axis == 0)
    assert x.components.repeatability == pytest.approx(0.2, rel=0.6)
    assert x.of_tolerance == pytest.approx(3.0 * x.components.gauge / 60.0)
    assert "R&R of tolerance" in gauge_table(found).columns


def test_devices_of_two_types_with_one_number_are_two_units():
    rng = np.random.default_rng(6)
    runs = [replace(run(k, 100.0 * (k % 2) + rng.normal()), unit="1", type=f"type {k % 2}") for k in range(12)]
    found = gauge_study(runs, None)
    x = next(one for one in found if one.quantity.name == "accel_bias_mg" and one.axis == 0)
    assert x.components.repeatability == pytest.approx(1.0, rel=0.6)


def test_an_appraiser_of_each_unit_is_none(monkeypatch):
    runs = [replace(run(k, float(k)), unit=f"{k % 4}") for k in range(8)]
    monkeypatch.setattr(module, "appraiser_of", lambda one, by: f"{by} {one.unit}")
    with pytest.raises(SettingsError, match="every unit has a serial_number of its own"):
        gauge_study(runs, None, "serial_number")


def test_without_repetitions_there_is_no_study():
    with pytest.raises(SettingsError, match="no unit was calibrated twice"):
        variance_components(np.arange(4.0), list("abcd"), ["x"] * 4)
    with pytest.raises(SettingsError, match="several"):
        gauge_study([run(0)], None)


def test_the_same_data_under_two_units_are_named():
    fields = [getattr(run(0), name) for name in ("maker", "type", "date", "error", "text")]

    class Measured(type(run(0))):
        data = "0123abcd"

    one, other = Measured("a", "first", "unit-1", *fields), Measured("b", "second", "unit-2", *fields)
    assert counted_once([one, one]) == [one]
    with pytest.raises(
        SettingsError, match="first of unit unit-1 and second of unit unit-2 are calibrations of the same"
    ):
        counted_once([one, other])
