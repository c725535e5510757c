"""Monte-Carlo studies of calibrations in the virtual cell: whether errors agree with standard deviations."""
