"""`recording.toml`: what the user knows about the cell. Every key is optional; kreisel guesses none."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, ValidationError, field_validator

from kreisel.errors import RecordingError, unknown_name
from kreisel.files import read_toml
from kreisel.inertial.noise_figures import GRADES


def _between(low: float, high: float) -> Any:
    """Return the bounds of a figure: far beyond real values, to catch a figure in another unit."""
    return Field(ge=low, le=high, allow_inf_nan=False)


Metres = Annotated[float, _between(1e-9, 0.2)]
Radians = Annotated[float, _between(1e-9, 0.3)]


_Within = Annotated[float, _between(-3.0, 3.0)]
_Unit = Annotated[float, _between(-1.0, 1.0)]
_Listed = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ImuTable(_Table):
    """Noise densities and prior knowledge of the IMU, SI."""

    gyro_noise_density: Annotated[float, _between(1e-9, 0.1)] | None = None
    accel_noise_density: Annotated[float, _between(1e-8, 1.0)] | None = None
    gyro_random_walk: Annotated[float, _between(1e-12, 1e-2)] | None = None
    accel_random_walk: Annotated[float, _between(1e-10, 1e-1)] | None = None
    gyro_offset_sd: Annotated[float, _between(1e-10, 2.0)] | None = None
    accel_offset_sd: Annotated[float, _between(1e-8, 10.0)] | None = None
    grade: str | None = None
    time_base: Literal["imu", "reference"] | None = None

    @field_validator("grade")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in GRADES:
            raise ValueError(unknown_name("grade", name, GRADES))
        return name


class SiteTable(_Table):
    """Where on Earth the cell is."""

    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    height_m: Annotated[float, Field(ge=-500.0, le=9000.0)] | None = None
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] | None = None
    gravity_sd: Annotated[float, _between(1e-7, 0.1)] | None = None


class ReferenceTable(_Table):
    """Kind of the reference and accuracy of its poses (standard deviations)."""

    kind: Literal["robot", "mocap"] | None = None
    position_sd: Metres | None = None
    orientation_sd: Radians | None = None
    standstill_position_sd: Metres | None = None
    standstill_orientation_sd: Radians | None = None
    scale_sd: Annotated[float, _between(0.0, 0.1)] | None = None


class RobotTable(_Table):
    """The robot's kinematics and how far the real robot may be from them (standard deviations)."""

    urdf: str | None = None
    tcp: str | None = None
    model: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    tool_position: Annotated[tuple[_Within, _Within, _Within], _Listed] | None = None
    tool_quaternion: Annotated[tuple[_Unit, _Unit, _Unit, _Unit], _Listed] | None = None
    length_sd: Annotated[float, _between(0.0, 0.2)] | None = None
    angle_sd: Annotated[float, _between(0.0, 0.3)] | None = None


Text = Annotated[str, Field(min_length=1, max_length=500)]


class DeviceTable(_Table):
    """The device that is calibrated, for reports, certificates and the history of a unit."""

    maker: Text | None = None
    type: Text | None = None
    serial_number: Text | None = None


class CertificateTable(_Table):
    """What a certificate says beyond the result."""

    number: Text | None = None
    customer: Text | None = None
    laboratory: Text | None = None
    operator: Text | None = None
    place: Text | None = None
    date: Text | None = None
    temperature: Text | None = None
    reference: Text | None = None
    traceability: Text | None = None
    procedure: Text | None = None
    remarks: Text | None = None


class ImuColumns(_Table):
    """Where the IMU's readings stand in a table of another shape; see `formats.mapping`.

    Accelerations may stand in a file of their own, with their own times.
    """

    file: str | None = None
    time: str | None = None
    rate: str | None = None
    acceleration: str | None = None
    acceleration_file: str | None = None
    acceleration_time: str | None = None
    temperature: str | None = None


class ReferenceColumns(_Table):
    """Where the poses stand."""

    file: str | None = None
    time: str | None = None
    position: str | None = None
    orientation: str | None = None


class JointColumns(_Table):
    """Where the joint angles stand."""

    file: str | None = None
    time: str | None = None
    angles: str | None = None


class ColumnsTable(_Table):
    """Which columns of which tables hold what.

    `imus` are tables of several IMUs, [columns.imu1] for that of this name; [columns.imu] is that of imu0, and says
    where the others stand unless they do.
    """

    imu: ImuColumns = ImuColumns()
    reference: ReferenceColumns = ReferenceColumns()
    joints: JointColumns = JointColumns()
    imus: dict[str, ImuColumns] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the IMUs, in the order of their numbers."""
        first = {"imu0"} if self.imu.rate is not None or not self.imus else set()
        return tuple(sorted({*first, *self.imus}, key=lambda name: int(name[3:])))

    def of_imu(self, name: str) -> ColumnsTable:
        """Return the columns with those of one of the IMUs as that of the IMU."""
        own = self.imus.get(name)
        stated = {} if own is None else own.model_dump(exclude_none=True)
        first = self.imu.model_dump(include={"file", "time"}) if name != "imu0" else self.imu.model_dump()
        return self.model_copy(update={"imu": ImuColumns(**{**first, **stated})})


class RecordingSettings(_Table):
    """The whole of `recording.toml`.

    `imus` and `devices` are tables of single IMUs, [imu1] and [device1] for the readings in `imu1`; without one [imu]
    and [device] hold. `fixed` and `prior` are what the user knows of single parameters, or of groups of them, as texts
    by their names: "true" or a value in JSON, and "value +- standard deviation"; see `model.stated_parameters`.
    """

    imu: ImuTable = ImuTable()
    site: SiteTable = SiteTable()
    reference: ReferenceTable = ReferenceTable()
    robot: RobotTable = RobotTable()
    device: DeviceTable = DeviceTable()
    certificate: CertificateTable = CertificateTable()
    columns: ColumnsTable | None = None
    imus: dict[str, ImuTable] = {}
    devices: dict[str, DeviceTable] = {}
    fixed: dict[str, str] = {}
    prior: dict[str, str] = {}
    _of_all: tuple[ImuTable, DeviceTable] | None = PrivateAttr(None)

    def of_imu(self, name: str) -> RecordingSettings:
        """Return the settings with the tables of one IMU by its name, of these or of those of another IMU."""
        imu, device = self._of_all or (self.imu, self.device)
        number = name.removeprefix("imu")
        own = {"imu": self.imus.get(name, imu), "device": self.devices.get(f"device{number}", device)}
        return self._with(own, None if own == {"imu": imu, "device": device} else (imu, device))

    def of_all_imus(self) -> RecordingSettings:
        """Return the settings with the tables that hold for all IMUs."""
        imu, device = self._of_all or (self.imu, self.device)
        return self._with({"imu": imu, "device": device}, None)

    def _with(self, tables: dict[str, Any], of_all: tuple[ImuTable, DeviceTable] | None) -> RecordingSettings:
        out = self.model_copy(update=tables)
        out._of_all = of_all
        return out

    @property
    def tables(self) -> dict[str, dict[str, Any]]:
        """What is set, by the tables of recording.toml."""
        tables = self.model_dump(exclude_none=True)
        of_units = tables.pop("imus") | tables.pop("devices")
        if "columns" in tables:
            tables["columns"] |= tables["columns"].pop("imus")
        return tables | of_units

    @field_validator("fixed", "prior", mode="before")
    @classmethod
    def _as_texts(cls, table: object) -> object:
        return _flat(table) if isinstance(table, dict) else table


def _flat(table: dict[str, Any], above: str = "") -> dict[str, str]:
    """Return the entries of a table as texts; keys with dots, which TOML reads as tables in tables, are joined."""
    out: dict[str, str] = {}
    for key, value in table.items():
        name = f"{above}{key}"
        if isinstance(value, dict) and set(value) == {"value", "sd"}:
            out[name] = f"{json.dumps(value['value'])} +- {json.dumps(value['sd'])}"
        elif isinstance(value, dict):
            out |= _flat(value, f"{name}.")
        else:
            out[name] = value if isinstance(value, str) else json.dumps(value, default=str)
    return out


_OPEN = ("fixed", "prior")
"""Tables whose keys are names of parameters."""

_OF_ONE_IMU = {"imu": "imus", "device": "devices"}
"""Tables that single IMUs have too, with the IMU's number behind the name, and where they are kept."""

_TABLES: dict[str, type[BaseModel]] = {
    "imu": ImuTable,
    "site": SiteTable,
    "reference": ReferenceTable,
    "robot": RobotTable,
    "device": DeviceTable,
    "certificate": CertificateTable,
    "columns": ColumnsTable,
}


def read_settings(path: Path) -> RecordingSettings:
    """Return the settings in a TOML file.

    Raises
    ------
    RecordingError
        If it is not TOML, has an unknown key (the known ones are listed) or an impossible value.
    """
    example, remedy = (
        'write tables and keys as in [imu], grade = "fog"',
        "; repair it, or remove it to use the defaults",
    )
    content = read_toml(path, example, partial(RecordingError, file=path), remedy)
    for name, table in content.items():
        kind = _kind_of(name)
        if kind not in _TABLES and kind not in _OPEN:
            raise RecordingError(unknown_name("table", name, (*_TABLES, *_OPEN)), file=path)
        if not isinstance(table, dict):
            raise RecordingError(f"'{name}' must be a table: write [{name}]", file=path)
        for key in table if kind in _TABLES else ():
            if (_kind_of(key) if name == "columns" else key) not in _TABLES[kind].model_fields:
                raise RecordingError(unknown_name("key", f"{name}.{key}", _TABLES[kind].model_fields), file=path)
    try:
        # strict: "0.001" and true are not numbers
        return RecordingSettings.model_validate(with_units_together(content), strict=True)
    except ValidationError as error:
        raise RecordingError(what_is_wrong(error), file=path) from error


def with_units_together(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables as `RecordingSettings` has them: [imu1], also of columns, is in `imus`, [device1] in `devices`."""
    out: dict[str, Any] = {}
    for name, table in tables.items():
        kind = _kind_of(name)
        if name == "columns":
            out[name] = with_units_together(table)
        elif kind == name:
            out[name] = table
        else:
            out.setdefault(_OF_ONE_IMU[kind], {})[name] = table
    return out


def _kind_of(name: str) -> str:
    """Return which table one of this name is: [imu1] is one of [imu]."""
    plain = name.rstrip("0123456789")
    return plain if plain in _OF_ONE_IMU else name


def what_is_wrong(error: ValidationError) -> str:
    """Return which setting is not accepted, and why, on one line."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    units = "; units are SI" if place.startswith(("imu.", "reference.", "robot.")) and "number" in first["type"] else ""
    units = (
        "; units are SI" if first["type"].startswith(("greater", "less", "finite")) and "_deg" not in place else units
    )
    return f"{place} = {_short(first['input'])} is not accepted: {first['msg'].removeprefix('Value error, ')}{units}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"
