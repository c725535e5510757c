"""`recording.toml`: what the user knows about the cell. Every key is optional, none is guessed at."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kreisel.errors import RecordingError, unknown_name
from kreisel.inertial.noise import GRADES

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ImuTable(_Table):
    """Noise densities and prior knowledge of the IMU, SI."""

    gyro_noise_density: Positive | None = None
    accel_noise_density: Positive | None = None
    gyro_offset_sd: Positive | None = None
    accel_offset_sd: Positive | None = None
    grade: str | None = None


class SiteTable(_Table):
    """Where on Earth the cell stands."""

    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    height_m: Annotated[float, Field(ge=-500.0, le=9000.0)] | None = None
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] | None = None


class ReferenceTable(_Table):
    """What kind of reference it is and how good its poses are (standard deviations)."""

    kind: Literal["robot", "mocap"] | None = None
    position_sd: Positive | None = None
    orientation_sd: Positive | None = None
    standstill_position_sd: Positive | None = None
    standstill_orientation_sd: Positive | None = None


class RobotTable(_Table):
    """The robot's kinematics and how far the real one may be from them (standard deviations)."""

    urdf: str | None = None
    tcp: str | None = None
    length_sd: NotNegative | None = None
    angle_sd: NotNegative | None = None


class RecordingSettings(_Table):
    """The whole of `recording.toml`."""

    imu: ImuTable = ImuTable()
    site: SiteTable = SiteTable()
    reference: ReferenceTable = ReferenceTable()
    robot: RobotTable = RobotTable()


_TABLES: dict[str, type[BaseModel]] = {
    "imu": ImuTable,
    "site": SiteTable,
    "reference": ReferenceTable,
    "robot": RobotTable,
}


def read_settings(path: Path) -> RecordingSettings:
    """Return the settings in a TOML file.

    Raises
    ------
    RecordingError
        If it is not TOML, has an unknown key (the known ones are listed) or an impossible value.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RecordingError(f"not valid TOML: {error}", file=path) from error
    for name, table in content.items():
        if name not in _TABLES:
            raise RecordingError(unknown_name("table", name, _TABLES), file=path)
        if not isinstance(table, dict):
            raise RecordingError(f"'{name}' must be a table: write [{name}]", file=path)
        for key in table:
            if key not in _TABLES[name].model_fields:
                raise RecordingError(unknown_name("key", f"{name}.{key}", _TABLES[name].model_fields), file=path)
    try:
        settings = RecordingSettings.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise RecordingError(f"{place} = {first['input']!r}: {first['msg']}", file=path) from error
    if settings.imu.grade is not None and settings.imu.grade not in GRADES:
        raise RecordingError(unknown_name("grade", settings.imu.grade, GRADES), file=path)
    return settings
