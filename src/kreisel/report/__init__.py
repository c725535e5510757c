"""HTML reports: of one calibration in five sections, and of several devices. One file each, nothing fetched."""
