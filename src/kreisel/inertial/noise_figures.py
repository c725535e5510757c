"""Noise of inertial sensors: grades of devices, models of their errors, and measures of noise in a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kreisel.geometry.rotation import Array
from kreisel.units import DEG, DEG_PER_HOUR, DEG_PER_ROOT_HOUR, MG, STANDARD_GRAVITY

_ASSUMED = "assumed, typical of data sheets"
_TABLE = "Fox and Janocha (2005), table 1"


@dataclass(frozen=True)
class Grade:
    """Errors of a class of devices, SI; standard deviations where they differ from device to device.

    Attributes
    ----------
    gyro_noise_density, accel_noise_density
        White noise, per root hertz (angle and velocity random walk N).
    gyro_offset_sd, accel_offset_sd
        Standard deviation of the offsets from one start of the device to the next.
    gyro_bias_instability, accel_bias_instability
        Flicker noise B, as in IEEE 952: the Allan deviation's floor is 0.664 B.
    gyro_rate_random_walk, accel_random_walk
        K: white noise in the offset's derivative, per root hertz.
    gyro_scale_sd, accel_scale_sd, misalignment_sd
        Scale factors (relative) and directions (rad) of the sensitive axes before calibration.
    gyro_range, accel_range, gyro_step, accel_step
        Largest reading, and the step readings are rounded to (0: none).
    bandwidth
        Of the readings, Hz (0: not limited).
    g_sensitivity, g_squared
        Of the gyros, rad/s per m/s^2, and per square of that.
    rate
        Samples a second.
    sources
        Source of each number; numbers without a source are assumed.
    """

    gyro_noise_density: float
    accel_noise_density: float
    gyro_offset_sd: float
    accel_offset_sd: float
    gyro_bias_instability: float = 0.0
    accel_bias_instability: float = 0.0
    gyro_rate_random_walk: float = 0.0
    accel_random_walk: float = 0.0
    gyro_scale_sd: float = 1e-3
    accel_scale_sd: float = 1e-3
    misalignment_sd: float = 1e-3
    gyro_range: float = 500.0 * DEG
    accel_range: float = 10.0 * STANDARD_GRAVITY
    gyro_step: float = 0.0
    accel_step: float = 0.0
    bandwidth: float = 0.0
    g_sensitivity: float = 0.0
    g_squared: float = 0.0
    rate: float = 400.0
    sources: dict[str, str] = field(default_factory=dict)

    def source(self, name: str) -> str:
        """Return the source of a number."""
        return self.sources.get(name, _ASSUMED)


GRADES = {
    "ring-laser": Grade(
        gyro_noise_density=0.0035 * DEG_PER_ROOT_HOUR,
        accel_noise_density=0.02 * MG,
        gyro_offset_sd=0.03 * DEG_PER_HOUR,
        accel_offset_sd=0.1 * MG,
        gyro_bias_instability=0.003 * DEG_PER_HOUR,
        accel_bias_instability=0.001 * MG,
        gyro_scale_sd=2e-4,
        accel_scale_sd=5e-4,
        misalignment_sd=5e-4,
        sources={
            "gyro_offset_sd": f"{_TABLE}, LPA (GG1320)",
            "accel_offset_sd": f"{_TABLE}, LPA (QA-2000-10)",
            "rate": f"{_TABLE}, LPA",
            "gyro_noise_density": "class of the GG1320, assumed",
            "accel_noise_density": "class of the QA-2000, assumed",
            "accel_bias_instability": "class of the QA-2000, assumed",
        },
    ),
    "fog": Grade(
        gyro_noise_density=0.02 * DEG_PER_ROOT_HOUR,
        accel_noise_density=0.02 * MG,
        gyro_offset_sd=1.0 * DEG_PER_HOUR,
        accel_offset_sd=1.0 * MG,
        gyro_bias_instability=0.05 * DEG_PER_HOUR,
        accel_bias_instability=0.001 * MG,
        gyro_scale_sd=5e-4,
        accel_scale_sd=5e-4,
        misalignment_sd=1e-3,
        sources={
            "gyro_offset_sd": f"{_TABLE}, iNAV-FMS",
            "accel_offset_sd": f"{_TABLE}, iNAV-FMS (QA-2000-10)",
            "rate": f"{_TABLE}, iNAV-FMS",
            "accel_noise_density": "class of the QA-2000, assumed",
        },
    ),
    "fog-mems": Grade(
        gyro_noise_density=0.15 * DEG_PER_ROOT_HOUR,
        accel_noise_density=0.1 * MG,
        gyro_offset_sd=20.0 * DEG_PER_HOUR,
        accel_offset_sd=25.0 * MG,
        gyro_bias_instability=0.5 * DEG_PER_HOUR,
        accel_bias_instability=0.01 * MG,
        gyro_scale_sd=1e-3,
        accel_scale_sd=2e-3,
        misalignment_sd=1e-2,
        rate=200.0,
        sources={
            "gyro_offset_sd": f"{_TABLE}, iVRU-FC (iOLFOG)",
            "accel_offset_sd": f"{_TABLE}, iVRU-FC (Colibrys MS8010)",
            "rate": f"{_TABLE}, iVRU-FC",
            "misalignment_sd": "data sheet of the MS1010, successor of the MS8010",
        },
    ),
    "industrial-mems": Grade(
        gyro_noise_density=0.3 * DEG_PER_ROOT_HOUR,
        accel_noise_density=0.1 * MG,
        gyro_offset_sd=400.0 * DEG_PER_HOUR,
        accel_offset_sd=10.0 * MG,
        gyro_bias_instability=5.0 * DEG_PER_HOUR,
        accel_bias_instability=0.02 * MG,
        gyro_scale_sd=5e-3,
        accel_scale_sd=5e-3,
        misalignment_sd=5e-3,
        gyro_step=0.005 * DEG,
        accel_step=0.1 * MG,
        g_sensitivity=0.01 * DEG / STANDARD_GRAVITY,
        rate=200.0,
    ),
    "consumer-mems": Grade(
        gyro_noise_density=0.6 * DEG_PER_ROOT_HOUR,
        accel_noise_density=0.3 * MG,
        gyro_offset_sd=3600.0 * DEG_PER_HOUR,
        accel_offset_sd=60.0 * MG,
        gyro_bias_instability=20.0 * DEG_PER_HOUR,
        accel_bias_instability=0.1 * MG,
        gyro_scale_sd=2e-2,
        accel_scale_sd=2e-2,
        misalignment_sd=1e-2,
        gyro_range=1000.0 * DEG,
        accel_range=8.0 * STANDARD_GRAVITY,
        gyro_step=0.03 * DEG,
        accel_step=0.25 * MG,
        g_sensitivity=0.1 * DEG / STANDARD_GRAVITY,
        rate=200.0,
    ),
}
"""Presets for `recording.toml`'s ``grade`` and for simulated devices."""

PAPER = {"LPA": "ring-laser", "iNAV-FMS": "fog", "iVRU-FC": "fog-mems"}
"""The paper's three devices, and their grades."""

_CALIBRATION, _AVERAGED = 600.0, 100.0
"""s: usual duration of a calibration, and the time over which an offset is averaged."""


def equivalent_walk(bias_instability: float, random_walk: float) -> float:
    """Return the density of the random walk that represents flicker noise in a filter, per root hertz.

    Flicker noise has no finite state. It is replaced by a random walk for which the offset, averaged over
    100 s, changes as much in ten minutes: K^2 T = 2 B^2 / pi (ln(2 pi T / 100 s) + 0.577), the structure
    function of flicker noise of limited bandwidth.
    """
    change = 2.0 * (np.log(2.0 * np.pi * _CALIBRATION / _AVERAGED) + np.euler_gamma) / np.pi
    return float(np.hypot(bias_instability * np.sqrt(change / _CALIBRATION), random_walk))


GAUSS_MARKOV_TIME = 7.7
"""s: time constant of the Gauss-Markov process of `gauss_markov_size`."""


def gauss_markov_size(bias_instability: float) -> float:
    """Return the deviation of the Gauss-Markov process that represents flicker noise beside `equivalent_walk`.

    Together their Allan deviation is within 20 % of the floor of the flicker noise, 0.664 B, from 3 to 300 s.
    """
    return 1.2 * bias_instability


def noise(
    rng: np.random.Generator, n: int, rate: float, density: float, bias_instability: float, random_walk: float
) -> Array:
    """Return noise of three sensors, (n, 3): white, flicker, and the offset's random walk, mean included.

    Parameters
    ----------
    n, rate
        Samples, and samples a second.
    density, bias_instability, random_walk
        N, B and K of IEEE 952; see `Grade`.
    """
    out = rng.normal(0.0, density * np.sqrt(rate), size=(n, 3)) if density > 0.0 else np.zeros((n, 3))
    if bias_instability > 0.0:
        # Two-sided spectral density B^2 / (2 pi f) down to one period, shaped from white noise.
        length = 1 << (2 * n - 1).bit_length()
        frequency = np.fft.rfftfreq(length, 1.0 / rate)[1:]
        size = np.sqrt(bias_instability**2 / (2.0 * np.pi * frequency) * rate * length)
        spectrum = np.zeros((length // 2 + 1, 3), dtype=complex)
        spectrum[1:] = size[:, None] * (rng.normal(size=(2, frequency.size, 3)).T @ [1.0, 1.0j]).T / np.sqrt(2.0)
        out += np.fft.irfft(spectrum, length, axis=0)[:n]
    if random_walk > 0.0:
        out += np.cumsum(rng.normal(0.0, random_walk / np.sqrt(rate), size=(n, 3)), axis=0)
    return out


def high_frequency_density(values: Array, interval: float) -> Array:
    """Return the noise density (3,) of sampled signals (n, 3), estimated from their third differences.

    White noise of variance s^2 has third differences of variance 20 s^2; those of a smooth motion are close
    to zero. The median of the squares is not affected by shocks.

    Parameters
    ----------
    values
        Readings, in their unit.
    interval
        Time between two samples, s.
    """
    third = np.diff(values, n=3, axis=0)
    # the median of a chi-square variable with one degree of freedom
    variance = np.median(third**2, axis=0) / (20.0 * 0.454936)
    return np.asarray(np.sqrt(variance * interval))


_SEGMENT, _BANDS, _TONES = 128, 8, 0.7
"""Samples of a segment of which a spectrum is made, bands between 1/8 and 7/8 of its frequencies, and share of the
density by differences below which the quietest band shows that the rest are tones."""


def white_density(values: Array, interval: float, density: Array | None = None) -> Array:
    """Return the density (3,) of the white noise in sampled signals (n, 3), without tones of a shaken sensor.

    density: the `high_frequency_density`, if it is known.

    Third differences show mostly frequencies above a quarter of the sample rate. Tones there, such as those of rotors,
    are no noise: they do not add up in an integral. Where a spectrum has a much quieter band, its density is taken.

    Notes
    -----
    Welch's spectrum: means of squared Fourier coefficients of segments that overlap by half, with a Hann window.
    """
    density = high_frequency_density(values, interval) if density is None else density
    n = (len(values) - _SEGMENT) // (_SEGMENT // 2) + 1
    if n < _BANDS:
        return density
    window = np.hanning(_SEGMENT)
    power = np.transpose([summed_power(np.ascontiguousarray(axis), window) for axis in values.T]) * interval / n
    inside = power[_SEGMENT // 16 : -_SEGMENT // 16]
    quietest = np.sqrt(np.min([band.mean(axis=0) for band in np.array_split(inside, _BANDS)], axis=0))
    return np.asarray(np.where(quietest < _TONES * density, quietest, density))


def summed_power(signal: Array, window: Array) -> Array:
    """Return the sum over segments of a signal (n,) of its squared Fourier coefficients, over that of the window's.

    Segments are as long as the window, and overlap by half.
    """
    segments = sliding_window_view(signal, window.size)[:: window.size // 2]
    found = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window, axis=1)
    squares = np.einsum("nf,nf->f", found.real, found.real) + np.einsum("nf,nf->f", found.imag, found.imag)
    return np.asarray(squares / np.sum(window**2))


_WINDOW, _QUIETEST, _EQUAL = 100, 90.0, 0.65
"""Samples of a window; percentile over windows; share of samples equal to the one before that shows coarse rounding."""


def coarse_step(values: Array) -> float:
    """Return the step to which samples (n, 3) are rounded, if it is so coarse that noise at rest does not average it.

    The error is then constant while the sensor rests, up to half a step. 0 for finer steps; the largest of the axes.
    """
    found = 0.0
    for axis in values.T:
        n = axis.size // _WINDOW * _WINDOW
        equal = np.flatnonzero(axis[1:n] == axis[: max(n - 1, 0)]) + 1
        share = np.bincount(equal // _WINDOW, minlength=n // _WINDOW) / _WINDOW
        if share.size and np.percentile(share, _QUIETEST) > _EQUAL:
            steps = np.diff(np.unique(axis))
            found = max(found, float(steps.min()) if steps.size else 0.0)
    return found


def settings_table(figures: Mapping[str, float]) -> str:
    """Return the table [imu] of recording.toml with noise figures by name."""
    return "\n".join(["[imu]", *(f"{name} = {value:.4g}" for name, value in figures.items())])
