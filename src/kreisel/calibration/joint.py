"""One calibration from several recordings of one device."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.array_checks import check_recording
from kreisel.calibration.assembly import Assessment, assemble
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.fusion import Fused, fuse
from kreisel.calibration.joint_outcome import Joint
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.repeatability import repeatability
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import (
    Consistency,
    JointFacts,
    JointRecording,
    Measured,
    RecordingFacts,
)
from kreisel.calibration.sharing import DEFAULT, SHARED, Sharing, shift_of, turn_of, values_of
from kreisel.calibration.verdict import Reason, motion_reasons, verdict_by
from kreisel.errors import KreiselError, SettingsError, unknown_name
from kreisel.estimation.consistency import normalised_bounds
from kreisel.geometry.rotation import Array, log
from kreisel.inertial.effects import OF_TEMPERATURE
from kreisel.model.calibration_settings import BY_CHOICE, CalibrationSettings
from kreisel.model.parameters import GROUPS, ROBOT_GROUPS
from kreisel.progress import Progress, shown
from kreisel.recording.recording import DataWarning, Recording
from kreisel.refinement.observability import observability
from kreisel.tasks import Executor, sequential
from kreisel.validation.common_readings import share_in_common

_POLYNOMIALS = ("gyro_polynomial", "accel_polynomial")
_LEVEL = 0.01
"""Probability that recordings which agree are taken for recordings that differ."""

_COVERED = 0.5
"""Factor for a difference in a single direction, in its standard deviations: it is then two of them."""

_BETTER = 0.4
"""Share of a factor that is left where something that was held to be common is not."""

_ADVICE = {
    "offsets": "leave out --same offsets", "mount": "leave out --same mount",
    "robot": "they are of different arms; calibrate --joint takes them with --own robot",
    "site": "--own site", "reference": "--own reference",
}  # fmt: skip

_COMMON = 0.01
"""Share of readings in common from which two recordings are not independent. Chosen: deviations are then 0.3 % too
small, and chance makes none."""

MAX_FACTOR = 3.0
"""Largest factor on deviations by which differences between recordings are covered."""


def calibrate_joint(
    recordings: Sequence[Recording],
    settings: CalibrationSettings | None = None,
    common: Collection[str] = DEFAULT,
    progress: Progress | bool | None = None,
    *,
    names: Sequence[str] = (),
    unread: Sequence[tuple[str, str]] = (),
    executor: Executor = sequential,
) -> Joint:
    """Return one calibration of a device from several recordings of it.

    The parameters of the device are common. Clocks, the direction of gravity and of north are each recording's own.

    Parameters
    ----------
    common
        What the recordings have in common besides: words of `SHARED`.
    progress
        As of `kreisel.calibrate`.
    names
        Of the recordings; their own by default.
    unread
        Names of further recordings that could not be read, and why: they are named among those that are left out.

    Raises
    ------
    KreiselError
        If fewer than two of them can be used; the message says why.
    """
    for recording in recordings:
        check_recording(recording)
    common = (common,) if isinstance(common, str) else tuple(common)
    unknown = [word for word in common if word not in SHARED]
    if unknown:
        raise SettingsError(unknown_name("thing in common", unknown[0], SHARED))
    named = tuple(names) or tuple(recording.name for recording in recordings)
    _check_different(recordings, named)
    own = replace(settings or CalibrationSettings(), partial=True)
    with shown(progress) as show:
        outcomes, left_out = _Alone(recordings, named, own, show, executor).outcomes()
    left_out = (*unread, *left_out)
    if len(outcomes) < 2:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in left_out)
        given = len(recordings) + len(unread)
        few = "give two or more recordings of one device" if given < 2 else "fewer than two can be used"
        raise SettingsError(f"{few}{f' ({reasons})' if reasons else ''}")
    # b is the body of a reference that has orientations, where there is one
    order = sorted(outcomes, key=lambda i: outcomes[i].problem.reference.quaternions is None)
    return _brought_together(tuple(named[i] for i in order), tuple(outcomes[i] for i in order), left_out, tuple(common))


def _check_different(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    """Check that no two recordings have readings in common.

    Raises
    ------
    SettingsError
        If some do; they would count as independent.
    """
    for k, one in enumerate(recordings):
        for i, other in enumerate(recordings[:k]):
            share = share_in_common(one.imu, other.imu)
            if share > _COMMON:
                same = "the same readings" if share > 1.0 - _COMMON else f"{100.0 * share:.0f} % of readings in common"
                raise SettingsError(f"{names[i]} and {names[k]} have {same}: give each recording once")


@dataclass(frozen=True)
class _Alone:
    """The calibration of each recording alone, all with the same effects."""

    recordings: Sequence[Recording]
    names: Sequence[str]
    settings: CalibrationSettings
    progress: Progress | None
    executor: Executor

    def outcomes(self) -> tuple[dict[int, Outcome], tuple[tuple[str, str], ...]]:
        """Return the accepted ones by number, and names and reasons of the others."""
        outcomes, left_out = self._calibrated(range(len(self.recordings)), self.settings)
        wanted = _effects(outcomes.values())
        if any(one.preparation.readings.temperature_difference is None for one in outcomes.values()):
            wanted -= set(OF_TEMPERATURE)  # a recording without temperatures cannot show them
        other = [i for i, one in outcomes.items() if not wanted <= _effects([one])]
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
                outcome = run_calibration(self.recordings[i], settings, self._progress(i), executor=self.executor)
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
    differing, factor = _difference(fused, names)
    remedy = _remedy(outcomes, names, common, factor) if differing else ""
    estimates = [shared.estimate(i, fused.parts[i], factor) for i in range(len(outcomes))]
    first, found = outcomes[0], estimates[0]
    honest = estimates if factor == 1.0 else [shared.estimate(i, one, 1.0) for i, one in enumerate(fused.parts)]
    seen = [observability(one.problem, one.deviation) for one in honest]
    reasons = [*_reasons(differing, factor, remedy), *motion_reasons(seen[0])]
    causes = max((one.verdict.causes for one in outcomes), key=lambda found: found[0].weight if found else 0.0)
    verdict = verdict_by(reasons, seen[0], causes)
    warnings = _warnings(names, outcomes, left_out, differing, factor, remedy)
    seconds = sum(one.calibration.estimator.filter_seconds for one in outcomes if one.calibration.estimator is not None)
    consistency = _pooled(outcomes)
    judged = [Assessment(one, consistency, verdict, seconds) for one in seen]
    own = [assemble(o.preparation.recording, e, j, ()) for o, e, j in zip(outcomes, estimates, judged, strict=True)]
    facts = JointFacts(
        common,
        tuple(_own(shared, fused, factor, *each) for each in zip(range(len(names)), names, own, strict=True)),
        left_out, fused.chi_square, fused.degrees, factor, differing,
    )  # fmt: skip
    result = assemble(first.preparation.recording, found, judged[0], warnings)
    calibration = replace(
        result, joint=facts, recording=_all(result, names, outcomes), estimates=_course(shared, factor, outcomes)
    )
    return Joint(calibration, names, outcomes, repeated, warnings)


def _difference(fused: Fused, names: Sequence[str]) -> tuple[tuple[str, ...], float]:
    """Return the recordings that differ from all of them by more than by chance, and the factor that covers this.

    Both by the sum of squares of a recording, and by that of a single direction.
    """
    tests = 2 * len(names)
    differing, worst = [], 1.0
    for i, misfit in enumerate(fused.misfits):
        if misfit.degrees == 0:
            continue
        ratio = misfit.chi_square / misfit.degrees
        whole = ratio > _bound(misfit.degrees, tests)
        if whole or misfit.largest**2 > _bound(1, tests * misfit.degrees):
            differing.append(f"{names[i]} (by {misfit.largest:.1f} in one direction)")
            worst = max(worst, float(ratio**0.5) if whole else 1.0, _COVERED * misfit.largest)
    return tuple(differing), worst


def _bound(degrees: int, tests: int) -> float:
    """Return the normalised chi-square that one of so many tests exceeds by chance with the probability `_LEVEL`."""
    return normalised_bounds(np.array([degrees]), 1.0 - 2.0 * _LEVEL / tests)[1]


def _remedy(outcomes: tuple[Outcome, ...], names: tuple[str, ...], common: tuple[str, ...], factor: float) -> str:
    """Return the likeliest cause of differences covered by a factor, such as what recordings do not have in common.

    Of those that explain it equally well, what the user states comes before what is usual.
    """
    factors = {}
    for word in (word for word in _ADVICE if word in common):
        other = Sharing(outcomes, [one for one in common if one != word])
        factors[word] = _difference(fuse(other.contributions(), other.layout, other.start(), other.prior()), names)[1]
    best = min(factors, key=lambda word: factors[word], default=None)
    if best is not None and factors[best] < max(1.0, _BETTER * factor):
        return f"they agree if {best} is each recording's own: {_ADVICE[best]}"
    return "they are not of the same device, or one of them is wrong"


def _reasons(differing: tuple[str, ...], factor: float, remedy: str) -> list[Reason]:
    if factor <= MAX_FACTOR:
        return []
    text = f"recordings differ from the others by more than {MAX_FACTOR:g} times their standard deviations explain"
    return [Reason(f"{text}: {', '.join(differing)}; {remedy}", own=True)]


def _warnings(
    names: tuple[str, ...], outcomes: tuple[Outcome, ...], left_out: tuple[tuple[str, str], ...],
    differing: tuple[str, ...], factor: float, remedy: str,
) -> tuple[DataWarning, ...]:  # fmt: skip
    out = [DataWarning(name, f"not used; {reason}") for name, reason in left_out]
    if differing:
        message = (
            f"recordings differ from the others by more than by chance: {', '.join(differing)}; standard deviations "
            f"were multiplied by {factor:.2f}; {remedy}"
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
        values = values_of(found)
        rows.append(np.concatenate([[seconds], values, found.deviation[: values.size]]))
    return np.array(rows)
