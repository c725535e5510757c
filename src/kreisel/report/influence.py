"""By how much each part of a recording moves the estimate, and what differs between parts: figures of section 5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.calibration.evidence import Split
from kreisel.calibration.outcome import Outcome
from kreisel.report import plots
from kreisel.report.plots import Figure, Plot
from kreisel.report.thinning import Curve, Single


@dataclass(frozen=True)
class Influence:
    """By how much each part of the recording moves the estimate, rms over a sensor's parameters in standard deviations.

    `seconds` (B,) are the middles of the parts, `found` and `expected` the sizes by sensor, (B,) each.
    """

    seconds: Single
    found: dict[str, Single]
    expected: dict[str, Single]


def influence_of(outcome: Outcome) -> Influence | None:
    """Return the influence of the parts of a calibrated recording; None where there are too few."""
    lack, problem = outcome.lack, outcome.problem
    if lack is None:
        return None
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    edges = np.array([stamps[updates[0].last], *(stamps[updates[end - 1].last] for end in lack.blocks.ends)])
    names = np.array(lack.names)
    every = dict(zip(problem.parameter_names, outcome.estimate.run.belief.standard_deviation, strict=False))
    deviation = np.array([every[name] for name in lack.names])
    found: dict[str, Single] = {}
    expected: dict[str, Single] = {}
    for sensor in ("gyroscope", "accelerometer"):
        own = np.char.startswith(names, f"{sensor}.")
        if own.any():
            for sizes, squares in ((found, lack.influence**2), (expected, lack.variance)):
                sizes[sensor] = np.sqrt(np.mean(squares[:, own] / deviation[own] ** 2, axis=1)).astype(np.float32)
    return Influence((0.5 * (edges[1:] + edges[:-1])).astype(np.float32), found, expected)


def influence_figures(influence: Influence | None) -> list[Figure]:
    """Return the influence of each part of the recording, of section 5."""
    if influence is None:
        return []
    return [
        Figure(
            f"influence-{sensor}",
            f"Influence of each part, {sensor}",
            "By how much each part of the recording, a move between two standstills or some seconds, moves the "
            "estimate: rms over the sensor's parameters, in standard deviations. Good: points about as high as the "
            "line. A part far above it contradicts the others.",
            _of_parts(influence, sensor),
            link="influence",
        )
        for sensor in influence.found
    ]


def _of_parts(influence: Influence, sensor: str) -> Plot:
    found, expected = influence.found[sensor], influence.expected[sensor]
    data = [
        plots.line(Curve(influence.seconds, expected), "expected", "muted"),
        plots.markers(influence.seconds, found, "found", "x", size=6),
    ]
    half = 0.5 * float(influence.seconds[-1] - influence.seconds[0]) / max(influence.seconds.size - 1, 1)
    x = plots.axis(plots.TIME, range=[float(influence.seconds[0]) - half, float(influence.seconds[-1]) + half])
    y = plots.axis("Moved by (sd)", range=[0.0, 1.1 * float(max(found.max(), expected.max()))])
    return plots.plot(x, plots.panel(data, y))


def splits_figures(splits: Sequence[Split]) -> list[Figure]:
    """Return how subsets of the parts differ, along each quantity, of section 5."""
    if not splits:
        return []
    quantities = sorted({split.quantity for split in splits})
    places = np.arange(len(quantities), dtype=float)
    data = [
        plots.line(Curve(np.array([-0.5, len(places) - 0.5], np.float32), np.ones(2, np.float32)), "limit", "muted")
    ]
    for sensor, colour in (("gyro", "x"), ("accel", "y")):
        worst = [_largest(splits, quantity, sensor) for quantity in quantities]
        values = np.array([0.0 if one is None else one.size / one.limit for one in worst], np.float32)
        texts = ["" if one is None else f"{one.parameter}: {one.score:.1f} deviations" for one in worst]
        data.append(plots.markers(places, values, f"{sensor}s", colour, size=7, texts=texts))
    high = 1.1 * max(1.0, *(split.size / split.limit for split in splits))
    x = plots.axis(
        "Quantity", range=[-0.5, len(places) - 0.5], ticks=[places.tolist(), [_short(q) for q in quantities]]
    )
    y = plots.axis("Difference / limit (1)", range=[0.0, high])
    return [
        Figure(
            "splits",
            "Parts with low and high values of what could matter",
            "By how much parts of the recording with low and with high values of a quantity differ in what they say of "
            "a sensor's group that differs most, over what one pair in 10,000 exceeds by chance. Good: all below one. "
            "Above it, an error that is not modelled changes with that quantity; deviations contain it.",
            plots.plot(x, plots.panel(data, y, height=240, texts=True)),
            shape="wide",
        )
    ]


def _largest(splits: Sequence[Split], quantity: str, sensor: str) -> Split | None:
    """Return the group of a sensor that differs most along a quantity; lever arms are the accelerometers'."""
    own = [s for s in splits if s.quantity == quantity and s.group.startswith("gyro") == (sensor == "gyro")]
    return max(own, key=lambda one: one.size / one.limit, default=None)


def _short(quantity: str) -> str:
    """Return a quantity as a short text for an axis."""
    for long, short in (("angle of joint ", "A"), ("gravity along ", "g "), ("sense of rotation about ", "ω ")):
        quantity = quantity.replace(long, short)
    return quantity.replace("position ", "at ").replace("temperature", "temp.")
