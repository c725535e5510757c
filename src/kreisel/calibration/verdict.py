"""Whether a result may be used, with the reasons why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.observability import Observability
from kreisel.calibration.run import Estimate
from kreisel.estimation.consistency import lag_one, mean_normalised
from kreisel.geometry.rotation import Array

LARGEST_NIS = 4.0
MOST_REJECTED = 0.1
LARGEST_CONTRADICTION = 3.0
_NEEDED = ("gyroscope.cross_coupling", "gyroscope.offset", "accelerometer.offset")


@dataclass(frozen=True)
class Consistency:
    """What the innovations say.

    `nis_*` are means per degree of freedom; `lag_one` the correlation of neighbouring whitened innovations
    of position and orientation, (6,).
    """

    nis_path: float
    nis_standstill: float
    updates: int
    rejected: int
    lag_one: Array
    correlation_factor: float


@dataclass(frozen=True)
class Verdict:
    """Accepted or not, and why not."""

    accepted: bool
    reasons: tuple[str, ...]


def consistency(estimate: Estimate) -> Consistency:
    """Return the consistency of an estimate's last pass."""
    h = estimate.run.history
    path, rest = h.used & ~h.at_rest, h.used & h.at_rest
    return Consistency(
        nis_path=mean_normalised(h.nis[path], h.degrees[path]),
        nis_standstill=mean_normalised(h.nis[rest], h.degrees[rest]),
        updates=h.nis.size,
        rejected=int(np.sum(~h.used)),
        lag_one=lag_one(h.whitened[:, :6], path),
        correlation_factor=estimate.correlation_factor,
    )


def judge(estimate: Estimate, seen: Observability, facts: Consistency) -> Verdict:
    """Return the verdict."""
    reasons = []
    for name, nis in (("on the path", facts.nis_path), ("at rest", facts.nis_standstill)):
        if nis > LARGEST_NIS:
            reasons.append(
                f"innovations {name} are {np.sqrt(nis):.1f} times larger than believed: "
                "model or noise figures do not fit"
            )
    if facts.rejected > MOST_REJECTED * facts.updates:
        reasons.append(
            f"{facts.rejected} of {facts.updates} updates had to be set aside: reference and IMU disagree; "
            "look for wrong units, lost samples, a slipping mount, or another run's poses"
        )
    if estimate.contradiction > LARGEST_CONTRADICTION:
        reasons.append(
            f"the data contradict the given noise figures {estimate.contradiction:.1f} times: the model does not fit "
            "(try --polynomial-order 2, or record the robot's joint angles), or the figures are wrong"
        )
    lost = [name for name in seen.unshown if name.startswith(_NEEDED)]
    if lost:
        reasons.append(
            f"the motion does not show {', '.join(lost[:4])}{' and others' if len(lost) > 4 else ''}: "
            "turn about all three axes, with rests in different attitudes"
        )
    sensors = estimate.run.parameters.sensors
    for name, K in (("gyroscope", sensors.K_omega), ("accelerometer", sensors.K_a)):
        scale = np.linalg.norm(np.linalg.inv(K), axis=1)
        if scale.max() > 1.5 or scale.min() < 0.67:
            reasons.append(
                f"{name} scale factors {np.round(scale, 3).tolist()} are far from 1: check its unit and range"
            )
    return Verdict(not reasons, tuple(reasons))
