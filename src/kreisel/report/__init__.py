"""HTML reports: of one calibration in five sections, and of several devices. One file each, nothing fetched."""

from kreisel.report.devices import Device, write_devices
from kreisel.report.page import write_report

__all__ = ["Device", "write_devices", "write_report"]
