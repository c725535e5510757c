"""What the user may choose about a calibration."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from kreisel.errors import SettingsError, unknown_name
from kreisel.estimation.sigma_points import WEIGHTS
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.model.groups import REGISTRY, group_named
from kreisel.model.parameters import GROUPS
from kreisel.model.stated_parameters import Known, known_parameters, parse_prior, parse_value, place_of

ESTIMATORS = ("spkf", "ukf", "cdkf", "ckf", "ekf", "iekf", "inverse", "batch")
"""Names of estimators; `calibration.calibrate.ESTIMATORS` has what they name."""

BY_CHOICE = tuple(group.name for group in REGISTRY if group.by_choice)
"""Groups that are estimated only if asked for."""


CUBES = 3
"""Order of sensor polynomials from which on `gyro_cubic` is a part of them."""

SENSORS, USES = ("gyroscope", "accelerometer"), ("orientations",)
"""Sensors that a verdict may be about, and parts of a reference that may be all of it that is used."""


@dataclass(frozen=True, init=False)
class CalibrationSettings:
    """Choices of a calibration; the defaults suit an unknown IMU on a robot.

    The constructor takes names and values in the forms that a user writes; what is kept has one type each.

    Attributes
    ----------
    estimator
        One of `ESTIMATORS`; ``spkf`` where `sigma_points` are given. By the recording if None: ``ekf``, which finds
        what sigma points find in less time, or ``spkf`` where the reference has no orientations and attitudes are far
        off at first.
    sigma_points
        Weights of ``spkf``: ``central-difference`` if None, ``unscented`` or ``cubature``.
    update_interval
        Seconds between two uses of the reference; chosen by the kind of reference if None.
    polynomial_order
        N of equations (1) and (2); 1 is offset and scale, 2 adds a quadratic term.
    fixed
        Groups of parameters that are not estimated. The constructor takes names of groups or of single parameters
        (their path in the result file, ``gyroscope.offset[0]``), or a mapping of names to the values they are held at,
        in SI and in the shape they have in the result file: (3, 3) for cross couplings and lever arms, (3,) for
        offsets, (order - 1, 3) for polynomials, a number for `gravity` (its magnitude), `time_offset`, `time_skew` and
        single parameters. What has no value, or None, is held at its start value.
    fixed_values
        Values of groups in `fixed`, as flat tuples.
    priors
        What is known of single parameters: name, value and standard deviation; single parameters that are fixed have
        the deviation 0. The constructor takes a mapping of names, of groups too, to (value, standard deviation), in
        SI. It takes the place of what kreisel assumes; an effect with a prior is estimated.
    estimated
        Groups of `BY_CHOICE` that are estimated too.
    skew
        Whether the clocks' ratio is estimated; if None, with orientations, and else where positions show it.
    size_effect
        Form of the eccentricity term in equation (2).
    passes
        Passes over the data, each starting from the estimates of the one before; as many as are useful if None.
        Further ones follow as long as noise figures are adapted.
    only
        ``gyroscope`` or ``accelerometer``: the verdict is that of this sensor; by default of both, or of the gyros
        where the reference has no positions.
    use
        ``orientations``: positions of the reference are left out.
    partial
        Whether the recording is one of several that are fused: parameters that are not observable are then no reason to
        reject it.

    Raises
    ------
    SettingsError
        If a choice is unknown or impossible.
    """

    estimator: str | None
    sigma_points: str | None
    update_interval: float | None
    polynomial_order: int
    fixed: tuple[str, ...]
    estimated: tuple[str, ...]
    skew: bool | None
    size_effect: SizeEffect
    passes: int | None
    only: str | None
    use: str | None
    partial: bool
    fixed_values: tuple[tuple[str, tuple[float, ...]], ...]
    priors: tuple[Known, ...]

    def __init__(
        self,
        estimator: str | None = None,
        sigma_points: str | None = None,
        update_interval: float | None = None,
        polynomial_order: int = 1,
        fixed: Collection[str] | Mapping[str, Any] = (),
        estimated: Collection[str] = (),
        skew: bool | None = None,
        size_effect: SizeEffect | str = SizeEffect.COMPLETED,
        passes: int | None = None,
        only: str | None = None,
        use: str | None = None,
        partial: bool = False,
        fixed_values: Sequence[tuple[str, Sequence[float]]] = (),
        priors: Mapping[str, Any] | tuple[Known, ...] = (),
    ) -> None:
        _check_choices(estimator, sigma_points, size_effect, only, use)
        if skew not in (None, True, False):
            raise SettingsError(f"skew = {skew!r}; expected True, False or None")
        _check_numbers(polynomial_order, update_interval, passes)
        groups, single = _parts_of_fixed(fixed)
        known = {one[0]: one for one in known_parameters(priors or {}, polynomial_order, "priors")}
        known |= {one[0]: one for one in known_parameters(single, polynomial_order, "fixed")}
        of = dict.fromkeys(place_of(name, polynomial_order)[0] for name in known)
        if twice := [group for group in of if group in groups]:
            raise SettingsError(f"{twice[0]} is fixed; a prior or a value for a part of it contradicts that")
        values = {name: shaped(name, value, polynomial_order) for name, value in fixed_values}
        values |= {name: value for name, value in groups.items() if value is not None}
        names = _names(groups if isinstance(fixed, Iterable) else fixed, "fixed", "group", GROUPS)
        wanted = (estimated,) if isinstance(estimated, str) else estimated
        if isinstance(wanted, Iterable):
            wanted = (*wanted, *(group for group in of if group in BY_CHOICE))
        chosen = _names(wanted, "estimated", "group that is estimated by choice", BY_CHOICE)
        if polynomial_order >= CUBES and "gyro_cubic" in chosen and "gyro_polynomial" not in names:
            raise SettingsError(f"gyro_cubic is a part of the polynomials of order {polynomial_order}; leave it out")
        held = {name: fixed_value(name, values[name], polynomial_order) for name in names if name in values}
        vars(self).update(
            estimator=estimator,
            sigma_points=sigma_points,
            update_interval=update_interval,
            polynomial_order=polynomial_order,
            fixed=names,
            estimated=chosen,
            skew=True if "time_skew" in of and skew is None else skew,
            size_effect=SizeEffect(size_effect),
            passes=passes,
            only=only,
            use=use,
            partial=partial,
            fixed_values=tuple((name, tuple(value.tolist())) for name, value in held.items()),
            priors=tuple(known.values()),
        )

    def with_stated(self, fixed: Mapping[str, str], prior: Mapping[str, str]) -> CalibrationSettings:
        """Return the settings with what a recording states of its parameters, where they say nothing themselves.

        Parameters
        ----------
        fixed, prior
            Tables of recording.toml.

        Raises
        ------
        SettingsError
            If a name is unknown or a value is impossible.
        """
        if not fixed and not prior:
            return self
        own = {name for name, _, _ in self.priors} | set(self.fixed)
        groups = {g: shaped(g, value, self.polynomial_order) for g, value in self.fixed_values}
        stated = {n: parse_value(text, f"recording.toml: fixed.{n}") for n, text in fixed.items() if n not in own}
        known = {n: parse_prior(text, f"recording.toml: prior.{n}") for n, text in prior.items() if n not in own}
        try:
            priors = known_parameters(known, self.polynomial_order, "prior")
            fixed_now = {**dict.fromkeys(self.fixed), **groups, **stated}
            known_now = tuple({one[0]: one for one in (*priors, *self.priors)}.values())
            return CalibrationSettings(**{**vars(self), "fixed": fixed_now, "priors": known_now})
        except SettingsError as error:
            raise SettingsError(f"recording.toml: {error}") from error

    @property
    def fixed_parameters(self) -> tuple[str, ...]:
        """Names of single parameters that are fixed."""
        return tuple(name for name, _, deviation in self.priors if deviation == 0.0)

    def value_of(self, group: str) -> Array | None:
        """Return the value a group is held at, as a flat array; None where none was given."""
        value = dict(self.fixed_values).get(group)
        return None if value is None else np.array(value)


def _check_choices(
    estimator: str | None, sigma_points: str | None, size_effect: SizeEffect | str, only: str | None, use: str | None
) -> None:
    if estimator is not None and estimator not in ESTIMATORS:
        raise SettingsError(unknown_name("estimator", estimator, ESTIMATORS))
    if sigma_points is not None and estimator not in (None, "spkf"):
        raise SettingsError(f"sigma_points = {sigma_points!r} are for the estimator spkf, and {estimator} has its own")
    if sigma_points is not None and sigma_points not in WEIGHTS:
        raise SettingsError(unknown_name("choice of sigma points", sigma_points, WEIGHTS))
    if size_effect not in list(SizeEffect):
        raise SettingsError(unknown_name("size effect", str(size_effect), [form.value for form in SizeEffect]))
    if only is not None and only not in SENSORS:
        raise SettingsError(unknown_name("sensor", only, SENSORS))
    if use is not None and use not in USES:
        raise SettingsError(unknown_name("part of the reference", use, USES))


def _check_numbers(order: int, interval: float | None, passes: int | None) -> None:
    for name, value, kind in (
        ("polynomial_order", order, Integral), ("update_interval", interval, Real), ("passes", passes, Integral),
    ):  # fmt: skip
        if value is not None and (isinstance(value, bool) or not isinstance(value, kind)):
            raise SettingsError(f"{name} = {value!r}; expected a {'whole ' if kind is Integral else ''}number")
    if not 1 <= order <= 5:
        raise SettingsError(f"polynomial order {order}; expected 1 to 5")
    if interval is not None and not 0.005 <= interval <= 10.0:
        raise SettingsError(f"update interval {interval:g} s; expected 0.005 to 10")
    if passes is not None and not 1 <= passes <= 10:
        raise SettingsError(f"{passes} passes; expected 1 to 10")


def _parts_of_fixed(given: object) -> tuple[dict[str, Any], dict[str, tuple[Any, float]]]:
    """Return groups with their values (None: the start value), and single parameters with value and deviation 0."""
    if isinstance(given, str):
        given = (given,)
    if not isinstance(given, Iterable):
        return {}, {}
    values = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given)
    single = {name: (value, 0.0) for name, value in values.items() if "." in str(name)}
    return {name: value for name, value in values.items() if name not in single}, single


def _names(given: object, argument: str, kind: str, known: Iterable[str]) -> tuple[str, ...]:
    """Return names of groups, each once; a single name is not read as a collection of letters."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Iterable):
        raise SettingsError(f"{argument} = {given!r}; expected names of groups: {', '.join(known)}")
    for name in names:
        if name not in known:
            raise SettingsError(unknown_name(kind, str(name), known))
    return tuple(dict.fromkeys(names))


def _shapes(order: int) -> dict[str, tuple[int, ...]]:
    """Return the shape in the result file of every group that may be given a value."""
    return {group.name: group.shape(order) for group in REGISTRY if group.shape is not None}


def shaped(group: str, value: Sequence[float], order: int) -> Array:
    """Return a flat value of a group in its own shape, or unchanged if it has another size."""
    flat, shape = np.array(value, dtype=float), _shapes(order).get(group, (-1,))
    return flat.reshape(shape) if flat.size == math.prod(shape) else flat


def fixed_value(group: str, value: object, order: int) -> Array:
    """Return a value that a group is to be held at as it is stored, flat.

    Parameters
    ----------
    value
        SI, in the shape the group has in the result file. It is known, or so accurate that no estimate is needed.
    order
        Of the sensor polynomials.

    Raises
    ------
    SettingsError
        If the group has no value of its own, or the value has another shape or is impossible.
    """
    shapes = _shapes(order)
    if group not in shapes:
        raise SettingsError(
            f"fixed['{group}'] cannot be given a value; fix it without one, or give values of {', '.join(shapes)}"
        )
    try:
        out = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"fixed['{group}'] is not an array of numbers: {error}") from error
    if out.shape != shapes[group] or not out.size:
        hint = ", for which polynomial_order must be 2 or more" if group.endswith("polynomial") and order == 1 else ""
        raise SettingsError(f"fixed['{group}'] has the shape {out.shape}, expected {shapes[group]}{hint}")
    low, high = group_named(group).limits
    if not (np.isfinite(out) & (low <= out) & (out <= high)).all():
        expected = f"{low:g} to {high:g}" if np.isfinite(low) else "finite numbers"
        raise SettingsError(f"fixed['{group}'] = {out.tolist()}; expected {expected}, in SI")
    if group.endswith("cross_coupling"):
        singular = np.linalg.svd(out, compute_uv=False)
        if singular[0] > 2.0 or singular[-1] < 0.5:
            raise SettingsError(
                f"fixed['{group}'] scales readings by {singular[-1]:.3g} to {singular[0]:.3g}, expected about 1: a "
                "cross-coupling matrix takes readings in SI to true values"
            )
    return out.ravel()
