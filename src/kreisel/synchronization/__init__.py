"""Bringing reference and IMU onto one clock: correlation of rate norms first, three axes afterwards."""

from kreisel.synchronization.clock import Clock
from kreisel.synchronization.conventions import better_reading, check_conventions
from kreisel.synchronization.correlation import Correlation, correlate
from kreisel.synchronization.rate_fit import RateFit, fit_rates

__all__ = ["Clock", "Correlation", "RateFit", "better_reading", "check_conventions", "correlate", "fit_rates"]
