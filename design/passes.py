"""Does another pass over the data pay? Errors in the virtual cell after one, two and three passes.

Run: python design/passes.py [trials [seconds]]
"""

import sys
from pathlib import Path

import numpy as np

import kreisel
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.units import MG, PPM


def main(trials: int = 6, seconds: int = 120) -> None:
    """Print a line for every number of passes."""
    cell = Cell.model_validate({"seconds": float(seconds)})
    for passes in (1, 2, 3, None):
        ratios, offsets, matrices, used = [], [], [], []
        for trial in range(trials):
            truth, recording = simulate(cell, Path("cell"), trial=trial)
            result = kreisel.calibrate(recording, kreisel.CalibrationSettings(passes=passes))
            deviation = result.document["standard_deviation"]
            offset = result.sensors.k_a[0] - truth.sensors.k_a[0]
            matrix = result.sensors.K_omega - truth.sensors.K_omega
            offsets.append(offset / MG)
            matrices.append(matrix / PPM)
            ratios.append(matrix / np.array(deviation["gyroscope"]["cross_coupling"]))
            used.append(result.document["estimator"]["passes"])
        print(
            f"passes {passes or 'as pay'} (used {np.mean(used):.1f}): "
            f"offset {np.sqrt(np.mean(np.square(offsets))):.5f} mg, "
            f"K_omega {np.sqrt(np.mean(np.square(matrices))):.3f} ppm, "
            f"error/sd {np.sqrt(np.mean(np.square(ratios))):.3f}"
        )


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:]))
