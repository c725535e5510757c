"""Tables of docs/explanation/robustness.md from the results of robustness studies.

Run: kreisel study robustness -o RESULTS, then python design/robustness_table.py RESULTS -o docs/data/robustness.csv,
with --foreign -o docs/data/foreign.csv: the situations of users' own data, a row for each size; and with --random -o
docs/data/random.csv: errors that are on no list, from kreisel study robustness --random N -o RESULTS, a row for each
basic cell.
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
from kreisel.study.situations import RANDOM, Situation, situations

FOREIGN = (
    "propellers", "gentle flight", "never at rest", "clock of the reference", "unsaid height", "noise and lag",
    "noise and flicker", "frozen poses", "swapped markers", "gap of the IMU", "ten minutes",
)  # fmt: skip
HEADER = ("situation", "runs", "accepted", "wrong", "rejected", "refused", "worst accepted")


def main() -> None:
    """Read result folders, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="RESULTS")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--foreign", action="store_const", dest="kind", const="foreign", default="usual")
    chosen.add_argument("--random", action="store_const", dest="kind", const="random")
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    rows = [row for folder in arguments.folders for row in rows_of(folder)]
    opened = arguments.output.open("w", encoding="utf-8", newline="") if arguments.output else nullcontext(sys.stdout)
    with opened as stream:
        csv.writer(stream, lineterminator="\n").writerows(table(rows, arguments.kind))


def rows_of(folder: Path) -> list[Row]:
    """Return the runs of a study."""
    seconds = json.loads((folder / "study.json").read_text(encoding="utf-8"))["seconds"]
    return RowFile(folder, seconds).rows()


def kind_of(name: str) -> str:
    """Return which table a situation belongs to."""
    return "random" if name == RANDOM else "foreign" if name in FOREIGN else "usual"


def table(rows: Sequence[Row], kind: str) -> list[list[str]]:
    """Return header and rows: of all, and of each situation, size of the foreign ones, or basic cell of the random."""
    grouped: dict[str, list[Row]] = {}
    for situation in situations():  # their order
        if kind_of(situation.name) == kind:
            grouped.setdefault(_title(situation, kind), [])
    for row in rows:
        if kind_of(row.name) == kind:
            grouped.setdefault(_title(row, kind), []).append(row)
    last = cause_named if kind == "usual" else error_over_deviation
    everything = {"all": [row for own in grouped.values() for row in own], **grouped}
    out = [[*HEADER, "cause named" if kind == "usual" else "error / sd"]]
    return out + [[name, *counts(own), last(own)] for name, own in everything.items() if own]


def _title(one: Situation | Row, kind: str) -> str:
    return {"usual": one.name, "foreign": f"{one.name}, {one.size}", "random": f"{one.name}, {one.basis}"}[kind]


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
