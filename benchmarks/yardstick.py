"""The unit all speeds are quoted in: a strapdown pass over the same samples, in C, for this machine's processor."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.geometry.rotation import Array

_SOURCE = Path(__file__).with_name("strapdown_pass.c")
_FLAGS = ("-O3", "-ffast-math", "-march=native", "-shared", "-fPIC")


@cache
def _compiled() -> Any:
    compiler = ["cc"] if shutil.which("cc") else [sys.executable, "-P", "-m", "ziglang", "cc"]
    with tempfile.TemporaryDirectory() as scratch:
        library = str(Path(scratch) / "strapdown_pass.so")
        subprocess.run([*compiler, *_FLAGS, str(_SOURCE), "-o", library], check=True)
        function = ctypes.CDLL(library).strapdown_pass
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    function.restype = ctypes.c_double
    function.argtypes = [array, array, ctypes.c_long, *[array] * 5, ctypes.c_double]
    return function


def seconds(rates: Array, forces: Array, interval: float, repeats: int = 9) -> float:
    """Return the shortest time of one pass over readings (n, 3) among a few."""
    run, eye, zero = _compiled(), np.eye(3), np.zeros(3)
    rates, forces = np.ascontiguousarray(rates), np.ascontiguousarray(forces)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        run(rates, forces, len(rates), eye, zero, eye, zero, np.array([0.0, 0.0, -9.81]), interval)
        times.append(time.perf_counter() - began)
    return min(times)
