"""What supports a calibration: consistency of the innovations, halves of the recording, latitude, unseen data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kreisel.calibration.result_sections import Consistency
from kreisel.estimation.uncertainty import Contribution
from kreisel.fitting.blocks import Blocks
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning
from kreisel.refinement.observability import Observability


@dataclass(frozen=True)
class SplitHalves:
    """Estimates from either half of the recording; `score` is their difference over its deviation, (n,).

    `plain` is the deviation without what errors on no list do to each half; None where it was not made.
    """

    names: tuple[str, ...]
    difference: Array
    deviation: Array
    plain: Array | None = None

    @property
    def score(self) -> Array:
        """Difference over its standard deviation."""
        return np.asarray(self.difference / np.maximum(self.deviation, 1e-300))

    def worst(self, sensor: tuple[str, ...] = ("gyroscope.", "accelerometer.")) -> tuple[str, float]:
        """Return the sensor parameter whose estimates differ most, and its score; an empty name and 0 without any."""
        own = [i for i, name in enumerate(self.names) if name.startswith(sensor)]
        if not own:
            return "", 0.0
        score = np.abs(self.score)[own]
        return self.names[own[int(np.argmax(score))]], float(score.max())


@dataclass(frozen=True)
class Disagreement:
    """What a disagreement adds to the uncertainty of an estimate, with the warning about it; both may be empty."""

    contributions: tuple[Contribution, ...] = ()
    warnings: tuple[DataWarning, ...] = ()


@dataclass(frozen=True)
class LackOfFit:
    """Scatter of what the blocks of a recording say.

    Attributes
    ----------
    blocks
        The blocks.
    influence : (B, n)
        By how much each block moves the estimate of every constant parameter (`Blocks.parameters`).
    covariance : (B, n, n)
        What the model expects of it.
    found : (n, n)
        Covariance of the estimate by the scatter of the blocks.
    degrees
        Blocks that count for a parameter, in the median: those that say about as much as each other.
    names
        Of the parameters.
    """

    blocks: Blocks
    influence: Array
    covariance: Array
    found: Array
    degrees: float
    names: tuple[str, ...] = ()

    @cached_property
    def variance(self) -> Array:
        """What the model expects of the square of each influence, (B, n); zero for what the prior alone determines."""
        return np.asarray(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    @cached_property
    def expected(self) -> Array:
        """Covariance of the estimate by the scatter that the model expects, (n, n)."""
        return np.asarray(self.covariance.sum(axis=0))


@dataclass(frozen=True)
class Split:
    """How parts that are low and high in a quantity differ in a group of parameters.

    Attributes
    ----------
    quantity, group
        Along what, and in what.
    parameter, score
        The parameter that differs most, and its difference over its deviation.
    size, limit
        Rms of the independent scores of the group, and what it exceeds by chance in one case of 10,000.
    """

    quantity: str
    group: str
    parameter: str
    score: float
    size: float
    limit: float

    @property
    def contradicts(self) -> bool:
        """Whether the subsets differ by more than by chance."""
        return self.size > self.limit


@dataclass(frozen=True)
class LatitudeCheck:
    """Stated latitude, latitude by the Earth's rotation in the readings, and the latter's standard deviation (deg).

    `score` is the difference of the two in standard deviations.
    """

    stated_deg: float
    found_deg: float
    deviation_deg: float
    score: float

    @property
    def doubtful(self) -> bool:
        """Whether the stated latitude is so far off that it may be wrong.

        Chosen: from 2.5 deviations on, one of 18 clean runs was doubted.
        """
        return self.score > 3.0


@dataclass(frozen=True)
class StatedValue:
    """What the user states of a parameter, and what the data say without it.

    Attributes
    ----------
    name
        Of the parameter.
    sd
        Standard deviation of what is stated, SI; 0 if the parameter is fixed.
    difference, deviation
        Of the estimate without it from what is stated, and the estimate's standard deviation.
    """

    name: str
    sd: float
    difference: float
    deviation: float

    @property
    def score(self) -> float:
        """By how many of its standard deviations the difference is not zero."""
        return abs(self.difference) / max(float(np.hypot(self.deviation, self.sd)), 1e-300)


@dataclass(frozen=True)
class Evidence:
    """What a verdict depends on besides the estimate itself; each part is computed by a module of its own.

    `stated` is what the user states of parameters, beside an estimate without it. `parts` is the number of parts whose
    scatter the deviations follow.
    """

    observability: Observability
    consistency: Consistency
    halves: SplitHalves | None
    latitude: LatitudeCheck | None
    stated: tuple[StatedValue, ...] = ()
    parts: int = 0


@dataclass(frozen=True)
class Drift:
    """Errors of free navigation from one update to the next, (u,) each.

    `seconds` are the IMU's; `position` (m) and `attitude` (rad) are lengths of the innovation.
    """

    seconds: Array
    position: Array
    attitude: Array


@dataclass(frozen=True)
class CrossValidation:
    """Drift between updates on unseen data, with nominal and with calibrated parameters."""

    trained_until: float
    nominal: Drift
    calibrated: Drift


@dataclass(frozen=True)
class Injection:
    """Known errors added to the raw data, and the change of the estimates, (n,) each."""

    names: tuple[str, ...]
    injected: Array
    found: Array
    deviation: Array
