"""Many units: calibrations of all recordings in a folder, their results in one file, and the history of each unit."""
