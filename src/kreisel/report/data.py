"""The data of the report, taken from a calibration's outcome, in the units of the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.evidence import CrossValidation, Drift, Injection, SplitHalves
from kreisel.calibration.outcome import Outcome
from kreisel.estimation.consistency import autocorrelation, chi_square_bound, mean_normalised, normalised_bounds
from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array, Indices, Mask, apply, conjugate, lengths, log, multiply
from kreisel.inertial.sensor_model import correct_angular_rate
from kreisel.inertial.strapdown import raw_readings, without_effects
from kreisel.report.thinning import Curve, Envelope, Single, enveloped_axes, every, thinned, thinned_axes
from kreisel.synchronization.clock import Clock
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MRAD, MS, PPM

EXCERPT = 8.0
"""Seconds of the recording shown raw and corrected."""

MAX_MARKERS = 2000
"""Largest number of markers of one kind in a figure; more of them make a browser slow."""

_MARGIN = 50  # samples beside the excerpt; chosen: above the reach of all derivatives, `slopes.REACH`
_ENERGY_POINTS = 500_000  # of which the excerpt is chosen: twenty minutes at 400 Hz
_HISTOGRAM_EDGES = np.linspace(-5.0, 5.0, 41)  # deviations; chosen: of a normal one 6e-7 lie beyond
_MAX_LAGS = 40  # updates; chosen: 10 to 20 s, at 0.24 and 0.48 s

Curves = tuple[Curve, ...]
Envelopes = tuple[Envelope, ...]


@dataclass(frozen=True)
class Spread:
    """Minimum and maximum value and rms over the recording, (3,) each."""

    least: Array
    greatest: Array
    rms: Array


@dataclass(frozen=True)
class ClockStep:
    """A step of finding the time relation: start of the reference in IMU seconds, and skew."""

    name: str
    start: float
    skew: float


@dataclass(frozen=True)
class Excitation:
    """Raw readings (deg/s, m/s^2), standstills (k, 2) and rejected updates in IMU seconds.

    `gyro_rate` and `reference_rate` are the norms of the rate (deg/s) by the gyros and by the reference, on one clock;
    `path` (k, 3) are positions in r, m, and `up` (k, 3) the upward direction in b, of the reference, some of all.
    """

    rates: Envelopes
    forces: Envelopes
    standstills: Array
    rejected: Single
    rate_spread: Spread
    force_spread: Spread
    at_standstill: float
    clock: tuple[ClockStep, ...]
    coefficient: float
    explained: float
    gyro_rate: Curve
    reference_rate: Curve
    path: Array
    up: Array


@dataclass(frozen=True)
class Kind:
    """Updates of one kind: their number, mean NIS per degree of freedom and the bounds of 95 %.

    `mean_bounds` are those of the mean, `bounds` those of a single update.
    """

    name: str
    count: int
    rejected: int
    degrees: int
    mean: float
    mean_bounds: tuple[float, float]
    bounds: tuple[float, float]


@dataclass(frozen=True)
class Residuals:
    """Innovations at every update: position (u, 3) mm, attitude (u, 3) mrad, and their statistics.

    The histogram's densities belong to the bins between `edges`; `normal` is the unit normal's at `steps`.
    """

    seconds: Single
    at_standstill: Mask
    used: Mask
    position: Single
    attitude: Single
    nis: Single
    kinds: tuple[Kind, ...]
    edges: Array
    densities: dict[str, Array]
    steps: Array
    normal: Array
    lags: Indices
    correlations: dict[str, Array]
    bound: float


@dataclass(frozen=True)
class Change:
    """Change of the readings of one triad by the calibration over an excerpt.

    raw (rotated by the nominal mount) and corrected in deg/s or m/s^2; their difference, and its rms by
    cause, in deg/s or mg.
    """

    raw: Curves
    corrected: Curves
    difference: Curves
    causes: dict[str, Array]


@dataclass(frozen=True)
class Difference:
    """The change of rates and of specific forces over the excerpt with the most rotation, in IMU seconds."""

    start: float
    stop: float
    rates: Change
    forces: Change


@dataclass(frozen=True)
class Track:
    """An estimate and its standard deviation over the updates, and the reported values."""

    axis: str
    seconds: Single
    value: Single
    deviation: Single
    reported: float
    reported_sd: float


@dataclass(frozen=True)
class Uncertainty:
    """Tracks by quantity, three axes each or one alone; prior and posterior; correlations (n, n).

    `names` and `groups` state to which parameter a row of the others belongs. Tracks of lever arms and time
    offset are less the reported value; those of offsets are biases, -k_0.
    """

    tracks: dict[str, tuple[Track, ...]]
    names: tuple[str, ...]
    groups: tuple[str, ...]
    prior: Array
    posterior: Array
    correlation: Single


@dataclass(frozen=True)
class DriftCurves:
    """Drift between updates in mm and mrad, its rms and its greatest value."""

    position: Curve
    attitude: Curve
    rms: tuple[float, float]
    greatest: tuple[float, float]


@dataclass(frozen=True)
class Unseen:
    """Drift on unseen data with nominal and with calibrated parameters."""

    trained_until: float
    updates: int
    nominal: DriftCurves
    calibrated: DriftCurves


@dataclass(frozen=True)
class ReportData:
    """All that the figures and tables of a report are made from."""

    outcome: Outcome
    excitation: Excitation
    residuals: Residuals
    difference: Difference
    uncertainty: Uncertainty
    unseen: Unseen | None
    halves: SplitHalves | None
    injection: Injection | None


def extract(
    outcome: Outcome,
    injection: Injection | None = None,
) -> ReportData:
    """Return what a report shows of an outcome and its validations."""
    excerpt = telling_excerpt(outcome)
    return ReportData(
        outcome=outcome,
        excitation=_excitation(outcome, excerpt),
        residuals=_residuals(outcome.estimate.run.history),
        difference=_difference(outcome, excerpt),
        uncertainty=_uncertainty(outcome),
        unseen=None if outcome.cross is None else _unseen(outcome.cross),
        halves=outcome.halves,
        injection=injection,
    )


def telling_excerpt(outcome: Outcome) -> slice:
    """Return the samples of the excerpt with the most rotation about all three axes together.

    It lies within one unbroken segment, and between the first and the last update where they are far
    enough apart.
    """
    readings, history = outcome.problem.sensor.readings, outcome.estimate.run.history
    t = readings.stamps
    step = every(t.size, _ENERGY_POINTS).step
    seconds, omega = t[::step], readings.rates[::step]
    energy = np.zeros((seconds.size, 3))
    np.cumsum(omega[:-1] ** 2 * np.diff(seconds)[:, None], axis=0, out=energy[1:])
    best, chosen = -1.0, slice(readings.segments[0][0], readings.segments[0][1] + 1)
    for first, last in readings.segments:
        low, high = max(t[first], history.seconds[0]), min(t[last], history.seconds[-1])
        starts = np.arange(low, max(high - EXCERPT, low) + 1e-9, 0.5)
        a = np.searchsorted(t, starts)
        b = np.minimum(np.searchsorted(t, starts + EXCERPT), np.searchsorted(t, high))
        begin, end = a // step, np.minimum(np.maximum(b, a) // step, seconds.size - 1)
        score = np.prod(np.cbrt(energy[end] - energy[begin]), axis=1)
        k = int(np.argmax(score))
        if b[k] - a[k] > 10 and score[k] > best:
            best, chosen = float(score[k]), slice(int(a[k]), int(b[k]))
    return chosen


def _excitation(outcome: Outcome, excerpt: slice) -> Excitation:
    imu, history = outcome.recording.imu, outcome.estimate.run.history
    t, preparation, found = imu.seconds, outcome.preparation, outcome.estimate.run.parameters
    gyro_rate, reference_rate = _rate_norms(outcome, excerpt)
    standstills = np.array([(one.start, one.stop) for one in outcome.problem.schedule.standstills]).reshape(-1, 2)
    return Excitation(
        rates=enveloped_axes(t, imu.rates / DEG),
        forces=enveloped_axes(t, imu.accelerations),
        standstills=standstills,
        rejected=history.seconds[~history.used].astype(np.float32),
        rate_spread=_spread(imu.rates, DEG),
        force_spread=_spread(imu.accelerations, 1.0),
        at_standstill=float(np.sum(standstills[:, 1] - standstills[:, 0]) / t[-1]),
        clock=(
            _step("correlation of rate norms", preparation.correlation.clock),
            _step("fit on three axes", preparation.rate_fit.clock),
            ClockStep("filter", found.start, found.skew),
        ),
        coefficient=preparation.correlation.coefficient,
        explained=preparation.rate_fit.explained,
        gyro_rate=gyro_rate,
        reference_rate=reference_rate,
        path=_path(outcome),
        up=_upward(outcome),
    )


def _step(name: str, clock: Clock) -> ClockStep:
    return ClockStep(name, clock.start, clock.skew)


def _spread(values: Array, unit: float) -> Spread:
    squares = np.einsum("ij,ij->j", values, values)
    return Spread(values.min(axis=0) / unit, values.max(axis=0) / unit, np.sqrt(squares / len(values)) / unit)


_POSES = 2000
"""Poses that are drawn of a path."""


def _path(outcome: Outcome) -> Array:
    """Return some of the reference's positions (k, 3); none where it has none."""
    positions = outcome.problem.reference.positions
    return np.zeros((0, 3)) if positions is None else positions[every(len(positions), _POSES)]


def _upward(outcome: Outcome) -> Array:
    """Return the upward direction in b at some of the reference's poses, (k, 3); none without orientations."""
    quaternions = outcome.problem.reference.quaternions
    if quaternions is None:
        return np.zeros((0, 3))
    q = quaternions[every(len(quaternions), _POSES)]
    gravity = outcome.calibration.alignment.gravity.value
    return np.asarray(apply(conjugate(q), np.broadcast_to(-gravity / np.linalg.norm(gravity), (len(q), 3))))


def _rate_norms(outcome: Outcome, excerpt: slice) -> tuple[Curve, Curve]:
    """Return the norms of the rate by corrected gyros and by the reference, over the same excerpt."""
    readings, parameters, reference = (
        outcome.problem.sensor.readings,
        outcome.estimate.run.parameters,
        outcome.problem.reference,
    )
    t = readings.stamps[excerpt]
    s = parameters.sensors
    temperature_difference = (
        None if readings.temperature_difference is None else readings.temperature_difference[excerpt]
    )
    raw = raw_readings(
        t, readings.rates[excerpt], readings.accelerations[excerpt], temperature_difference=temperature_difference
    )
    omega = correct_angular_rate(without_effects(raw, s)[0], s)
    gyro_rate = thinned(t, lengths(omega) / DEG)
    nothing = Curve(np.zeros(0, dtype=np.float32), np.zeros(0, dtype=np.float32))
    if reference.quaternions is None:
        return gyro_rate, nothing
    clock, tau = Clock(parameters.start, parameters.skew), outcome.problem.reference.seconds
    at = clock.imu_time(tau)
    inside = np.flatnonzero((at >= t[0]) & (at <= t[-1]))
    stride = max(1, round(0.06 / reference.interval))
    if inside.size <= stride + 1:
        return gyro_rate, nothing
    q, moment = reference.quaternions[inside], at[inside]
    turned = log(multiply(conjugate(q[:-stride]), q[stride:]))
    span = moment[stride:] - moment[:-stride]
    middle = 0.5 * (moment[stride:] + moment[:-stride])
    return gyro_rate, thinned(middle, lengths(turned) / span / DEG)


def _residuals(h: History) -> Residuals:
    path, standstill = h.used & ~h.at_standstill, h.used & h.at_standstill
    shown = every(h.seconds.size, MAX_MARKERS)
    position, orientation, velocity = slice(0, 3), slice(3, 6), slice(6, 9)
    samples = {
        "position, path": h.whitened[path, position],
        "attitude, path": h.whitened[path, orientation],
        "position, standstill": h.whitened[standstill, position],
        "attitude, standstill": h.whitened[standstill, orientation],
        "velocity, standstill": h.whitened[standstill, velocity],
    }
    lags = int(min(_MAX_LAGS, path.sum() // 4)) if path.sum() >= 12 else 0
    series = {"position": h.whitened[path, position], "attitude": h.whitened[path, orientation]}
    correlations = {name: _correlation(x, lags) for name, x in series.items()}
    steps = np.linspace(-5.0, 5.0, 201)
    return Residuals(
        seconds=h.seconds[shown].astype(np.float32),
        at_standstill=h.at_standstill[shown],
        used=h.used[shown],
        position=(h.innovation[shown, position] / MM).astype(np.float32),
        attitude=(h.innovation[shown, orientation] / MRAD).astype(np.float32),
        nis=(h.nis / h.degrees)[shown].astype(np.float32),
        kinds=tuple(
            _kind(name, h, which)
            for name, which in (("path", ~h.at_standstill), ("standstill", h.at_standstill))
            if which.any()
        ),
        edges=_HISTOGRAM_EDGES,
        densities={name: d for name, x in samples.items() if (d := _density(x)) is not None},
        steps=steps,
        normal=np.exp(-0.5 * steps**2) / np.sqrt(2.0 * np.pi),
        lags=np.arange(1, lags + 1, dtype=np.int64),
        correlations={name: c for name, c in correlations.items() if c is not None},
        bound=float(1.96 / np.sqrt(3.0 * max(int(path.sum()), 1))),
    )


def _kind(name: str, h: History, which: Mask) -> Kind:
    used = h.used & which
    degrees = int(np.median(h.degrees[which]))
    low, high = (chi_square_bound(tail, degrees) / degrees for tail in (0.975, 0.025))
    return Kind(
        name=name,
        count=int(which.sum()),
        rejected=int(np.sum(which & ~h.used)),
        degrees=degrees,
        mean=mean_normalised(h.nis[used], h.degrees[used]),
        mean_bounds=normalised_bounds(h.degrees[used]) if used.any() else (np.nan, np.nan),
        bounds=(float(low), float(high)),
    )


def _density(whitened: Array) -> Array | None:
    """Return the histogram's densities, the outermost bins with all values beyond; None for too few values."""
    values = whitened[np.isfinite(whitened)]
    if values.size < 30:
        return None
    inside = np.clip(values, _HISTOGRAM_EDGES[0], _HISTOGRAM_EDGES[-1])
    return np.asarray(np.histogram(inside, _HISTOGRAM_EDGES, density=True)[0])


def _correlation(series: Array, lags: int) -> Array | None:
    if lags < 1 or not np.isfinite(series).all():
        return None
    return np.mean([autocorrelation(series[:, i], lags)[1:] for i in range(3)], axis=0)


def _difference(outcome: Outcome, excerpt: slice) -> Difference:
    readings, sensors, nominal = (
        outcome.problem.sensor.readings,
        outcome.calibration.sensors,
        outcome.problem.prior.nominal.sensors,
    )
    segment = readings.segments[readings.segment_of(excerpt.start) or 0]
    wide = slice(max(excerpt.start - _MARGIN, segment[0]), min(excerpt.stop + _MARGIN, segment[1] + 1))
    rates, forces = readings.rates[wide], readings.accelerations[wide]
    temperature, temperature_difference = outcome.recording.imu.temperature, None
    if temperature is not None and readings.temperature_difference is not None:
        temperature, temperature_difference = temperature[wide], readings.temperature_difference[wide]
    omega, f = outcome.calibration.correct(rates, forces, readings.stamps[wide], temperature, check=False)
    cut = slice(excerpt.start - wide.start, excerpt.stop - wide.start)
    t = readings.stamps[excerpt]
    clean = without_effects(
        raw_readings(readings.stamps[wide], rates, forces, temperature_difference=temperature_difference), sensors
    )
    gyro = _parts(rates[cut], clean[0][cut], sensors.K_omega, sensors.k_w[0], nominal.K_omega, omega[cut])
    accel = _parts(forces[cut], clean[1][cut], sensors.K_a, sensors.k_a[0], nominal.K_a, f[cut])
    del gyro["lever arms"]  # rates have none
    return Difference(
        start=float(t[0]),
        stop=float(t[-1]),
        rates=_change(t, rates[cut] @ nominal.K_omega.T, omega[cut], DEG, DEG, gyro),
        forces=_change(t, forces[cut] @ nominal.K_a.T, f[cut], 1.0, MG, accel),
    )


def _parts(raw: Array, clean: Array, K: Array, k_0: Array, mount: Array, corrected: Array) -> dict[str, Array]:
    """Return the parts of the correction, (n, 3) each; their sum is corrected less raw rotated by the mount.

    clean: the readings without effects beyond offset and matrix.
    """
    parts = {
        "offset": np.broadcast_to(K @ k_0, raw.shape),
        "scale, cross-coupling and mount": raw @ (K - mount).T,
        "further error terms": (clean - raw) @ K.T,
        "lever arms": corrected - (clean + k_0) @ K.T,
    }
    if not np.any(clean != raw):
        del parts["further error terms"]
    return parts


def _change(t: Array, raw: Array, corrected: Array, unit: float, fine: float, parts: dict[str, Array]) -> Change:
    change = corrected - raw
    rms = {name: np.sqrt(np.mean(part**2, axis=0)) / fine for name, part in {**parts, "all": change}.items()}
    return Change(
        raw=thinned_axes(t, raw / unit),
        corrected=thinned_axes(t, corrected / unit),
        difference=thinned_axes(t, change / fine),
        causes=rms,
    )


def _uncertainty(outcome: Outcome) -> Uncertainty:
    problem, calibration = outcome.problem, outcome.calibration
    groups = tuple(g for g in problem.groups for _ in range(problem.layout[g].start, problem.layout[g].stop))
    deviation = np.sqrt(np.diag(calibration.covariance))
    safe = np.where(deviation > 0.0, deviation, 1.0)
    correlation = calibration.covariance / np.outer(safe, safe)
    return Uncertainty(
        tracks=_tracks(outcome, groups, correlation),
        names=calibration.names,
        groups=groups,
        prior=calibration.prior_deviation,
        posterior=deviation,
        correlation=correlation.astype(np.float32),
    )


def _tracks(outcome: Outcome, groups: tuple[str, ...], correlation: Array) -> dict[str, tuple[Track, ...]]:
    n = len(groups)
    table = outcome.calibration.estimates[every(outcome.calibration.estimates.shape[0], MAX_MARKERS)]
    seconds, deviations = table[:, 0], table[:, 1 + n :]
    values = _around_prior(outcome, table[:, 1 : 1 + n], deviations)
    covariance, parameters = outcome.calibration.covariance, outcome.estimate.run.parameters
    final = outcome.calibration.estimates[-1, 1 : 1 + n]
    tracks: dict[str, tuple[Track, ...]] = {}

    def columns(group: str) -> slice:
        return slice(groups.index(group), groups.index(group) + groups.count(group))

    def track(axis: str, value: Array, sd: Array, reported: float, reported_sd: float) -> Track:
        single = [x.astype(np.float32) for x in (seconds, value, sd)]
        return Track(axis, single[0], single[1], single[2], reported, reported_sd)

    for group, unit, relative, labels in (
        ("accel_offset", -MG, False, "xyz"),
        ("gyro_offset", -DEG_PER_HOUR, False, "xyz"),
        ("lever_arms", MM, True, "xyzxyzxyz"),
        ("time_offset", MS, True, "x"),
    ):
        if group not in groups:
            continue
        value, sd = values[:, columns(group)] / unit, deviations[:, columns(group)] / abs(unit)
        reported, own = final[columns(group)] / unit, covariance[columns(group), columns(group)] / unit**2
        if relative:
            value, reported = value - reported, np.zeros_like(reported)
        tracks[group] = tuple(
            track(labels[axis], value[:, i], sd[:, i], float(reported[i]), float(np.sqrt(own[i, i])))
            for i, axis in enumerate(outcome.problem.layout.present(group).tolist())
        )
    for group in ("gyro_cross_coupling", "accel_cross_coupling"):
        if group in groups:
            c, present = columns(group), outcome.problem.layout.present(group)
            K = parameters.stored(group)
            matrices, own = np.tile(K, (seconds.size, 1)), np.zeros((9, 9))
            matrices[:, present], own[np.ix_(present, present)] = values[:, c], correlation[c, c]
            scale, sd = _scales(matrices, _padded(deviations[:, c], present), own)
            final_sd = np.sqrt(np.diag(covariance)[c])[None]
            reported, reported_sd = _scales(K[None], _padded(final_sd, present), own)
            tracks[group] = tuple(
                track("xyz"[i], scale[:, i], sd[:, i], float(reported[0, i]), float(reported_sd[0, i]))
                for i in range(3)
            )
    return tracks


def _around_prior(outcome: Outcome, values: Array, deviations: Array) -> Array:
    """Return estimates over time (u, n), shifted so that they end at the reported values.

    The reported values contain the stated prior instead of the belief the run started with, by the whole covariance.
    Over time only standard deviations are kept. The line therefore approaches the reported value in proportion to the
    decrease of the start's share in each parameter.
    """
    problem, n = outcome.problem, values.shape[1]
    final = outcome.calibration.estimates[-1, 1 : 1 + n]
    moved = values.copy()
    for group in problem.groups:
        if group == "alignment":
            continue
        part = problem.layout[group]
        share = np.minimum((deviations[:, part] / np.maximum(deviations[0, part], 1e-300)) ** 2, 1.0)
        left = final[part] - moved[-1, part]
        moved[:, part] += left * np.minimum((1.0 - share) / np.maximum(1.0 - share[-1], 1e-9), 1.0)
    return moved


def _padded(own: Array, present: Indices) -> Array:
    """Return deviations of all elements of matrices, (u, 9), from those that are estimated; others have none."""
    out = np.zeros((len(own), 9))
    out[:, present] = own
    return out


def _scales(K: Array, deviation: Array, correlation: Array) -> tuple[Array, Array]:
    """Return scale errors and standard deviations (u, 3), ppm, of matrices K (u, 9).

    The correlations (9, 9) are the final ones, assumed at all times.
    """
    matrices = K.reshape(-1, 3, 3)
    rows = np.linalg.inv(matrices)
    scale = np.linalg.norm(rows, axis=2)
    # d|s_j| = -(s_j dK)(K^-1 s_j^T) / |s_j| with s_j row j of K^-1
    turned = np.einsum("uab,ujb->uja", rows, rows) / scale[:, :, None]
    J = -np.einsum("uja,ujb->ujab", rows, turned).reshape(-1, 3, 9) * deviation[:, None, :]
    variance = np.einsum("uji,ik,ujk->uj", J, correlation, J)
    return (scale - 1.0) / PPM, np.sqrt(np.maximum(variance, 0.0)) / PPM


def _unseen(cross: CrossValidation) -> Unseen | None:
    if cross.nominal.seconds.size == 0 or cross.calibrated.seconds.size == 0:
        return None
    return Unseen(
        cross.trained_until,
        int(cross.calibrated.seconds.size),
        _drift(cross.nominal),
        _drift(cross.calibrated),
    )


def _drift(drift: Drift) -> DriftCurves:
    shown = every(drift.seconds.size, MAX_MARKERS)
    sizes = drift.position / MM, drift.attitude / MRAD
    curves = [Curve(drift.seconds[shown].astype(np.float32), size[shown].astype(np.float32)) for size in sizes]
    rms, greatest = (
        tuple(float(f(size[np.isfinite(size)])) if np.isfinite(size).any() else np.nan for size in sizes)
        for f in (lambda x: np.sqrt(np.mean(x**2)), np.max)
    )
    return DriftCurves(curves[0], curves[1], (rms[0], rms[1]), (greatest[0], greatest[1]))


__all__ = [
    "Change",
    "Curve",
    "Difference",
    "DriftCurves",
    "Excitation",
    "Kind",
    "ReportData",
    "Residuals",
    "Track",
    "Uncertainty",
    "Unseen",
    "extract",
]
