"""Whether a result may be used, with the reasons if not."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.causes import SEEN_IN_THE_DATA, find_causes, lasting_runs, slip_of_mount
from kreisel.calibration.data_sheet import MAX_ANGLE, MAX_SCALE, MAX_SPREAD, non_orthogonality, sensitivity
from kreisel.calibration.evidence import Evidence, LatitudeCheck, SplitHalves, StatedValue
from kreisel.calibration.result_sections import Cause, Consistency, Verdict
from kreisel.estimation.consistency import gate_bounds, lag_one, mean_normalised
from kreisel.model.calibration_settings import SENSORS
from kreisel.model.considered_terms import describe
from kreisel.model.groups import group_named
from kreisel.model.parameters import DELAYS, SMOOTHINGS, walk_of
from kreisel.preparation.gravity import UNKNOWN_SD
from kreisel.refinement import discrepancy
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.named_terms import OFFSET_OF
from kreisel.refinement.observability import Observability
from kreisel.refinement.prior_conflict import MAX_SCORE, OFFSETS, largest_score
from kreisel.synchronization.fits import Correlation

MAX_NIS = 4.0
"""Largest mean NIS over the degrees of freedom, expected to be 1. Chosen: errors twice as large as assumed; smaller
ones are left to the comparison of noise figures, `MAX_CONTRADICTION`."""

MAX_REJECTED = 0.05
"""Share of rejected updates. Chosen: of a right model the gate rejects one in a million
(`estimation.consistency.GATE`); single ones among poses that fit have a limit of their own."""

MAX_SCATTERED, _LASTING_SHARE = 0.1, 0.25
"""Share of rejected updates, if at most this share of them is in runs that last: noise differs from place to place. Six
random situations beyond `MAX_REJECTED` had 5.4 to 8.2 %, and none was 3 deviations off."""

MAX_OUTLIERS = 0.3
"""Share of rejected updates, if they are single ones among poses that fit."""

MAX_CONTRADICTION, MAX_EXPLAINED_CONTRADICTION = 3.0, 20.0
"""Factors on given noise figures: the larger where deviations follow the scatter of many parts, or the innovations are
white, or the data show why, and all else fits. Of 18 random situations without standstills beyond 3, none was 4
deviations off; of four on the list that were rejected for it alone, none was 2."""

_MIN_PARTS = 15
"""Moves between standstills, or parts of some seconds, from which their scatter is known well enough to take the place
of noise figures."""

_BOTH = 4.0
"""Deviations of the result between what two halves say, up to which it contains both: a mean of them lies half as far
from each."""

MAX_UNLISTED = 9.0
"""Rms of a sensor's errors that are on no list, and walk of its offsets, in deviations of usual devices' offsets, up to
which a result is accepted. Chosen: with 3, eight of 155 random situations were rejected needlessly."""

MAX_MOVED = 1.0
"""Standard deviations by which the last pass may have moved the estimates."""

MAX_OFFSET_SCORE = 100.0
"""Stated deviations beyond which offsets are no longer those of a device of the stated grade."""

MAX_POSITION_SCALE = 2.5e-3
"""Relative; a larger error of the scale of positions, by two deviations, is no longer that of a robot or of cameras."""

_LARGEST = {
    **dict.fromkeys(DELAYS, 50e-3),
    **dict.fromkeys(SMOOTHINGS, 1.5e-3),
}
"""Sizes (s, s^2) up to which the first terms of a series describe an effect."""

_NEEDED = ("gyroscope.cross_coupling", "gyroscope.offset", "accelerometer.offset")


def consistency(estimate: Estimate, correlation: Correlation) -> Consistency:
    """Return the consistency of an estimate's last pass.

    A rejected update counts with the bound of the gate: it is evidence against the model although the estimate does
    not use it, but the size of a single gross outlier must not dominate the mean.
    """
    h = estimate.run.history
    nis = estimate.run.excess * np.minimum(h.nis, gate_bounds(h.degrees))
    path, standstill = ~h.at_standstill, h.at_standstill
    return Consistency(
        nis_path=mean_normalised(nis[path], h.degrees[path]),
        nis_standstill=mean_normalised(nis[standstill], h.degrees[standstill]),
        updates=h.nis.size,
        rejected=int(np.sum(~h.used)),
        lag_one=lag_one(h.whitened[:, :6], path & h.used),
        correlation_factor=estimate.correlation_factor,
        synchronisation=correlation.coefficient,
    )


@dataclass(frozen=True)
class Reason:
    """A reason against a result.

    Attributes
    ----------
    text
        In words.
    sensors
        The sensors it is about.
    motion
        Whether it is the motion that does not show enough, and nothing that contradicts the model.
    own
        Whether it says its cause itself.
    """

    text: str
    sensors: tuple[str, ...] = SENSORS
    motion: bool = False
    own: bool = False


def judge(estimate: Estimate, evidence: Evidence) -> Verdict:
    """Return the verdict."""
    causes = find_causes(estimate, evidence.halves, evidence.latitude)
    named = frozenset(cause.name for cause in causes)
    settings = estimate.problem.settings
    # a slip is one change: parts do not scatter by it
    scattered = 0 if "slipping mount" in named else evidence.parts
    reasons = [
        *_innovations(evidence.consistency, _allowed(estimate, named)),
        *_halves(estimate, evidence.halves),
        *_slip(estimate, evidence.halves),
        *_latitude(evidence.latitude),
        *_priors(estimate),
        *_stated(evidence.stated),
        *_expansions(estimate),
        *_implausible(estimate),
        *_passes(estimate),
        *_noise(estimate, explained=scattered >= _MIN_PARTS or bool(named & SEEN_IN_THE_DATA)),
        *(() if settings.partial else motion_reasons(evidence.observability)),
        *_scale(estimate),
    ]
    asked = SENSORS if estimate.problem.reference.positions is not None else ("gyroscope",)
    return verdict_by(reasons, evidence.observability, causes, (settings.only,) if settings.only else asked)


def verdict_by(
    reasons: Sequence[Reason], seen: Observability, causes: tuple[Cause, ...], asked: tuple[str, ...] = SENSORS
) -> Verdict:
    """Return the verdict for reasons against a result.

    asked: the sensors that must be accepted.
    """
    sensors = {}
    for sensor in SENSORS:
        own = [reason for reason in reasons if sensor in reason.sensors]
        sensors[sensor] = "rejected" if any(not r.motion for r in own) else "not_observable" if own else "accepted"
    if sensors["gyroscope"] != "accepted" and sensors["accelerometer"] == "accepted":
        sensors["accelerometer"] = "not_observable"  # forces and attitudes are turned by what the gyros measure
    shown = [reason for reason in reasons if set(asked) & set(reason.sensors)]
    texts = [reason.text for reason in shown]
    others = [reason.text for reason in reasons if not set(asked) & set(reason.sensors)]
    accepted = all(sensors[sensor] == "accepted" for sensor in asked)
    unexplained = next((k for k, reason in enumerate(shown) if not reason.own and not reason.motion), None)
    if causes and unexplained is not None:
        texts[unexplained] += f". Likeliest cause: {causes[0].text}"
    return Verdict(accepted, tuple(texts), seen.unobservable, causes, sensors, tuple(others))


def _of(parameter: str) -> tuple[str, ...]:
    """Return the sensor that a parameter belongs to, by its name; both for others."""
    return tuple(sensor for sensor in SENSORS if parameter.startswith(f"{sensor}.")) or SENSORS


def _allowed(estimate: Estimate, named: Collection[str]) -> float:
    """Return the share of updates that may be rejected, by the causes that are named."""
    if "pose outliers" in named:
        return MAX_OUTLIERS
    rejected = ~estimate.run.history.used
    lasting = float(np.mean(lasting_runs(rejected)[rejected])) if rejected.any() else 0.0
    return MAX_SCATTERED if lasting <= _LASTING_SHARE and "slipping mount" not in named else MAX_REJECTED


def _innovations(facts: Consistency, allowed: float) -> list[Reason]:
    reasons = []
    for name, nis in (("on the path", facts.nis_path), ("at standstill", facts.nis_standstill)):
        if nis > MAX_NIS:
            size = f"{np.sqrt(nis):.1f} times larger than expected: model or noise figures do not fit"
            reasons.append(Reason(f"innovations {name} are {size}"))
    if facts.rejected > allowed * facts.updates:
        text = f"{facts.rejected} of {facts.updates} updates were rejected: reference and IMU disagree; look for "
        reasons.append(Reason(f"{text}wrong units, lost samples, a slipping mount, or another run's poses"))
    return reasons


def _halves(estimate: Estimate, halves: SplitHalves | None) -> list[Reason]:
    """Return the reasons about parameters of which the halves differ, by more than the result's deviations contain."""
    if halves is None:
        return []
    total = dict(zip(estimate.problem.parameter_names, estimate.deviation, strict=False))
    contained = np.array([_BOTH * total.get(name, 0.0) for name in halves.names])
    open_ = replace(halves, difference=np.where(np.abs(halves.difference) > contained, halves.difference, 0.0))
    found = []
    for sensor in SENSORS:
        name, score = open_.worst((f"{sensor}.",))
        if score > MAX_SCORE:
            text = (
                f"the two halves of the recording give values of {name} that differ by {score:.1f} standard "
                "deviations: something changed during the recording (an offset that drifts or steps, a mount that "
                "slips), or the reference has errors that are not modelled"
            )
            found.append((score, Reason(text, (sensor,))))
    return [reason for _, reason in sorted(found, key=lambda one: -one[0])]


def _slip(estimate: Estimate, halves: SplitHalves | None) -> list[Reason]:
    """Return the reason about a slip of the mount, unless the deviations contain the mounts before and after it."""
    found = slip_of_mount(halves)
    if found is None:
        return []
    d = estimate.problem.layout["gyro_cross_coupling"]
    # the rotation's share in K, row by row: half the difference of two elements
    P = estimate.belief.covariance[d, d]
    columns = np.array([[7, 2, 3], [5, 6, 1]])
    deviation = 0.5 * np.sqrt([P[i, i] + P[j, j] - 2.0 * P[i, j] for i, j in columns.T])
    if np.all(np.abs(found[0]) <= _BOTH * deviation):
        return []
    text = (
        f"the two halves of the recording give mounts {np.degrees(np.linalg.norm(found[0])):.2g} deg apart, more than "
        "the deviations of the result contain: it describes neither"
    )
    return [Reason(text)]


def _latitude(check: LatitudeCheck | None) -> list[Reason]:
    if check is None or check.score <= MAX_SCORE:
        return []
    text = (
        f"the stated latitude of {check.stated_deg:.4g} deg contradicts the Earth's rotation in the gyros' readings, "
        f"which gives {check.found_deg:.1f} ± {check.deviation_deg:.1g} deg: "
        "correct site.latitude_deg in recording.toml"
    )
    return [Reason(text, own=True)]


def _stated(values: Sequence[StatedValue]) -> list[Reason]:
    """Return the reasons about parameters whose estimate lies far from what the user states of them."""
    prior = "standard deviations from the prior that is stated: correct it (prior in recording.toml, --prior)"
    reasons = []
    for one in values:
        if one.score <= MAX_SCORE:
            continue
        fixed = (
            f"{one.name} is fixed, and the data without that differ from it by {one.difference:.3g} "
            f"± {one.deviation:.1g}: correct it, or let it be estimated (fixed in recording.toml, --fix)"
        )
        text = fixed if one.sd == 0.0 else f"{one.name} lies {one.score:.1f} {prior}"
        reasons.append(Reason(text, _of(one.name), own=True))
    return reasons


_STATED = {
    "gyro_offset": ("gyro offsets", "imu.gyro_offset_sd or imu.grade", ("gyroscope",)),
    "accel_offset": ("accelerometer offsets", "imu.accel_offset_sd or imu.grade", ("accelerometer",)),
    "gravity": ("gravity", "site.gravity, site.gravity_sd, site.latitude_deg or site.height_m", ("accelerometer",)),
    "robot_placement": ("the robot's placement errors", "robot.length_sd and robot.angle_sd", SENSORS),
}
"""Groups with a prior the user states or accepts: titles, keys of recording.toml, and the sensors they matter to."""


def _priors(estimate: Estimate) -> list[Reason]:
    """Return the reasons about estimates that lie far from their stated prior."""
    problem = estimate.problem
    reasons = [
        Reason(
            f"{_STATED[group][0]} lie {score:.0f} stated standard deviations away: this is not the device that "
            f"recording.toml describes; correct {_STATED[group][1]}",
            _STATED[group][2],
        )
        for group, score in estimate.contradicted.items()
        if score > MAX_OFFSET_SCORE
    ]
    for group, (title, keys, sensors) in _STATED.items():
        if group not in problem.layout or (group.endswith("_offset") and group not in problem.prior.stated):
            continue
        if group in estimate.walks:
            continue  # not one value
        far = largest_score(problem, estimate.run, group, estimate.deviation)
        if far > MAX_SCORE:
            verb = "lies" if group == "gravity" else "lie"
            text = (
                f"{title} {verb} up to {far:.1f} stated standard deviations from the prior: correct {keys} "
                "in recording.toml, or look for an error term that is not modelled"
            )
            if group == "gravity" and problem.site.gravity_sd >= UNKNOWN_SD:
                text = (
                    f"gravity is found to be {estimate.run.parameters.gravity:.3f} m/s^2, {far:.1f} standard "
                    "deviations from that of places on Earth: look for a wrong scale of the positions or of the "
                    "clocks, for offsets that are fixed (--fix), or an error term that is not modelled"
                )
            reasons.append(Reason(text, sensors))
    return reasons


def _expansions(estimate: Estimate) -> list[Reason]:
    """Return the reasons about effects that are too large: for their model, or to be what they seem."""
    scale = next((e for e in estimate.considered if e.included and e.group == "position_scale"), None)
    found = []
    if scale is not None and abs(float(scale.value[0])) > MAX_POSITION_SCALE + 2.0 * float(scale.deviation[0]):
        text = (
            f"{describe(scale)}: more than a reference errs. The positions' unit, or what is stated about gravity "
            "(site.gravity, site.latitude_deg, site.height_m), is wrong: the accelerometers' scale depends on which; "
            "or a filter of the tracker exaggerates fast moves: switch it off"
        )
        found.append(Reason(text, ("accelerometer",)))
    series = "this is too large for its model, which is a series; correct the cause, or record more slowly"
    return found + [
        Reason(f"{describe(effect)}: {series}", ("accelerometer",) if effect.group.startswith("accel") else SENSORS)
        for effect in estimate.considered
        if effect.included and float(np.abs(effect.value).max()) > _LARGEST.get(effect.group, np.inf)
    ]


def _implausible(estimate: Estimate) -> list[Reason]:
    """Return the reasons for errors on no list, and walks, larger than those of any device: something else is wrong."""
    found = []
    for one in estimate.discrepancy:
        sensor = one.family.owner
        if sensor in OFFSET_OF and one.size > _largest(OFFSET_OF[sensor]):
            words = discrepancy.describe(one)
            text = f"errors on no list are larger than those of any device ({words}): the model does not describe it"
            found.append(Reason(text, (sensor,)))
    for sensor, group in OFFSET_OF.items():
        if _walked(estimate, group) > _largest(group):
            text = (
                f"the {OFFSETS[group]} offsets change by more than those of any device: the model does not describe it"
            )
            found.append(Reason(text, (sensor,)))
    return found


def _walked(estimate: Estimate, group: str) -> float:
    """Return how far a group walked, SI; its density does not say that, for what comes and goes leads nowhere."""
    own = (float(np.abs(one.columns).max()) for one in estimate.contributions if one.cause == walk_of(group))
    return max(own, default=0.0)


def _largest(offset: str) -> float:
    """Return the largest error, SI, of a sensor that its offset, or errors on no list, may have."""
    return MAX_UNLISTED * (group_named(offset).usual_sd or np.inf)


def _passes(estimate: Estimate) -> list[Reason]:
    if estimate.problem.settings.passes is not None or estimate.moved <= MAX_MOVED:
        return []
    text = (
        f"after {estimate.passes} passes the estimates still move by {estimate.moved:.1f} standard deviations per "
        "pass: the motion is too weak for this model; move faster and farther, or fix groups (--fix)"
    )
    return [Reason(text)]


def _noise(estimate: Estimate, *, explained: bool) -> list[Reason]:
    white = estimate.correlation_factor == 1.0 and estimate.problem.noise.correlation_time == 0.0
    if estimate.contradiction <= (MAX_EXPLAINED_CONTRADICTION if white or explained else MAX_CONTRADICTION):
        return []
    unknown_arm = any(estimate.problem.noise.frame_sd)  # an arm without joint angles
    hint = " (record the robot's joint angles)" if unknown_arm else ""
    text = (
        f"the data contradict the given noise figures: the noise found is up to {estimate.contradiction:.1f} times as "
        f"large. The model does not fit{hint}, or the figures are wrong"
    )
    return [Reason(text)]


def motion_reasons(seen: Observability) -> list[Reason]:
    """Return the reasons about parameters that every use needs and the motion does not show."""
    reasons = []
    for sensor in SENSORS:
        lost = [name for name in seen.not_narrowed if name.startswith(_NEEDED) and sensor in _of(name)]
        if lost:
            text = (
                f"not observable with this motion: {', '.join(lost[:4])}{' and others' if len(lost) > 4 else ''}; "
                "turn about all three axes, with standstills in different attitudes"
            )
            reasons.append(Reason(text, (sensor,), motion=True))
    return reasons


def _scale(estimate: Estimate) -> list[Reason]:
    """Return the reasons about scale factors and axes that no device has."""
    reasons = []
    parameters, layout = estimate.run.parameters, estimate.problem.layout
    for sensor, group in (("gyroscope", "gyro_cross_coupling"), ("accelerometer", "accel_cross_coupling")):
        if group not in layout:
            continue
        K = parameters.stored(group).reshape(3, 3)
        sd = float(np.max(estimate.deviation[layout[group]]))
        scale, off = sensitivity(K)[0], np.abs(non_orthogonality(K))
        text = ""
        if scale.max() > MAX_SCALE or scale.min() < 1.0 / MAX_SCALE:
            text = f"{sensor} scale factors {np.round(scale, 3).tolist()} are far from 1: check its unit and range"
        elif float(np.ptp(scale)) > MAX_SPREAD + 3.0 * sd:
            text = f"{sensor} scale factors {np.round(scale, 3).tolist()} differ more than those of any device"
        elif float(off.max()) > MAX_ANGLE + 3.0 * sd:
            text = f"{sensor} axes are {np.degrees(off.max()):.0f} deg off right angles, more than those of any device"
        if text:
            hint = "" if "unit" in text else ": the motion or the reference has errors that are not modelled"
            reasons.append(Reason(text + hint, (sensor,), own=not hint))
    return reasons
