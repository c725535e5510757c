"""The calibration itself: the problem set up from a recording, its first values, the run, the answer."""
