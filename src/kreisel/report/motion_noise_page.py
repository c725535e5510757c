"""The noise of an IMU in motion on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kreisel.calibration.motion_noise import SENSORS, MotionNoise
from kreisel.inertial.noise_figures import settings_table
from kreisel.preparation.resting_noise import UNITS
from kreisel.report import plots
from kreisel.report.cells import Row, Table, number
from kreisel.report.plots import Figure
from kreisel.report.template import fill
from kreisel.report.thinning import Curve

COLUMNS = ("gap s", "gyroscope", "accelerometer", "reference", "NIS at rest", "NIS in motion", "gaps")
"""Factors over the figures at rest by length of the gap, and the mean normalised innovation squared on unused data."""

_STANDING = 0.1
"""Share of the time from which standstills are said to make densities smaller. Chosen: by 5 %, what a figure is good
for."""

_BAND = (0.8, 1.3)
"""Mean normalised innovation squared of a filter that is called consistent here. Chosen: deviations right to 14 %."""


def write_motion_noise(title: str, found: MotionNoise, path: Path) -> None:
    """Write the page as one HTML file that works offline."""
    figures = [_density(found, i) for i in range(2)] + [_consistency(found)]
    shown = {
        "title": "Noise in motion",
        "kind": "readings in motion",
        "heading": "Noise figures for a filter",
        "lead": f"{title}: {remarks_of(found)[0]}",
        "table_of_groups": Table(
            "Factors over the noise at rest, with deviations, and consistency on data not used", COLUMNS,
            tuple(Row(tuple(row)) for row in rows_of(found)), text=1,
        ),
        "facts": [
            *remarks_of(found)[1:],
            "For recording.toml: " + settings_table(found.figures).replace("\n", "; "),
        ],
        "figures": figures,
    }  # fmt: skip
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def rows_of(found: MotionNoise) -> list[list[str]]:
    """Return a row of cells for each length of gaps."""
    out = []
    for gap in found.gaps:
        factors = gap.sizes / np.append(found.at_rest, 1.0)
        out.append([
            number(gap.seconds),
            *(f"{f:.2f} ± {f * sd:.2f}" if sd < 1.0 else f"{f:.2f} ± ?" for f, sd in zip(
                factors, gap.log_deviation, strict=True)),
            *(f"{value:.2f}" for value in gap.consistency),
            str(gap.unused),
        ])  # fmt: skip
    return out


def remarks_of(found: MotionNoise) -> list[str]:
    """Return what the figures say, in sentences; the first is the result."""
    rest, motion = found.best.consistency
    if found.best.gain <= 0.0 or np.allclose(found.factor, 1.0, atol=0.25):
        first = "the IMU is as noisy in motion as at rest"
    else:
        parts = [f"{f:.2g} times the {name}'s" for f, name in zip(found.factor, SENSORS, strict=True)]
        first = f"in motion a filter needs {' and '.join(parts)} noise density at rest"
    out = [
        first,
        f"on data not used, over gaps of {found.best.seconds:.2g} s, the mean normalised innovation squared is "
        f"{rest:.2f} with the figures at rest and {motion:.2f} with those in motion; 1 is expected",
    ]
    if not _BAND[0] <= motion <= _BAND[1]:
        out.append(
            f"that is outside {_BAND[0]} to {_BAND[1]}: the noise changes along the recording, and one density is "
            f"too {'small' if motion > 1.0 else 'large'} elsewhere"
        )
    if found.standing > _STANDING and not np.allclose(found.factor, 1.0, atol=0.25):
        factors = found.while_moving / found.at_rest
        parts = [f"{f:.2g} times the {name}'s" for f, name in zip(factors, SENSORS, strict=True)]
        out.append(
            f"the IMU stands still for {100.0 * found.standing:.0f} % of the time, and these figures are for all of "
            f"it: if noise is as at rest then, a filter that never stands still needs {' and '.join(parts)} at rest"
        )
    for name, shares in zip(SENSORS, found.shares, strict=True):
        if np.isfinite(shares).all():
            white, bounded, growing = (f"{100.0 * share:.0f} %" for share in shares)
            out.append(
                f"{name}: of the squared density over the longest gaps {white} is white, {bounded} is bounded "
                f"(vibration, noise of the reference), {growing} grows (walks of offsets, lack of fit)"
            )
    for name, measured in zip(SENSORS, found.measured, strict=True):
        if not measured:
            out.append(f"{name}: standstills do not show its noise; at rest means as neighbouring readings differ")
    return out


def _density(found: MotionNoise, sensor: int) -> Figure:
    """Return the density by length of the gap, with deviations, and that at rest."""
    name, (unit, size) = SENSORS[sensor], UNITS[SENSORS[sensor]][1]
    at = np.array([gap.seconds for gap in found.gaps])
    values = np.array([gap.density[sensor] for gap in found.gaps]) / size
    spread = np.exp(np.minimum([gap.log_deviation[sensor] for gap in found.gaps], 3.0))
    rest = np.full(at.size, found.at_rest[sensor] / size)
    bar = [
        plots.trail(np.array([x, x]), np.array([y / s, y * s]), "", "x", width=2)
        for x, y, s in zip(at, values, spread, strict=True)
    ]
    traces = [
        plots.markers(at, values, "in motion, with deviations", "x", size=8),
        *bar,
        plots.line(Curve(at.astype(np.float32), rest.astype(np.float32)), "at rest", "muted"),
    ]
    highest = 1.1 * float(max(np.max(np.minimum(values * spread, 3.0 * values)), rest[0]))
    y = plots.axis(f"density, {unit}", range=[0.0, highest])
    caption = "Flat: white noise. Falling: vibration, or noise of the reference. Growing: walks, or lack of fit."
    x = plots.axis("gap between poses, s", range=[0.0, 1.1 * float(at[-1])])
    return Figure(name, name.capitalize(), caption, plots.plot(x, plots.panel(traces, y)))


def _consistency(found: MotionNoise) -> Figure:
    """Return the mean normalised innovation squared on unused data, by length of the gap."""
    at = np.array([gap.seconds for gap in found.gaps])
    rest, motion = (np.array([gap.consistency[i] for gap in found.gaps]) for i in range(2))
    one = np.ones(at.size)
    traces = [
        plots.markers(at, rest, "figures at rest", "y", size=8),
        plots.markers(at, motion, "figures in motion", "x", size=8),
        plots.line(Curve(at.astype(np.float32), one.astype(np.float32)), "expected", "muted"),
    ]
    y = plots.axis("mean NIS, data not used", range=[0.0, 1.1 * float(max(rest.max(), motion.max(), 1.0))])
    x = plots.axis("gap between poses, s", range=[0.0, 1.1 * float(at[-1])])
    caption = "Above one a filter is too sure, below one too careful."
    return Figure("consistency", "Consistency", caption, plots.plot(x, plots.panel(traces, y)))
