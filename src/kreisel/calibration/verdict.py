"""Whether a result may be used, with the reasons if not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.calibration.causes import SEEN_IN_THE_DATA, find_causes
from kreisel.calibration.evidence import Evidence, LatitudeCheck, SplitHalves
from kreisel.calibration.parts import Consistency, Verdict
from kreisel.estimation.consistency import gate_bounds, lag_one, mean_normalised
from kreisel.filtering.estimate import Estimate
from kreisel.filtering.observability import Observability
from kreisel.filtering.prior_conflict import MAX_SCORE, largest_score
from kreisel.model.considered import describe
from kreisel.synchronization.results import Correlation

MAX_NIS = 4.0
MAX_REJECTED = 0.05
MAX_OUTLIERS = 0.3
"""Share of rejected updates, if they are single ones among poses that fit."""

MAX_CONTRADICTION, MAX_WHITE_CONTRADICTION = 3.0, 20.0
"""Factors on given noise figures: the larger one where the innovations are white, or the data show why, and all else
fits."""

MAX_MOVED = 1.0
"""Standard deviations by which the last pass may have moved the estimates."""

MAX_OFFSET_SCORE = 100.0
"""Stated deviations beyond which offsets are no longer those of a device of the stated grade."""

MAX_POSITION_SCALE = 2.5e-3
"""Relative; a larger error of the positions' scale is no longer that of a robot or of cameras."""

_LARGEST = {"accel_delay": 50e-3, "accel_smoothing": 1.5e-3, "reference_smoothing": 1.5e-3}
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


def judge(estimate: Estimate, evidence: Evidence) -> Verdict:
    """Return the verdict."""
    causes = find_causes(estimate, evidence.halves, evidence.latitude)
    named = frozenset(cause.name for cause in causes)
    reasons = [
        *_innovations(evidence.consistency, outliers="pose outliers" in named),
        *_halves(evidence.halves),
        *_latitude(evidence.latitude),
        *_priors(estimate),
        *_known(evidence.known),
        *_expansions(estimate),
        *_passes(estimate),
        *_noise(estimate, explained=bool(named & SEEN_IN_THE_DATA)),
        *(() if estimate.problem.settings.partial else motion_reasons(evidence.observability)),
        *_scale(estimate),
    ]
    if reasons and causes:
        reasons = [f"{reasons[0]}. Likeliest cause: {causes[0].text}", *reasons[1:]]
    return Verdict(not reasons, tuple(reasons), evidence.observability.unobservable, causes)


def _innovations(facts: Consistency, *, outliers: bool) -> list[str]:
    reasons = []
    allowed = MAX_OUTLIERS if outliers else MAX_REJECTED
    for name, nis in (("on the path", facts.nis_path), ("at standstill", facts.nis_standstill)):
        if nis > MAX_NIS:
            reasons.append(
                f"innovations {name} are {np.sqrt(nis):.1f} times larger than expected: "
                "model or noise figures do not fit"
            )
    if facts.rejected > allowed * facts.updates:
        reasons.append(
            f"{facts.rejected} of {facts.updates} updates were rejected: reference and IMU disagree; "
            "look for wrong units, lost samples, a slipping mount, or another run's poses"
        )
    return reasons


def _halves(halves: SplitHalves | None) -> list[str]:
    if halves is None:
        return []
    name, score = halves.worst()
    if score <= MAX_SCORE:
        return []
    return [
        f"the two halves of the recording give values of {name} that differ by {score:.1f} standard deviations: "
        "something changed during the recording (an offset that drifts or steps, a mount that slips), or the reference "
        "has errors that are not modelled"
    ]


def _latitude(check: LatitudeCheck | None) -> list[str]:
    if check is None or check.score <= MAX_SCORE:
        return []
    return [
        f"the stated latitude of {check.stated_deg:.4g} deg contradicts the Earth's rotation in the gyros' readings, "
        f"which gives {check.found_deg:.1f} ± {check.deviation_deg:.1g} deg: "
        "correct site.latitude_deg in recording.toml"
    ]


def _known(scores: Mapping[str, float]) -> list[str]:
    """Return the reasons about single parameters that lie far from the prior the user states."""
    return [
        f"{name} lies {score:.1f} standard deviations from the prior that is stated: correct it (prior in "
        "recording.toml, --prior)"
        for name, score in scores.items()
        if score > MAX_SCORE
    ]


_STATED = {
    "gyro_offset": ("gyro offsets", "imu.gyro_offset_sd or imu.grade"),
    "accel_offset": ("accelerometer offsets", "imu.accel_offset_sd or imu.grade"),
    "gravity": ("gravity", "site.gravity, site.gravity_sd, site.latitude_deg or site.height_m"),
    "robot_placement": ("the robot's placement errors", "robot.length_sd and robot.angle_sd"),
}
"""Groups with a prior the user states or accepts: their titles, and the keys of recording.toml."""


def _priors(estimate: Estimate) -> list[str]:
    """Return the reasons about estimates that lie far from their stated prior."""
    problem = estimate.problem
    reasons = [
        f"{_STATED[group][0]} lie {score:.0f} stated standard deviations away: this is not the device that "
        f"recording.toml describes; correct {_STATED[group][1]}"
        for group, score in estimate.contradicted.items()
        if score > MAX_OFFSET_SCORE
    ]
    for group, (title, keys) in _STATED.items():
        if group not in problem.layout or (group.endswith("_offset") and group not in problem.prior.stated):
            continue
        if group in estimate.walks:
            continue  # not one value
        far = largest_score(problem, estimate.run, group)
        if far > MAX_SCORE:
            verb = "lies" if group == "gravity" else "lie"
            reasons.append(
                f"{title} {verb} up to {far:.1f} stated standard deviations from the prior: correct {keys} "
                "in recording.toml, or look for an effect that is not modelled"
            )
    return reasons


def _expansions(estimate: Estimate) -> list[str]:
    """Return the reasons about effects that are too large: for their model, or to be what they seem."""
    scale = next((e for e in estimate.considered if e.included and e.group == "position_scale"), None)
    found = []
    if scale is not None and abs(float(scale.value[0])) > MAX_POSITION_SCALE:
        found.append(
            f"{describe(scale)}: more than a reference errs. The positions' unit, or what is stated about gravity "
            "(site.gravity, site.latitude_deg, site.height_m), is wrong: the accelerometers' scale depends on which"
        )
    return found + [
        f"{describe(effect)}: this is too large for its model, which is a series; mend the cause, or record more slowly"
        for effect in estimate.considered
        if effect.included and float(np.abs(effect.value).max()) > _LARGEST.get(effect.group, np.inf)
    ]


def _passes(estimate: Estimate) -> list[str]:
    if estimate.problem.settings.passes is not None or estimate.moved <= MAX_MOVED:
        return []
    return [
        f"after {estimate.passes} passes the estimates still move by {estimate.moved:.1f} standard deviations per "
        "pass: the motion is too weak for this model; move faster and farther, or fix groups (--fix)"
    ]


def _noise(estimate: Estimate, *, explained: bool) -> list[str]:
    reasons = []
    white = estimate.correlation_factor == 1.0 and estimate.problem.noise.correlation_time == 0.0
    if estimate.contradiction > (MAX_WHITE_CONTRADICTION if white or explained else MAX_CONTRADICTION):
        reasons.append(
            "the data contradict the given noise figures: the noise found is up to "
            f"{estimate.contradiction:.1f} times as large. The model does not fit (record "
            "the robot's joint angles), or the figures are wrong"
        )
    return reasons


def motion_reasons(seen: Observability) -> list[str]:
    """Return the reasons about parameters that every use needs and the motion does not show."""
    reasons = []
    lost = [name for name in seen.not_narrowed if name.startswith(_NEEDED)]
    if lost:
        reasons.append(
            f"not observable with this motion: {', '.join(lost[:4])}{' and others' if len(lost) > 4 else ''}; "
            "turn about all three axes, with standstills in different attitudes"
        )
    return reasons


def _scale(estimate: Estimate) -> list[str]:
    reasons = []
    sensors = estimate.run.parameters.sensors
    for name, K in (("gyroscope", sensors.K_omega), ("accelerometer", sensors.K_a)):
        scale = np.linalg.norm(np.linalg.inv(K), axis=1)
        if scale.max() > 1.5 or scale.min() < 0.67:
            reasons.append(
                f"{name} scale factors {np.round(scale, 3).tolist()} are far from 1: check its unit and range"
            )
    return reasons
