"""Trials of the calibration without a reference: error over deviation, and situations that are wrong.

python design/static_trials.py [--trials N] [--first K] [-o FILE.csv]
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array
from kreisel.inertial.noise_figures import GRADES
from kreisel.model.parameters import CellParameters
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.rest_problem import begun
from kreisel.static.static_result import StaticOutcome, calibrate_static
from kreisel.study.robustness import WRONG
from kreisel.validation.checks import check_streams

LEVEL = (0.96, 0.28, 0.05)
"""Axis of a door laid down, in the local level."""

DRILL = HandTurns(attitudes=12, laid="hinge", table_axis=LEVEL, spin=40.0, spin_rate=6.0, off_axis=0.03)
"""Forty revolutions in each mounting, one a second, three centimetres off."""

BY_A_STOP = HandTurns(attitudes=12, laid="faces", by_a_stop=True, laid_error=1e-3)
"""Each face has the same tilt again."""

SITUATIONS: dict[str, HandTurns] = {
    **{grade: HandTurns(grade) for grade in GRADES},
    "few attitudes": HandTurns(attitudes=10),
    "many attitudes": HandTurns(attitudes=60),
    "tilt of 10 deg": HandTurns(tilt=np.radians(10.0)),
    "tilt of 40 deg": HandTurns(tilt=np.radians(40.0)),
    "hand tremor 2 mrad": HandTurns(tremor=2e-3),
    "hand tremor 10 mrad": HandTurns(tremor=1e-2),
    "creep 2 mrad": HandTurns(creep=2e-3),
    "creep 20 mrad": HandTurns(creep=2e-2),
    "slip 5 mrad": HandTurns(slip=5e-3),
    "slip 50 mrad": HandTurns(slip=5e-2),
    "vibration 0.1 m/s^2": HandTurns(vibration=0.1),
    "vibration 1 m/s^2": HandTurns(vibration=1.0),
    "warm-up": HandTurns(warm_up=1.0),
    "warm-up, large": HandTurns(warm_up=5.0),
    "quadratic accelerometers": HandTurns(quadratic=3e-4),
    "cubic gyros": HandTurns(gyro_cubic=3e-4),
    "jitter 1 ms": HandTurns(jitter=1e-3),
    "lost samples 0.2 %": HandTurns(lost=2e-3),
    "lost samples 3 %": HandTurns(lost=3e-2),
    "clipped rates": HandTurns(range_share=0.6),
    "fast turns": HandTurns(turn=0.7),
    "short standstills": HandTurns(rest=1.8),
    **{
        f"{laid}, {grade}": HandTurns(grade, attitudes=12, laid=laid)
        for laid in ("faces", "whole turns", "turntable")
        for grade in GRADES
    },
    "faces, case skewed by 5 mrad": HandTurns(attitudes=12, laid="faces", squareness=5e-3),
    "faces, laid down to 30 mrad": HandTurns(attitudes=12, laid="faces", laid_error=0.03),
    "faces, held to 0.1 rad": HandTurns(attitudes=12, laid="faces", laid_error=0.1, tremor=2e-3),
    "faces, by a stop on a slope of 25 mrad": replace(BY_A_STOP, slope=(0.02, -0.015)),
    "faces, by a stop": BY_A_STOP,
    "whole turns on a slope of 25 mrad": HandTurns(attitudes=12, laid="whole turns", slope=(0.02, -0.015)),
    "whole turns, to 50 mrad": HandTurns(attitudes=12, laid="whole turns", heading_error=0.05),
    "whole turns, all short by 0.1 rad": HandTurns(attitudes=12, laid="whole turns", heading_bias=0.1),
    "whole turns, fog, short by 0.1 rad": HandTurns("fog", attitudes=12, laid="whole turns", heading_bias=0.1),
    "turntable, axis off by 0.2 rad": HandTurns(attitudes=12, laid="turntable", table_tilt=0.2),
    "turntable, level axis": HandTurns(attitudes=18, laid="turntable", table_axis=(1.0, 0.0, 0.0)),
    "turntable, wobbling by 3 mrad": HandTurns(attitudes=12, laid="turntable", table_error=3e-3),
    "turntable, rate wrong by 0.1 %": HandTurns(attitudes=12, laid="turntable", table_scale=1e-3),
    "turntable, fog, rate wrong by 0.1 %": HandTurns("fog", attitudes=12, laid="turntable", table_scale=1e-3),
    **{f"hinge, {grade}": HandTurns(grade, attitudes=18, laid="hinge", table_axis=LEVEL) for grade in GRADES},
    **{f"drill, {grade}": replace(DRILL, grade=grade) for grade in GRADES},
    "hinge, upright": HandTurns(attitudes=18, laid="hinge"),
    "hinge, play of 10 mrad": HandTurns(attitudes=18, laid="hinge", table_axis=LEVEL, table_error=1e-2),
    "drill, axis steep": replace(DRILL, table_axis=(0.3, 0.0, 0.95)),
    "drill, 20 cm off its axis": replace(DRILL, off_axis=0.2),
    "drill, fast": replace(DRILL, spin_rate=25.0),
    "navigation grade, creep": HandTurns("ring-laser", creep=1e-4),
    "navigation grade, slip": HandTurns("ring-laser", slip=1e-3),
}


def trial(name: str, number: int) -> list[str]:
    """Return situation, number, verdict, worst score, its parameter, and error over deviation.

    That is of the gyros and of the accelerometers without offsets, and of the offsets, whose deviations hold for any
    moment of the recording.
    """
    how = SITUATIONS[name]
    truth, recording = hand_turned(how, np.random.default_rng([number, *name.encode()]))
    try:
        found = calibrate_static(check_streams(recording))
    except KreiselError as error:
        return [name, str(number), "refused", "", str(error)[:80], "", "", ""]
    C, _ = upper_triangular(truth.K_a)
    true = begun(turned(truth, C, np.zeros(3)), found.found.problem.site)
    scores = _scores(true, found)
    ok = [k for k, n in enumerate(found.calibration.names) if n not in found.calibration.verdict.unobservable]
    usual = [k for k in ok if found.calibration.names[k].startswith(("gyroscope.", "accelerometer."))]
    worst = max(usual, key=lambda k: abs(scores[k])) if usual else 0
    names = found.calibration.names
    groups = ["offsets" if ".offset[" in names[k] else names[k].partition(".")[0] for k in usual]
    squares = [[scores[k] ** 2 for k, g in zip(usual, groups, strict=True) if g == own]
               for own in ("gyroscope", "accelerometer", "offsets")]  # fmt: skip
    rms = [float(np.sqrt(np.mean(own or [np.nan]))) for own in squares]
    verdict = "accepted" if found.calibration.accepted else "rejected"
    return [name, str(number), verdict, f"{abs(scores[worst]):.2f}", names[worst], *(f"{r:.3f}" for r in rms)]


def _scores(true: CellParameters, found: StaticOutcome) -> Array:
    """Return the errors of the estimated parameters over their deviations."""
    problem = found.found.problem
    error = problem.values(found.found.parameters) - problem.values(problem.room(true))
    deviation = np.sqrt(np.diag(found.calibration.covariance))
    return np.asarray(error[: deviation.size] / deviation)


COLUMNS = ["situation", "number", "verdict", "worst", "parameter", "gyros", "accelerometers", "offsets"]
HEADER = ["situation", "runs", "accepted", "wrong", "rejected", "refused", "worst accepted", "gyros: error / sd",
          "accelerometers: error / sd", "offsets: error / sd"]  # fmt: skip


def main() -> None:
    """Run the trials, print a row for each situation, write tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--only", action="append", help="one situation; may be repeated")
    parser.add_argument("-o", type=Path, help="a row for each trial")
    parser.add_argument("--table", type=Path, help="a row for each situation")
    args = parser.parse_args()
    rows, table = [], [HEADER]
    for name in args.only or SITUATIONS:
        own = [trial(name, k) for k in range(args.first, args.first + args.trials)]
        rows += own
        table.append(summary(name, own))
        print("  ".join(table[-1]), flush=True)
    for path, content in ((args.o, [COLUMNS, *rows]), (args.table, table)):
        if path is not None:
            with path.open("w", encoding="utf-8", newline="") as stream:
                csv.writer(stream, lineterminator="\n").writerows(content)


def summary(name: str, own: list[list[str]]) -> list[str]:
    """Return the row of a situation."""
    accepted = [row for row in own if row[2] == "accepted"]
    counts = [sum(row[2] == verdict for row in own) for verdict in ("accepted", "rejected", "refused")]
    wrong = sum(float(row[3]) > WRONG for row in accepted)
    if not accepted:
        return [name, str(len(own)), "0", "0", *map(str, counts[1:]), "", "", "", ""]
    ratios = [np.sqrt(np.nanmean([float(row[k]) ** 2 for row in accepted])) for k in (5, 6, 7)]
    worst = max(float(row[3]) for row in accepted)
    return [name, str(len(own)), str(counts[0]), str(wrong), *map(str, counts[1:]), f"{worst:.1f}",
            *(f"{ratio:.2f}" for ratio in ratios)]  # fmt: skip


if __name__ == "__main__":
    main()
