"""What the user may choose about a calibration."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.calibration.parameters import GROUPS
from kreisel.errors import SettingsError, unknown_name
from kreisel.estimation.sigma_points import WEIGHTS
from kreisel.inertial.sensor_model import SizeEffect

ESTIMATORS = {"spkf": "central-difference", "ekf": "linear"}
"""Estimators and the sigma points each uses by default."""

BY_CHOICE = ("robot_gears", "robot_compliance")
"""Groups that are estimated only if asked for."""


@dataclass(frozen=True)
class CalibrationSettings:
    """Choices of a calibration; the defaults suit an unknown IMU on a robot.

    Attributes
    ----------
    estimator
        ``spkf`` or ``ekf``.
    sigma_points
        Weights of the SPKF: ``central-difference`` or ``unscented``; by default the estimator's own.
    update_interval
        Seconds between two uses of the reference; chosen by the kind of reference if None.
    polynomial_order
        N of equations (1) and (2); 1 is offset and scale, 2 adds a quadratic term.
    fixed
        Groups of parameters that are not estimated.
    estimated
        Groups of `BY_CHOICE` that are estimated too.
    skew
        Whether the clocks' ratio is estimated; decided by the correlation if None.
    size_effect
        Form of the eccentricity term in equation (2).
    passes
        Passes over the data, each starting from the estimates of the one before; as many as pay if None.
    """

    estimator: str = "spkf"
    sigma_points: str | None = None
    update_interval: float | None = None
    polynomial_order: int = 1
    fixed: tuple[str, ...] = ()
    estimated: tuple[str, ...] = ()
    skew: bool | None = None
    size_effect: SizeEffect = SizeEffect.COMPLETED  # or its name
    passes: int | None = None

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise SettingsError(unknown_name("estimator", self.estimator, ESTIMATORS))
        if self.sigma_points is not None and self.sigma_points not in WEIGHTS:
            raise SettingsError(unknown_name("choice of sigma points", self.sigma_points, WEIGHTS))
        if self.size_effect not in list(SizeEffect):
            raise SettingsError(unknown_name("size effect", str(self.size_effect), [form.value for form in SizeEffect]))
        object.__setattr__(self, "size_effect", SizeEffect(self.size_effect))
        for group in self.fixed:
            if group not in GROUPS:
                raise SettingsError(unknown_name("group", group, GROUPS))
        for group in self.estimated:
            if group not in BY_CHOICE:
                raise SettingsError(unknown_name("group that is estimated by choice", group, BY_CHOICE))
        if not 1 <= self.polynomial_order <= 5:
            raise SettingsError(f"polynomial order {self.polynomial_order}; expected 1 to 5")
        if self.update_interval is not None and not 0.005 <= self.update_interval <= 10.0:
            raise SettingsError(f"update interval {self.update_interval:g} s; expected 0.005 to 10")
        if self.passes is not None and not 1 <= self.passes <= 10:
            raise SettingsError(f"{self.passes} passes; expected 1 to 10")

    @property
    def weights(self) -> str:
        """Name of the sigma points' weights."""
        return self.sigma_points or ESTIMATORS[self.estimator]
