"""The virtual cell: motion, readings and poses as they would be recorded, with the truth behind them."""

from kreisel.simulation.cell import Truth, simulate, write_truth
from kreisel.simulation.settings import Cell, example, read_cell

__all__ = ["Cell", "Truth", "example", "read_cell", "simulate", "write_truth"]
