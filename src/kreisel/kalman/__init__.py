"""The sigma-point Kalman filter: one estimator, run by the compiled library."""
