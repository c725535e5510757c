"""The likeliest causes of what does not fit, or did not: each with its name, its figure, and how strongly it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import LatitudeCheck, SplitHalves
from kreisel.calibration.result_sections import Cause
from kreisel.estimation.consistency import MAX_REJECTED_IN_A_ROW
from kreisel.geometry.rotation import Array, Mask, lengths
from kreisel.model.considered_terms import describe
from kreisel.model.problem import Problem
from kreisel.preparation.gravity import UNKNOWN_SD
from kreisel.preparation.imu_noise import rounding_step
from kreisel.preparation.reference_noise import stamp_resolution
from kreisel.refinement.discrepancy import describe as describe_family
from kreisel.refinement.discrepancy_terms import RANGE
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.noise_adaptation import CONTRADICTION, imu_density
from kreisel.refinement.prior_conflict import MAX_SCORE, OFFSETS, prior_scores
from kreisel.refinement.turning_reference import (
    NO_EARTH_RATE,
    earth_rate_is_missing,
    turn_found,
    turn_in_words,
)
from kreisel.validation.stamp_checks import runs

_WALKS = {
    "gyro_offset": ("gyro offset walks", "the gyro offsets change during the recording"),
    "accel_offset": (
        "accel offset walks",
        "the accelerometer offsets change during the recording, or there are accelerations that the poses do not show "
        "(a base that moves, steps between samples)",
    ),
    "time_offset": ("clock walk", "the clocks' offset changes during the recording"),
}

_REPEATED, _GROSS, _SHAKEN = 0.01, 20.0, 3.0
"""Share of repeated or gross values that counts; size of a gross one, in medians; vibration, in noise at rest."""

_AGAIN = 3
"""Times from which what lasts is no change of the mount or the frames. Chosen: 3 to 4 in poses with passing errors."""

_NEAR = 5
"""Poses before and after one between which the motion is seen."""

_EXCERPT = 20_000
"""Samples that are enough to see whether readings are repeated."""

_COARSE = 1e-3
"""Step, as a share of the motion's size, below which rounding has no effect."""

_NOISY, _LITTLE = 1.1, 5.0
"""Times the noise by rounding from which stamps are a cause; weight of a cause that the model contains."""

_CERTAIN = 1e5
"""Weight of what is seen in the readings themselves, and of a turn that no arm's own errors make."""

_SENSORS = ("gyroscope", "accelerometer")

_LARGE_SLIP, _ALIKE = 0.5, 0.3
"""deg; rotation between the halves that is a slip's alone: errors of references are below 0.2; and the share of it by
which the two sensors may differ."""

_LARGE_TURN = 0.1
"""deg."""

_CUT_OFF = 100.0
"""Gain by which readings are cut off for certain. Chosen: a range that is exceeded shows by 500 and more; jitter of the
IMU's stamps, which is largest in fast turns, by 35."""


SEEN_IN_THE_DATA = frozenset({"vibration", "held poses", "pose outliers", "rounding", "stuck samples"})
"""Causes of larger noise that readings and poses show by themselves."""


def find_causes(estimate: Estimate, halves: SplitHalves | None, latitude: LatitudeCheck | None) -> tuple[Cause, ...]:
    """Return the causes that the checks point to, the likeliest first."""
    found = [
        *(Cause(e.group, describe(e), e.gain) for e in estimate.considered if e.included),
        *(Cause(*_WALKS[group], gain) for group, gain in estimate.walks.items()),
        *_slip(halves),
        *_range(estimate),
        *_site(estimate, latitude),
        *_offsets(estimate),
        *_robot(estimate),
        *_rounding(estimate),
        *_stamps(estimate),
        *_misstated(estimate),
        *_noise(estimate),
    ]
    return tuple(sorted(found, key=lambda cause: -cause.weight))


def slip_of_mount(halves: SplitHalves | None) -> tuple[Array, float] | None:
    """Return the rotation of the mount between the halves, (3,), rad, and its score; None where none shows.

    A large one, which both sensors share, counts by the estimator's own deviations: functions that follow it would hide
    it.
    """
    if halves is None:
        return None
    found = _common_turn(halves)
    if found is not None or halves.plain is None:
        return found
    large = _common_turn(replace(halves, deviation=halves.plain))
    if large is None or np.degrees(float(np.linalg.norm(large[0]))) < _LARGE_SLIP:
        return None
    turns = [turn for turn in (_turn(halves, sensor) for sensor in _SENSORS) if turn is not None]
    apart = float(np.linalg.norm(turns[0][0] - turns[1][0]))
    return large if apart < _ALIKE * float(np.linalg.norm(large[0])) else None


def _common_turn(halves: SplitHalves) -> tuple[Array, float] | None:
    """Return the rotation between the halves that both sensors share, beyond chance, and its score."""
    turns = [_turn(halves, sensor) for sensor in _SENSORS]
    if any(turn is None for turn in turns):
        return None
    (a, a_sd), (b, b_sd) = (turn for turn in turns if turn is not None)
    score = np.abs(0.5 * (a + b)) / np.hypot(a_sd, b_sd) * 2.0**0.5
    apart = np.abs(a - b) / np.hypot(a_sd, b_sd)
    worst = int(np.argmax(score))
    if score[worst] < MAX_SCORE or apart[worst] > score[worst]:
        return None
    return 0.5 * (a + b), float(score[worst])


def _slip(halves: SplitHalves | None) -> list[Cause]:
    """Return a slip of the mount."""
    found = slip_of_mount(halves)
    if found is None:
        return []
    turn, score = found
    angle = np.degrees(float(np.linalg.norm(turn)))
    text = f"the IMU turned in its mount by about {angle:.2g} deg"
    certain = _CERTAIN if angle > _LARGE_TURN else 0.0
    return [Cause("slipping mount", text, certain + 0.5 * score**2)]


def _turn(halves: SplitHalves, sensor: str) -> tuple[Array, Array] | None:
    """Return the rotation between the halves by one sensor's matrix, and its deviation, (3,) each."""
    stem = f"{sensor}.cross_coupling["
    place = {name[len(stem) - 1 :]: i for i, name in enumerate(halves.names) if name.startswith(stem)}
    if len(place) < 9:
        return None
    turn, sd = np.zeros(3), np.zeros(3)
    for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        plus, minus = place[f"[{i},{j}]"], place[f"[{j},{i}]"]
        turn[axis] = 0.5 * (halves.difference[plus] - halves.difference[minus])
        sd[axis] = 0.5 * float(np.hypot(halves.deviation[plus], halves.deviation[minus]))
    return turn, sd


def _range(estimate: Estimate) -> list[Cause]:
    """Return readings that are cut off near the ends of their range, before a filter or a factory's matrix."""
    found = [one for one in estimate.discrepancy if one.family.of == RANGE and one.gain > _CUT_OFF]
    return [Cause("exceeded range", f"{describe_family(one)}: move more gently", one.gain) for one in found]


def _site(estimate: Estimate, latitude: LatitudeCheck | None) -> list[Cause]:
    out = []
    if latitude is not None and latitude.doubtful:
        text = f"the stated latitude of {latitude.stated_deg:.4g} deg; the gyros show {latitude.found_deg:.1f} deg"
        mistaken = sum(e.gain for e in estimate.considered if e.included and e.group == "gyro_g_sensitivity")
        out.append(Cause("stated latitude", text, 0.5 * latitude.score**2 + mistaken))
    if estimate.stated is not None and earth_rate_is_missing(estimate.stated, estimate.problem):
        deviation = float(np.max(estimate.run.belief.standard_deviation[estimate.problem.layout["north"]]))
        out.append(Cause("no Earth rate", NO_EARTH_RATE, 0.5 * deviation**-2))
    turn = None if estimate.stated is None else turn_found(estimate.stated, estimate.problem, estimate.run)
    if turn is not None:
        out.append(Cause("turning reference", turn_in_words(*turn), 0.5 * (turn[0] / turn[1]) ** 2))
    if "gravity" in estimate.problem.layout:
        score = float(prior_scores(estimate.problem, estimate.run, "gravity", estimate.deviation).max())
        if score > MAX_SCORE:
            name = "stated gravity" if estimate.problem.site.earth_rate_n is None else "stated latitude"
            stated = estimate.problem.site.gravity_sd < UNKNOWN_SD
            what = "what is stated about gravity" if stated else "gravity, of which nothing is stated,"
            out.append(Cause(name, f"{what} {score:.1f} deviations off", 0.5 * score**2))
    return out


def _offsets(estimate: Estimate) -> list[Cause]:
    out = []
    for group, score in estimate.contradicted.items():
        text = f"the stated spread of the {OFFSETS[group]} offsets, which lie {score:.1f} deviations away"
        out.append(Cause("stated offsets", text, 0.5 * score**2))
    return out


def _robot(estimate: Estimate) -> list[Cause]:
    """Return errors of the arm that are far from what is stated."""
    if "robot_placement" not in estimate.problem.layout:
        return []
    scores = prior_scores(estimate.problem, estimate.run, "robot_placement", estimate.deviation)
    score = float(scores.max())
    if score <= MAX_SCORE:
        return []
    return [Cause("robot_placement", f"the robot's errors, up to {score:.1f} times what is stated", 0.5 * score**2)]


def _rounding(estimate: Estimate) -> list[Cause]:
    """Return readings that are rounded so coarsely that their errors do not average out at rest."""
    readings, out = estimate.problem.sensor.readings, []
    for name, values, unit in (("gyro", readings.rates, "rad/s"), ("accelerometer", readings.accelerations, "m/s^2")):
        step = rounding_step(values)
        if step > 0.0 and step > _COARSE * float(np.median(np.abs(values - np.median(values, axis=0)))):
            out.append(Cause("rounding", f"{name} readings are rounded to steps of {step:.2g} {unit}", _CERTAIN))
    return out


def _stamps(estimate: Estimate) -> list[Cause]:
    """Return stamps of the reference that the gyros show to be noisy."""
    problem = estimate.problem
    stamp = problem.noise.reference.stamp
    if stamp <= _NOISY * stamp_resolution(problem.reference) / 12.0**0.5:
        return []
    text = f"poses are taken at other times than stamped, by {1e3 * stamp:.2g} ms at random"
    return [Cause("jitter", text, _LITTLE)]


def _noise(estimate: Estimate) -> list[Cause]:
    """Return stated noise figures that the data contradict, or what makes the noise as large."""
    out, first, last = [], estimate.stated, estimate.problem
    if first is None:
        return []
    found, stated = last.noise.reference, first.noise.reference
    reference = max(found.position / stated.position, found.orientation / stated.orientation)
    if reference > CONTRADICTION:
        name, text = _of_poses(estimate)
        out.append(Cause(name, f"{text} ({reference:.1f} times the assumed noise)", _strength(name, reference)))
    gyro, accel = (a / b for a, b in zip(imu_density(last), imu_density(first), strict=True))
    if max(gyro, accel) > CONTRADICTION:
        name, text = _of_readings(estimate)
        size = max(gyro, accel)
        out.append(Cause(name, f"{text} ({size:.1f} times the assumed noise)", _strength(name, size)))
    return out


def _strength(name: str, factor: float) -> float:
    """Return a weight for noise that is larger by a factor: little where nothing tells why."""
    return (5.0 if name.startswith("stated") else 50.0) * float(np.log(factor))


def _of_poses(estimate: Estimate) -> tuple[str, str]:
    """Return what makes the poses noisy."""
    reference, history = estimate.problem.reference, estimate.run.history
    positions = reference.positions
    if positions is not None:
        step = lengths(np.diff(positions, axis=0))
        usual = 0.3 * float(np.percentile(step, 75))
        moved = lengths(positions[2 * _NEAR :] - positions[: -2 * _NEAR]) > 2 * _NEAR * usual
        held = float(np.mean((step[_NEAR : step.size + 1 - _NEAR] == 0.0) & moved))
        if held > _REPEATED:
            return "held poses", f"{100.0 * held:.0f} % of the poses repeat the one before"
    size = history.nis / history.degrees
    gross = size > _GROSS * np.median(size)
    if float(np.mean(gross & ~_lasting(gross | ~history.used))) > _REPEATED:
        return "pose outliers", "some poses, or readings, are grossly wrong"
    return "stated reference", "the poses are less accurate than stated"


def _lasting(marked: Mask) -> Mask:
    """Return the updates in marked runs that last; none if there are `_AGAIN` such runs."""
    lasting = lasting_runs(marked)
    return lasting if runs(lasting)[0].size < _AGAIN else np.zeros_like(lasting)


def lasting_runs(marked: Mask) -> Mask:
    """Return the updates in marked runs of `MAX_REJECTED_IN_A_ROW` or more."""
    out = np.zeros(marked.size, dtype=bool)
    for begin, end in zip(*runs(marked), strict=True):
        out[begin:end] = end - begin >= MAX_REJECTED_IN_A_ROW
    return out


def _of_readings(estimate: Estimate) -> tuple[str, str]:
    """Return what makes the readings noisy."""
    readings = estimate.problem.sensor.readings
    rate = lengths(readings.rates[:_EXCERPT])
    moving = rate[1:] > 0.2 * float(np.percentile(rate, 95))  # at rest, readings of few digits repeat
    for values in (readings.rates, readings.accelerations):
        same = np.all(np.diff(values[:_EXCERPT], axis=0) == 0.0, axis=1)
        repeated = float(np.mean(same[moving])) if moving.any() else 0.0
        if repeated > _REPEATED:
            return "stuck samples", f"{100.0 * repeated:.0f} % of the samples repeat the one before"
    quiet, busy = _third_differences(estimate.problem, estimate.problem.sensor.readings.accelerations)
    if busy > _SHAKEN * quiet > 0.0:
        return "vibration", f"the IMU vibrates while it moves: its noise is {busy / quiet:.0f} times that at rest"
    return "stated noise", "the IMU is noisier than stated"


def _misstated(estimate: Estimate) -> list[Cause]:
    """Return statements about the sensors that are of another device."""
    found = estimate.problem.noise.misstated
    if not found:
        return []
    sensors = max(found, key=lambda name: found[name])
    text = f"what is stated of the IMU: at rest the {sensors} are {found[sensors]:.0f} times as noisy"
    return [Cause("stated noise", text, _CERTAIN)]


def _third_differences(problem: Problem, values: Array) -> tuple[float, float]:
    """Return the usual size of third differences of readings (n, 3) at standstill and on the path; 0 without either."""
    stamps = problem.sensor.readings.stamps
    at = np.zeros(stamps.size - 3, dtype=bool)
    for interval in problem.schedule.standstills:
        a, b = np.searchsorted(stamps, (interval.start, interval.stop))
        at[a : max(b - 3, a)] = True
    if not at.any() or at.all():
        return 0.0, 0.0
    third = np.sum(np.diff(values, n=3, axis=0) ** 2, axis=1)
    return float(np.sqrt(np.median(third[at]))), float(np.sqrt(np.median(third[~at])))
