"""The likeliest causes of what does not fit, or did not: each with its name, its figure, and how strongly it shows."""

from __future__ import annotations

import numpy as np

from kreisel.calibration.evidence import LatitudeCheck, SplitHalves
from kreisel.calibration.parts import Cause
from kreisel.filtering.estimate import Estimate, describe
from kreisel.filtering.noise_adaptation import CONTRADICTION, imu_density
from kreisel.filtering.prior_conflict import MAX_SCORE, prior_scores
from kreisel.geometry.rotation import Array

_WALKS = {
    "gyro_offset": ("gyro offset walks", "the gyro offsets change during the recording"),
    "accel_offset": ("accel offset walks", "the accelerometer offsets change during the recording"),
    "time_offset": ("clock walk", "the clocks' offset changes during the recording"),
}

_OFFSETS = {"gyro_offset": "gyro", "accel_offset": "accelerometer"}


def find_causes(estimate: Estimate, halves: SplitHalves | None, latitude: LatitudeCheck | None) -> tuple[Cause, ...]:
    """Return the causes that the checks point to, the likeliest first."""
    found = [
        *(Cause(e.group, describe(e), e.gain) for e in estimate.considered if e.included),
        *(Cause(*_WALKS[group], gain) for group, gain in estimate.walks.items()),
        *_slip(halves),
        *_site(estimate, latitude),
        *_offsets(estimate),
        *_noise(estimate),
    ]
    return tuple(sorted(found, key=lambda cause: -cause.weight))


def _slip(halves: SplitHalves | None) -> list[Cause]:
    """Return a slip of the mount: a rotation between the halves that both sensors share."""
    if halves is None:
        return []
    turns = [_turn(halves, sensor) for sensor in ("gyroscope", "accelerometer")]
    if any(turn is None for turn in turns):
        return []
    (a, a_sd), (b, b_sd) = (turn for turn in turns if turn is not None)
    score = np.abs(0.5 * (a + b)) / np.hypot(a_sd, b_sd) * 2.0**0.5
    apart = np.abs(a - b) / np.hypot(a_sd, b_sd)
    worst = int(np.argmax(score))
    if score[worst] < 0.7 * MAX_SCORE or apart[worst] > score[worst]:
        return []
    angle = np.degrees(float(np.linalg.norm(0.5 * (a + b))))
    text = f"the IMU turned in its mount by about {angle:.2g} deg"
    return [Cause("slipping mount", text, 0.5 * float(score[worst]) ** 2)]


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


def _site(estimate: Estimate, latitude: LatitudeCheck | None) -> list[Cause]:
    out = []
    if latitude is not None and latitude.score > MAX_SCORE:
        text = f"the stated latitude of {latitude.stated_deg:.4g} deg; the gyros show {latitude.found_deg:.1f} deg"
        out.append(Cause("stated latitude", text, 0.5 * latitude.score**2))
    if "gravity" in estimate.problem.layout:
        score = float(prior_scores(estimate.problem, estimate.run, "gravity").max())
        if score > MAX_SCORE:
            name = "stated gravity" if estimate.problem.site.earth_rate_n is None else "stated latitude"
            out.append(Cause(name, f"what is stated about gravity, {score:.1f} deviations off", 0.5 * score**2))
    return out


def _offsets(estimate: Estimate) -> list[Cause]:
    out = []
    for group, score in estimate.contradicted.items():
        text = f"the stated spread of the {_OFFSETS[group]} offsets, which lie {score:.1f} deviations away"
        out.append(Cause("stated offsets", text, 0.5 * score**2))
    return out


def _noise(estimate: Estimate) -> list[Cause]:
    """Return stated noise figures that the data contradict."""
    out, first, last = [], estimate.stated, estimate.problem
    if first is None:
        return []
    found, stated = last.noise.reference, first.noise.reference
    reference = max(found.position / stated.position, found.orientation / stated.orientation)
    if reference > CONTRADICTION:
        out.append(
            Cause("stated reference", f"the poses are {reference:.1f} times less accurate than stated", reference)
        )
    imu = max(a / b for a, b in zip(imu_density(last), imu_density(first), strict=True))
    if imu > CONTRADICTION:
        out.append(Cause("stated noise", f"the IMU's noise is {imu:.1f} times what is stated", imu))
    return out
