"""Readings of single units of a recording: those of a reference were moved, and are checked as such."""

from dataclasses import replace

import numpy as np

from kreisel.array.unit_readings import unit_reader
from kreisel.formats.loading import load
from kreisel.formats.write import write, write_imu
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import parse_cell

SPIKED = [1000, 2000, 3000]


def test_spikes_of_a_unit_are_left_out_where_a_reference_says_that_it_was_moved(tmp_path):
    cell = {"seed": 9, "seconds": 40.0, "imu": {"grade": "industrial-mems", "rate": 100.0}, "tray": {"units": 2}}
    first, second = (simulate(parse_cell(cell, tmp_path), tmp_path, unit=k)[1] for k in range(2))
    forces = second.imu.accelerations.copy()
    forces[SPIKED, 1] += 40.0
    write(first, tmp_path / "moved")
    write_imu(replace(second.imu, accelerations=forces), tmp_path / "moved" / "imu1")
    found = unit_reader(load(tmp_path / "moved"), "imu0")("imu1")
    assert np.isin(second.imu.stamps_ns[SPIKED], found.imu.stamps_ns).sum() == 0
    assert found.imu.stamps_ns.size == second.imu.stamps_ns.size - len(SPIKED)
    assert [warning.subject for warning in found.warnings] == ["masked"]
