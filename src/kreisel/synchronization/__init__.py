"""Synchronisation of reference and IMU: first by correlation of rate norms, then by a fit of all three axes."""
