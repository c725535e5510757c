"""Noise of an IMU in motion: densities with which a plain strapdown filter with known parameters is consistent.

At rest an IMU is quieter than in a hand, on an arm or on a frame that flies: vibration, what is left of the parameters,
and the scatter of stamps add to its noise. The likeliest densities are found from the innovations of navigation over
gaps without a pose, in every second block of a recording, and judged in the others, which had no part in them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from kreisel.calibration.cross_validation import navigation_only
from kreisel.calibration.outcome import Outcome
from kreisel.errors import RecordingError
from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.noise_figures import coarse_step, white_density
from kreisel.model.problem import Problem, part_of, with_rarer_updates, with_readings
from kreisel.progress import Progress
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.noise_adaptation import imu_density

GAPS = (0.4, 12.0)
"""s between poses, least and most. Chosen: below, the noise of the reference hides the IMU's; longer gaps are few."""

FEWEST = 20
"""Gaps in the blocks of either kind. Chosen: their mean square of six numbers is known to 13 %."""

_PHASES = 4
"""Beginnings of the gaps that are tried: gaps that begin elsewhere see other motion."""

_BLOCK = 10.0
"""s in a block, three gaps at least. Chosen: longer than a move, far shorter than a recording."""

_LOGS = np.arange(-2.0, 7.0)
"""Binary logarithms of the factors on densities that are compared. Chosen: nobody multiplies by more than a hundred."""

_ROUNDS = 2
"""Rounds over the three sizes: they hardly depend on each other."""

_EVIDENCE = 3.0
"""Logarithm of the likelihood by which other sizes must be likelier than those at rest: the price of three numbers by
Akaike's criterion."""

_UNKNOWN = 0.7
"""Deviation of a logarithm from which gaps do not tell a size, and that of shorter gaps holds: a factor of two."""

_OFFSETS = {"gyro_offset": 1e-3, "accel_offset": 0.02}
"""Deviations of the offsets at the beginning, rad/s and m/s^2: every filter estimates them. Chosen: what is left after
calibration, of most devices."""

_LARGER = 1.25
"""Factor on the density at rest from which its excess is split. Chosen: three deviations of a usual recording."""

_REST, _RESTS = 64, 3
"""Least readings at a standstill, which show noise to 10 %, and standstills. Chosen: their median excludes one."""

SENSORS = ("gyroscope", "accelerometer")


@dataclass(frozen=True)
class GapNoise:
    """White noise that explains what navigation gathers over gaps of one length.

    Attributes
    ----------
    seconds
        Median length of the gaps.
    sizes, log_deviation
        Densities of gyros and accelerometers, rms over the axes, SI, and the factor on the noise of the reference that
        is likeliest with them; the deviations of their logarithms; (3,).
    gain
        Logarithm of how much likelier the innovations are than with the densities at rest.
    consistency
        Mean normalised innovation squared in the unused blocks, with the densities at rest and with these; 1 expected.
    unused
        Gaps in the unused blocks.
    """

    seconds: float
    sizes: Array
    log_deviation: Array
    gain: float
    consistency: tuple[float, float]
    unused: int

    @property
    def density(self) -> Array:
        """Densities of gyros and accelerometers, (2,)."""
        return self.sizes[:2]


@dataclass(frozen=True)
class MotionNoise:
    """Noise of gyros and accelerometers in motion, rms over the axes, SI.

    Attributes
    ----------
    at_rest
        Densities as the standstills of the recording show them, else as neighbouring readings differ, (2,).
    measured
        Whether standstills showed them.
    gaps
        By length of the gaps, ascending.
    walk
        Random walks of the offsets that the calibration found, (2,); zero where it found none.
    shares : (2, 3)
        Of the squared density over the longest gaps: white, bounded (vibration, the reference), and growing (walks,
        lack of fit); nan where fewer than three lengths show them, or the density is that at rest.
    standing
        Share of the time in which the IMU stands still, without a margin before and after.
    """

    at_rest: Array
    measured: tuple[bool, bool]
    gaps: tuple[GapNoise, ...]
    walk: Array
    shares: Array
    standing: float

    @property
    def best(self) -> GapNoise:
        """The gaps in which the IMU's noise shows most: the longest."""
        return self.gaps[-1]

    @property
    def factor(self) -> Array:
        """Densities in motion over those at rest, (2,)."""
        return np.asarray(self.best.density / self.at_rest)

    @property
    def while_moving(self) -> Array:
        """Densities (2,) of a filter that never stands still, if standstills are as quiet as at rest."""
        excess = np.maximum(self.best.density**2 - self.at_rest**2, 0.0)
        return np.asarray(np.sqrt(self.at_rest**2 + excess / max(1.0 - self.standing, 1e-3)))

    @property
    def figures(self) -> dict[str, float]:
        """The figures that a filter takes, named as in [imu] of recording.toml."""
        out = {}
        for i, name in enumerate(("gyro", "accel")):
            out[f"{name}_noise_density"] = float(self.best.density[i])
            if self.walk[i]:
                out[f"{name}_random_walk"] = float(self.walk[i])
        return out

    @property
    def document(self) -> dict[str, Any]:
        """The figures as an object; null where nothing shows one."""
        kinds = ("white", "bounded", "growing")
        return {
            **{
                name: {
                    "noise_density": float(self.best.density[i]),
                    "noise_density_at_rest": float(self.at_rest[i]),
                    "measured_at_rest": self.measured[i],
                    "factor": float(self.factor[i]),
                    "noise_density_while_moving": float(self.while_moving[i]),
                    "random_walk": float(self.walk[i]) or None,
                    "shares": {
                        kind: float(share) if np.isfinite(share) else None
                        for kind, share in zip(kinds, self.shares[i], strict=True)
                    },
                }
                for i, name in enumerate(SENSORS)
            },
            "gaps": [
                {
                    "seconds": gap.seconds,
                    **{f"{name}_noise_density": float(gap.density[i]) for i, name in enumerate(SENSORS)},
                    **{f"{name}_log_deviation": float(gap.log_deviation[i]) for i, name in enumerate(SENSORS)},
                    "reference_factor": float(gap.sizes[2]),
                    "log_likelihood_gain": gap.gain,
                    "nis_at_rest": gap.consistency[0],
                    "nis_in_motion": gap.consistency[1],
                    "unused": gap.unused,
                }
                for gap in self.gaps
            ],
            "standing": self.standing,
            "filter": self.figures,
        }


def motion_noise(outcome: Outcome, progress: Progress | None = None) -> MotionNoise:
    """Return the noise in motion of a calibrated recording.

    progress: called with the step and the share of it that is done.

    Raises
    ------
    RecordingError
        If it has too few gaps to judge.
    """
    found = outcome.estimate
    problem = found.problem
    resting_density = _density_at_rest(problem)
    measured = resting_density > 0.0
    at_rest = np.where(measured, resting_density, np.sqrt(np.mean(problem.noise.observed**2, axis=1)))
    known = navigation_only(problem, {group: np.eye(3) * sd**2 for group, sd in _OFFSETS.items()})
    lengths = [k for k in range(20) if GAPS[0] < known.schedule.interval * 2**k < GAPS[1]]
    resting = np.append(at_rest, 1.0)
    gaps: list[GapNoise] = []
    for k, halvings in enumerate(lengths):
        if progress is not None:
            progress("noise in motion", k / len(lengths))
        gap = _over_gaps(found, _phases(known, halvings), resting, gaps[-1].sizes if gaps else resting)
        if gap is None:
            break
        gaps.append(gap)
    if not gaps:
        raise RecordingError(
            f"has fewer than {2 * FEWEST} gaps of a second between poses in motion; record more motion, or calibrate "
            "at rest without --in-motion",
            file=outcome.recording.imu.source,
        )
    walks = [problem.noise.offset_walk.get(f"{name}_offset", 0.0) for name in ("gyro", "accel")]
    shares = np.array([_shares(gaps, at_rest, i) for i in range(2)])
    seconds = problem.sensor.readings.stamps
    standing = sum(one.stop - one.start for one in problem.schedule.standstills) / float(seconds[-1] - seconds[0])
    seen_at_rest = bool(measured[0]), bool(measured[1])
    return MotionNoise(at_rest, seen_at_rest, tuple(gaps), np.array(walks), shares, standing)


def _density_at_rest(problem: Problem) -> Array:
    """Return the noise densities (2,) at the standstills, rms over the axes; 0 where they do not show them."""
    readings, out = problem.sensor.readings, np.zeros(2)
    bounds = np.searchsorted(readings.stamps, [(one.start, one.stop) for one in problem.schedule.standstills])
    long = [slice(first, last) for first, last in bounds.reshape(-1, 2) if last - first >= _REST]
    if len(long) < _RESTS:
        return out
    interval = float(np.median(np.diff(readings.stamps)))
    for i, values in enumerate((readings.rates, readings.accelerations)):
        parts = [values[one] for one in long]
        if not coarse_step(np.concatenate(parts)):
            out[i] = np.sqrt(np.mean(np.median([white_density(part, interval) for part in parts], axis=0) ** 2))
    return out


def _over_gaps(found: Estimate, phases: list[Problem], at_rest: Array, begin: Array) -> GapNoise | None:
    """Return the likeliest densities over the problems' gaps, or None where there are too few."""
    masks = [_blocks(_run(found, one, at_rest), one.schedule.interval) for one in phases]
    used, unused = (sum(int(mask[part].sum()) for mask in masks) for part in range(2))
    if min(used, unused) < FEWEST * len(phases):
        return None

    def likelihood(sizes: Array) -> float:
        """Mean over the phases, which see the same noise."""
        runs = zip(phases, masks, strict=True)
        return sum(float(_run(found, p, sizes).log_likelihood[m[0]].sum()) for p, m in runs) / len(phases)

    best, deviation = begin.copy(), np.zeros(3)
    for _ in range(_ROUNDS):
        for k in range(3):
            best[k], deviation[k] = _likeliest(likelihood, best, k, at_rest[k])
            if deviation[k] > _UNKNOWN:
                best[k] = begin[k]
    gain = likelihood(best) - likelihood(at_rest)
    if gain < _EVIDENCE:
        best = at_rest.copy()
    mean = []
    for sizes in (at_rest, best):
        histories = [_run(found, one, sizes) for one in phases]
        squares = sum(float(h.nis[m[1]].sum()) for h, m in zip(histories, masks, strict=True))
        mean.append(squares / sum(float(h.degrees[m[1]].sum()) for h, m in zip(histories, masks, strict=True)))
    lengths = np.concatenate([_since(h)[m[1]] for h, m in zip(histories, masks, strict=True)])
    return GapNoise(float(np.median(lengths)), best, deviation, gain, (mean[0], mean[1]), unused // len(phases))


def _phases(problem: Problem, halvings: int) -> list[Problem]:
    """Return problems whose updates are halved so often, with gaps that begin at different updates."""
    every = 2**halvings
    out = []
    for first in sorted({every * k // _PHASES for k in range(_PHASES)}):
        one = part_of(problem, slice(first, None))
        for _ in range(halvings):
            one = with_rarer_updates(one)
        out.append(one)
    return out


def _since(history: History) -> Array:
    """Return the seconds since the update before, of each."""
    return np.diff(history.seconds, prepend=history.seconds[0])


def _blocks(history: History, interval: float) -> tuple[Mask, Mask]:
    """Return which updates end a gap in a used block, and which in an unused one."""
    after = _since(history) > 0.6 * interval
    number = (history.seconds - history.seconds[0]) // max(_BLOCK, 3.0 * interval)
    return after & (number % 2 == 0), after & (number % 2 == 1)


def _likeliest(likelihood: Callable[[Array], float], sizes: Array, k: int, at_rest: float) -> tuple[float, float]:
    """Return the likeliest size of one kind and the deviation of its logarithm: octaves, then a parabola."""

    def of(log: float) -> float:
        trial = sizes.copy()
        trial[k] = at_rest * 2.0**log
        return likelihood(trial)

    values = [of(log) for log in _LOGS]
    top = float(_LOGS[int(np.argmax(values))])
    before, at, after = of(top - 0.5), max(values), of(top + 0.5)
    bend = 4.0 * (before - 2.0 * at + after)
    if not bend < 0.0:
        return at_rest * 2.0**top, np.log(2.0)
    shift = float(np.clip((before - after) / bend, -0.5, 0.5))
    return at_rest * 2.0 ** (top + shift), np.log(2.0) * float((-bend) ** -0.5)


def _run(found: Estimate, problem: Problem, sizes: Array) -> History:
    """Return the history of navigation with densities, and with a factor on the reference's noise on the path."""
    factors, scale = sizes[:2] / np.array(imu_density(problem)), float(sizes[2])
    readings = problem.sensor.readings.with_noise(*factors.tolist())
    reference = problem.noise.reference.scaled(position=scale, orientation=scale, standstill=1.0)
    scaled = replace(with_readings(problem, readings), noise=replace(problem.noise, reference=reference))
    return found.estimator.navigate(scaled, found.run.parameters).history


def _shares(gaps: list[GapNoise], at_rest: Array, sensor: int) -> Array:
    """Return the shares of the squared density over the longest gaps: white, bounded and growing.

    A bounded error of navigation looks like a density that falls as the inverse square root of the gap, one that walks
    like one that grows with its square root.
    """
    if len(gaps) < 3 or gaps[-1].density[sensor] < _LARGER * at_rest[sensor]:
        return np.full(3, np.nan)
    lengths = np.array([gap.seconds for gap in gaps]) / gaps[-1].seconds
    squares = np.array([gap.density[sensor] ** 2 for gap in gaps])
    weights = 1.0 / (squares * np.maximum([gap.log_deviation[sensor] for gap in gaps], 0.05))
    columns = np.stack([np.ones_like(lengths), 1.0 / lengths, lengths], axis=1)
    parts = _nonnegative(columns * weights[:, None], squares * weights)
    return np.asarray(parts / parts.sum())


def _nonnegative(columns: Array, values: Array) -> Array:
    """Return the least squares solution without negative parts: of the few columns every choice is tried."""
    best, least = np.zeros(columns.shape[1]), np.inf
    for size in range(1, columns.shape[1] + 1):
        for chosen in combinations(range(columns.shape[1]), size):
            parts = np.zeros(columns.shape[1])
            parts[list(chosen)] = np.linalg.lstsq(columns[:, chosen], values, rcond=None)[0]
            misfit = float(np.sum((columns @ parts - values) ** 2))
            if (parts >= 0.0).all() and misfit < least:
                best, least = parts, misfit
    return best
