"""A calibration applied to readings in files, in bags, through pipes and from devices."""
