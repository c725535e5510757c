"""The sigma-point Kalman filter over a problem: one pass, its prior, and passes until the estimates settle."""
