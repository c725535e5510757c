"""The unit all speeds are quoted in: a strapdown pass over the same samples, compiled for this machine's processor.

It is the pass of `kreisel._kernels.strapdown_pass`, which is compiled for any processor and takes a tenth longer.
"""

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

_KERNELS = Path(__file__).parents[1] / "src/kernels"
_FLAGS = ("-std=c++17", "-O3", "-ffast-math", "-march=native", "-shared", "-fPIC", "-w")
_SOURCE = """
#include "strapdown_pass.hpp"
extern "C" double timed(
    const double *rates, const double *forces, long n,
    const double *K, const double *zero, const double *gravity, double dt
) {
    return strapdown_pass({rates, n, 3}, {forces, n, 3}, {K, 3, 3}, {zero, 3}, {K, 3, 3}, {zero, 3}, {gravity, 3}, dt);
}
"""


@cache
def _compiled() -> Any:
    compiler = ["c++"] if shutil.which("c++") else [sys.executable, "-P", "-m", "ziglang", "c++"]
    with tempfile.TemporaryDirectory() as scratch:
        source, library = Path(scratch) / "timed.cpp", str(Path(scratch) / "timed.so")
        source.write_text(_SOURCE, encoding="utf-8")
        subprocess.run([*compiler, *_FLAGS, f"-I{_KERNELS}", str(source), "-o", library], check=True)
        timed = ctypes.CDLL(library).timed
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    timed.restype = ctypes.c_double
    timed.argtypes = [array, array, ctypes.c_long, *[array] * 3, ctypes.c_double]
    return timed


def seconds(rates: Array, forces: Array, interval: float, repeats: int = 9) -> float:
    """Return the shortest time of one pass over readings (n, 3) among a few."""
    run, eye, zero = _compiled(), np.eye(3), np.zeros(3)
    rates, forces = np.ascontiguousarray(rates), np.ascontiguousarray(forces)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        run(rates, forces, len(rates), eye, zero, np.array([0.0, 0.0, -9.81]), interval)
        times.append(time.perf_counter() - began)
    return min(times)
