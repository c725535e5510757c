"""Simulated recordings: truth first, readings and poses from it."""

from kreisel.simulation.small_cell import Truth, simulate, write_truth

__all__ = ["Truth", "simulate", "write_truth"]
