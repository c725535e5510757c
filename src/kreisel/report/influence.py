"""By how much each part of a recording moves the estimate: numbers and figures of section 5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    names = np.array([problem.parameter_names[k] for k in problem.constant])
    deviation = outcome.estimate.run.belief.standard_deviation[problem.constant]
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
