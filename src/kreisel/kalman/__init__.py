"""The sigma-point Kalman filter: one estimator, with the compiled library behind it."""
