"""Recordings of an IMU and of reference poses: the type, its files, and what can be wrong with it."""

from kreisel.recording.load import load
from kreisel.recording.recording import Finding, ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording.settings import RecordingSettings

__all__ = [
    "Finding",
    "ImuSamples",
    "JointAngles",
    "Recording",
    "RecordingSettings",
    "ReferencePoses",
    "load",
]
