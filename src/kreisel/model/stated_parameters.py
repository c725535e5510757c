"""What the user knows of single parameters, or of all of a group: a value with its deviation, or that it is fixed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array, Indices
from kreisel.model.groups import REGISTRY, ParameterGroup, group_named

Known = tuple[str, float | None, float]
"""Name of a parameter, its value (None: the start value) and standard deviation, SI; the deviation 0 fixes it."""

_JOINTS = 9
"""Joints of an arm whose parameters can be named."""

_MIN = 1e-12
"""SI; least deviation that can be stated, besides 0. Chosen: nobody knows a parameter so well; who means that it is
known exactly states 0, and its square, 1e-24, would be lost in rounding beside others."""

_PAIR = re.compile(r"^(?P<value>.*\S)\s*(?:\+-|±|\+/-)\s*(?P<sd>\S.*)$", re.S)


def place_of(name: str, order: int) -> tuple[str, int]:
    """Return the group of a parameter and its place in it, by its path in the result file.

    Raises
    ------
    SettingsError
        If there is no such parameter.
    """
    for group in _nameable():
        names = group.names(order, _JOINTS)
        if name in names:
            return group.name, names.index(name)
    raise SettingsError(_unknown(name, order))


def known_parameters(given: object, order: int, table: str) -> tuple[Known, ...]:
    """Return what is known of each parameter, from a mapping of names to values and deviations.

    Parameters
    ----------
    given
        From names of parameters (paths in the result file) or of groups to (value, deviation); for a group, each is one
        number for all, or an array in the shape of the result file. Or what this function has returned.
    order
        Of the sensor polynomials.
    table
        Where it was given, for messages.

    Raises
    ------
    SettingsError
        If a name is unknown, or a value impossible; the message names it.
    """
    if isinstance(given, tuple):
        given = {name: (value, deviation) for name, value, deviation in given}
    if not isinstance(given, Mapping):
        raise SettingsError(f"{table} = {given!r}; expected a mapping of names to (value, standard deviation)")
    out: dict[str, Known] = {}
    for name, pair in given.items():
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise SettingsError(f"{table}['{name}'] = {pair!r}; expected (value, standard deviation), in SI")
        for one, value, deviation in _spread(str(name), pair[0], pair[1], order, table):
            out[one] = _checked(one, value, deviation, order, table)
    return tuple(out.values())


def parse_fixed(given: Iterable[str]) -> dict[str, Any]:
    """Return names of parameters and groups with their values (None: the start value), by texts NAME or NAME=VALUE.

    Raises
    ------
    SettingsError
        If a value is no number.
    """
    pairs = [text.partition("=") for text in given]
    return {name.strip(): parse_value(value, f"--fix {name}") if equals else None for name, equals, value in pairs}


def parse_priors(given: Iterable[str]) -> dict[str, tuple[Any, Any]]:
    """Return names with values and deviations, by texts NAME=VALUE+-DEVIATION.

    Raises
    ------
    SettingsError
        If one is another text.
    """
    pairs = [text.partition("=") for text in given]
    return {name.strip(): parse_prior(value, f"--prior {name}") for name, _, value in pairs}


def parse_prior(text: str, place: str) -> tuple[Any, Any]:
    """Return value and deviation of a text "value +- deviation", numbers or lists of them.

    Raises
    ------
    SettingsError
        If it is another text.
    """
    found = _PAIR.match(text.strip())
    if found is None:
        raise SettingsError(f"{place} = '{text}'; expected 'value +- standard deviation', in SI")
    return parse_value(found["value"], place), parse_value(found["sd"], place)


def parse_value(text: str, place: str) -> Any:
    """Return the number, or lists of numbers, in a text; None for "true": a start value.

    Raises
    ------
    SettingsError
        If it is another text.
    """
    if text.strip().lower() == "true":
        return None
    try:
        return json.loads(text)
    except ValueError as error:
        raise SettingsError(f"{place} = '{text}'; expected a number, or lists of numbers, in SI") from error


def with_marginal(
    mean: Array, covariance: Array, index: Indices, value: Array, deviation: Array
) -> tuple[Array, Array]:
    """Return a Gaussian some numbers of which have a given value and deviation, independent of each other.

    What depends on them follows by regression (Jeffrey's rule); fixed numbers (deviation 0) depend on nothing.
    """
    P = covariance[np.ix_(index, index)]
    gain = np.linalg.solve(P, covariance[index]).T
    new_mean = mean + gain @ (value - mean[index])
    new = covariance + gain @ (np.diag(deviation**2) - P) @ gain.T
    new_mean[index] = value
    rows = np.array(index)[deviation == 0.0]
    new[rows], new[:, rows] = 0.0, 0.0
    return new_mean, 0.5 * (new + new.T)


def with_observed(
    mean: Array, covariance: Array, index: Indices, value: Array, deviation: Array
) -> tuple[Array, Array]:
    """Return a Gaussian some numbers of which were also observed, with given deviations."""
    S = covariance[np.ix_(index, index)] + np.diag(deviation**2)
    gain = np.linalg.solve(S, covariance[index]).T
    new = covariance - gain @ S @ gain.T
    new_mean = mean + gain @ (value - mean[index])
    rows = np.array(index)[deviation == 0.0]
    new[rows], new[:, rows] = 0.0, 0.0
    new_mean[rows] = value[deviation == 0.0]
    return new_mean, 0.5 * (new + new.T)


def _nameable() -> Iterable[ParameterGroup]:
    """Return the groups whose parameters the user can know something of."""
    return (group for group in REGISTRY if not group.rotation and not group.passing)


def _unknown(name: str, order: int) -> str:
    group = next((g for g in REGISTRY if g.path == name.partition("[")[0].rstrip(".0123456789")), None)
    if group is not None and order == 1 and group.name.endswith("polynomial"):
        return f"'{name}' needs polynomial_order 2 or more"
    if group is not None and group in _nameable():
        names = group.names(order, _JOINTS)
        return f"unknown parameter '{name}'; those of {group.name} are {', '.join(names[:9])}"
    return (
        f"unknown parameter '{name}'; give a path of calibration.yaml, gyroscope.offset[0], or a group: "
        f"{', '.join(g.name for g in _nameable() if g.owner != 'robot')}"
    )


def _spread(
    name: str, value: ArrayLike | None, deviation: ArrayLike, order: int, table: str
) -> list[tuple[str, float | None, float]]:
    """Return the entries of single parameters for a name, which may be a group's."""
    if name not in {group.name for group in _nameable() if group.owner != "robot"}:
        place_of(name, order)
        names, shape = [name], tuple[int, ...]()
    else:
        group = group_named(name)
        names = list(group.names(order))
        shape = group.shape(order) if group.shape is not None else (len(names),)
        if not names:
            raise SettingsError(_unknown(group.path, order))

    def numbers(given: ArrayLike) -> Array:
        try:
            array = np.asarray(given, dtype=float)
        except (TypeError, ValueError) as error:
            raise SettingsError(f"{table}['{name}'] is not an array of numbers: {error}") from error
        if array.ndim and array.shape != shape:
            raise SettingsError(f"{table}['{name}'] has the shape {array.shape}, expected {shape}, or one number")
        return np.broadcast_to(array, shape).ravel()

    values = [None] * len(names) if value is None else numbers(value).tolist()
    return list(zip(names, values, numbers(deviation).tolist(), strict=True))


def _checked(name: str, value: float | None, deviation: float, order: int, table: str) -> Known:
    group = group_named(place_of(name, order)[0])
    if deviation != 0.0 and not (math.isfinite(deviation) and deviation >= _MIN):
        raise SettingsError(f"{table}['{name}']: standard deviation {deviation!r}; expected {_MIN:g} or more, in SI")
    if value is None:
        return name, None, deviation
    low, high = group.limits
    low, high = (low, high) if math.isfinite(low) else (-1e3, 1e3)
    if group.name.endswith("cross_coupling"):
        low, high = -2.0, 2.0
    if not low <= value <= high:
        raise SettingsError(f"{table}['{name}'] = {value!r}; expected {low:g} to {high:g}, in SI")
    return name, value, deviation
