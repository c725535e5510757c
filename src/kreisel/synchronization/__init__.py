"""Bringing reference and IMU onto one clock: correlation of rate norms first, three axes afterwards."""
