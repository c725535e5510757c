"""Effects of sensors written in other languages: texts made from the one description of each in `effects`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import EFFECTS, Arrangement, Factor


@dataclass(frozen=True)
class AxisLanguage:
    """A language whose sums are written axis by axis.

    Attributes
    ----------
    factors
        Returns a factor in an axis, given the name of the sensor's own reading.
    number
        Returns a number as the language writes it.
    """

    factors: Callable[[Factor, str, int], str]
    number: Callable[[float], str]


@dataclass(frozen=True)
class ArrayLanguage:
    """A language whose sums are written for whole arrays (n, 3).

    Attributes
    ----------
    factors
        Returns a factor, given the name of the sensor's own readings.
    product
        Returns the product, element by element, of a row of numbers and factors.
    power
        Returns the power of a factor.
    by_matrix
        Returns the product of an array and the transpose of a matrix.
    array, number
        Return arrays and numbers as the language writes them.
    """

    factors: Callable[[Factor, str], str]
    product: Callable[[list[str]], str]
    power: Callable[[str, int], str]
    by_matrix: Callable[[str, str], str]
    array: Callable[[Array], str]
    number: Callable[[float], str]


def of_axis(group: str, value: Array, axis: int, own: str, language: AxisLanguage) -> list[str]:
    """Return the terms that an effect adds to the reading of an axis; `value` flat, as stored.

    own: name of the sensor's own reading.
    """
    effect, flat, out = EFFECTS[group], np.asarray(value, dtype=float).ravel(), []
    for i, factors in enumerate(effect.products(flat.size)):
        if effect.arrangement is Arrangement.MATRIX:
            pairs = [(3 * axis + k, k) for k in range(3)]
        elif effect.arrangement is Arrangement.ALL_AXES:
            pairs = [(0, axis)]
        else:
            pairs = [(3 * i + axis, axis)]
        out += [
            " * ".join([language.number(float(flat[place])), *(language.factors(one, own, k) for one in factors)])
            for place, k in pairs
        ]
    return out


def of_arrays(group: str, value: Array, own: str, language: ArrayLanguage) -> list[str]:
    """Return the terms that an effect adds to the readings of all axes; arguments as for `of_axis`."""
    effect, flat, out = EFFECTS[group], np.asarray(value, dtype=float).ravel(), []
    for i, factors in enumerate(effect.products(flat.size)):
        counts: Mapping[Factor, int] = {one: factors.count(one) for one in factors}
        texts = [
            language.factors(one, own) if n == 1 else language.power(language.factors(one, own), n)
            for one, n in counts.items()
        ]
        if effect.arrangement is Arrangement.MATRIX:
            out.append(language.by_matrix(language.product(texts), language.array(flat.reshape(3, 3))))
            continue
        common = effect.arrangement is Arrangement.ALL_AXES
        number = language.number(float(flat[0])) if common else language.array(flat[3 * i : 3 * i + 3])
        out.append(language.product([number, *texts]))
    return out
