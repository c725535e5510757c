"""Several IMUs on one rigid body: their common motion, each one's calibration, and where they lie."""
