"""Every kernel made ready before the work begins, so that compiling shows as a step of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel._kernels import filtering, quadrature
from kreisel.estimation.filter import Belief, triangularise, widen
from kreisel.estimation.state import Part, StateLayout
from kreisel.inertial.strapdown import Samples, integrate_attitude, prepare


def _filter() -> None:
    """Run the filter over no updates: nothing is computed, all of it compiled."""
    layout = StateLayout([Part("held", 3), Part("turn", 3, rotation=True)])
    number, numbers, table, block = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 1))
    index, flags, rows = np.zeros(1, dtype=np.int64), np.zeros(2, dtype=bool), filtering.Rows
    some = rows(index, number)
    model = filtering.Model(
        layout.table, layout.table, number, some, some, some, some, index, index, index, index, 1, 1.0, True, 0.0, 0.0,
        number, number, index, number, 0.02,
    )  # fmt: skip
    samples = Samples(number, index, numbers, numbers, table, table, table, table, numbers, numbers)
    steps = filtering.Steps(index, index, number, flags, numbers, numbers, flags, block)
    record = filtering.Record(numbers, numbers, flags, numbers, numbers, block, block, block)
    filtering.run(model, samples, steps, 0, 0, number, 1, number.copy(), numbers.copy(), record, index)


def _belief() -> None:
    layout = StateLayout([Part("held", 3), Part("turn", 3, rotation=True)])
    belief = widen(layout, Belief(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.eye(6)), "held", 1.0)
    triangularise(np.hstack([belief.factor, np.eye(6)]))
    layout.minus(layout.plus(belief.mean, np.zeros((6, 1))), belief.mean)


_STEPS: tuple[Callable[[], object], ...] = (
    lambda: integrate_attitude(prepare(np.arange(12.0), np.zeros((12, 3)), np.zeros((12, 3))), np.zeros((4, 3))),
    _belief,
    lambda: quadrature.double_integral(
        np.arange(3.0), np.zeros((3, 3)), np.zeros(1, dtype=np.int64), np.zeros(1), np.empty((1, 3))
    ),
    _filter,
)


def compile_kernels(progress: Callable[[float], None] | None = None) -> None:
    """Compile every kernel, or load it from the cache, by small problems; seconds the first time.

    Parameters
    ----------
    progress
        Called with the share done.
    """
    for i, step in enumerate(_STEPS):
        step()
        if progress is not None:
            progress((i + 1) / len(_STEPS))
