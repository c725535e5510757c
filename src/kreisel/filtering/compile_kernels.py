"""Compilation of all kernels before the work starts, so that progress shows it as a step of its own.

The first compilation runs in helper processes, two at a time where possible, and fills the cache from which all later
starts load the kernels.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from kreisel._kernels import (
    cell,
    compilation,
    composition,
    filter_loop,
    measurement_model,
    preintegration,
    process_model,
    quadrature,
    sensor_noise,
    sigma_point_filter,
    unit_forces,
)
from kreisel._kernels.increments import Coefficients, Increments, Span
from kreisel.estimation.belief import Belief, inflate_variance, triangularise
from kreisel.estimation.state import Part, StateLayout
from kreisel.inertial.strapdown import Samples, integrate_attitude, prepare
from kreisel.progress import StepProgress

_LAYOUT = StateLayout([Part("held", 3), Part("turn", 3, rotation=True)])
_NUMBER, _NUMBERS, _BLOCK = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1))
_INDEX, _FLAGS = np.zeros(1, dtype=np.int64), np.zeros(2, dtype=bool)


def _signal() -> None:
    """Integrate readings of no motion."""
    signal = prepare(np.arange(12.0), np.zeros((12, 3)), np.zeros((12, 3)))
    integrate_attitude(signal, np.zeros((4, 3)))
    quadrature.double_integral(np.arange(3.0), np.zeros((3, 3)), _INDEX, _NUMBER, np.empty((1, 3)))
    x, q = np.zeros((3, 3)), np.zeros((3, 4))
    unit_forces.at_sample(q[0], x[0], x[0], x[0], np.empty(3 * unit_forces.PARAMETERS))
    unit_forces.double_integrals(np.arange(3.0), q, x, x, x, _INDEX, _NUMBER, np.empty((1, 3 * unit_forces.PARAMETERS)))


def _belief() -> None:
    """Inflate, triangularise and change a belief in six numbers."""
    belief = inflate_variance(_LAYOUT, Belief(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.eye(6)), "held", 1.0)
    triangularise(np.hstack([belief.factor, np.eye(6)]))
    _LAYOUT.minus(_LAYOUT.plus(belief.mean, np.zeros((6, 1))), belief.mean)


def _model() -> cell.Model:
    some = cell.ParameterRows(_INDEX, _NUMBER)
    return cell.Model(
        _LAYOUT.table, _LAYOUT.table, _NUMBER, some, some, some, some, _INDEX, _INDEX, _INDEX, _INDEX, 1, 1.0, True,
        0.0, 0.0, _NUMBER, _NUMBER, _INDEX, _NUMBER, 0.02,
    )  # fmt: skip


def _samples() -> Samples:
    x = _NUMBERS
    return Samples(_NUMBER, _INDEX, x, x, x, x, x, x, x, 1.0)


def _filter() -> None:
    """Run the filter over no updates: nothing is computed, but all of it is compiled."""
    steps = cell.Steps(_INDEX, _INDEX, _NUMBER, _FLAGS, _NUMBERS, _NUMBERS, _FLAGS, _BLOCK)
    record = cell.Record(_NUMBERS, _NUMBERS, _FLAGS, _NUMBERS, _NUMBERS, _BLOCK, _BLOCK, _BLOCK)
    gate = cell.Gate(_NUMBER, 1, _INDEX)
    filter_loop.run(_model(), _samples(), steps, 0, 0, gate, sigma_point_filter.Gaussian(_NUMBER, _NUMBERS), record)


_SPAN = Span(0, 0, 0, 0)
_INCREMENTS = Increments(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, _BLOCK, _NUMBERS, _NUMBERS)


def _motion_kernels() -> None:
    compilation.compile_for(process_model.sensor_coefficients, _model(), _NUMBERS, _BLOCK, _BLOCK, _BLOCK)
    coefficients = Coefficients(_BLOCK, _BLOCK, _BLOCK)
    compilation.compile_for(preintegration.preintegrate, _SPAN, _samples(), coefficients, _INCREMENTS)


def _update_kernels() -> None:
    x = _NUMBERS
    compilation.compile_for(sigma_point_filter.draw, _LAYOUT.table, _NUMBER, x, 0.0, x)
    belief, predicted = sigma_point_filter.Gaussian(_NUMBER, x), sigma_point_filter.Predicted(x, x, x, x)
    table = _LAYOUT.table
    compilation.compile_for(sigma_point_filter.update, table, table, _NUMBER, belief, predicted, _NUMBER, x, 0.0)
    compilation.compile_for(composition.compose, 0.0, _INDEX, _INCREMENTS, x, x, x, x, x)
    compilation.compile_for(sensor_noise.noise_covariance, _SPAN, 0, _samples(), _INCREMENTS, x, x, x)
    compilation.compile_for(sensor_noise.navigation_noise, x, _NUMBER, _NUMBER, x)
    motion = cell.IntegratedMotion(x, x, x, _BLOCK, x, x, x, x)
    moments = cell.Moments(_NUMBER, 0.0, 0.0, _INDEX, _INDEX)
    compilation.compile_for(measurement_model.predict_poses, _model(), motion, x, True, moments, x)


_NEEDED = (_signal, _belief, _filter)
"""Functions that load every kernel into this process."""

_ASIDE: dict[str, tuple[Callable[[], None], ...]] = {
    "motion": (_motion_kernels, _signal),
    "update": (_update_kernels, _belief),
    "filter": (_filter,),
}
"""Functions that helper processes run, by the name of the work."""

_ROUNDS = (("motion", "update"), ("filter",))
"""Works that run at the same time; the last one combines what the others have compiled."""


def compile_kernels(progress: StepProgress | None = None) -> None:
    """Compile every kernel, or load it from the cache, with small problems; the first time takes half a minute.

    Parameters
    ----------
    progress
        Called with the share done.
    """
    if compilation.is_cold(filter_loop.run):
        for works in _ROUNDS:
            _compile_aside(works, progress)
    for step in _NEEDED:
        step()
    if progress is not None:
        progress(1.0)


def _compile_aside(works: tuple[str, ...], progress: StepProgress | None) -> None:
    """Compile in a process for each work; if one fails, this process compiles what is missing."""
    command = [sys.executable, "-m", __name__]
    quiet = subprocess.DEVNULL
    helpers = [subprocess.Popen([*command, work], stdout=quiet, stderr=quiet) for work in works]
    try:
        while any(helper.poll() is None for helper in helpers):
            time.sleep(0.1)
            if progress is not None:
                progress(compilation.share_compiled())
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()


if __name__ == "__main__":
    for compile_some in _ASIDE[sys.argv[1]]:
        compile_some()
