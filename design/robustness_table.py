"""Tables of docs/explanation/robustness.md from the results of robustness studies.

Run: kreisel study robustness -o RESULTS, then python design/robustness_table.py RESULTS -o docs/data/robustness.csv,
and with --foreign -o docs/data/foreign.csv: the situations of users' own data, a row for each size.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from kreisel.study.robustness import VERDICTS, WRONG, Row, RowFile, rightly
from kreisel.study.situations import situations

FOREIGN = (
    "propellers", "gentle flight", "never at rest", "clock of the reference", "unsaid height", "noise and lag",
    "noise and flicker", "frozen poses", "swapped markers", "gap of the IMU", "ten minutes",
)  # fmt: skip
HEADER = ("situation", "runs", "accepted", "wrong", "rejected", "refused", "worst accepted")


def main() -> None:
    """Read result folders, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="RESULTS")
    parser.add_argument("--foreign", action="store_true")
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    rows = [row for folder in arguments.folders for row in rows_of(folder)]
    opened = arguments.output.open("w", encoding="utf-8", newline="") if arguments.output else nullcontext(sys.stdout)
    with opened as stream:
        csv.writer(stream, lineterminator="\n").writerows(table(rows, foreign=arguments.foreign))


def rows_of(folder: Path) -> list[Row]:
    """Return the runs of a study."""
    seconds = json.loads((folder / "study.json").read_text(encoding="utf-8"))["seconds"]
    return RowFile(folder, seconds).rows()


def table(rows: Sequence[Row], *, foreign: bool) -> list[list[str]]:
    """Return header and rows: of all, and of each situation, or of each size of the foreign ones."""
    grouped: dict[str, list[Row]] = {}
    for situation in situations():  # their order
        if (situation.name in FOREIGN) == foreign:
            grouped.setdefault(f"{situation.name}, {situation.size}" if foreign else situation.name, [])
    for row in rows:
        if (row.name in FOREIGN) == foreign:
            grouped[f"{row.name}, {row.size}" if foreign else row.name].append(row)
    last = error_over_deviation if foreign else cause_named
    everything = {"all": [row for own in grouped.values() for row in own], **grouped}
    out = [[*HEADER, "error / sd" if foreign else "cause named"]]
    return out + [[name, *counts(own), last(own)] for name, own in everything.items() if own]


def counts(rows: Sequence[Row]) -> list[str]:
    """Return numbers of runs by verdict, and the largest error of an accepted one."""
    verdicts = {verdict: [row for row in rows if row.verdict == verdict] for verdict in VERDICTS}
    if verdicts["crashed"]:
        raise SystemExit(f"crashed: {verdicts['crashed'][0]}")
    accepted = [row.worst for row in verdicts["accepted"]]
    numbers = (len(rows), len(accepted), sum(worst > WRONG for worst in accepted))
    others = (len(verdicts["rejected"]), len(verdicts["refused"]))
    return [*map(str, (*numbers, *others)), f"{max(accepted):.1f}" if accepted else ""]


def cause_named(rows: Sequence[Row]) -> str:
    """Return how many of the runs that were rejected, or that name a cause, name a true one first."""
    causes = {(s.name, s.size, s.basis): s.causes for s in situations()}
    noticed = [row for row in rows if causes.get(row.key, ()) and (row.verdict == "rejected" or row.named)]
    return f"{sum(rightly(row, causes.get(row.key, ())) for row in noticed)} of {len(noticed)}" if noticed else ""


def error_over_deviation(rows: Sequence[Row]) -> str:
    """Return the rms of error over standard deviation of the accepted runs."""
    ratios = [row.ratio for row in rows if row.verdict == "accepted"]
    return f"{np.sqrt(np.mean(np.square(ratios))):.2f}" if ratios else ""


if __name__ == "__main__":
    main()
