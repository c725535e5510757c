"""A shift at a station: many simulated units by keyboard alone, one unplugged, one killed station; then the books.

Run: python -m design.station_trial FOLDER [UNITS]. Every recording is calibrated again by the command, and its outcome
compared with that in the file of results.
"""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright
from tests.station_line import PROGRAM, Operator, StationLine

from kreisel.formats.loading import load

STATUS = {"conforms": 0, "does not conform": 3, "rejected": 3, "no decision": 4, "failed": 1}


def main(folder: Path, units: int) -> None:
    """Run the shift, and print what the file of results holds."""
    folder.mkdir(parents=True)
    limits = folder / "limits.toml"
    limits.write_text("[limits]\naccel_non_orthogonality_mrad = 15.0\ngyro_scale_error_ppm = 8000.0\n")
    line = StationLine(folder, more=("--limits", str(limits), "--retests", "0"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        try:
            _shift(line, page, units)
        finally:
            line.end()
            browser.close()
    _check(line.output, limits, units)


def _chromium() -> str:
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))


def _shift(line: Any, page: Any, units: int) -> None:
    port = line.start(line.clamp(100))
    operator, began = Operator(page, line.url), time.monotonic()
    for number in range(units):
        serial = f"SN-{number:04d}"
        line.clamp(100 + number)
        operator.scan(serial)
        operator.busy()
        if number == units // 3:
            operator.recording()
            line.imu.pull()
            operator.result(serial)
            line.clamp(100 + number)
            operator.again()
        if number == 2 * units // 3:
            operator.recording()
            line.kill()
            line.start(line.folder / "cell-100", port)
            operator.wait(lambda: operator.word == "! NOT TESTED")
            operator.again()
        word = operator.result(serial)
        print(f"{time.monotonic() - began:6.1f} s  {serial}  {word}", flush=True)


def _check(output: Path, limits: Path, units: int) -> None:
    with sqlite3.connect(output / "results.db") as database:
        rows = database.execute("select unit, outcome, recording, state from attempts order by id").fetchall()
    tested = {unit: (outcome, recording) for unit, outcome, recording, _ in rows if outcome != "interrupted"}
    wrong = [
        unit for unit, (outcome, recording) in tested.items() if _again(output / recording, limits) != STATUS[outcome]
    ]
    kept = sum(load(output / recording).imu.stamps_ns.size > 0 for _, _, recording, _ in rows)
    ended = sum(state == "ended" for *_, state in rows)
    print(f"{units} units, {len(rows)} attempts, {ended} ended, {kept} recordings that can be read")
    print(f"outcomes: {sorted(outcome for _, outcome, _, _ in rows)}")
    print(f"{len(tested)} units tested; outcome differs from that of the command: {wrong or 'none'}")


def _again(recording: Path, limits: Path) -> int:
    own = [*PROGRAM, "calibrate", str(recording), "--limits", str(limits)]
    return subprocess.run(own, capture_output=True, check=False).returncode


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20)
