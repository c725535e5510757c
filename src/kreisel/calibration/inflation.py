"""Contributions to the uncertainty of errors that are not estimated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.calibration.evidence import LatitudeCheck
from kreisel.calibration.frame_errors import axis_columns, frame_columns, repeatability_columns
from kreisel.calibration.linear_errors import LINEAR_ERRORS, linear_columns
from kreisel.estimation.uncertainty import Contribution, along, each, scaling
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import Array
from kreisel.inertial.earth import normal_gravity
from kreisel.inertial.slopes import usual_interval
from kreisel.inertial.vibration import SLOW, missed_by_sampling, most_missed
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import DELAYS, SMOOTHINGS, walk_of
from kreisel.model.problem import Problem, walked_variance
from kreisel.preparation.gravity import ANOMALY_SD
from kreisel.recording.recording import DataWarning
from kreisel.refinement.estimate import Estimate
from kreisel.units import DEG_PER_HOUR, MG

_TERMS = {
    **dict.fromkeys(DELAYS, 0.01),
    **dict.fromkeys(SMOOTHINGS, 1.5e-4),
}
"""Sizes (s, s^2) at which the terms that the model of an effect leaves out are as large as other uncertainties."""

_SMALL = 0.3
"""Size, over that of `_TERMS`, up to which nothing is added: deviations would grow by 4 %, the root of 1 + 0.3^2."""

_OFFSETS = ("gyro_offset", "accel_offset")

_SERIES = "delay or smoothing are large for a model that is the first terms of a series;"

_CRYSTALS = 2e-5
"""Difference of the rates of two clocks, of which nothing is known. Chosen: crystals are within 10 to 30 ppm."""

_CAREFUL = 300.0
"""How many stated latitudes are right for a wrong one."""

_GRAVITY_SHARE = 0.25
"""Share of a variance that would remain with gravity known; below it, gravity limits the result."""


def with_unestimated_errors(found: Estimate) -> Estimate:
    """Return the estimate with contributions of frames, linear errors and stamps, and the warnings about them."""
    problem, run, noise = found.problem, found.run, found.problem.noise
    layout, K_omega = problem.layout, run.parameters.sensors.K_omega
    out, warnings = [], []
    of_arm = max(noise.frame_sd) > 0.0
    frame_sd = length, angle = frame_deviations(found) if of_arm else (0.0, 0.0)
    if of_arm:
        columns = frame_columns(problem, run.parameters, frame_sd)
        out.append(Contribution("the robot's frames", Source.ROBOT, columns, common=True))
        first = (problem if found.stated is None else found.stated).noise.frame_sd[0]
        warnings.append(_frame_warning(length, angle, shown=abs(length - first) > 0.01 * first))
    if of_arm or noise.volume_sd > 0.0:
        linear = found.linear or found.estimator.linearise(problem, run)
        effect, mean = linear_columns(problem, linear, frame_sd)
        source = Source.ROBOT if of_arm else Source.PATH
        out.append(Contribution(LINEAR_ERRORS, source, effect, common=True))
        out.append(Contribution(f"{LINEAR_ERRORS} that show", source, mean))
    if len(noise.axes):
        out.append(Contribution("the robot's axes", Source.ROBOT, axis_columns(problem, run.parameters)))
        warnings.append(_axes_warning(problem))
    out.append(
        Contribution("the reference's repeatability", Source.STANDSTILL, repeatability_columns(problem, run.parameters))
    )
    if "time_offset" in layout:
        columns = each(layout.degrees, layout["time_offset"], noise.lateness)
        out.append(Contribution("lateness of stamps", Source.CLOCKS, columns))
    if "time_skew" in layout:
        # stamps may be later at the end than at the beginning
        columns = each(
            layout.degrees, layout["time_skew"], noise.lateness / max(float(np.ptp(run.history.seconds)), 1.0)
        )
        out.append(Contribution("change of the lateness of stamps", Source.CLOCKS, columns))
    elif "time_offset" in layout and not _skew_is_known(problem.settings):
        # the offset is that of the middle, and stated is that of the first pose
        middle = 0.5 * float(np.ptp(run.history.seconds))
        columns = each(layout.degrees, layout["time_offset"], _CRYSTALS * middle)
        out.append(Contribution("ratio of the clocks", Source.CLOCKS, columns))
    if "gyro_cross_coupling" in layout:
        longer = problem.columns("gyro_cross_coupling", noise.time_base_sd * K_omega.ravel())
        column = along(layout.degrees, layout["gyro_cross_coupling"], longer)
        out.append(Contribution("whose seconds are true", Source.CLOCKS, column))
    of_vibration, vibrating = _vibration(found)
    out += of_vibration
    warnings += vibrating
    factor = series_factor(found)
    if factor > 1.0:
        out.append(scaling("delay and smoothing as series", Source.MISFIT, found.as_noisy, factor))
        warnings.append(DataWarning("effects", f"{_SERIES} deviations by noise were multiplied by {factor:.2f}"))
    return found.adding(out, (*warnings, *_gravity_warning(problem, run)))


def _skew_is_known(settings: CalibrationSettings) -> bool:
    """Return whether the user states the ratio of the clocks."""
    return "time_skew" in settings.fixed or "timing.skew" in settings.fixed_parameters


def _vibration(found: Estimate) -> tuple[list[Contribution], list[DataWarning]]:
    """Return what vibration between the samples may do to the offsets, and the warning about it.

    It is not taken from the offsets: a device whose samples are means over their intervals vibrates more than they do.
    """
    problem, layout, readings = found.problem, found.problem.layout, found.problem.sensor.readings
    groups = [group for group in _OFFSETS if group in layout]
    small = {g: _SMALL * found.belief.standard_deviation[layout[g]] for g in groups}
    sampled = usual_interval(readings.stamps), readings.rates, readings.accelerations
    most = dict(zip(_OFFSETS, most_missed(*sampled), strict=True))
    if all(most[g] <= small[g].min(initial=np.inf) for g in groups):
        return [], []
    missed = dict(zip(_OFFSETS, missed_by_sampling(*sampled), strict=True))
    shown = {g: problem.columns(g, np.abs(missed[g])) for g in groups}
    if not any(np.any(shown[g] > small[g]) for g in groups):
        return [], []
    columns = np.hstack([each(layout.degrees, layout[g], shown[g]) for g in groups])
    of_rate, of_force = (float(np.linalg.norm(values)) for values in missed.values())
    message = (
        f"the IMU vibrates faster than {SLOW / sampled[0]:.3g} Hz, a tenth of its rate, and what this does to the mean "
        "rate and acceleration (coning and sculling) is only partly in its samples. Deviations of the offsets contain "
        f"up to {of_rate / DEG_PER_HOUR:.2g} deg/h and {of_force / MG:.2g} mg: "
        "record faster, or damp the mount"
    )
    return [Contribution("vibration between samples", Source.SENSOR, columns)], [DataWarning("vibration", message)]


def with_walked_deviations(found: Estimate, path_near: Callable[[Problem, Fit], Array]) -> Estimate:
    """Return the estimate with deviations of what walks that include how far it walked.

    By the distance of the value at the end from those at other moments of the recording, on average: the former is
    known better, but it is not the device's. What walks is known within the deviations at the end, but no worse than by
    the walk itself, whose mean square distance is half its variance over the recording. An error that only comes and
    goes looks like a walk of great density, but leads nowhere.

    Parameters
    ----------
    path_near
        Returns the most likely states before all updates, (u, size), of a problem near a fit.
    """
    problem, layout = found.problem, found.problem.layout
    if not found.walks:
        return found
    out, path, variance = [], path_near(problem, found.run), np.diag(found.run.belief.covariance)
    for group in found.walks:
        own = path[:, layout.stored(group)]
        walked = np.mean((own - own[-1]) ** 2, axis=0)
        unknown = np.minimum(2.0 * variance[layout[group]], 0.5 * walked_variance(problem, group))
        columns = each(layout.degrees, layout[group], np.sqrt(walked + unknown))
        source = Source.CLOCKS if group == "time_offset" else Source.SENSOR
        out.append(Contribution(walk_of(group), source, columns))
    return found.adding(out)


def with_doubtful_latitude(found: Estimate, check: LatitudeCheck | None) -> Estimate:
    """Return the estimate with deviations for a stated latitude that the Earth's rotation makes doubtful.

    Gravity would then be that of the latitude found. This counts with the probability that the stated one is wrong.
    """
    layout = found.problem.layout
    if check is None or not check.doubtful or "gravity" not in layout:
        return found
    odds = float(np.exp(min(0.5 * check.score**2, 100.0))) / _CAREFUL
    share = (odds / (1.0 + odds)) ** 0.5
    there, here = (normal_gravity(np.radians(deg)) for deg in (check.found_deg, check.stated_deg))
    i, P = layout["gravity"].start, found.run.belief.covariance
    column = share * (there - here) * P[:, [i]] / P[i, i]
    message = (
        f"the stated latitude of {check.stated_deg:.4g} deg is doubtful: the Earth's rotation in the gyros' readings "
        f"gives {check.found_deg:.1f} ± {check.deviation_deg:.1g} deg. Standard deviations of the accelerometers' "
        "scale factors contain the difference in gravity"
    )
    return found.adding([Contribution("doubtful latitude", Source.PRIOR, column)], [DataWarning("site", message)])


def with_open_periods(found: Estimate, periods: tuple[float, ...]) -> Estimate:
    """Return the estimate with a deviation of the time offset for shifts that fit as well, s."""
    layout = found.problem.layout
    if not periods or "time_offset" not in layout:
        return found
    column = np.zeros((layout.degrees, 1))
    column[layout["time_offset"]] = max(map(abs, periods))
    return found.adding([Contribution("repeated motion", Source.CLOCKS, column)])


def series_factor(found: Estimate) -> float:
    """Return the factor on deviations for delay and smoothing, the first terms of a series; 1 for small ones."""
    sizes = [
        float(np.abs(effect.value).max()) / _TERMS[effect.group]
        for effect in found.considered
        if effect.included and effect.group in _TERMS
    ]
    return (1.0 + max(sizes) ** 2) ** 0.5 if sizes and max(sizes) > _SMALL else 1.0


def _axes_warning(problem: Problem) -> DataWarning:
    axes = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in np.round(problem.noise.axes, 2) + 0.0)
    message = (
        f"all rotation is about three axes, one after the other: {axes} in b. Errors of the arm's axes are not "
        f"distinguished from those of the gyros' axes, and deviations contain {1e3 * problem.noise.axis_sd:.2g} mrad "
        "for them (move several joints at once, record joint angles, or state robot.angle_sd in recording.toml)"
    )
    return DataWarning("motion", message)


def _frame_warning(length: float, angle: float, *, shown: bool) -> DataWarning:
    """Return the warning about errors of an arm that cannot be estimated; shown: poses show their size."""
    as_shown = ", as large as the poses show" if shown else ""
    message = (
        "its geometric errors cannot be estimated without joint angles and robot.urdf: standard deviations contain "
        f"{1e3 * length:.2g} mm and {1e3 * angle:.2g} mrad for base and tool frame{as_shown} (robot.length_sd and "
        'robot.angle_sd in recording.toml state them; for motion capture, write reference.kind = "mocap")'
    )
    return DataWarning("robot", message)


def frame_deviations(found: Estimate) -> tuple[float, float]:
    """Return the deviations of base and tool frame of an arm whose errors cannot be estimated, m and rad.

    The errors that its poses show beyond what was assumed are those of its geometry. They change with the posture, and
    the part that does not is an error of the frames, which nothing shows: it counts as as large as the others.
    """
    now, first = found.problem.noise, (found.problem if found.stated is None else found.stated).noise
    length, angle = now.frame_sd
    own, assumed = now.reference, first.reference
    for name in ("position", "standstill_position"):
        length = float(np.sqrt(max(length**2, getattr(own, name) ** 2 - getattr(assumed, name) ** 2)))
    for name in ("orientation", "standstill_orientation"):
        angle = float(np.sqrt(max(angle**2, getattr(own, name) ** 2 - getattr(assumed, name) ** 2)))
    return length, angle


def _gravity_warning(problem: Problem, run: Fit) -> list[DataWarning]:
    """Return the warning that gravity's uncertainty limits the accelerometers' scale factors, if it does."""
    layout = problem.layout
    if "gravity" not in layout or "accel_cross_coupling" not in layout:
        return []
    P = run.belief.covariance
    g, K = layout["gravity"].start, layout["accel_cross_coupling"]
    # the mean relative change of the three scale factors, as a function of the entries of K_a
    of_entries = np.asarray(np.linalg.inv(run.parameters.sensors.K_a).T.ravel() / 3.0)
    mean_scale = problem.columns("accel_cross_coupling", of_entries)
    with_gravity = float(mean_scale @ P[K, K] @ mean_scale)
    known = with_gravity - float(mean_scale @ P[K, g]) ** 2 / float(P[g, g])
    if known > _GRAVITY_SHARE * with_gravity:
        return []
    message = (
        f"gravity is known to {problem.site.gravity_sd:.2g} m/s^2 only and limits the accelerometers' scale factors: "
        f"{1e6 * with_gravity**0.5:.0f} ppm instead of {1e6 * max(known, 0.0) ** 0.5:.0f} ppm "
        f"({_missing_of(problem)} in recording.toml)"
    )
    return [DataWarning("site", message)]


def _missing_of(problem: Problem) -> str:
    """Return what a user may still state of gravity, in words."""
    sd = problem.site.gravity_sd
    if sd <= ANOMALY_SD * 1.01:
        return "state site.gravity with site.gravity_sd, if it was measured,"
    height = "site.height_m" if problem.site.earth_rate_n is not None else "site.latitude_deg and site.height_m"
    return f"state {height}, or site.gravity with site.gravity_sd,"
