"""The problem of a further pass: updates by the estimated clocks, attitudes by the run before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import apply, conjugate, exp, multiply
from kreisel.inertial.readings import attitudes_at
from kreisel.inertial.strapdown import rate_coefficients
from kreisel.model.problem import Problem
from kreisel.model.schedule import MIN_UPDATES
from kreisel.preparation.reference_noise import with_measured_jitter
from kreisel.preparation.scheduling import schedule_updates
from kreisel.preparation.standstill_search import find_standstills
from kreisel.synchronization.clock import Clock

_ATTITUDE_SD = 0.01
"""rad; standard deviation of attitudes after the rates are integrated back from the end of a run."""


def assigns_otherwise(problem: Problem, clock: Clock) -> bool:
    """Return whether another clock assigns poses to other samples."""
    step = float(np.median(np.diff(problem.sensor.readings.stamps[:1000])))
    return problem.schedule.clock.distance(clock, problem.reference.seconds) > 0.5 * step


def rescheduled(problem: Problem, clock: Clock) -> Problem:
    """Return the problem with updates, standstills and their scatter by other clocks, if half a sample lies between."""
    if problem.reference.quaternions is None or not assigns_otherwise(problem, clock):
        return problem
    schedule, tau = problem.schedule, problem.reference.seconds
    standstills, noise = schedule.standstills, problem.noise
    if schedule.stillness is not None:
        standstills = find_standstills(schedule.stillness, problem.reference, clock, noise.reference)
        scatter = with_measured_jitter(noise.reference, problem.reference, standstills, clock)
        noise = replace(noise, reference=scatter)
    updates = schedule_updates(
        problem.sensor.readings, clock.imu_time(tau), problem.reference, standstills, schedule.interval
    )
    if len(updates) < MIN_UPDATES:
        return problem
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(updates), 1))
    schedule = replace(schedule, clock=clock, standstills=standstills, updates=updates, attitude=attitude)
    return replace(problem, schedule=schedule, noise=noise)


def with_attitudes_of(problem: Problem, run: Fit) -> Problem:
    """Return the problem with attitudes integrated back from the end of a run, if the reference has none.

    A run that starts with a guess of the attitude is nonlinear until the attitude has converged; the next run needs no
    guess. With gaps in the readings attitudes cannot be transferred, and the problem is returned unchanged.
    """
    readings, schedule = problem.sensor.readings, problem.schedule
    if problem.reference.quaternions is not None or len(readings.segments) > 1:
        return problem
    p, samples = run.parameters, np.array([update.last for update in schedule.updates])
    corrected = readings.with_effects({}, p.sensors.effects)
    free = attitudes_at(corrected, rate_coefficients(p.sensors), samples)
    level, down = problem.site.earth_rate_units
    earth = apply(p.q_rn, np.array([*(level * p.north), down * p.earth_down]))
    turned = exp(-(readings.stamps[samples] - readings.stamps[samples[-1]])[:, None] * earth)
    at_end = multiply(run.belief.mean[problem.layout.stored("attitude")], conjugate(free[-1]))
    attitude = multiply(turned, multiply(at_end, free))
    return replace(problem, schedule=replace(schedule, attitude=attitude, attitude_sd=_ATTITUDE_SD))
