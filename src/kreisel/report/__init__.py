"""The HTML report of a calibration: one file, five sections, nothing fetched from anywhere."""

from kreisel.report.page import write_report

__all__ = ["write_report"]
