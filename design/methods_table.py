"""Table of estimators in docs/explanation/method.md from the results of studies of methods.

Run: kreisel study methods --seeds 50 --methods spkf,ekf,iekf,ukf,ckf,batch -o RESULTS, the inverse filter with fewer
seeds in a folder of its own, then python design/methods_table.py RESULTS INVERSE -o docs/data/methods.csv.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np

from kreisel.study.methods import MAX_PASSES

HEADER = ("estimator", "motion", "first errors", "fits", "not settled", "error / sd", "worst", "passes", "time, s")


def main() -> None:
    """Read result folders, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="RESULTS")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a CSV file")
    arguments = parser.parse_args()
    cells: dict[tuple[str, str, str], list[dict[str, str]]] = defaultdict(list)
    for folder in arguments.folders:
        with (folder / "methods.csv").open(encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                cells[row["method"], row["motion"], row["first"]].append(row)
    with arguments.output.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *(summary(key, own) for key, own in cells.items())])


def summary(key: tuple[str, str, str], rows: list[dict[str, str]]) -> list[str]:
    """Return the row of an estimator, a motion and first errors."""
    good = [row for row in rows if not row["failure"] and int(row["passes"]) < MAX_PASSES]
    ratio = np.sqrt(np.mean([float(row["ratio"]) ** 2 for row in good]))
    worst = max(float(row["worst"]) for row in good)
    passes, seconds = (np.mean([float(row[name]) for row in good]) for name in ("passes", "seconds"))
    failed = len(rows) - len(good)
    motion, first = key[1:]
    return [
        key[0],
        motion,
        first,
        str(len(rows)),
        str(failed),
        f"{ratio:.2f}",
        f"{worst:.1f}",
        f"{passes:.1f}",
        f"{seconds:.2f}",
    ]


if __name__ == "__main__":
    main()
