"""What a result file says of the recording it came from."""

from __future__ import annotations

from kreisel.calibration.result_sections import RecordingFacts, StatedNoise
from kreisel.preparation.imu_noise import noise_stated
from kreisel.recording.recording import DataWarning, Recording


def recording_facts(
    recording: Recording, warnings: tuple[DataWarning, ...], reference: str, poses: int, kind: str = ""
) -> RecordingFacts:
    """Return the facts about a recording.

    Parameters
    ----------
    warnings
        What was found in it.
    reference, poses, kind
        Name, number of poses, and stated kind of the reference.
    """
    imu, stated = recording.imu, noise_stated(recording)
    return RecordingFacts(
        name=recording.name,
        reference=reference,
        imu_samples=int(imu.stamps_ns.size),
        imu_rate_hz=1.0 / imu.interval,
        reference_poses=poses,
        duration_s=float(imu.seconds[-1]),
        warnings=tuple(str(warning) for warning in warnings),
        temperature_c=imu.usual_temperature,
        noise=None if stated is None else StatedNoise(stated[0], **stated[1]),
        device=recording.settings.device.model_dump(exclude_none=True),
        certificate=recording.settings.certificate.model_dump(exclude_none=True),
        digest=recording.sha256,
        begin_ns=int(imu.stamps_ns[0]),
        reference_kind=kind,
    )
