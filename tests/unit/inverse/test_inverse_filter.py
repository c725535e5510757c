"""The inverse filter: its derivatives against differences, its result against a filter that goes forwards."""

from dataclasses import replace

import numpy as np
import pytest

import kreisel.inverse.inverse_filter as module
from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.errors import EstimationError
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.pose_spline import ORDER
from kreisel.inverse.inverse_filter import InverseFilter, inverted, smooth_motion
from kreisel.inverse.normal_equations import POINT
from kreisel.inverse.pose_rows import pose_rows
from kreisel.inverse.reading_rows import raw_samples, reading_rows
from kreisel.inverse.spline_knots import SPACINGS, first_spline, spacing_of
from kreisel.inverse.unknowns import MAX_INTERVALS, unknowns_of
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import with_groups

from ...small_problem import camera_problem, small_problem, with_noise

EFFECTS = (
    "gyro_g_sensitivity", "gyro_axis_delay", "gyro_asymmetry", "gyro_polynomial", "accel_delay", "accel_polynomial",
    "position_scale",
)  # fmt: skip


def near(problem):
    ekf = KalmanFilter("ekf", "derivatives")
    return ekf.refit(problem, ekf.fit(problem))


def at_a_result(problem, begin=10.0, end=14.0):
    """Return unknowns and a motion, both off the data a little, and the readings of a few seconds."""
    fit = near(problem)
    unknowns = unknowns_of(problem, fit.parameters, begin, end)
    rng = np.random.default_rng(2)
    step = 1e-3 * rng.normal(size=unknowns.count)
    unknowns = unknowns.moved(step)
    spline = first_spline(problem, fit.parameters, begin, end, 0.1)
    spline = spline.moved(1e-3 * rng.normal(size=(len(spline.positions), POINT)))
    return unknowns, spline, fit


def rows_of(unknowns, spline, fit):
    samples = raw_samples(unknowns, spline.begin, spline.begin + spline.spacing * spline.spans)
    return [*reading_rows(unknowns, spline, samples), *pose_rows(unknowns, spline, fit.history.used)]


PROBLEMS = {
    "cameras": camera_problem,
    "poses": small_problem,
    "effects": lambda: with_groups(camera_problem(), EFFECTS),
    "walks": lambda: with_noise(camera_problem(), offset_walk={"gyro_offset": 1e-4, "accel_offset": 1e-3}),
    "clock that walks": lambda: with_noise(camera_problem(), offset_walk={"time_offset": 1e-5}),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in ("poses", "walks") else name for name in PROBLEMS]
)
def test_derivatives_are_those_of_the_residuals(name):
    problem = PROBLEMS[name]()
    unknowns, spline, fit = at_a_result(problem)
    rows, h = rows_of(unknowns, spline, fit), 1e-6
    assert (unknowns.walking.size > 0) == ("walk" in name)
    walked = unknowns.walking.size * (MAX_INTERVALS if "walk" in name else 0)
    assert unknowns.count == len(problem.parameter_names) + walked + unknowns.still.size
    assert len(unknowns.still) > 3

    def differences(moved):
        after, before = moved(h), moved(-h)
        return [(b.residual - a.residual) / (2 * h) for a, b in zip(after, before, strict=True)]

    rng = np.random.default_rng(1)
    for column in rng.choice(unknowns.count, 12, replace=False):
        step = np.eye(unknowns.count)[column]
        found = differences(lambda size, step=step: rows_of(unknowns.moved(size * step), spline, fit))
        for own, wanted in zip(rows, found, strict=True):
            exact = own.by_parameters @ own.columns @ step
            size = max(np.abs(wanted).max(), 1e-3)
            # errors of poses turn a little with each other, and what is squared in effects changes with all of them
            assert np.abs(exact - wanted).max() / size < 0.02, column
    for point in rng.choice(len(spline.positions), 3, replace=False):
        for i in range(POINT):
            step = np.zeros((len(spline.positions), POINT))
            step[point, i] = 1.0
            found = differences(lambda size, step=step: rows_of(unknowns, spline.moved(size * step), fit))
            for own, wanted in zip(rows, found, strict=True):
                place = point - own.span
                exact = np.zeros_like(wanted)
                inside = np.flatnonzero((place >= 0) & (place < ORDER))
                exact[inside] = own.by_points[inside, :, POINT * place[inside] + i]
                assert np.abs(exact - wanted).max() / max(np.abs(wanted).max(), 1e-3) < 0.01


def compared(problem, fit, found):
    """Return differences of parameters in the fit's deviations, and ratios of deviations."""
    n = len(problem.parameter_names)
    sd = fit.belief.standard_deviation[:n]
    moved = problem.layout.minus(found.belief.mean[:, None], fit.belief.mean)[:n, 0]
    return np.abs(moved / sd), found.belief.standard_deviation[:n] / sd


def test_it_agrees_with_the_filter_that_goes_forwards_the_closer_its_points_are(monkeypatch):
    """Two estimators that share the model and nothing else: one integrates readings, the other differentiates."""
    problem = camera_problem()
    fit = near(problem)
    apart = []
    for spacing in (0.1, 0.025):
        monkeypatch.setattr(module, "spacing_of", lambda *_, spacing=spacing: spacing)
        moved, ratio = compared(problem, fit, inverted(problem, fit))
        apart.append(moved.max())
        assert ratio.min() > 0.99
        assert ratio.max() < 1.01
    assert apart[0] < 0.15
    assert apart[1] < 0.5 * apart[0]


def test_coloured_errors_are_taken_as_white_ones_that_are_larger():
    """Of positions on the path: lever arms know less than by the filter, and nothing claims to know more."""
    problem = small_problem()
    assert problem.noise.coloured.time > 0.0
    fit = near(problem)
    moved, ratio = compared(problem, fit, inverted(problem, fit))
    assert moved.max() < 1.0
    assert ratio.min() > 0.99
    assert ratio.max() < 2.0


def test_noise_of_readings_does_not_pull_at_effects():
    """Delays are derivatives of readings; those of the readings themselves pull by 0.2 deviations."""
    problem = with_groups(camera_problem(), ("accel_delay", "gyro_axis_delay"))
    fit = near(problem)
    moved, ratio = compared(problem, fit, inverted(problem, fit))
    assert moved.max() < 0.15
    assert ratio.min() > 0.98
    assert ratio.max() < 1.05


def test_it_follows_walks():
    """Offsets that walk are found at the end, as by the filter."""
    problem = with_noise(camera_problem(), offset_walk={"gyro_offset": 1e-4, "accel_offset": 1e-3})
    fit = near(problem)
    found = inverted(problem, fit)
    for group in ("gyro_offset", "accel_offset"):
        own = problem.layout[group]
        sd = fit.belief.standard_deviation[own]
        moved = (found.belief.mean - fit.belief.mean)[problem.layout.stored(group)]
        assert np.abs(moved / sd).max() < 1.0
        np.testing.assert_allclose(found.belief.standard_deviation[own], sd, rtol=0.25)


def test_the_motion_says_how_close_the_points_are():
    problem = camera_problem()
    unknowns = unknowns_of(problem, near(problem).parameters, 5.0, 30.0)
    samples = raw_samples(unknowns, 5.0, 30.0)
    readings = (samples.seconds, samples.rates, samples.forces)
    usual = spacing_of(*readings, samples.deviation)
    assert usual in SPACINGS
    assert spacing_of(*readings, 1e-3 * samples.deviation) < usual
    assert spacing_of(*readings, 1e3 * samples.deviation) == SPACINGS[0]


def test_a_motion_is_used_again():
    problem = camera_problem()
    inverse = InverseFilter(KalmanFilter("inverse", "derivatives"))
    first = inverse.fit(problem)
    again = inverse.refit(problem, first)
    assert first.motion is not None
    assert again.motion.begin == first.motion.begin
    moved = problem.layout.minus(again.belief.mean[:, None], first.belief.mean)[:, 0]
    n = len(problem.parameter_names)
    assert np.abs(moved[:n] / first.belief.standard_deviation[:n]).max() < 0.1
    state = stored_state(problem, smooth_motion(problem, first)[1].known)
    away = problem.layout.minus(state[:, None], again.belief.mean)[:n, 0]
    assert np.abs(away / first.belief.standard_deviation[:n]).max() < 0.1


def test_what_it_cannot_do_it_says():
    problem = camera_problem()
    fit = near(problem)
    printed = replace(problem, settings=CalibrationSettings(size_effect="fox2005"))
    with pytest.raises(EstimationError, match="size effect in its completed form only"):
        inverted(printed, fit)
    without = replace(problem, reference=replace(problem.reference, quaternions=None))
    with pytest.raises(EstimationError, match="has no orientations; choose another estimator"):
        inverted(without, fit)
    assert ESTIMATORS["inverse"].name == "inverse"
