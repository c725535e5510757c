"""What the owner of a virtual cell hands over: recording.toml and the robot's description, right or wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.inertial.noise_figures import GRADES
from kreisel.recording.recording import Recording
from kreisel.recording.recording_settings import ImuTable, RecordingSettings, ReferenceTable, RobotTable, SiteTable
from kreisel.robot.description import Arm
from kreisel.robot.urdf import calibrated_urdf
from kreisel.simulation.cell_settings import Cell

_WRONG_LINK = 2
"""Index of the joint before which a link of the description is too long."""


def as_stated(cell: Cell, nominal: Arm, recording: Recording) -> Recording:
    """Return the recording with what its owner writes about it."""
    stated = cell.stated
    joints = recording.joints if stated.joints else None
    settings = recording_settings(cell, nominal) if stated.settings else RecordingSettings()
    urdf = _description(cell, nominal) if joints is not None and stated.settings else None
    return replace(recording, joints=joints, settings=settings, urdf=urdf)


def _description(cell: Cell, nominal: Arm) -> str:
    """Return the robot's URDF, with the errors of the cell's `stated`."""
    stated = cell.stated
    if stated.urdf_length_error == 0.0 and stated.tcp_error == 0.0:
        return nominal.urdf
    moved = np.zeros((len(nominal.joints) + 1, 6))
    moved[min(_WRONG_LINK, len(moved) - 2), :3] = stated.urdf_length_error / np.sqrt(3.0)
    moved[-1, 0] = stated.tcp_error
    return calibrated_urdf(nominal, moved)


def recording_settings(cell: Cell, arm: Arm) -> RecordingSettings:
    """Return what the cell's owner would write into recording.toml."""
    return RecordingSettings(imu=_imu(cell), site=_site(cell), reference=_reference(cell), robot=_robot(cell, arm))


def _imu(cell: Cell) -> ImuTable:
    stated = cell.stated
    name = stated.grade or cell.imu.grade
    grade = GRADES[name]
    if not cell.imu.noise:
        return ImuTable(
            gyro_noise_density=1e-7,
            accel_noise_density=1e-5,
            gyro_offset_sd=grade.gyro_offset_sd,
            accel_offset_sd=grade.accel_offset_sd,
        )
    if stated.densities:
        return ImuTable(
            gyro_noise_density=stated.noise_factor * grade.gyro_noise_density,
            accel_noise_density=stated.noise_factor * grade.accel_noise_density,
        )
    written: dict[str, float] = {}
    for factor, keys in (
        (stated.noise_factor, ("gyro_noise_density", "accel_noise_density")),
        (stated.offset_sd_factor, ("gyro_offset_sd", "accel_offset_sd")),
    ):
        if factor != 1.0:
            written |= {key: factor * getattr(grade, key) for key in keys}
    return ImuTable.model_validate({"grade": name, **written})


def _site(cell: Cell) -> SiteTable:
    stated, site = cell.stated, cell.site
    if not stated.place:
        return SiteTable(gravity=stated.gravity)
    latitude = site.latitude_deg if stated.latitude_deg is None else stated.latitude_deg
    return SiteTable(latitude_deg=latitude, height_m=site.height_m if stated.height else None, gravity=stated.gravity)


def _reference(cell: Cell) -> ReferenceTable:
    errors, factor = cell.errors, cell.stated.reference_factor

    def sd(value: float) -> float:
        return min(max(factor * float(value), 1e-7), 0.2)

    return ReferenceTable(
        kind=cell.reference.kind,
        # between two standstills the error passes from that of the first to that of the second
        position_sd=sd(np.hypot(errors.path_position_sd, errors.repeatability_position_sd)),
        orientation_sd=sd(np.hypot(errors.path_orientation_sd, errors.repeatability_orientation_sd)),
        standstill_position_sd=sd(errors.repeatability_position_sd),
        standstill_orientation_sd=sd(errors.repeatability_orientation_sd),
    )


def _robot(cell: Cell, arm: Arm) -> RobotTable:
    if cell.reference.kind != "robot":
        return RobotTable()
    stated, errors = cell.stated, cell.errors
    described = cell.reference.joints and stated.joints
    return RobotTable(
        urdf="robot.urdf" if described else None,
        tcp=arm.tcp if described else None,
        length_sd=stated.robot_factor * errors.geometry_length_sd if stated.robot else None,
        angle_sd=stated.robot_factor * errors.geometry_angle_sd if stated.robot else None,
    )
