"""From a recording without a reference to a calibration, by standstills and the turns between them."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.estimation.uncertainty import Contribution, along
from kreisel.estimation.uncertainty_budget import Source
from kreisel.geometry.rotation import Array, Mask, skew
from kreisel.preparation.axis_order import LEFT_HANDED_GYROS, disorder, in_order, turn_between
from kreisel.preparation.gravity import NO_LATITUDE, UNKNOWN_SD, site_of
from kreisel.progress import Progress, of_step
from kreisel.recording.recording import DataWarning, Recording
from kreisel.static.after_turns import settled
from kreisel.static.count_sizes import in_quantities
from kreisel.static.known_attitudes import Faces
from kreisel.static.lost_share import lost_share
from kreisel.static.multi_position import StaticEstimate, estimate_static, part_about, shows_even_terms
from kreisel.static.rate_size import check_rate_size
from kreisel.static.rest_problem import RestProblem, nuisance, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.slow_ends import UNSURE, with_slow_ends
from kreisel.static.slow_turn import common_turn, effect_of
from kreisel.static.static_methods import SQUARENESS, Chosen, with_method
from kreisel.static.static_parts import Judged, budget_of, parts_of
from kreisel.static.static_verdict import LOST, SKIPPED, judge_static
from kreisel.static.table_errors import with_table_errors
from kreisel.static.truncation import with_truncation
from kreisel.static.vertical_turn import effect_of_vertical, vertical_turn
from kreisel.units import MRAD
from kreisel.validation.imu_checks import check_dead
from kreisel.validation.masking import CHANNELS, without_spikes

_NO_GRAVITY = (
    "gravity is not known well: the accelerometers' scale factors are uncertain by 0.15 % for it (--gravity, or "
    "site.latitude_deg and site.height_m, state it)"
)

CLIPPED = (
    "standstills at which a reading is at the end of its range, and that are not used: {count}; choose a larger range"
)
"""What is said of standstills that are left out for this."""

_SPIKES = "samples that are spikes, and that are not used: {count}"
"""What is said of them."""

SILENT = (
    "the device sets its rates to zero while it stands still: the gyros' offsets are those by which turns fit, and "
    "hold for motion only"
)
"""What is said of such a device."""

_ROUNDS, _CONTRADICTED = 3, 3.5
"""Times that angles between faces may be found to be larger than stated, and deviations from which they are."""

_NOT_SQUARE = (
    "the faces are not at right angles: they are {angle:.2g} mrad off, by gravity and gyros, where {stated:.2g} mrad "
    "were expected (--squareness)"
)
"""What is said of such a case."""

_SHOWN = 30.0
"""Deviation of a parameter by half a recording, over that by all of it, up to which the half shows it. Chosen: halves
with about the same attitudes have 1.5 to 5; of a hinge in three mountings each half lacks one."""

_HALF = 10
"""Fewest standstills of half a recording that is compared with the other half."""

_WALKS = 3.0
"""Size of the offsets' walk, over their deviations, from which on it is said: a smaller one may be none."""

_STEADY, _WARM, _FEWEST = 0.7, 7.0, 10
"""Change of an offset from beginning to end, over its range and over the error of a standstill, from which on it counts
as warming up; and fewest standstills that show it. Chosen: of eight devices on one board it names all when they start
cold; in two warm runs, two of 48 gyro axes, which do drift."""

_NO_MIRROR = 0.5
"""Of two orders with the same trace, the one that is no mirror image is named: columns that are moved in a circle."""

_KNOWN = 0.1
"""Deviation of the gyros' matrix up to which it shows their axes."""

_BROKEN = "turns across which readings are missing, and that are not used: {count}"
"""What is said of turns that nothing measured as a whole."""

_TURNING = (
    "the device turns at its standstills, by {rate:.2g} rad/s about one of its axes, as gravity shows: the gyros' "
    "offsets are uncertain by as much; lay it down"
)
"""What is said of such standstills."""

_ALONG = 0.97
"""Component of a unit vector from which on it is called along an axis: within 14 deg."""


@dataclass(frozen=True)
class StaticOutcome:
    """A calibration from standstills, with its intermediate results.

    Attributes
    ----------
    found
        The estimate.
    halves : (P,) or None
        Difference of both halves of the recording over its deviation.
    calibration
        The result, in axes of the accelerometers.
    warnings
        What to know about it.
    method
        The one that was used, of `static_methods.METHODS`.
    """

    found: StaticEstimate
    halves: Array | None
    calibration: Calibration
    warnings: tuple[DataWarning, ...]
    method: str

    @property
    def up(self) -> str:
        """What is up at the first standstill, by the accelerometers: an axis with its sign, or a direction."""
        sensors = self.found.parameters.sensors
        force = sensors.K_a @ (self.found.problem.rests.forces[0] + sensors.k_a[0])
        up = force / np.linalg.norm(force)
        i = int(np.argmax(np.abs(up)))
        if abs(up[i]) > _ALONG:
            return f"{'+' if up[i] > 0.0 else '-'}{'xyz'[i]}"
        return "(" + ", ".join(f"{value:.2f}" for value in up) + ")"


def calibrate_static(
    recording: Recording, *, gravity: float | None = None, constant_offsets: bool = False, only: str | None = None,
    method: str | None = None, squareness: float = SQUARENESS, progress: Progress | None = None,
) -> StaticOutcome:  # fmt: skip
    """Return the calibration of a recording without a reference.

    Parameters
    ----------
    gravity
        Local gravity, m/s^2, instead of that of recording.toml.
    constant_offsets
        Whether offsets are taken to be constant, as other programs do; otherwise they may walk.
    only
        The sensor that the verdict is for.
    method
        One of `static_methods.METHODS`; None for the one that the data show.
    squareness
        Standard deviation of the angles between a case's faces, rad, where they are used.

    Raises
    ------
    RecordingError
        If there are no standstills, too few, or not those of the method.
    SettingsError
        For an unknown method.
    """
    began = time.perf_counter()
    table = recording.settings.site
    if gravity is not None:
        table = table.model_validate({**table.model_dump(), "gravity": gravity})
    site, of_site = site_of(table)
    check_dead(recording.imu, CHANNELS[3:])
    imu, spikes = without_spikes(recording.imu)
    imu, counts = in_quantities(imu, site.gravity)
    rests = find_rests(imu)
    lacking = 0.0
    if rests.silent:
        imu, lacking = with_slow_ends(imu)
    imu, rests, relaxing, settling = settled(imu, rests)
    if counts is None:
        check_rate_size(imu, rests)
    problem = RestProblem(imu, raw_of(imu), rests, site, constant_offsets=constant_offsets)
    chosen = replace(with_method(problem, method, recording.table, squareness), counts=counts)
    known = [] if site.gravity_sd < UNKNOWN_SD else [DataWarning("site", _NO_GRAVITY)]
    of_gravity = [warning for warning in of_site if warning is not NO_LATITUDE]
    clipped = [DataWarning("standstills", CLIPPED.format(count=rests.clipped))] if rests.clipped else []
    silent = [DataWarning("standstills", SILENT)] if rests.silent else []
    left = [DataWarning("imu", _SPIKES.format(count=spikes))] if spikes else []
    begins = [DataWarning("standstills", relaxing)] if relaxing else []
    said = (*recording.warnings, *chosen.warnings, *left, *clipped, *silent, *begins, *(of_gravity or known))
    return concluded(recording, replace(chosen, warnings=said), only, progress, began, lacking, settling)


def concluded(
    recording: Recording, chosen: Chosen, only: str | None, progress: Progress | None, began: float,
    lacking: float = 0.0, settling: str = "",
) -> StaticOutcome:  # fmt: skip
    """Return the estimate by a method, with account of uncertainty, verdict and result.

    Parameters
    ----------
    began
        `time.perf_counter()` at the beginning.
    lacking
        Share of turns that was restored, of a device that sets its rates to zero.
    settling
        Why turns do not show the gyros' matrix; empty where they do.

    Raises
    ------
    RecordingError
        If nothing fits, or if gyros and accelerometers have not the same axes.
    """
    found = estimate_static(chosen.problem, chosen.start, of_step(progress, "fit"), chosen.attitudes)
    chosen, found = _skewed(chosen, found, progress)
    chosen, found = with_table_errors(chosen, found, progress)
    chosen, found = with_truncation(chosen, found, progress)
    if chosen.counts is None:  # the sign of a count is a part of what is found
        _check_axes(found)
    rests = found.problem.rests
    least, most = lost_share(found.problem.imu, rests, found.noise.turn)
    walked = _walked(found)
    own = found.problem.reported
    turning, vertical = common_turn(rests), vertical_turn(found)
    contributions = [
        *_contributions(found, walked, most, UNSURE * lacking, chosen),
        Contribution("standstills that turn", Source.MISFIT, effect_of(turning, found)),
        Contribution("what turns about the vertical", Source.MISFIT, effect_of_vertical(vertical, found)),
    ]
    more = [replace(one, columns=one.columns[:own]) for one in contributions]
    covariance = np.asarray(found.covariance[:own, :own] + sum(one.covariance for one in more))
    halves = _halves(found, walked)
    halves = None if halves is None else halves[:own]
    warnings = (*chosen.warnings, *_remarks(found, walked, least))
    if turning.any():
        warnings = (*warnings, DataWarning("standstills", _TURNING.format(rate=float(np.linalg.norm(turning)))))
    if vertical is not None and not vertical.reason:
        warnings = (*warnings, DataWarning("standstills", vertical.remark))
    latitude = "" if vertical is None else vertical.reason
    against_gyros = [reason for reason in (latitude, settling) if reason]
    verdict = judge_static(found, np.sqrt(np.diag(covariance)), halves, only, against_gyros, least)
    judged = Judged(chosen, covariance, budget_of(found, more), verdict, time.perf_counter() - began, warnings)
    names = found.problem.names[:own]
    calibration = Calibration(
        **vars(parts_of(recording, found, judged)), names=names, covariance=covariance,
        prior_deviation=found.problem.width[:own], estimates=np.zeros((0, 1 + 2 * len(names))),
    )  # fmt: skip
    return StaticOutcome(found, halves, calibration, warnings, chosen.name)


def _skewed(chosen: Chosen, found: StaticEstimate, progress: Progress | None) -> tuple[Chosen, StaticEstimate]:
    """Return method and estimate with faces as far from right angles as gravity and gyros show them to be."""
    stated, angle = None, 0.0
    for _ in range(_ROUNDS):
        faces = next((one for one in found.problem.known if isinstance(one, Faces)), None)
        if faces is None:
            break
        d = found.problem.layout["case"]
        moved, own = np.abs(nuisance(found.parameters, "case", 6)[3:]), found.deviation[d][3:]
        prior = found.problem.width[d][3:]
        share = np.maximum(1.0 - (own / prior) ** 2, 1e-12)  # of the information that the data give
        if np.max(moved / np.sqrt(share * own**2 + share**2 * prior**2)) < _CONTRADICTED:
            break
        stated, angle = faces.squareness if stated is None else stated, float(np.max(moved / share))
        known = tuple(replace(one, squareness=angle) if one is faces else one for one in found.problem.known)
        chosen = replace(chosen, problem=replace(chosen.problem, known=known))
        found = estimate_static(chosen.problem, chosen.start, of_step(progress, "fit"), chosen.attitudes)
    if stated is None:
        return chosen, found
    said = DataWarning("method", _NOT_SQUARE.format(angle=angle / MRAD, stated=stated / MRAD))
    return replace(chosen, warnings=(*chosen.warnings, said)), found


def _check_axes(found: StaticEstimate) -> None:
    """Raise an error for columns in the wrong order, or with wrong signs.

    Turns and gravity are the same in a mirror, with accelerometers that point the other way: of the two orders the one
    with fewer faults is named. Gyros that turn the wrong way do so in a mirror, too.
    """
    problem, sensors = found.problem, found.parameters.sensors
    if not problem.own_frame or found.deviation[problem.layout["gyro_cross_coupling"]].max() > _KNOWN:
        return
    if np.linalg.det(sensors.K_omega) < 0.0:
        raise RecordingError(LEFT_HANDED_GYROS, file=problem.imu.source)
    F = turn_between(sensors.K_omega, sensors.K_a)
    F = max(F, -F, key=lambda order: float(np.trace(order) + _NO_MIRROR * np.linalg.det(order)))
    wrong = disorder(F)
    if wrong is not None and not in_order(F):
        chips = "; the same holds for a chip that is turned against the other" if np.linalg.det(F) < 0.0 else ""
        raise RecordingError(wrong + chips, file=problem.imu.source)


def _contributions(
    found: StaticEstimate, walked: Array, lost: float, lacking: float, chosen: Chosen
) -> list[Contribution]:  # fmt: skip
    """Return what the estimate does not know.

    walked: see `_walked`; lost, lacking: shares by which turns may be too small, for samples and for slow ends.
    """
    scale = found.parameters.sensors.K_omega.ravel()
    d = found.problem.layout["gyro_cross_coupling"]
    return [
        Contribution("offsets walk", Source.MISFIT, np.diag(np.sqrt(walked))),
        Contribution("undecided error terms", Source.EFFECTS, found.undecided),
        Contribution("lost samples", Source.CLOCKS, along(walked.size, d, lost * scale)),
        Contribution("rates set to zero", Source.MISFIT, along(walked.size, d, lacking * scale)),
        Contribution("whose seconds are true", Source.CLOCKS, along(walked.size, d, chosen.time_base_sd * scale)),
        Contribution("the robot's frames", Source.ROBOT, _turned(found, chosen)),
    ]


def _turned(found: StaticEstimate, chosen: Chosen) -> Array:
    """Return the effect of a body that is turned about each of its axes, (P, 3): as much as its attitudes differ."""
    layout, sensors = found.problem.layout, found.parameters.sensors
    out = np.zeros((layout.degrees, 3))
    if not chosen.frame_sd:
        return out
    angle = max(chosen.frame_sd, *found.noise.known)
    for i, axis in enumerate(np.eye(3)):
        for group, K in (("gyro_cross_coupling", sensors.K_omega), ("accel_cross_coupling", sensors.K_a)):
            out[layout[group], i] = (angle * skew(axis) @ K).ravel()[layout.present(group)]
    return out


def _walked(found: StaticEstimate) -> Array:
    """Return the variance (P,) by how far walking offsets are from those in the middle: its mean over time.

    Where they change steadily, as while a unit warms up, those at the end are what it will have.
    """
    rests, layout = found.problem.rests, found.problem.layout
    span = float(rests.seconds[-1] - rests.seconds[0])
    out = np.zeros(layout.degrees)
    walks = (found.noise.gyro_walk, found.noise.accel_walk)
    for group, walk, path, steady in zip(
        ("gyro_offset", "accel_offset"), walks, found.walks, _steady(found), strict=True
    ):
        usual = np.full(3, 0.25 * walk**2 * span)
        out[layout[group]] = np.where(steady, np.maximum(usual, path[-1] ** 2), usual)
    return out


def _steady(found: StaticEstimate) -> tuple[Mask, Mask]:
    """Return which axes' offsets change steadily, by far more than standstills err, (3,) of either sensor."""
    rests = found.problem.rests
    sizes = (found.noise.rate, rests.density_w), (found.noise.force, rests.density_a)
    out = []
    for walk, (own, density) in zip(found.walks, sizes, strict=True):
        noise = np.sqrt(own**2 + density**2 / np.median(rests.durations))
        change, span = np.abs(walk[-1] - walk[0]), np.ptp(walk, axis=0)
        out.append((change > _STEADY * span) & (change > _WARM * noise) & (rests.count >= _FEWEST))
    return out[0], out[1]


def _halves(found: StaticEstimate, walked: Array) -> Array | None:
    """Return the difference of both halves over its deviation, (P,); None where they are too short.

    It is zero for a parameter that a half does not show: a step that large is not linear.
    """
    rests = found.problem.rests
    middle = rests.count // 2
    if middle < _HALF:
        return None
    parts = [part_about(found, own) for own in (np.arange(middle), np.arange(middle, rests.count))]
    (first, P), (second, Q) = parts
    # the middles of both halves are half a recording apart
    apart = (first - second) / np.sqrt(np.diag(P) + np.diag(Q) + 2.0 * walked)
    shown = np.maximum(np.diag(P), np.diag(Q)) < (_SHOWN * found.deviation) ** 2
    return np.asarray(np.where(shown, apart, 0.0))


def _remarks(found: StaticEstimate, walked: Array, lost: float) -> list[DataWarning]:
    layout = found.problem.layout
    out: list[DataWarning] = []
    for group, unit in (("gyro_offset", "rad/s"), ("accel_offset", "m/s^2")):
        size = float(np.sqrt(walked[layout[group]].max()))
        if size > _WALKS * float(found.deviation[layout[group]].max()):
            name = "gyro" if group.startswith("gyro") else "accelerometer"
            text = f"the {name} offsets walk by {size:.2g} {unit} (rms) from those in the middle of the recording"
            out.append(DataWarning("offsets", text))
    if not shows_even_terms(found.problem) and "accel_offset" in layout:
        text = (
            "six attitudes on faces do not separate asymmetry and square terms of the accelerometers from their offsets"
        )
        out.append(DataWarning("offsets", f"{text}: the offsets hold at one g; add attitudes between the faces"))
    out += _warming(found)
    if lost > LOST:
        out.append(DataWarning("imu", SKIPPED.format(share=100.0 * lost)))
    broken = np.setdiff1d(np.flatnonzero(~found.linear.turns.whole), found.problem.unused)
    if broken.size and np.ptp(found.problem.imu.rates, axis=0).all():
        out.append(DataWarning("turns", _BROKEN.format(count=broken.size)))
    for kind in ("force", "rate", "turn"):
        nodes = [node for k, node in found.left_out if k == kind]
        if nodes:
            what = "turns after standstills" if kind == "turn" else f"the {kind} of standstills"
            at = ", ".join(f"{found.problem.rests.seconds[n]:.1f} s" for n in nodes[:6])
            out.append(DataWarning("standstills", f"{what} at {at} do not fit and are left out"))
    return out


def _warming(found: StaticEstimate) -> list[DataWarning]:
    """Return the remarks about axes whose offsets change steadily."""
    out = []
    units = (("gyro", "rad/s"), ("accelerometer", "m/s^2"))
    for walk, steady, (name, unit) in zip(found.walks, _steady(found), units, strict=True):
        if steady.any():
            axes = ", ".join(axis for axis, one in zip("xyz", steady, strict=True) if one)
            change = float(np.abs(walk[-1] - walk[0])[steady].max())
            text = f"the offset of {name} {axes} changes by {change:.2g} {unit} from beginning to end"
            cause = "the unit warms up, its temperature changes, or it was switched off in between; warm it up first"
            out.append(DataWarning("offsets", f"{text}: {cause}"))
    return out
