"""From a recording to a calibration: the checks after the filter has run, and the result."""
