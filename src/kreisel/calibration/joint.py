"""One calibration from several recordings of one device."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.assembly import Judged, assemble
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.fusion import Fused, fuse
from kreisel.calibration.joint_outcome import Joint
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.parts import (
    Consistency,
    JointFacts,
    JointRecording,
    Measured,
    RecordingFacts,
    Verdict,
)
from kreisel.calibration.repeatability import repeatability
from kreisel.calibration.result import Calibration
from kreisel.calibration.sharing import DEFAULT, SHARED, Sharing, shift_of, turn_of
from kreisel.calibration.verdict import motion_reasons
from kreisel.errors import KreiselError, SettingsError, unknown_name
from kreisel.estimation.consistency import normalised_bounds
from kreisel.filtering.observability import observability
from kreisel.geometry.rotation import Array, log
from kreisel.model.groups import group_named
from kreisel.model.parameters import GROUPS, ROBOT_GROUPS
from kreisel.model.settings import BY_CHOICE, CalibrationSettings
from kreisel.progress import Progress, Together, one_by_one
from kreisel.recording.recording import DataWarning, Recording

_POLYNOMIALS = ("gyro_polynomial", "accel_polynomial")
_LEVEL = 0.01
"""Probability that recordings which agree are taken for recordings that differ."""

MAX_FACTOR = 3.0
"""Largest factor on deviations by which differences between recordings are covered."""


def calibrate_joint(
    recordings: Sequence[Recording],
    settings: CalibrationSettings | None = None,
    common: Collection[str] = DEFAULT,
    progress: Progress | None = None,
    *,
    names: Sequence[str] = (),
    together: Together = one_by_one,
) -> Joint:
    """Return one calibration of a device from several recordings of it.

    The parameters of the device are common. Clocks, the direction of gravity and of north are each recording's own.

    Parameters
    ----------
    common
        What the recordings have in common besides: words of `SHARED`.
    names
        Of the recordings; their own by default.

    Raises
    ------
    KreiselError
        If fewer than two of them can be used; the message says why.
    """
    unknown = [word for word in common if word not in SHARED]
    if unknown:
        raise SettingsError(unknown_name("thing in common", unknown[0], SHARED))
    named = tuple(names) or tuple(recording.name for recording in recordings)
    alone = _Alone(recordings, named, replace(settings or CalibrationSettings(), partial=True), progress, together)
    outcomes, left_out = alone.outcomes()
    if len(outcomes) < 2:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in left_out)
        few = "give two or more recordings of one device" if len(recordings) < 2 else "fewer than two can be used"
        raise SettingsError(f"{few}{f' ({reasons})' if reasons else ''}")
    return _brought_together(tuple(named[i] for i in outcomes), tuple(outcomes.values()), left_out, tuple(common))


@dataclass(frozen=True)
class _Alone:
    """The calibration of each recording alone, all with the same effects."""

    recordings: Sequence[Recording]
    names: Sequence[str]
    settings: CalibrationSettings
    progress: Progress | None
    together: Together

    def outcomes(self) -> tuple[dict[int, Outcome], tuple[tuple[str, str], ...]]:
        """Return the accepted ones by number, and names and reasons of the others."""
        outcomes, left_out = self._calibrated(range(len(self.recordings)), self.settings)
        wanted = _effects(outcomes.values())
        other = [i for i, one in outcomes.items() if _effects([one]) != wanted]
        if other:
            settings = _with_effects(self.settings, wanted)
            again, refused = self._calibrated(other, settings)
            outcomes = {i: again.get(i, one) for i, one in outcomes.items() if i in again or i not in other}
            left_out = {**left_out, **refused}
        return outcomes, tuple((self.names[i], left_out[i]) for i in sorted(left_out))

    def _calibrated(
        self, numbers: Iterable[int], settings: CalibrationSettings
    ) -> tuple[dict[int, Outcome], dict[int, str]]:
        accepted, left_out = {}, {}
        for i in numbers:
            try:
                outcome = run_calibration(self.recordings[i], settings, self._progress(i), together=self.together)
            except KreiselError as error:
                left_out[i] = f"refused: {error}"
                continue
            if outcome.verdict.accepted:
                accepted[i] = outcome
            else:
                left_out[i] = f"rejected: {'; '.join(outcome.verdict.reasons)}"
        return accepted, left_out

    def _progress(self, i: int) -> Progress | None:
        show = self.progress
        return None if show is None else lambda step, share: show(f"{i + 1}/{len(self.recordings)} {step}", share)


def _effects(outcomes: Iterable[Outcome]) -> frozenset[str]:
    """Return the effects of the device and the reference that any of these contains."""
    return frozenset(
        group
        for one in outcomes
        for group in one.problem.groups
        if (group in BY_CHOICE and group not in ROBOT_GROUPS) or group in _POLYNOMIALS
    )


def _with_effects(settings: CalibrationSettings, effects: Collection[str]) -> CalibrationSettings:
    order = max(settings.polynomial_order, 2) if set(effects) & {*_POLYNOMIALS} else settings.polynomial_order
    chosen = [group for group in GROUPS if group in effects and group in BY_CHOICE]
    return replace(settings, estimated=tuple(dict.fromkeys((*settings.estimated, *chosen))), polynomial_order=order)


def _brought_together(
    names: tuple[str, ...],
    outcomes: tuple[Outcome, ...],
    left_out: tuple[tuple[str, str], ...],
    common: tuple[str, ...],
) -> Joint:
    shared = Sharing(outcomes, common)
    fused = fuse(shared.contributions(), shared.layout, shared.start(), shared.prior())
    repeated = repeatability([one.calibration for one in outcomes])
    differing, factor = _difference(shared, fused, names)
    estimates = [shared.estimate(i, fused.parts[i], factor) for i in range(len(outcomes))]
    first, found = outcomes[0], estimates[0]
    seen = [observability(one.problem, one.run) for one in estimates]
    reasons = [*_reasons(differing, factor, common), *motion_reasons(seen[0])]
    causes = max((one.verdict.causes for one in outcomes), key=lambda found: found[0].weight if found else 0.0)
    verdict = Verdict(not reasons, tuple(reasons), seen[0].unobservable, causes)
    warnings = _warnings(names, outcomes, left_out, differing, factor)
    seconds = sum(one.calibration.estimator.filter_seconds for one in outcomes if one.calibration.estimator is not None)
    judged = [Judged(one, _pooled(outcomes), verdict, seconds) for one in seen]
    own = [assemble(o.recording, e, j, ()) for o, e, j in zip(outcomes, estimates, judged, strict=True)]
    facts = JointFacts(
        common,
        tuple(_own(shared, fused, factor, *each) for each in zip(range(len(names)), names, own, strict=True)),
        left_out, fused.chi_square, fused.degrees, factor, differing,
    )  # fmt: skip
    result = assemble(first.recording, found, judged[0], warnings)
    calibration = replace(
        result, joint=facts, recording=_all(result, names, outcomes), estimates=_course(shared, factor, outcomes)
    )
    return Joint(calibration, names, outcomes, repeated, warnings)


def _difference(shared: Sharing, fused: Fused, names: Sequence[str]) -> tuple[tuple[str, ...], float]:
    """Return where a recording differs from all of them by more than by chance, and the factor that covers this."""
    compared = [row for row in shared.differences(fused) if row[3] > 0]
    differing, worst = [], 1.0
    for i, group, chi_square, degrees in compared:
        ratio = chi_square / degrees
        if ratio > normalised_bounds(np.array([degrees]), 1.0 - 2.0 * _LEVEL / len(compared))[1]:
            differing.append(f"{group_named(group).path} of {names[i]}")
            worst = max(worst, float(ratio**0.5))
    return tuple(differing), worst


def _reasons(differing: tuple[str, ...], factor: float, common: Collection[str]) -> list[str]:
    if factor <= MAX_FACTOR:
        return []
    stated = [word for word in ("offsets", "mount") if word in common]
    advice = f"; {' and '.join(stated)} are stated to be the same: leave out --same" if stated else ""
    return [
        f"the recordings differ by {factor:.1f} times their standard deviations in {', '.join(differing)}: "
        f"they are not of the same device, or one of them is wrong{advice}"
    ]


def _warnings(
    names: tuple[str, ...], outcomes: tuple[Outcome, ...], left_out: tuple[tuple[str, str], ...],
    differing: tuple[str, ...], factor: float,
) -> tuple[DataWarning, ...]:  # fmt: skip
    out = [DataWarning(name, f"not used; {reason}") for name, reason in left_out]
    if differing:
        message = (
            f"recordings differ by more than their standard deviations in {', '.join(differing)}; all were "
            f"multiplied by {factor:.2f}"
        )
        out.append(DataWarning("differences", message))
    for name, one in zip(names, outcomes, strict=True):
        out += [DataWarning(f"{name}: {warning.subject}", warning.message) for warning in one.warnings]
    return tuple(out)


def _pooled(outcomes: Sequence[Outcome]) -> Consistency:
    """Return the consistency of all recordings together, each weighted by its updates."""
    facts = [one.consistency for one in outcomes]
    updates = np.array([one.updates for one in facts], dtype=float)

    def mean(values: Sequence[float]) -> float:
        known = np.isfinite(values)
        return float(np.average(np.array(values)[known], weights=updates[known])) if known.any() else float("nan")

    return Consistency(
        nis_path=mean([one.nis_path for one in facts]),
        nis_standstill=mean([one.nis_standstill for one in facts]),
        updates=int(updates.sum()),
        rejected=sum(one.rejected for one in facts),
        lag_one=np.average([one.lag_one for one in facts], axis=0, weights=updates),
        correlation_factor=max(one.correlation_factor for one in facts),
        synchronisation=min(one.synchronisation for one in facts),
    )


def _own(shared: Sharing, fused: Fused, factor: float, i: int, name: str, own: Calibration) -> JointRecording:
    """Return what a recording has of its own."""
    nothing = Measured(np.zeros(3), np.zeros(3))
    turn = shift = nothing
    if turn_of(i) in shared.layout:
        (q, q_sd), (s, s_sd) = fused.of(turn_of(i)), fused.of(shift_of(i))
        turn, shift = Measured(log(q), factor * q_sd), Measured(s, factor * s_sd)
    offsets = [
        Measured(value[0], sd[0])
        for value, sd in ((own.sensors.k_w, own.sensor_sd.k_w), (own.sensors.k_a, own.sensor_sd.k_a))
    ]
    return JointRecording(name, offsets[0], offsets[1], turn, shift, own.timing)


def _all(first: Calibration, names: Sequence[str], outcomes: Sequence[Outcome]) -> RecordingFacts | None:
    """Return the facts of all recordings together."""
    each = [one.calibration.recording for one in outcomes if one.calibration.recording is not None]
    if first.recording is None or len(each) != len(outcomes):
        return first.recording
    return replace(
        first.recording,
        name=" + ".join(names),
        reference=", ".join(dict.fromkeys(one.reference for one in each)),
        imu_samples=sum(one.imu_samples for one in each),
        reference_poses=sum(one.reference_poses for one in each),
        duration_s=sum(one.duration_s for one in each),
    )


def _course(shared: Sharing, factor: float, outcomes: Sequence[Outcome]) -> Array:
    """Return duration, estimates and deviations with the first recording alone, the first two, and so on."""
    rows, seconds = [], 0.0
    contributions, start, prior = shared.contributions(), shared.start(), shared.prior()
    for count, one in enumerate(outcomes, 1):
        seconds += float(one.recording.imu.seconds[-1])
        fused = fuse(contributions[:count], shared.layout, start, prior)
        found = shared.estimate(0, fused.parts[0], factor)
        n = len(found.problem.parameter_names)
        mean = np.zeros(n)
        for group in found.problem.groups:
            if not group_named(group).rotation:
                mean[found.problem.layout[group]] = found.run.parameters.stored(group)
        rows.append(np.concatenate([[seconds], mean, found.run.belief.standard_deviation[:n]]))
    return np.array(rows)
