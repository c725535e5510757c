"""What the tests of broken recordings share: a good recording, the command in this process, and what to check."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.cli.main import run
from kreisel.recording.recording import Recording

from ..small_cell import Truth, simulate

Break = Callable[[Recording], Recording]
Damage = Callable[[Path], object]
Command = Callable[..., "Ended"]


@dataclass(frozen=True)
class Case:
    """A fault, the status it must end with, and what must be said of it."""

    fault: Callable[..., object]
    status: int
    words: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.fault.__name__


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int
    out: str
    err: str


@cache
def simulated(seed: int = 1) -> tuple[Truth, Recording]:
    """Return forty seconds of the small cell, with their truth."""
    return simulate(np.random.default_rng(seed), 40.0, Path("good"))


def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the `kreisel` command as a function that runs it in this process."""

    def call(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["kreisel", *map(str, arguments)])
        monkeypatch.delenv("KREISEL_DEBUG", raising=False)
        with pytest.raises(SystemExit) as ended:
            run()
        return Ended(ended.value.code or 0, *capsys.readouterr())

    return call


def check(case: Case, ended: Ended, truth: Truth) -> None:
    """Check status, number of lines, words; and that what was accepted is right."""
    assert ended.status == case.status, ended.err or ended.out[:2000]
    if case.status == 1:
        assert_one_line(ended.err, case.words)
        return
    document = json.loads(ended.out)
    verdict, warnings = document["verdict"], " | ".join(document["recording"]["findings"])
    told = " | ".join(verdict["reasons"]) if case.status == 3 else warnings
    for word in case.words:
        assert word in told
    if case.status == 0:
        assert verdict["accepted"]
        assert worst_error(document, truth) < 5.0


def assert_one_line(err: str, words: tuple[str, ...]) -> None:
    assert err.count("\n") == 1, err
    assert err.startswith("kreisel: ")
    assert "unexpected" not in err
    assert "Traceback" not in err
    for word in words:
        assert word in err


def worst_error(document: dict, truth: Truth) -> float:
    """Return the largest error of any parameter in its standard deviations."""
    s, sd = truth.sensors, document["standard_deviation"]
    errors = [(document["timing"]["offset"] - truth.time_offset) / sd["timing"]["offset"]]
    for sensor, key, true in (
        ("gyroscope", "cross_coupling", s.K_omega),
        ("gyroscope", "offset", s.k_w[0]),
        ("accelerometer", "cross_coupling", s.K_a),
        ("accelerometer", "offset", s.k_a[0]),
        ("accelerometer", "lever_arms", s.lever_arms),
    ):
        errors += ((np.array(document[sensor][key]) - true) / np.array(sd[sensor][key])).ravel().tolist()
    return max(map(abs, errors))
