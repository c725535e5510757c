"""Kalibr's YAML of several IMUs: those of a tray, each in its own frame i, against imu0, the reference unit.

Kalibr's body b is its imu0. Of imu k it writes T_i_b, p_i = T_i_b p_b, and time_offset, which is added to its stamps:
t_imu0 = t_imuk + time_offset. Source: IccSensors.py of ethz-asl/kalibr.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kreisel.exchange.chain_proof import proved
from kreisel.exchange.exported import ArrayRequest, ExportedArray, PlacedUnit
from kreisel.exchange.kalibr import FORMULA, FRAME_I, bias_text, dumped, imu_entry, losses_of
from kreisel.exchange.kalibr_model import InKalibrsFrame, in_kalibrs_frame
from kreisel.exchange.losses import clock_losses
from kreisel.geometry.rotation import Array


def export(request: ArrayRequest) -> ExportedArray:
    """Return Kalibr's YAML of the units of a tray, proved by a synthetic motion.

    Raises
    ------
    SettingsError
        If noise figures are missing.
    RecordingError
        If the proof fails: the places of the units do not belong to their calibrations.
    """
    own = [in_kalibrs_frame(placed.request.calibration.sensors) for placed in request.units]
    blocks, lost = [_head(request)], []
    for k, (placed, frame) in enumerate(zip(request.units, own, strict=True)):
        name = placed.unit.name
        missing = (*losses_of(frame), *clock_losses(placed.unit.skew))
        lost += [f"{name}: {text}" for text in missing]
        entry = imu_entry(placed.request, frame.model, relative_transform(placed, frame, own[0]), placed.unit.offset)
        blocks.append(_comments(k, placed, frame, missing) + dumped({f"imu{k}": entry}))
    text = "\n".join(blocks)
    units = [placed.unit for placed in request.units]
    renamed = [f"{unit.name} is imu{k} in the file" for k, unit in enumerate(units) if unit.name != f"imu{k}"]
    return ExportedArray({"": text}, tuple(lost), (proved(text, units).sentence, *renamed))


def relative_transform(placed: PlacedUnit, own: InKalibrsFrame, base: InKalibrsFrame) -> Array:
    """Return T_i_b (4, 4) of a unit, from frame i of the reference unit, Kalibr's b, to its own.

    Parameters
    ----------
    own, base
        The unit and the reference unit as Kalibr sees them, from their frames `imu`.

    Notes
    -----
    The frames' origins differ by unit: the place is that of frames `imu`, p_0 = R p + position.
    """
    unit = placed.unit
    if own is base:
        return np.eye(4)
    to_own = own.C_ib @ unit.rotation.T
    T_i_b = np.eye(4)
    T_i_b[:3, :3] = to_own @ base.C_ib.T
    T_i_b[:3, 3] = to_own @ (base.origin - unit.position) - own.C_ib @ own.origin
    return T_i_b


def _head(request: ArrayRequest) -> str:
    lines = [
        f"{request.title}: {len(request.units)} IMUs, by kreisel, as Kalibr writes its results. Direction: true to "
        "measured.",
        FORMULA,
        "does not hold, beside each IMU below.",
        "T_i_b: from b, the frame i of imu0, to that of the IMU: p_i = T_i_b p_b.",
        "time_offset: t_imu0 = t_imu + time_offset, at the IMU's first stamp of the recording.",
        *FRAME_I,
        *(f"Left out: {name}: {reason}" for name, reason in request.left_out.items()),
    ]
    return _commented(lines)


def _comments(k: int, placed: PlacedUnit, own: InKalibrsFrame, lost: Iterable[str]) -> str:
    unit, facts = placed.unit, placed.request.calibration.recording
    title = "" if facts is None or facts.title == facts.name else f", {facts.title}"
    lines = [f"imu{k}: {unit.name}{title}", f"Biases: {bias_text(own.model)}."]
    if k:
        first = "" if facts is None or facts.begin_ns is None else f" = {facts.begin_ns} ns"
        lines += [
            f"Standard deviations, in axes imu of the reference unit: of the middle of the accelerometers "
            f"[{_listed(unit.position_sd)}] m, of the rotation [{_listed(unit.rotation_sd)}] rad; of time_offset "
            f"{unit.offset_sd:.3g} s.",
            f"Clock: t_imu0 = t + time_offset + skew (t - first t), skew {unit.skew:.9g}, standard deviation "
            f"{unit.skew_sd:.3g}, first t{first}.",
        ]
    lines += [f"{name}: {source}" for name, source in placed.request.noise.sources.items()]
    return _commented([*lines, *(f"Not held: {text}" for text in lost)])


def _listed(values: Array) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _commented(lines: Iterable[str]) -> str:
    """Return lines as comments; a title may hold any characters."""
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)
