"""What the tests of broken recordings share: a good recording, edits of it, the command in this process, and checks."""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

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


FAULTS: list[Case] = []
"""Every fault that is declared with `refused`, `rejected` or `handled`: see the modules `faults_of_*`."""


def refused(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 1, words)) or fault


def rejected(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 3, words)) or fault


def handled(*words: str) -> Callable[[Break], Break]:
    return lambda fault: FAULTS.append(Case(fault, 0, words)) or fault


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


def imu(r: Recording, **parts: object) -> Recording:
    return replace(r, imu=replace(r.imu, **parts))


def poses(r: Recording, **parts: object) -> Recording:
    return replace(r, reference=replace(r.reference, **parts))


def with_rates(r: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    """Return the recording with rates that a function has changed in place."""
    rates = r.imu.rates.copy()
    change(rates)
    return imu(r, rates=rates)


def with_accelerations(r: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    accelerations = r.imu.accelerations.copy()
    change(accelerations)
    return imu(r, accelerations=accelerations)


def put(index: object, value: object) -> Callable[[np.ndarray], None]:
    return lambda array: array.__setitem__(index, value)


def samples(r: Recording, keep: object) -> Recording:
    s = r.imu
    return imu(r, stamps_ns=s.stamps_ns[keep], rates=s.rates[keep], accelerations=s.accelerations[keep])


def between(r: Recording, low: float, high: float) -> np.ndarray:
    t = r.reference.seconds
    return (t > low) & (t < high)


def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the `kreisel` command as a function that runs it in this process."""

    def call(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["kreisel", *map(str, arguments)])
        monkeypatch.delenv("KREISEL_DEBUG", raising=False)
        # the command changes the environment of its process; other tests must not inherit that
        with patch.dict(os.environ), pytest.raises(SystemExit) as ended:
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
