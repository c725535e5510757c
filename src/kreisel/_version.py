"""The version of kreisel, read by the build."""

__version__ = "0.1.1"
