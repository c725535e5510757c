"""HTML reports: of one calibration in five sections, and of several devices. Each is one file that works offline."""
