"""Arrays as the compiled library takes them, and the named tuples that are made of them."""

from __future__ import annotations

import ctypes
from typing import Annotated, Any, ClassVar, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

LANES = 4
"""Columns that are computed together."""


class View(ctypes.Structure):
    """Where an array's numbers lie, and the lengths of its axes."""

    dtype: ClassVar[np.dtype[Any]]
    axes: ClassVar[int]

    @classmethod
    def from_param(cls, array: NDArray[Any]) -> View:
        """Return the view of an array, which must live until the call returns.

        Raises
        ------
        TypeError
            If the array has another type or number of axes, or its numbers do not lie one after another.
        """
        if array.dtype != cls.dtype or array.ndim != cls.axes or not array.flags.c_contiguous:
            raise TypeError(
                f"array {array.dtype} {array.shape}, contiguous: {array.flags.c_contiguous}; expected {cls.dtype} with "
                f"{cls.axes} axes, contiguous"
            )
        return cls(array.__array_interface__["data"][0], *array.shape)


def _view(name: str, dtype: type[np.generic], *axes: str) -> type[View]:
    fields = [("data", ctypes.c_void_p), *((axis, ctypes.c_int64) for axis in axes)]
    return type(name, (View,), {"_fields_": fields, "dtype": np.dtype(dtype), "axes": len(axes)})


NumbersView = _view("NumbersView", np.float64, "count")
TableView = _view("TableView", np.float64, "rows", "columns")
StackView = _view("StackView", np.float64, "tables", "rows", "columns")
IndicesView = _view("IndicesView", np.int64, "count")
IndexTableView = _view("IndexTableView", np.int64, "rows", "columns")
BytesView = _view("BytesView", np.uint8, "count")
MaskView = _view("MaskView", np.bool_, "count")

Array = NDArray[np.float64]
Numbers = Annotated[NDArray[np.float64], NumbersView]
Table = Annotated[NDArray[np.float64], TableView]
Stack = Annotated[NDArray[np.float64], StackView]
Indices = Annotated[NDArray[np.int64], IndicesView]
IndexTable = Annotated[NDArray[np.int64], IndexTableView]
Mask = Annotated[NDArray[np.bool_], MaskView]


class Pointer:
    """A named tuple of arrays, numbers and named tuples, passed by its address.

    Its fields' annotations say how each is passed: the library has a structure with the same fields in the same order.
    `keep` keeps the last one, for values that are passed again and again.
    """

    def __init__(self, kind: type[NamedTuple], *, keep: bool = False) -> None:
        self._structure = _structure(kind)
        self._keep = keep
        self._last: tuple[NamedTuple, ctypes.Structure] | None = None

    @property
    def structures(self) -> list[type[ctypes.Structure]]:
        """The structure, and those of the named tuples in it."""
        own, out = [self._structure], []
        while own:
            out.append(own.pop())
            own += [kind for _, kind in _fields(out[-1]) if not issubclass(kind, View) and hasattr(kind, "_fields_")]
        return out

    def from_param(self, values: NamedTuple) -> object:
        """Return the address of the values, as the library takes them."""
        last = self._last
        if last is not None and last[0] is values:
            return ctypes.byref(last[1])
        filled = _filled(self._structure, values)
        if self._keep:
            self._last = values, filled
        return ctypes.byref(filled)


def _structure(kind: type[NamedTuple]) -> type[ctypes.Structure]:
    hints = get_type_hints(kind, include_extras=True)
    fields = [(name, _passed(hints[name])) for name in kind._fields]
    return type(kind.__name__, (ctypes.Structure,), {"_fields_": fields})


def _passed(hint: Any) -> type:
    """Return how a value of an annotated type is passed."""
    if get_origin(hint) is Annotated:
        return get_args(hint)[1]
    if hint is float:
        return ctypes.c_double
    return ctypes.c_int64 if hint in (int, bool) else _structure(hint)


def _filled(structure: type[ctypes.Structure], values: NamedTuple) -> ctypes.Structure:
    out = structure()
    for field, value in zip(structure._fields_, values, strict=True):
        name, kind = field[0], field[1]
        if issubclass(kind, View):
            setattr(out, name, kind.from_param(value))
        else:
            setattr(out, name, _filled(kind, value) if issubclass(kind, ctypes.Structure) else value)
    return out


_NAMES: dict[Any, str] = {ctypes.c_double: "double", ctypes.c_int64: "Index"}


def _fields(structure: type[ctypes.Structure]) -> list[tuple[str, Any]]:
    return [(field[0], field[1]) for field in structure._fields_]


def described(structure: type[ctypes.Structure]) -> str:
    """Return a structure in words, as `layout.hpp` does: its size, then name, place and type of each field."""
    fields = [
        f"{name} {getattr(structure, name).offset} {_NAMES.get(kind, kind.__name__.removesuffix('View'))}"
        for name, kind in _fields(structure)
    ]
    return f"{ctypes.sizeof(structure)} {', '.join(fields)}"


def padded(columns: Array) -> Array:
    """Return a copy whose last axis is a multiple of `LANES`: copies of its last column stand after it."""
    m = columns.shape[-1]
    missing = -m % LANES
    if missing == 0:
        return np.array(columns, dtype=float, order="C")
    return np.concatenate([columns, np.repeat(columns[..., -1:], missing, axis=-1)], axis=-1).astype(float, order="C")


def for_columns(*shape: int) -> Array:
    """Return zeros of a shape whose last axis, the columns', is made a multiple of `LANES`."""
    return np.zeros((*shape[:-1], shape[-1] + -shape[-1] % LANES))


def check_lengths(**lengths: tuple[NDArray[Any], tuple[int, ...]]) -> None:
    """Compare the shapes of arrays with what they must be, given by the arrays' names.

    Raises
    ------
    ValueError
        Naming the first that differs.
    """
    for name, (array, shape) in lengths.items():
        if array.shape != shape:
            raise ValueError(f"{name} has the shape {array.shape}; expected {shape}")


def check_indices(name: str, indices: NDArray[np.int64], begin: int, end: int) -> None:
    """Compare indices with the range they must lie in, `end` not included.

    Raises
    ------
    ValueError
        If one lies outside.
    """
    if indices.size and not (begin <= indices.min() and indices.max() < end):
        raise ValueError(f"{name} from {indices.min()} to {indices.max()}; expected {begin} to {end - 1}")
