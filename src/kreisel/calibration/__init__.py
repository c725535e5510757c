"""From a recording to a calibration: what is judged once the filter has run, and the result."""
