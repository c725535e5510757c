"""The filter over many updates: predict, measure, update, record."""

from __future__ import annotations

import ctypes

import numpy as np

from kreisel._kernels.compiled import check_count, function
from kreisel._kernels.filter_arguments import (
    ACCEL,
    COLOURED,
    GYRO,
    MEASURED,
    NOISE,
    STORED,
    Gate,
    Gaussian,
    Model,
    Record,
    Samples,
    Steps,
)
from kreisel._kernels.views import (
    IndicesView,
    Pointer,
    check_indices,
    check_lengths,
)

_RATES = 4  # features of a rate without error terms, 1 and the three rates: RATES in coefficients.hpp
check_count("rates", _RATES)

_run = function(
    "run", Pointer(Model, keep=True), Pointer(Samples), Pointer(Steps), ctypes.c_int64, ctypes.c_int64, Pointer(Gate),
    Pointer(Gaussian), Pointer(Record, keep=True), IndicesView,
)  # fmt: skip


def run(
    model: Model, signal: Samples, steps: Steps, begin: int, end: int, gate: Gate, belief: Gaussian, record: Record
) -> int:
    """Carry a belief over the updates from `begin` to `end`, in place.

    Returns
    -------
    int
        The update it stopped before: less than `end` if too many measurements were rejected in a row, or the
        state is no longer finite.

    Raises
    ------
    ValueError
        If lengths or indices do not fit together.
    """
    stopped = np.zeros(1, dtype=np.int64)
    _check_belief(model, belief)
    _check_signal(signal, model)
    _check_steps(model, signal, steps, begin, end)
    check_lengths(about=(steps.about, (steps.first.size, min(steps.about.shape[1], belief.mean.size))))
    _check_record(record, begin, end, belief, model)
    check_lengths(bounds=(gate.bounds, (MEASURED + 1,)), rejected=(gate.rejected, (1,)))
    _run(model, signal, steps, begin, end, gate, belief, record, stopped)
    return int(stopped[0])


_checked: tuple[Model, int, int] | None = None
"""The last model that was checked, with degrees of freedom and numbers of its state."""


def _check_belief(model: Model, belief: Gaussian) -> None:
    global _checked
    n, size = belief.upper.shape[0], belief.mean.size
    check_lengths(upper=(belief.upper, (n, n)))
    if _checked is None or _checked[0] is not model or _checked[1:] != (n, size):
        _check_model(model, n, size)
        _checked = model, n, size


def _check_model(model: Model, n: int, size: int) -> None:
    check_lengths(
        parts=(model.parts, (len(model.parts), 4)),
        tail=(model.tail, (len(model.tail), 4)), weights=(model.weights, (5,)),
        gyro=(model.gyro.source, (GYRO["gyro_effects"] + model.gyro_applied.size,)),
        accel=(model.accel.source, (ACCEL["accel_effects"] + model.accel_applied.size,)),
        gyro_effects=(model.gyro_effects, (len(model.gyro_effects), 3)),
        accel_effects=(model.accel_effects, (len(model.accel_effects), 3)),
        around=(model.around.source, (10,)), stored=(model.stored, (len(STORED),)),
        noise=(model.noise, (len(NOISE),)), standstill=(model.standstill, (2,)),
        coloured=(model.coloured, (len(COLOURED),)),
        varying=(model.varying, model.varying.shape),
        walk=(model.walk, model.walking.shape), fading=(model.fading, model.walking.shape),
    )  # fmt: skip
    for name in ("gyro", "accel", "around", "robot"):
        rows = getattr(model, name)
        check_lengths(known=(rows.known, rows.source.shape))
        check_indices(name, rows.source, -1, size)
    check_indices("gyro_effects", model.gyro_effects, -1, model.gyro_applied.size)
    check_indices("accel_effects", model.accel_effects, -1, model.accel_applied.size)
    check_indices("walking", model.walking, 0, n)
    check_indices("varying", model.varying, 0, n)
    check_indices("stored", model.stored, -1, size - 2)
    check_indices("stored, moving", model.stored[:3], 0, size - 2)
    first, degrees, stored, rotation = model.parts.T
    held = np.cumsum(np.where(rotation, 4, degrees))
    if not (np.array_equal(first, np.cumsum(degrees) - degrees) and first[-1] + degrees[-1] == n and held[-1] == size):
        raise ValueError(f"the parts do not make up a state of {n} degrees of freedom and {size} numbers")
    if not np.array_equal(stored[1:], held[:-1]) or np.any(degrees[rotation == 1] > 3):
        raise ValueError("the parts do not lie one after another")
    if not {*map(tuple, model.sampled)} <= {*map(tuple, model.parts)}:
        raise ValueError("parts are sampled that are not in the state")
    last = model.parts[len(model.parts) - len(model.tail) :]
    if not np.array_equal(last - [last[0, 0], 0, last[0, 2], 0], model.tail):
        raise ValueError("the tail is not the last parts of the state")
    if not 0 <= model.gyro_degrees <= model.sensor_degrees <= n:
        raise ValueError(f"{model.gyro_degrees} and {model.sensor_degrees} of {n} degrees of freedom are the sensors'")


def _check_signal(signal: Samples, model: Model) -> None:
    n, P = signal.stamps.size, _RATES + len(model.gyro_effects)
    check_lengths(
        base=(signal.base, (n - 1,)), single=(signal.single, (n - 1, 6)), twice=(signal.twice, (n - 1, 6)),
        rates=(signal.rates, (P, n)), slopes=(signal.slopes, (_RATES, n)),
        integrals=(signal.integrals, (P, n - 1)),
        forces=(signal.forces, (3 + len(model.accel_effects), n)), noise=(signal.noise, (4, 3)),
    )  # fmt: skip
    check_indices("base", signal.base, 0, n - 5)


def _check_steps(model: Model, signal: Samples, steps: Steps, begin: int, end: int) -> None:
    u = steps.first.size
    if not 0 <= begin <= end <= u:
        raise ValueError(f"updates {begin} to {end} of {u}")
    check_lengths(
        last=(steps.last, (u,)), tau=(steps.tau, (u,)), stamp=(steps.stamp, (u,)),
        at_standstill=(steps.at_standstill, (u,)),
        new_standstill=(steps.new_standstill, (u,)),
        position=(steps.position, (u, 3)), quaternion=(steps.quaternion, (u, 4)), given=(steps.given, (2,)),
        regressor=(steps.regressor, (u, 6, steps.regressor.shape[2])),
    )  # fmt: skip
    if steps.regressor.shape[2] not in (0, model.robot.source.size):
        raise ValueError(f"{steps.regressor.shape[2]} errors of the robot; expected {model.robot.source.size}")
    first, last = steps.first[begin:end], steps.last[begin:end]
    check_indices("first", first, 0, signal.stamps.size - 1)
    check_indices("last", last, 1, signal.stamps.size - 1)
    if np.any(first > last):
        raise ValueError("an update whose last sample stands before its first")


def _check_record(record: Record, begin: int, end: int, belief: Gaussian, model: Model) -> None:
    u, m = len(record.used), MEASURED
    if end > u:
        raise ValueError(f"updates {begin} to {end} for a record of {u}")
    numbers, wide = (record.nis, record.log_likelihood, record.turn_information), record[6:10]
    six = (record.passing, record.correction, record.correction_variance)
    shapes = {(u,): numbers, (u, m): wide, (u, 6): six, (u, 2): (record.late,)}
    check_lengths(**{f"record_{len(s)}_{i}": (a, s) for s, arrays in shapes.items() for i, a in enumerate(arrays)})
    n, tables, known = belief.upper.shape[0], len(record.transition), len(record.before)
    if tables not in (0, u) or known not in (0, u):
        raise ValueError(f"{tables} tables of slopes and {known} of means for a record of {u}")
    changing = int(model.tail[:, 1].sum())
    check_lengths(
        before=(record.before, (known, belief.mean.size)),
        covariance=(record.covariance, (known, model.varying.size, n)),
        transition=(record.transition, (tables, changing, n)), design=(record.design, (tables, m, n)),
        gain=(record.gain, (tables, m, n)), whitening=(record.whitening, (tables, m, m)),
    )  # fmt: skip
    for name, array, most in (
        ("mean", record.mean, belief.mean.size), ("deviation", record.deviation, belief.upper.shape[0])
    ):  # fmt: skip
        if array.shape[0] != u or array.shape[1] > most:
            raise ValueError(f"the record's {name} has the shape {array.shape}; expected {u} and at most {most}")
