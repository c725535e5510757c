"""Errors of the reference that are linear in place or attitude: against refits of moved poses, and of whole cells."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.linear_errors import _fields, linear_columns
from kreisel.geometry.rotation import exp, multiply
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

from ...small_problem import camera_problem, small_problem, with_noise

NO_ARM = (0.0, 0.0)
SMALL, STEP = 1e-6, 2e-5
"""Deviations about which the data say nothing, and changes of poses for differences."""

ARM = (SMALL, SMALL)
"""m and rad; deviations of an arm's frames."""


def refitted(problem, run, fields, step):
    """Change of the parameters for poses at all times that are moved by a field, given at the updates alone."""
    updates = np.array([update.pose for update in problem.schedule.updates])
    moved = np.zeros((problem.reference.seconds.size, 6))
    moved[updates] = step * fields
    reference = replace(
        problem.reference,
        positions=problem.reference.positions + moved[:, :3],
        quaternions=multiply(problem.reference.quaternions, exp(moved[:, 3:])),
    )
    again = KalmanFilter().refit(replace(problem, reference=reference), run, gate=np.inf)
    return problem.layout.minus(again.belief.mean[:, None], run.belief.mean)[:, 0]


@pytest.mark.parametrize(
    ("cameras", "k"),
    [*((True, k) for k in (*range(6), 6, 14, 22, 32, 33, 34, 35)), *((False, k) for k in (0, 7, 15, 20, 32))],
)
def test_what_a_reference_that_errs_linearly_does_is_what_refits_say(cameras, k):
    problem, sizes = (with_noise(camera_problem(), volume_sd=SMALL), NO_ARM) if cameras else (small_problem(), ARM)
    run = KalmanFilter().refit(problem, KalmanFilter().fit(problem), gate=np.inf)
    effect, _ = linear_columns(problem, KalmanFilter().linearise(problem, run), sizes)
    fields, deviations = _fields(problem, sizes)
    small = STEP / max(1.0, float(np.abs(fields[:, :, k]).max()))
    ahead, back = (refitted(problem, run, fields[:, :, k], step) for step in (small, -small))
    n, sd = len(problem.parameter_names), run.belief.standard_deviation
    want = (ahead - back) / (2.0 * small) * deviations[k]
    # the estimate moves the other way than an error of the poses that it does not have
    found, want = np.abs(effect[:n, k] / sd[:n]), np.abs(want[:n] / sd[:n])
    np.testing.assert_allclose(found, want, rtol=0.05, atol=max(2e-5, 5e-3 * float(want.max())))


def test_data_that_show_an_error_leave_less_of_it():
    """Of errors far larger than the data allow, what they leave does not depend on how large they were."""
    problem = camera_problem()
    run = KalmanFilter().fit(problem)
    linear = KalmanFilter().linearise(problem, run)
    large, larger = (linear_columns(with_noise(problem, volume_sd=sd), linear, NO_ARM)[0] for sd in (1.0, 10.0))
    n, sd = len(problem.parameter_names), run.belief.standard_deviation
    first, second = (np.sqrt(np.sum((effect[:n] / sd[:n, None]) ** 2, axis=1)) for effect in (large, larger))
    np.testing.assert_allclose(first, second, rtol=0.05, atol=0.01)


@pytest.mark.parametrize(("ppm", "seed"), [(1500.0, 2), (-1500.0, 3)])
def test_a_wand_of_another_length_is_in_the_deviations(ppm, seed):
    """Without a site: the accelerometers' scale factors and gravity are wrong alike, and nothing contradicts."""
    cell = {"seed": seed, "seconds": 90.0, "reference": {"kind": "mocap", "position_scale_ppm": ppm}}
    truth, recording = simulate(Cell.model_validate(cell), Path("cell"))
    settings = RecordingSettings.model_validate({"reference": {"kind": "mocap"}})
    found = run_calibration(check_streams(replace(recording, settings=settings)), CalibrationSettings()).calibration
    assert found.accepted, found.verdict
    error = np.diag(found.sensors.K_a - truth.sensors.K_a)
    assert np.abs(error).min() > 5e-4
    assert np.abs(error / np.diag(found.sensor_sd.K_a)).max() < 3.0


def scale_column(problem, run):
    small = with_noise(problem, volume_sd=SMALL)
    return linear_columns(small, KalmanFilter().linearise(problem, run), NO_ARM)[0][:, 0]


def test_a_scale_of_positions_is_one_of_gravity_accelerometers_and_lever_arms():
    """Multiply positions, gravity, K_a and the lever arms by one number: readings stay, so nothing else moves.

    That is so where gravity is as good as unknown. Lever arms and K_a have priors of their own, which are wide against
    what this motion shows; a tenth of the change is left for them.
    """
    problem, scale = camera_problem(), 1e-3
    unknown = {"gravity": np.array([[1.0]])}
    prior = replace(problem.prior, covariance=problem.prior.covariance | unknown,
                    start_covariance=problem.prior.start_covariance | unknown)  # fmt: skip
    problem = replace(problem, prior=prior)
    run = KalmanFilter().fit(problem)
    column = linear_columns(with_noise(problem, volume_sd=1e-6), KalmanFilter().linearise(problem, run), NO_ARM)[0][
        :, 0
    ]
    column = scale / 1e-6 * column
    layout, p = problem.layout, run.parameters
    for group, value in (("gravity", [p.gravity]), ("accel_cross_coupling", p.sensors.K_a.ravel()),
                         ("lever_arms", p.sensors.lever_arms.ravel())):  # fmt: skip
        want = scale * np.array(value)
        np.testing.assert_allclose(column[layout[group]], want, atol=0.1 * np.abs(want).max())
    for group in ("gyro_cross_coupling", "gyro_offset", "time_offset", "alignment"):
        assert np.abs(column[layout[group]] / run.belief.standard_deviation[layout[group]]).max() < 0.1
    assert not column[len(problem.parameter_names) :].any()


def test_where_gravity_is_known_the_scale_enters_as_far_as_it_comes_from_motion():
    problem = camera_problem()
    run, d = KalmanFilter().fit(problem), problem.layout["accel_cross_coupling"]
    column = 1e-3 / SMALL * scale_column(problem, run)
    trace = column[d].reshape(3, 3).trace() / run.parameters.sensors.K_a.trace()
    assert 0.0 < abs(trace) < 0.3e-3


def test_where_cameras_have_no_such_errors_nothing_is_added():
    problem, linear = camera_problem(), KalmanFilter().linearise(camera_problem(), KalmanFilter().fit(camera_problem()))
    problem = with_noise(problem, volume_sd=0.0)
    effect, mean = linear_columns(problem, linear, NO_ARM)
    assert effect.shape == (problem.layout.degrees, 36)
    assert not effect.any()
    assert not mean.any()
